"""What comes from a pipe or a camera: a line a frame, with its age; bounded, and refused in one line.

Of everybody in a film that is still shown: names when looks allow them.
"""

import contextlib
import io
import itertools
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from functools import partial
from types import SimpleNamespace
from urllib.request import urlopen

import av
import cv2
import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Frame
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs import live
from facetrack_cli.runs.live import LiveCast, follow, piped, received
from facetrack_cli.trackers.face.detectors import check_cascades
from facetrack_cli.trajectory.formats.boxes import read_truth
from facetrack_cli.video.shots import find_cuts, passing_shots
from facetrack_cli.video.source import open_source
from tests.support.film_run import FILM
from tests.support.samples import FOLDER
from tests.test_docs import ROOT, blocks

SDP = (
    "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=camera\r\nc=IN IP4 0.0.0.0\r\nt=0 0\r\nm=video 0 RTP/AVP 96\r\n"
    "a=rtpmap:96 H264/90000\r\na=fmtp:96 packetization-mode=1\r\na=control:video\r\n"
)
MORE = {
    "OPTIONS": "Public: DESCRIBE, SETUP, PLAY, TEARDOWN\r\n",
    "DESCRIBE": f"Content-Type: application/sdp\r\nContent-Length: {len(SDP)}\r\n",
    "SETUP": "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\n",
}


def camera(images, fps=25, visits=1):
    """The address of a camera that shows the images to so many visitors, at their rate, and then is taken away."""
    server = socket.create_server(("127.0.0.1", 0))

    def serve():
        with server:
            for _ in range(visits):
                _serve(server, images, fps)

    threading.Thread(target=serve, daemon=True).start()
    return f"rtsp://127.0.0.1:{server.getsockname()[1]}/live"


def _serve(server, images, fps):
    with server.accept()[0] as visitor, visitor.makefile("rb") as asked:
        method = ""
        while method != "PLAY":
            lines = list(iter(lambda: asked.readline().decode().strip(), ""))
            if not lines:
                return
            method, number = lines[0].split()[0], next(one for one in lines if one.lower().startswith("cseq"))
            body = SDP if method == "DESCRIBE" else ""
            answer = f"RTSP/1.0 200 OK\r\n{number}\r\nSession: 1\r\n{MORE.get(method, '')}\r\n{body}"
            visitor.sendall(answer.encode())
        _show(visitor, images, fps)


def _show(visitor, images, fps):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as packets:
        packets.bind(("127.0.0.1", 0))
        packets.setblocking(False)
        with av.open(f"rtp://127.0.0.1:{packets.getsockname()[1]}", "w", format="rtp") as out:
            options = {"preset": "ultrafast", "tune": "zerolatency"}
            stream = out.add_stream("libx264", rate=fps, options=options)
            stream.height, stream.width = images[0].shape[:2]
            stream.pix_fmt = "yuv420p"
            for image in images:
                out.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
                _pass_on(packets, visitor)
                time.sleep(1 / fps)
            out.mux(stream.encode())
            _pass_on(packets, visitor)


def _pass_on(packets, visitor):
    """What PyAV sent, which the loopback has at once, in the visitor's connection."""
    while True:
        try:
            packet = packets.recv(65535)
        except BlockingIOError:
            return
        visitor.sendall(b"$\0" + len(packet).to_bytes(2, "big") + packet)


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


def y4m(images):
    height, width = images[0].shape[:2]
    frames = [b"FRAME\n" + cv2.cvtColor(image, cv2.COLOR_BGR2YUV_I420).tobytes() for image in images]
    return f"YUV4MPEG2 W{width} H{height} F25:1 C420jpeg\n".encode() + b"".join(frames)


def claims(width, height):
    """A JPEG of a few bytes whose header says that it is so large."""
    data = mjpeg([np.zeros((16, 16, 3), np.uint8)])
    at = data.index(b"\xff\xc0") + 5
    return data[:at] + height.to_bytes(2, "big") + width.to_bytes(2, "big") + data[at + 4 :]


IMAGES = list(sway(6))


def container(images, form):
    """The images as a file of H.264 in memory."""
    data = io.BytesIO()
    with av.open(data, "w", format=form) as file:
        stream = file.add_stream("libx264", rate=25, options={"preset": "ultrafast", "tune": "zerolatency"})
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        for image in images:
            file.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
        file.mux(stream.encode())
    return data.getvalue()


mpegts, matroska = partial(container, form="mpegts"), partial(container, form="matroska")
PLACE = (40.0, 30.0, 24.0, 24.0)


def followed(images, write, *more, **asked):
    return follow(images, load_recipe("correlation_filter"), PLACE, write, *more, **asked)


