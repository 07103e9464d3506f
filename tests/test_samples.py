"""The committed sample clips: complete, small, and with a start that agrees with the ground truth."""

import pytest

from facetrack_cli.start.init_file import read_init
from tests.support.samples import FOLDER, read_pictures, read_rows

CLIPS = sorted(path.stem for path in FOLDER.glob("*.mp4") if path.stem != "film")  # which is joined from the others


def test_the_film_is_small() -> None:
    assert (FOLDER / "film.mp4").stat().st_size < 1_000_000
    assert {row["target"] for row in read_rows("film")} == {"collins", "hopper"}


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", CLIPS)
def test_a_clip_is_small_and_its_truth_has_a_row_for_each_frame_and_part(name: str) -> None:
    assert (FOLDER / f"{name}.mp4").stat().st_size < 1_000_000
    pictures, rows = read_pictures(name), read_rows(name)
    assert pictures.shape[1:] == (240, 320, 3) and 150 <= len(pictures) <= 300
    parts = [(r["target"], r["part"]) for r in rows if r["frame"] == "0"]
    expected = [(str(t), f"{t / 25:.2f}", *part) for t in range(len(pictures)) for part in parts]
    assert [(r["frame"], r["time_s"], r["target"], r["part"]) for r in rows] == expected
    assert {r["status"] for r in rows} <= {"visible", "hidden"}


@pytest.mark.parametrize("name", CLIPS)
def test_the_init_file_is_the_truth_of_the_first_frame(name: str) -> None:
    start = read_init(FOLDER / f"{name}.init.yaml")
    assert start.frame == 0
    for row in read_rows(name):
        if row["frame"] != "0":
            continue
        target = start.targets[row["target"]]
        if row["part"] in target.points:
            assert target.points[row["part"]] == pytest.approx((float(row["x"]), float(row["y"])))
            continue
        left, top, width, height = target.box
        # pixel centres are at whole numbers, so a box has its middle half a pixel before left + width / 2
        box = left + (width - 1) / 2, top + (height - 1) / 2, width, height
        assert box == pytest.approx([float(row[key]) for key in "xywh"], abs=0.011)
