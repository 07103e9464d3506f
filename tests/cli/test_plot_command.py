"""facetrack plot: what it writes, where, and what it refuses."""

import sys
import xml.etree.ElementTree as ET

import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.cli.commands.finished import FIGURES
from facetrack_cli.report.figures import page, style

pytest.importorskip("matplotlib", reason="needs the extra: pip install -e '.[plot]'")


def write(path, rows, columns):
    path.write_text("\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows)]) + "\n")
    return path


@pytest.fixture
def run(tmp_path):
    """The folder of a run of two parts over 30 frames."""
    names = ("frame", "time_s", "target", "part", "x", "y", "w", "h", "confidence", "status", "std_x", "std_y")
    rows = [
        (f, f / 25, "face", part, 100 + k + f / 3, 80 + k, 12, 12, 0.9, "tracked" if f else "init", 1, 1)
        for f in range(30)
        for k, part in enumerate(("nose", "chin"))
    ]
    folder = tmp_path / "run"
    folder.mkdir()
    write(folder / "trajectory.csv", rows, names)
    return folder


def facetrack(capsys, *arguments):
    code = main(["plot", *map(str, arguments)])
    out, err = capsys.readouterr()
    assert out == ""
    return code, err


def test_the_page_lies_beside_the_trajectory_is_not_overwritten_and_needs_matplotlib(capsys, run, monkeypatch):
    assert facetrack(capsys, run) == (0, f"{run} -> {run / 'plot.png'}\n")
    before = (run / "plot.png").read_bytes()
    assert before.startswith(b"\x89PNG") and int.from_bytes(before[16:20], "big") == 1200
    code, err = facetrack(capsys, run / "trajectory.csv")
    assert code == 2 and "exists already; replace it with --overwrite" in err
    assert (run / "plot.png").read_bytes() == before
    (run / "plot.png").write_bytes(b"")
    assert facetrack(capsys, run / "trajectory.csv", "--overwrite")[0] == 0
    assert (run / "plot.png").read_bytes() == before
    assert sorted(p.name for p in run.iterdir()) == ["plot.png", "trajectory.csv"]
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr(style, "need_matplotlib", style.need_matplotlib.__wrapped__)
    need = "figures need matplotlib, which is not installed: pip install 'facetrack[plot]'"
    assert facetrack(capsys, run, "--overwrite") == (2, f"facetrack: error: {need}\n")


@pytest.mark.one_in(3)
@pytest.mark.parametrize("form", FIGURES)
def test_every_form_by_its_ending(capsys, run, form):
    path = run / f"page.{form.upper()}"
    assert facetrack(capsys, run, "-o", path)[0] == 0
    data = path.read_bytes()
    if form == "svg":
        assert ET.fromstring(data).tag.endswith("svg")
    assert data[:5] == {"png": b"\x89PNG\r", "svg": b"<?xml", "pdf": b"%PDF-"}[form]


def test_truth_adds_the_error(capsys, run, tmp_path, monkeypatch):
    rows = [(f, "face", p, 101 + k + f / 3, 80 + k) for f in range(30) for k, p in enumerate(("nose", "chin"))]
    truth = write(tmp_path / "truth.csv", rows, ("frame", "target", "part", "x", "y"))
    seen, draw = [], page.page_figure
    monkeypatch.setattr(page, "page_figure", lambda *both: seen.append(both) or draw(*both))
    monkeypatch.setattr(style, "render", lambda *_, **how: b"drawn")
    assert facetrack(capsys, run, "--truth", truth)[0] == 0
    assert facetrack(capsys, run, "--truth", truth, "--target", "face/chin", "--overwrite")[0] == 0
    (table, pairs), (chosen, pair) = seen
    assert [s.name for s in table.parts] == ["face/nose", "face/chin"] == [p.ours.name for p in pairs]
    assert (pairs[0].ours.x - pairs[0].truth.x).round(2).tolist() == [-1.0] * 30
    assert [s.name for s in chosen.parts] == ["face/chin"] == [p.ours.name for p in pair]


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["-o", "page.jpg"], 2, "page.jpg: cannot tell the kind of file; let its name end in .png, .svg or .pdf"),
        (["-o", "nowhere/page.png"], 2, "nowhere/page.png: there is no folder nowhere"),
        (["--target", "hand"], 2, "has no 'hand'; choose among face"),
        (["--measure", "yaw"], 2, "has no yaw; it has no measures, which the recipe face gives"),
    ],
)
def test_usage(capsys, run, arguments, code, said):
    found, err = facetrack(capsys, run, *arguments)
    assert found == code and said in err and err.startswith("facetrack: error: ") and err.count("\n") == 1
    assert [p.name for p in run.iterdir()] == ["trajectory.csv"]
