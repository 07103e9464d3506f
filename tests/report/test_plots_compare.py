"""Figures that set recipes and seeds side by side, and what all figures share: colours, equal bytes, a quiet import."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.cli.options import FIGURES
from facetrack_cli.evaluation.reliability import reliability_bins
from facetrack_cli.report import figures as plots
from facetrack_cli.report.figures import style
from tests.report.test_plots import drawn, headings, track

pytest.importorskip("matplotlib", reason="needs the extra: pip install -e '.[plot]'")


def legend(figure):
    return [text.get_text() for text in figure.legends[0].texts]


def curves(of, measure="AUC", mark=None):
    return plots.curves_figure(of, "Success", ("threshold", "share"), measure, mark)


def test_success_ranks_by_area_and_keeps_a_recipe_its_colour():
    at = np.linspace(0, 1, 21)
    figure = curves({"poor": (at, np.tile(1 - at, (3, 1))), "good": (at, np.stack([np.ones(21), np.full(21, 0.9)]))})
    assert legend(figure) == ["0.950  good", "0.500  poor"]
    axes, handles = figure.axes[0], figure.legends[0].legend_handles
    assert np.allclose(drawn(axes)[1][:, 1], 0.95)
    assert [line.get_color() for line in axes.lines] == [handle.get_color() for handle in handles][::-1]
    assert len(axes.collections) == 2, "bands over seeds"
    assert not curves({"one": (at, at[None])}).axes[0].collections
    assert (axes.get_xlabel(), figure.legends[0].get_title().get_text()) == ("threshold", "AUC")
    assert plots.render(figure).startswith(b"\x89PNG")
    marked = curves({"_a": (50 * at, np.tile(at, (2, 1)))}, "at 20 px", 20)  # read off there
    assert legend(marked) == ["0.400   _a"] and marked.legends[0].get_title().get_text() == "at 20 px"
    assert any(np.allclose(line.get_xdata(), 20) for line in marked.axes[0].lines)


def test_error_over_time_has_the_median_and_what_is_hidden():
    errors = np.array([[1.0], [2], [9]]) * np.ones(20)
    errors[:, 3] = np.nan
    frames = np.arange(100, 120)
    figure = plots.error_over_time_figure(frames, {"a": errors}, np.isin(frames, range(105, 110)))
    axes = figure.subfigs[1].axes[0]
    line = drawn(axes)[0]
    assert np.nanmax(line[:, 1]) == np.nanmin(line[:, 1]) == 2
    assert np.isnan(line[:, 1]).sum() == 1
    (shade,) = axes.patches
    assert (shade.get_x(), shade.get_x() + shade.get_width()) == (104.5, 109.5)
    assert plots.render(figure, "svg").startswith(b"<?xml")


def test_calibration_shows_share_and_count():
    confidence = np.r_[np.full(30, 0.95), np.full(10, 0.15)]
    near = np.r_[np.ones(24, bool), np.zeros(16, bool)]
    bins = reliability_bins(confidence, near, confidence > 0.5)
    upper, lower = plots.calibration_figure(bins).axes
    points = {line.get_label(): line.get_xydata() for line in upper.lines}
    assert np.allclose(points["right"], [(0.15, 0), (0.95, 0.8)])
    assert np.allclose(points["visible in the ground truth"], [(0.15, 0), (0.95, 1)])
    assert [bar.get_height() for bar in lower.patches] == [10, 30]
    assert "0.150" in headings(upper)[1]


def test_many_recipes_and_frames():
    frames = np.arange(20_000)
    errors = {f"recipe_with_a_long_name_{i}": np.abs(np.sin(frames / (50 + i)))[None] for i in range(12)}
    figure = plots.error_over_time_figure(frames, errors, frames < 0)
    assert len(figure.subfigs[0].legends[0].texts) == 12
    assert max(len(line) for line in drawn(figure.subfigs[1].axes[0])) <= 2000


def test_twelve_lines_differ_in_colour_or_dash():
    looks = {str(style.line_style(i)) for i in range(12)}
    assert len(looks) == 12
    assert not {style.line_style(i)["color"] for i in range(12)} & {style.STATUS["lost"]}


@pytest.mark.one_in(2)
@pytest.mark.parametrize("form", FIGURES)
def test_same_numbers_give_the_same_bytes_whatever_the_user_has_set(form):
    import matplotlib

    table = track(parts=1)
    first = plots.render(plots.page_figure(table), form)
    with matplotlib.rc_context(
        {"lines.linewidth": 9, "font.size": 20, "svg.hashsalt": "other", "figure.dpi": 30, "xtick.direction": "in"}
    ):
        assert plots.render(plots.page_figure(table), form) == first
        assert matplotlib.rcParams["lines.linewidth"] == 9, "the user's settings come back"
    assert not re.search(rb"(?i)date>|CreationDate|20[2-9]\d-\d\d", first)


def test_the_first_import_says_nothing_and_no_pyplot(tmp_path):
    """With a home folder that cannot be written, no font cache, and a backend that does not exist."""
    (tmp_path / "file").touch()
    home = str(tmp_path / "file" / "home")
    script = (
        "import numpy as np, sys\n"
        "from facetrack_cli.report import figures as plots\n"
        "assert 'matplotlib' not in sys.modules\n"
        "plots.render(plots.curves_figure({'a': (np.arange(2.0), np.ones((1, 2)))}, 'a', ('x', 'y')))\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    settings = {"PATH": "", "HOME": home, "MPLCONFIGDIR": home, "MPLBACKEND": "none_such", "TMPDIR": str(tmp_path)}
    run = [sys.executable, "-W", "error", "-c", script]
    done = subprocess.run(
        run, env=settings, capture_output=True, text=True, check=False, cwd=Path(plots.__file__).parents[3]
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
