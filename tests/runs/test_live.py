"""What comes from a pipe or a camera: a line a frame, with its age; bounded, and refused in one line."""

import io
import json
import os
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Frame
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs import live
from facetrack_cli.runs.live import follow, piped


def sway(frames):
    """A textured square that moves over a textured ground."""
    rng = np.random.default_rng(1)
    ground = np.repeat(np.repeat(rng.integers(60, 120, (12, 16, 3), np.uint8), 8, 0), 8, 1)
    square = np.repeat(np.repeat(rng.integers(120, 255, (6, 6, 3), np.uint8), 4, 0), 4, 1)
    for i in range(frames):
        image = ground.copy()
        image[30:54, 40 + i : 64 + i] = square
        yield image


def mjpeg(images):
    return b"".join(cv2.imencode(".jpg", image)[1].tobytes() for image in images)


def y4m(images, colours="420jpeg"):
    height, width = images[0].shape[:2]
    frames = [b"FRAME\n" + cv2.cvtColor(image, cv2.COLOR_BGR2YUV_I420).tobytes() for image in images]
    return f"YUV4MPEG2 W{width} H{height} F25:1 C{colours}\n".encode() + b"".join(frames)


def claims(width, height):
    """A JPEG of a few bytes whose header says that it is so large."""
    data = mjpeg([np.zeros((16, 16, 3), np.uint8)])
    at = data.index(b"\xff\xc0") + 5
    return data[:at] + height.to_bytes(2, "big") + width.to_bytes(2, "big") + data[at + 4 :]


IMAGES = list(sway(6))


@pytest.mark.parametrize("encoded", [mjpeg, y4m])
def test_images_of_a_pipe_are_those_that_went_in(encoded):
    found = [getattr(one, "bgr", one) for one in piped(io.BytesIO(encoded(IMAGES)))]
    assert len(found) == 6 and all(one.shape == IMAGES[0].shape for one in found)
    assert max(np.abs(a.astype(int) - b).mean() for a, b in zip(found, IMAGES, strict=True)) < 12


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")  # as in a run
@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "is empty"),
        (b"RIFF....AVI LIST", "neither MJPEG nor y4m"),
        (b"YUV4MPEG2 H48 F25:1\n", "without a size"),
        (b"YUV4MPEG2 W99999998 H99999998 F25:1\n", "at most 64 MB"),
        (y4m(IMAGES[:1], "444"), "colours 444"),
        (y4m(IMAGES)[:-9], "cut short"),
        (b"YUV4MPEG2 W-64 H-48 F25:1\n", "is y4m of -64x-48; sides must be even"),
        (b"YUV4MPEG2 W0 H48 F25:1\n", "is y4m of 0x48; sides must be even"),
        (b"\xff\xd8" + bytes(100) + b"\xff\xd9", "image 0 is damaged, or very large"),
        (claims(30000, 30000), "image 0 is damaged, or very large"),
        (claims(12000, 10000), "image 0: is too large for a frame: 12000x10000, and at most 100 megapixels are read"),
    ],
)
def test_a_pipe_that_is_no_clip_is_one_line(data, said):
    with pytest.raises(InputError, match=said):
        list(piped(io.BytesIO(data)))


def test_an_image_without_an_end_is_not_held(monkeypatch):
    monkeypatch.setattr(live, "MAX_IMAGE_BYTES", 1 << 20)
    with pytest.raises(InputError, match="has no end in 1 MB"):
        list(piped(io.BytesIO(b"\xff\xd8" + bytes(3 << 20))))


def test_lines_come_as_the_frames_do_with_their_age():
    lines, seen = [], []

    def slowly():
        for image in IMAGES:
            seen.append(len(lines))  # how many lines were out before this image was asked for
            time.sleep(0.01)
            yield image

    assert follow(slowly(), load_recipe("correlation_filter"), (40.0, 30.0, 24.0, 24.0), lines.append) == 6
    assert seen[-1] >= 4, "no line waits for a later frame"
    told = [json.loads(line) for line in lines]
    assert [one["frame"] for one in told] == list(range(6)) and all(one["age_s"] >= 0 for one in told)
    [part] = told[-1]["targets"][0]["parts"]
    assert part["x"] == pytest.approx(56.5, abs=2) and told[-1]["time_s"] >= 0.05


def test_run_live_from_standard_input(monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(y4m(IMAGES)), isatty=lambda: False))
    assert main(["run", "-", "--live", "--box", "40,30,24,24"]) == 0
    out, err = capsys.readouterr()
    assert [json.loads(line)["time_s"] for line in out.splitlines()] == [0, 0.04, 0.08, 0.12, 0.16, 0.2]
    assert err == ""


def test_a_tracker_is_told_when_images_came_and_not_their_count(monkeypatch):
    lines, times, clock = [], [], iter(range(100, 200))
    monkeypatch.setattr(live.time, "monotonic", lambda: next(clock) / 4)
    monkeypatch.setattr(live, "record", lambda result, time_s, age_s: times.append((result.frame.time_s, time_s)) or {})
    assert follow(iter(IMAGES), load_recipe("correlation_filter"), (40.0, 30.0, 24.0, 24.0), lines.append) == 6
    # the clock is asked when an image comes and when its line is written
    assert times == [(0.5 * n, 0.5 * n) for n in range(6)]
    frames = [Frame(n, 7 + n / 10, image) for n, image in enumerate(IMAGES)]
    assert follow(iter(frames), load_recipe("correlation_filter"), (40.0, 30.0, 24.0, 24.0), lines.append) == 6
    assert [time_s for time_s, _ in times[6:]] == [7 + n / 10 for n in range(6)]


@pytest.mark.skipif(os.name != "posix", reason="signals need POSIX")
@pytest.mark.parametrize("number", [2, 15, 1])
def test_a_pipe_that_stalls_is_ended_by_a_signal(number):
    words = [sys.executable, "-m", "facetrack_cli", "run", "-", "--live", "--box", "40,30,24,24"]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdin.write(y4m(IMAGES))
        process.stdin.flush()
        assert [json.loads(process.stdout.readline())["frame"] for _ in range(6)] == list(range(6))
        began = time.monotonic()
        process.send_signal(number)
        said = process.stderr.read()
        seconds = time.monotonic() - began
        process.stdin.close()
    assert process.returncode == (130 if number == signal.SIGINT else 143) and b"Fatal" not in said
    assert seconds < 5, "a second, and what a busy machine takes"


def test_a_pipe_from_which_nothing_comes_is_ended():
    out, into = os.pipe()
    until = time.monotonic() + 0.3
    with open(out, "rb") as stream:  # noqa: PTH123 -- a number
        recipe = load_recipe("correlation_filter")
        count = follow(piped(stream), recipe, (40.0, 30.0, 24.0, 24.0), print, lambda: time.monotonic() > until)
        assert count == 0 and time.monotonic() < until + 2
        os.close(into)  # the thread that reads ends


def test_what_live_cannot_be(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["run", "-"]) == 2 and "has no end; give --live" in capsys.readouterr().err
    assert main(["run", "7", "--live", "--box", "1,1,9,9"]) == 3
    assert "7: there is no camera of this number" in capsys.readouterr().err
    assert main(["run", "-", "--live", "-o", "x"]) == 2 and "leave --out out" in capsys.readouterr().err


def test_options_that_live_has_none_of_are_refused(capsys):
    assert main(["run", "0", "--live", "--stop", "3"]) == 2
    assert "--live has no --stop" in capsys.readouterr().err
    assert main(["run", "0"]) == 2
    assert "0: has no end; give --live" in capsys.readouterr().err
