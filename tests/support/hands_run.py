"""A run of a head and two hands, of a few frames."""

from facetrack_cli.__main__ import main
from tests.support.samples import FOLDER

FEW = [word for t in ("head", "left_hand", "right_hand") for word in ("--set", f"targets.{t}.filter.particles=40")]


def hands_run(out, stop=8, *more):
    """The folder `out` with it."""
    what = ["run", FOLDER / "signing.mp4", "--config", "head_hands", *FEW, "--stop", stop, "--no-video", "-q"]
    assert main([str(word) for word in [*what, "-o", out, *more]]) == 0
    return out
