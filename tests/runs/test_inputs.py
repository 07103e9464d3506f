"""What a command line names: files, folders, globs and lists."""

import io
import shutil
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest
from PIL import Image

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.runs.batch import expand
from facetrack_cli.video.files import brings_rate

FILES = """
day1/b10.mp4 day1/b2.MP4 day1/notes.txt day1/.hidden.mp4 day1/cover.jpg day2/c.mkv faces/0.png faces/1.png
tree/x/1.jpg tree/y/a.mp4 tree/y/deep/z.mp4 tree/r/run.json tree/r/annotated.mp4 tree/empty/no.txt empty/no.txt
"""


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in (*FILES.split(), "sub/day3/d [1].mp4"):
        touch(name)


def touch(name):
    Path(name).parent.mkdir(parents=True, exist_ok=True)
    Path(name).touch()


def expanded(*inputs):
    said = []
    clips, several = expand([Path(one) for one in inputs], said.append)
    return [clip.as_posix() for clip in clips], several, said


@pytest.mark.parametrize(
    ("inputs", "clips", "several"),
    [
        (["day2/c.mkv"], ["day2/c.mkv"], False),
        (["gone.mp4"], ["gone.mp4"], False),
        (["faces"], ["faces"], False),
        (["faces/*.png"], ["faces/*.png"], False),
        (["empty"], ["empty"], False),
        (["tree/r"], ["tree/r"], False),
        (["day2/c.mkv", "./day2/c.mkv"], ["day2/c.mkv"], False),
        (["day2"], ["day2/c.mkv"], True),
        (["day2/c.mkv", "faces"], ["day2/c.mkv", "faces"], True),
        (["tree"], ["tree/x", "tree/y/a.mp4"], True),
        (["sub"], ["sub/day3/d [1].mp4"], True),
        (["sub/day3/d [1].mp4"], ["sub/day3/d [1].mp4"], False),
        (["day1/*.mp4"], ["day1/b10.mp4"], True),
        (["day?/*.m*"], ["day1/b10.mp4", "day2/c.mkv"], True),
        (["tree/*"], ["tree/x", "tree/y/a.mp4"], True),
        (["**/c.mkv"], ["day2/c.mkv"], True),
    ],
)
def test_inputs(inputs, clips, several):
    assert expanded(*inputs) == (clips, several, [])


def test_images_beside_videos_are_left_out_with_a_line():
    clips, several, said = expanded("day1")
    assert (clips, several) == (["day1/b2.MP4", "day1/b10.mp4"], True), "by their numbers"
    assert said == [
        "facetrack: warning: day1: 1 image beside the videos is left out; give images a folder of their own"
    ]
    touch("day1/other.png")
    assert "day1: 2 images beside the videos are left out" in expanded("day1")[2][0]


def test_animations_and_archives_are_clips():
    still, *others = [Image.new("L", (8, 8), level) for level in (10, 60, 110)]
    Path("mixed").mkdir()
    for name in ("mixed/b.gif", "mixed/c10.png"):
        still.save(name, save_all=True, append_images=others)
    still.save("mixed/c2.png")
    for name, inside in (("mixed/d.zip", "1.png"), ("mixed/e.zip", "notes.txt")):
        with ZipFile(name, "w") as packed:
            packed.write("mixed/c2.png", inside)
    Path("mixed/f.zip").write_bytes(b"PK")  # which is told once it is opened
    clips, several, said = expanded("mixed")
    assert (clips, several) == (["mixed/b.gif", "mixed/c10.png", "mixed/d.zip", "mixed/f.zip"], True)
    assert len(said) == 1 and "mixed: 1 image beside the videos is left out" in said[0]
    assert expanded("mixed/*.png")[0] == ["mixed/c10.png"]
    assert expanded("mixed/c10.png", "mixed/b.gif")[0] == ["mixed/c10.png", "mixed/b.gif"]
    rates = {name: brings_rate(Path("mixed") / name) for name in ("b.gif", "c10.png", "c2.png", "d.zip", "*.png", "")}
    assert [name for name, own in rates.items() if own] == ["b.gif", "c10.png"]


def test_lists(monkeypatch):
    Path("list.txt").write_bytes(b"\xef\xbb\xbfday2/c.mkv\r\n\n  \n# day1/b10.mp4\nfaces\nday1/*.mp4\nday2/c.mkv\n")
    clips = ["day2/c.mkv", "faces", "day1/b10.mp4"]
    assert expanded("@list.txt") == (clips, True, [])
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"day2/c.mkv")))
    assert expanded("@-") == (["day2/c.mkv"], True, [])
    touch("@odd.mp4")
    assert expanded("./@odd.mp4") == (["@odd.mp4"], False, [])


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        (["@gone.txt"], InputError, "gone.txt: cannot be read as a list of clips: No such file or directory"),
        (["@day1"], InputError, "day1: cannot be read as a list of clips: Is a directory"),
        (["@empty/no.txt"], InputError, "empty/no.txt: names no clip; it has a path a line"),
        (["@zeros"], InputError, "zeros: is not a list of clips"),
        (["gone/*.mp4"], InputError, "gone/*.mp4: matches no file"),
        (["faces/0.png", "faces/1.png", "day2/c.mkv"], UsageError, "faces/0.png and 1 more are single images; give "),
    ],
)
def test_what_cannot_be_meant(given, error, words):
    Path("zeros").write_bytes(b"a\0b")
    with pytest.raises(error) as raised:
        expanded(*given)
    assert str(raised.value).startswith(words) and "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (["GX010042.MP4", "GX020042.MP4", "GX030042.MP4"], "GX010042.MP4 to GX030042.MP4"),
        (["GOPR0042.MP4", "GP010042.MP4"], "GOPR0042.MP4 to GP010042.MP4"),
        ([f"00{n:03}.MTS" for n in range(10)], "00000.MTS to 00009.MTS"),
        (["DJI_0001.MP4", "DJI_0002.MP4"], "DJI_0001.MP4 to DJI_0002.MP4"),
        (["p1.mp4", "p7.mp4"], ""),
        (["anna.mp4", "ben.mp4"], ""),
        (["1.png", "2.png"], ""),
    ],
)
def test_what_may_be_chapters_of_one_recording_is_told_how_to_join(names, told):
    for name in names:
        touch(f"card/{name}")
    said = expanded("card")[2]
    assert bool(said) == bool(told)
    if told:
        assert said[0].startswith(f"facetrack: {told}: each is a clip of its own") and "-f concat" in said[0]
    shutil.rmtree("card")
