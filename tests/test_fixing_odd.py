"""Runs that are put right though something about them is out of the way."""

import cv2
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.fixing.fixer import Fixer
from facetrack_cli.fixing.run_folder import CORRECTED, open_run
from facetrack_cli.fixing.save import save
from facetrack_cli.types import Correction, TargetStart
from facetrack_cli.video.seek import Frames
from facetrack_cli.video.source import open_source
from tests.samples import FOLDER

FEW = ["--set", "filter.particles=20", "--no-video", "-q"]


def run(*words):
    assert main(["run", *map(str, words), *FEW]) == 0


def put(folder, *corrections):
    """Have these corrections, one after the other, and save."""
    with open_run(folder) as opened, Frames(opened.clip, fps=opened.fps) as frames:
        fixer = Fixer(opened, frames.read)
        for one in corrections:
            fixer.put([one])
        save(fixer)
        fixer.close()


def nose(frame, x, y):
    return Correction(frame, "face", TargetStart(points={"nose": (x, y)}))


@pytest.fixture(scope="module")
def leaving(tmp_path_factory):
    """A folder of images in which a face leaves the picture to the left, and where it begins."""
    folder = tmp_path_factory.mktemp("leaving")
    pictures = folder / "shots"
    pictures.mkdir()
    with open_source(FOLDER / "expressions.mp4", stop=12) as source:
        for frame in source:
            left = 120 + 3 * frame.index
            cv2.imwrite(str(pictures / f"{frame.index:02}.png"), frame.bgr[90:200, left : left + 120])
    places = "nose: [40, 51], mouth_left: [19, 64], mouth_right: [61, 64], lip_upper: [40, 63], lip_lower: [40, 79]"
    (folder / "shots.init.yaml").write_text(f"frame: 0\nface:\n  points: {{{places}}}\n")
    return pictures


def test_a_part_beyond_the_border_is_kept_there(leaving, tmp_path):
    """The init file is read again, and the run put right a second time."""
    run(leaving, "-o", tmp_path / "out")
    put(tmp_path / "out", nose(11, 6, 50))
    with open_run(tmp_path / "out") as opened:
        assert opened.start.corrections[0].kept["mouth_left"][0] < -0.5
    run(leaving, "-o", tmp_path / "again", "--init", tmp_path / "out" / CORRECTED)
    ours, theirs = ((tmp_path / folder / "trajectory.csv").read_bytes() for folder in ("out", "again"))
    assert ours == theirs
    put(tmp_path / "out", nose(10, 9, 50))
