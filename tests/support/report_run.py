"""The folder of a run that never ran, for tests of the report: two parts, one lost for a while, one for good."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from facetrack_cli.core.types import Frame
from facetrack_cli.trajectory.writers import WRITERS, RunSummary
from tests.support.media import SIZE
from tests.support.results import part, result, target
from tests.support.sinks import Alone

# part a is lost in frames 8 to 11, part b from 14 to the end
LOST = {"a": range(8, 12), "b": range(14, 99)}
KEYS = [5, 6, 8, 12, 14, 24]


def write_run(
    out: Path, clip: Path, *, size=SIZE, start=5, frames=20, times=None, recipe=None, targets=("face",), footer=None
) -> Path:
    """A run's folder with a trajectory of two parts; they keep to the lowest lines, clear of the pictures' numbers."""
    out.mkdir(parents=True, exist_ok=True)
    header = {
        "source": {"path": str(clip), "size": list(size), "fps": 25.0},
        "recipe": recipe or {"name": "mine", "description": "a test", "filter": {"type": "sir", "particles": 10}},
        "seed": 3,
        "init": {"from": "haar", "frame": start, "targets": {t: {"points": {"a": [9, 44]}} for t in targets}},
    }
    writer = WRITERS["json"](Alone(out / "trajectory.json"), header)
    still = np.zeros((1, 1, 3), np.uint8)
    for index in range(start, start + frames):
        found = []
        for k, name in enumerate("ab"):
            lost = index in LOST[name]
            status = "init" if index == start else "lost" if lost else "tracked"
            sure = 0.05 + k / 100 if lost else 0.75
            found.append(part(name, 12.0 + 30 * k, 44.0, 4.0, 4.0, status, sure, (0.01, 0.0, 0.01), 5.0))
        time_s = index / 25 if times is None else times[index]
        shown = [target(t, found, 10) for t in targets]
        writer.write(result(Frame(index, time_s, still), shown).rows)
    writer.close(footer or RunSummary())
    return out