@pytest.mark.parametrize("encoded", [mjpeg, y4m, mpegts, matroska])
def test_images_of_a_pipe_are_those_that_went_in(encoded):
    found = list(piped(io.BytesIO(encoded(IMAGES))))
    assert len(found) == 6 and all(one.bgr.shape == IMAGES[0].shape for one in found)
    assert max(np.abs(a.bgr.astype(int) - b).mean() for a, b in zip(found, IMAGES, strict=True)) < 12
    times = np.array([one.time_s for one in found])
    assert np.isnan(times).all() if encoded is mjpeg else np.allclose(times, np.arange(6) / 25, atol=2e-3)


@pytest.mark.parametrize(
    "data",
    [b"", b"RIFF....AVI LIST", b"YUV4MPEG2 H48 F25:1\n", b"YUV4MPEG2 W99999998 H99999998 F25:1\n",
     b"\xff\xd8" + bytes(100) + b"\xff\xd9", claims(30000, 30000), claims(12000, 10000),
     b"v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=-\r\nc=IN IP4 127.0.0.1\r\nm=video 9 RTP/AVP 96\r\n",
     b"#EXTM3U\n#EXTINF:1,\nfile:///etc/hostname\n"],
)  # fmt: skip
def test_a_pipe_that_is_no_clip_is_one_line(data):
    with pytest.raises(InputError, match=r"^standard input: ") as error:
        list(piped(io.BytesIO(data)))
    assert "\n" not in str(error.value)
    assert "Errno" not in str(error.value)


def test_an_address_that_gives_nothing_is_one_line_and_no_waiting():
    with pytest.raises(InputError, match=r"^tcp://127\.0\.0\.1:9: ") as error:
        next(received("tcp://127.0.0.1:9", print))
    assert "\n" not in str(error.value)


def test_lines_come_as_the_frames_do_with_their_age():
    lines, seen = [], []

    def slowly():
        for image in IMAGES:
            seen.append(len(lines))  # how many lines were out before this image was asked for
            time.sleep(0.01)
            yield image

    assert followed(slowly(), lines.append) == 6
    assert seen[-1] >= 3, "no line waits for a later frame"
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
    lines, now = [], [0.0]

    def coming():
        for n, image in enumerate(IMAGES):
            now[0] = 25 + n / 2
            yield image

    monkeypatch.setattr(live.time, "monotonic", lambda: now[0])
    assert followed(coming(), lines.append) == 6
    frames = [Frame(n, 7 + n / 10, image) for n, image in enumerate(IMAGES)]
    assert followed(iter(frames), lines.append) == 6
    told = [json.loads(line)["time_s"] for line in lines]
    assert told == [0.5 * n for n in range(6)] + [7 + n / 10 for n in range(6)]


def test_an_image_ages_while_it_waits_for_those_before_it():
    ages = []

    def slowly(line):
        ages.append(json.loads(line)["age_s"])
        time.sleep(0.2)

    assert followed(iter(IMAGES), slowly) == 6
    assert min(ages[2:]) > 0.2, "it came while another line was written"


@pytest.mark.skipif(os.name != "posix", reason="signals need POSIX")
@pytest.mark.parametrize("number", [2, pytest.param(15, marks=pytest.mark.nightly)])
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


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["-"], 2, "has no end; give --live"),
        (["/dev/video2"], 2, "/dev/video2: has no end; give --live"),
        (["7", "--live", "--box", "1,1,9,9"], 3, "7: there is no camera of this number"),  # OpenCV says nothing
        (["-", "--live", "-o", "x"], 2, "leave --out out"),
        (["0", "--live", "--stop", "3"], 2, "--live has no --stop"),
        *(
            ([str(FILM), "--faces", "all", "--live", *more], 2, "--faces all --live looks for every face; leave out")
            for more in (["--box", "1,1,9,9"], ["--config", "signer"], ["--config", "correlation_filter"])
        ),
    ],
)
def test_what_live_cannot_be(capfd, tmp_path, monkeypatch, words, code, said):
    monkeypatch.chdir(tmp_path)
    assert main(["run", *words]) == code
    err = capfd.readouterr().err
    assert said in err and (code == 2 or err.count("\n") == 1)


def test_a_camera_of_rtsp_is_followed_again_when_it_ends_and_that_is_said(monkeypatch):
    """It shows its images twice: then nobody answers there, and a signal ends the wait."""
    address, lines, said = camera(IMAGES, visits=2), [], []
    monkeypatch.setattr(live, "LEAST_WAIT_S", 0.01)
    images = received(address, said.append)
    found = followed(images, lines.append, lambda: len(lines) == 12 and len(said) > 2)
    assert found == 12 and [json.loads(line)["frame"] for line in lines] == list(range(12))
    for at in (5, 11):
        assert json.loads(lines[at])["targets"][0]["parts"][0]["x"] == pytest.approx(56.5, abs=2)
    assert said[:2] == [f"{address}: it has ended; it is opened again in 0.01 s"] * 2


