"""A diagnostic that a likelihood declares, and that nothing else names: from the tracker to files, plots and editor."""

import shutil
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.types import Correction, TargetStart
from facetrack_cli.editor.history import Fixer
from facetrack_cli.editor.save import save
from facetrack_cli.report import figures as plots
from facetrack_cli.run_folder.finished import open_run
from facetrack_cli.trackers.points import colour_ratio
from facetrack_cli.trajectory.diagnostics import EVIDENCE, Diagnostic
from facetrack_cli.trajectory.reader import CORRECTED, read_trajectory
from facetrack_cli.video.source import open_source
from tests.support.samples import FOLDER

CLIP, STOP = FOLDER / "expressions.mp4", 9
COLOURS = Diagnostic("colours", "spread of the colours around each part", "levels", (5,), least=0, decimals=3)
FOCUS = Diagnostic("focus", "mean spread of the colours", "levels", least=0, decimals=6)
SHARES = Diagnostic("shares", shape=None, least=0, most=1)


@dataclass(frozen=True)
class Focused(colour_ratio.ColourRatio):
    """The likelihood of the shipped recipes, which reports how far colours are spread."""

    diagnostics: ClassVar = (COLOURS, FOCUS, SHARES)

    def diagnose(self, learned):
        spread = np.asarray(learned.sigma, np.float32)
        return {"colours": spread, "focus": spread.mean(), "shares": {"half": 0.5, "unknown": float("nan")}}


def run(folder, *options):
    words = ["run", CLIP, "--config", "factorized", "--set", "filter.particles=12", "--no-video", "-q", "-o", folder]
    assert main([*map(str, words), "--stop", str(STOP), "--format", "csv,json", *map(str, options)]) == 0
    return folder


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """The folder of a run whose likelihood reports it; so do runs that follow."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(colour_ratio, "ColourRatio", Focused)
        yield run(tmp_path_factory.mktemp("runs") / "run")


def test_it_is_read_with_its_meaning_and_has_a_panel(done):
    table = read_trajectory(done / "trajectory.json")
    found = table.diagnostics["face"]
    assert set(found.declared) == {COLOURS, FOCUS, SHARES, EVIDENCE}
    assert found.frame.tolist() == list(range(STOP)) and found.get("colours").shape == (STOP, 5)
    assert (found.get("focus") > 0).all() and found.labels == {"shares": ("half",)}
    pytest.importorskip("matplotlib", reason="needs the extra: pip install -e '.[plot]'")
    words = {}
    for axes in plots.page_figure(table).axes:
        for box in (one for one in axes.artists if hasattr(one, "get_child")):
            title, *notes = (area.get_text() for area in box.get_child().get_children())
            words[title] = notes, axes
    notes, axes = words["focus (levels)"]
    assert notes == ["mean spread of the colours"] and axes.get_ylim()[0] == 0
    np.testing.assert_allclose(axes.lines[0].get_ydata(), found.get("focus"))
    assert len(words["colours (levels)"][1].lines) == 5 and "shares" in words


def test_a_corrected_run_has_it_as_a_whole_run_has(done, tmp_path):
    done = shutil.copytree(done, tmp_path / "run")
    with open_source(CLIP, stop=STOP) as source:
        frames = list(source)
    fixer = Fixer(open_run(done), lambda index: frames[index])
    fixer.put([Correction(4, "face", TargetStart(points={"nose": (160.0, 135.0)}))])
    save(fixer)
    fixer.close()
    again = run(tmp_path / "again", "--init", done / CORRECTED)

    def records(folder):
        return [line for line in (folder / "trajectory.json").read_text().splitlines() if line.startswith('{"frame"')]

    assert records(done) == records(again)
