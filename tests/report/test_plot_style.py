"""The one look: colours that all eyes tell apart, bytes that stay the same, and matplotlib kept quiet."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from facetrack_cli.cli.types import FIGURES
from facetrack_cli.report import figures as plots
from facetrack_cli.report.figures import style as plot_style
from tests.report.test_plots import track

pytest.importorskip("matplotlib", reason="needs the extra: pip install -e '.[plot]'")

# Machado, Oliveira and Fernandes (2009), severity 1, on linear RGB


def test_twelve_lines_differ_in_colour_or_dash():
    looks = {str(plot_style.line_style(i)) for i in range(12)}
    assert len(looks) == 12
    assert not {plot_style.line_style(i)["color"] for i in range(12)} & {plot_style.STATUS["lost"]}


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
        "plots.render(plots.success_figure({'a': (np.arange(2.0), np.ones((1, 2)))}))\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    settings = {"PATH": "", "HOME": home, "MPLCONFIGDIR": home, "MPLBACKEND": "none_such", "TMPDIR": str(tmp_path)}
    run = [sys.executable, "-W", "error", "-c", script]
    done = subprocess.run(
        run, env=settings, capture_output=True, text=True, check=False, cwd=Path(plots.__file__).parents[3]
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