def test_the_service_of_the_page_follows_a_camera(tmp_path):
    """Typed as the page has it, in a process of its own, beside a camera that shows a sample clip once."""
    check_cascades()
    [text] = [one for one in blocks(ROOT / "docs" / "pipelines.md", "python") if "HTTPServer" in one]
    (tmp_path / "service.py").write_text(text, encoding="utf-8")
    with av.open(str(FOLDER / "expressions.mp4")) as file:
        images = [one.to_ndarray(format="bgr24") for one in itertools.islice(file.decode(video=0), 25)]
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    words = [sys.executable, str(tmp_path / "service.py"), camera(images), str(port)]
    with subprocess.Popen(words, cwd=ROOT, stderr=subprocess.PIPE) as service:
        try:
            seen = _asked(port, lambda told: told.get("time_s", 0) >= 24 / 25)
            assert service.poll() is None
        finally:
            service.kill()
            said = service.stderr.read().decode()
    assert seen, said
    truth = read_truth(FOLDER / "expressions.truth.csv").find("face", "nose").at(24)
    assert seen["status"] == "tracked" and seen["time_s"] == pytest.approx(24 / 25)
    assert np.hypot(seen["x"] - truth.x[0], seen["y"] - truth.y[0]) < 5


def _asked(port, until):
    """What a service answers once it is what is waited for; None after a minute."""
    end = time.monotonic() + 60
    while time.monotonic() < end:
        with contextlib.suppress(OSError), urlopen(f"http://127.0.0.1:{port}/", timeout=5) as answer:
            if until(told := json.load(answer)):
                return told
        time.sleep(0.1)
    return None


STOP = 125  # after the two people were seen together


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """The lines of the sample film."""
    lines, cast = [], LiveCast(None, 25.0, {})

    def write(line):
        lines.append(json.loads(line))
        assert len(cast.names) <= 2, "of a stream the names are kept of those that are there"

    with open_source(FILM, stop=STOP) as source:
        count = follow(iter(source), load_recipe("face"), None, write, cast=cast)
    assert count == len(lines)
    return lines


def seen(frames):
    """Of each track that is seen on a face of the truth: its frame, its name, its name then, who it truly is."""
    truth = read_truth(FOLDER / "film.truth.csv")
    for line in frames:
        there = truth.at(line["frame"])
        for one in line["targets"]:
            [box] = [part for part in one["parts"] if part["part"] == "box"]
            near = [
                there.names[which][0]
                for x, y, w, which in zip(there.x, there.y, there.w, there.which, strict=True)
                if box["status"] != "lost" and abs(x - box["x"]) + abs(y - box["y"]) < 0.6 * w
            ]
            if near:
                yield line["frame"], one["target"], line["people"][one["target"]], near[0]


def test_each_frame_has_its_line_and_each_face_of_it_its_track(told):
    assert [line["frame"] for line in told] == list(range(len(told)))
    truth = read_truth(FOLDER / "film.truth.csv")
    assert len([*seen(told)]) > 0.95 * (truth.between(0, STOP).status == "visible").sum()


def test_a_name_that_was_told_is_right_and_comes_soon(told):
    rows = [*seen(told)]
    who = Counter((name, true) for _, _, name, true in rows if name)
    assert len({name for name, _ in who}) == len({true for _, true in who}) == len(who) == 2, who
    assert sum(who.values()) > 0.7 * len(rows)
    begun = {track: frame for frame, track, _, _ in reversed(rows)}
    named = {track: frame for frame, track, name, _ in reversed(rows) if name}
    assert all(named[track] - begun[track] <= 20 for track in named) and len(named) > 2


def test_a_cut_is_known_when_its_first_frame_comes_out():
    with open_source(FILM) as source:
        frames = list(source)
    shots = [(shot, frame.index) for shot, frame in passing_shots(iter(frames))]
    cuts = [cut.frame for cut in find_cuts(iter(frames)) if cut.last < cut.first]
    begins = dict(reversed(shots))
    assert [frame for _, frame in shots] == list(range(len(shots))) and cuts and {*cuts} <= {*begins.values()}


def test_tracks_that_end_together_end_in_their_order(monkeypatch):
    cast, ended = LiveCast(None, 25.0, {}), []
    cast._now = dict.fromkeys([f"track_{n}" for n in range(20)])
    monkeypatch.setattr(cast, "_end", ended.append)
    cast._see(SimpleNamespace(targets=(), frame=SimpleNamespace(index=9)), 0)
    assert ended == [*cast._now], "not in that of a set, which each process has of its own"
