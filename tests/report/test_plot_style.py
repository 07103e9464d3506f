"""The one look: colours that all eyes tell apart, bytes that stay the same, and matplotlib kept quiet."""

import colorsys
import itertools
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.cli.options import FIGURES
from facetrack_cli.core.errors import UsageError
from facetrack_cli.report import figures as plots
from facetrack_cli.report.figures import style as plot_style
from facetrack_cli.video.overlay.marks import PALETTE
from tests.report.test_plots import track

pytest.importorskip("matplotlib", reason="needs the extra: pip install -e '.[plot]'")

# Machado, Oliveira and Fernandes (2009), severity 1, on linear RGB
BLIND = {
    "none": np.eye(3),
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


def rgb(colour):
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255


def oklab(linear):
    to_lms = [
        [0.41222147, 0.53633254, 0.05144599],
        [0.2119035, 0.68069955, 0.10739696],
        [0.08830246, 0.28171884, 0.62997870],
    ]
    to_lab = [
        [0.21045426, 0.79361779, -0.00407205],
        [1.9779985, -2.42859221, 0.45059371],
        [0.02590404, 0.78277177, -0.80867577],
    ]
    return np.array(to_lab) @ np.cbrt(np.array(to_lms) @ np.clip(linear, 0, 1))


@pytest.mark.parametrize("kind", BLIND)
def test_colours_are_told_apart_by_colour_blind_eyes(kind):
    linear = [((rgb(c) + 0.055) / 1.055) ** 2.4 for c in plot_style.COLOURS]
    seen = [oklab(np.array(BLIND[kind]) @ c) for c in linear]
    nearest = min(float(np.linalg.norm(a - b)) for a, b in itertools.combinations(seen, 2))
    assert nearest > 0.08, "two colours look alike"


def test_colours_are_those_of_the_video():
    for ours, (b, g, r) in zip(plot_style.COLOURS[:4], PALETTE, strict=False):
        hue, light, _ = colorsys.rgb_to_hls(*rgb(ours))
        video_hue, video_light, _ = colorsys.rgb_to_hls(r / 255, g / 255, b / 255)
        assert abs(hue - video_hue) < 0.06 and light < video_light


def test_twelve_lines_differ_in_colour_or_dash():
    looks = {str(plot_style.line_style(i)) for i in range(12)}
    assert len(looks) == 12
    assert not {plot_style.line_style(i)["color"] for i in range(12)} & {plot_style.STATUS["lost"]}


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


def test_missing_matplotlib_is_one_line(monkeypatch):
    plot_style.need_matplotlib.cache_clear()
    for name in [name for name in sys.modules if name.partition(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(UsageError, match=r"^figures need matplotlib, .*pip install 'facetrack\[plot\]'$"):
        plots.success_figure({"a": (np.arange(2.0), np.ones((1, 2)))})


def test_the_first_import_says_nothing_and_no_pyplot(tmp_path):
    """With a home folder that cannot be written, no font cache, and a backend that does not exist."""
    (tmp_path / "file").touch()
    home = str(tmp_path / "file" / "home")
    script = (
        "import numpy as np, sys\n"
        "from facetrack_cli.report import figures as plots\n"
        "assert 'matplotlib' not in sys.modules\n"
        "plots.render(plots.success_figure({'a': (np.arange(2.0), np.ones((1, 2)))}))\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    settings = {"PATH": "", "HOME": home, "MPLCONFIGDIR": home, "MPLBACKEND": "none_such", "TMPDIR": str(tmp_path)}
    run = [sys.executable, "-W", "error", "-c", script]
    done = subprocess.run(
        run, env=settings, capture_output=True, text=True, check=False, cwd=Path(plots.__file__).parents[3]
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
