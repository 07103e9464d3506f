"""A diagnostic that a likelihood declares, and that nothing else names: from the tracker to files, plots and editor."""

import json
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
from tests.trajectory.test_writers import plain

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
    assert main([*map(str, words), "--stop", str(STOP), "--format", "csv,json,jsonl", *map(str, options)]) == 0
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Folders of a run whose likelihood reports it, and of one whose likelihood does not. The former is used below."""
    folder = tmp_path_factory.mktemp("runs")
    plain = run(folder / "plain")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(colour_ratio, "ColourRatio", Focused)
        yield run(folder / "run"), plain


def test_it_goes_into_json_and_leaves_the_csv_alone(runs):
    done, other = runs
    whole = json.loads((done / "trajectory.json").read_text())
    assert whole["diagnostics"] == json.loads(json.dumps([one.record() for one in (COLOURS, FOCUS, SHARES)]))
    for frame in whole["frames"]:
        (target,) = frame["targets"]
        evidence = ["evidence"] * (frame["frame"] > 0)
        assert list(target) == ["target", "particles", "shares", *evidence, "focus", "colours", "parts"]
        assert target["shares"] == {"half": 0.5}
        assert target["focus"] == pytest.approx(np.mean(target["colours"]), abs=1e-3)
    first = (done / "trajectory.json").read_text().split('"focus":')[1].split(",")[0]
    assert len(first.split(".")[1]) == 6
    assert (other / "trajectory.csv").read_bytes() == (done / "trajectory.csv").read_bytes()
    assert "diagnostics" not in json.loads((other / "trajectory.json").read_text())
    rows = [plain(folder / f"trajectory.{form}") for folder in runs for form in ("json", "jsonl")]
    assert rows[0] == rows[1] == rows[2] == rows[3]


@pytest.mark.parametrize("form", ["json", "jsonl"])
def test_it_is_read_with_its_meaning_and_has_a_panel(runs, form):
    table = read_trajectory(runs[0] / f"trajectory.{form}")
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


def test_a_corrected_run_has_it_as_a_whole_run_has(runs, tmp_path):
    done = shutil.copytree(runs[0], tmp_path / "run")
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
