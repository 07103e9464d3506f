"""Boxes for the toolkit and for us, and how measure.py is run over them.

`edges` of expected.json has in each row a pair of boxes at the border of some rule: apart, side by side, one in the
other, overlaps of a half and three quarters, empty, negative, rounded, far below a pixel, out of the image, unknown.
`python -m tests.peers.cases PYTHON` writes what is said of its boxes again, by the Python that has the packages of
requirements.txt.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

HERE = Path(__file__).parent
EXPECTED = HERE / "expected.json"


class Case(NamedTuple):
    """Boxes (T, 4) of a tracker and the ground truth; (width, height) of the image."""

    ours: np.ndarray
    truth: np.ndarray
    size: tuple[int, int]


def walk(rng, rows, size=(320, 240)):
    """A target on its way and a tracker that slips off it; some rows without ground truth, some without boxes."""
    centre = rng.uniform(0.2, 0.8, 2) * size + np.cumsum(rng.normal(0, 4, (rows, 2)), axis=0)
    sides = rng.uniform(5, 80, 2) * np.exp(np.cumsum(rng.normal(0, 0.03, (rows, 2)), axis=0))
    off = np.cumsum(rng.normal(0, 1, (rows, 2)), axis=0) * rng.choice([0.02, 0.3, 1.5])
    ours = np.concatenate([centre + off - sides / 2, sides * np.exp(rng.normal(0, 0.2, (rows, 2)))], axis=1)
    truth = np.concatenate([centre - sides / 2, sides], axis=1)
    kind = rng.integers(3)
    if kind == 0:
        ours, truth = np.round(ours), np.round(truth)
    elif kind == 1:
        ours, truth = np.round(ours * 2) / 2, np.round(truth, 3)
    ours[rng.random(rows) < 0.1] = truth[0]
    ours[rng.random(rows) < 0.05, 2:] = 0
    ours[rng.random(rows) < 0.1] = np.nan
    truth[rng.random(rows) < 0.1] = np.nan
    truth[0] = [*centre[0].clip(5, 100), 30, 40]  # what the tracker starts from
    ours[0] = truth[0] + rng.choice([0, 3])
    return Case(ours, truth, size)


def random(seed):
    """New ones."""
    cases = {}
    for at in range(12):
        rng = np.random.default_rng([seed, at])
        size = tuple(rng.integers(40, 400, 2).tolist())
        rows = int(rng.integers(3, 120))
        cases[f"random {seed} {at}"] = walk(rng, rows, size)
    return cases


def write(folder, case):
    """The files that measure.py reads."""
    folder.mkdir()

    def lines(rows):
        return "".join(",".join(map(repr, np.asarray(row).ravel().tolist())) + "\n" for row in rows)

    folder.joinpath("size.txt").write_text(lines([case.size]), encoding="utf-8")
    for name, boxes in (("ours", case.ours), ("truth", case.truth)):
        folder.joinpath(f"{name}.txt").write_text(lines(boxes), encoding="utf-8")


def run(python, cases):
    """What the toolkits say of the cases: `packages` and `measures` by name."""
    with tempfile.TemporaryDirectory() as name:
        folders = [Path(name, case) for case in cases]
        for folder, case in zip(folders, cases.values(), strict=True):
            write(folder, case)
        done = subprocess.run([python, HERE / "measure.py", *folders], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{python} {HERE / 'measure.py'}:\n{done.stderr}")
    return json.loads(done.stdout)


def from_json(held):
    return Case(*(np.array(held[name], dtype=float) for name in ("ours", "truth")), tuple(held["size"]))


def expected():
    """Cases and what the toolkits said of them when they were recorded, by name."""
    held = json.loads(EXPECTED.read_text(encoding="utf-8"))["cases"]
    return {name: (from_json(one["boxes"]), one["measures"]) for name, one in held.items()}


def record(python):
    cases = {name: case for name, (case, _) in expected().items()}
    said = run(python, cases)

    def plain(value):
        if not isinstance(value, np.ndarray):
            return value
        return np.where(np.isnan(value), None, value).tolist()

    held = {
        name: {"boxes": {key: plain(v) for key, v in case._asdict().items()}, "measures": said["measures"][name]}
        for name, case in cases.items()
    }
    # a line a case, so that a change shows where it is
    text = ",\n".join(f"{json.dumps(name)}: {json.dumps(one)}" for name, one in held.items())
    EXPECTED.write_text(f'{{"packages": {json.dumps(said["packages"])}, "cases": {{\n{text}\n}}}}\n', encoding="utf-8")


if __name__ == "__main__":
    record(sys.argv[1])
