"""Writing MP4s: each frame at its time, the sound in step, and nothing half-written left behind."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from facetrack_cli.core.errors import OutputError
from facetrack_cli.video import writer as ours
from facetrack_cli.video.decode import sound_of
from facetrack_cli.video.source import open_source
from facetrack_cli.video.writer import VideoWriter
from tests.support import media
from tests.support.sway import names as left_behind

FPS = Fraction(25)
# a tone that begins in the 13th frame
BEEP = "0.5*sin(6000*t)*gte(t,0.5)"


def write(path: Path, count: int = 20, **options: object) -> VideoWriter:
    writer = VideoWriter(path, media.SIZE, FPS, **options)  # type: ignore[arg-type]
    for index in range(count):
        writer.write(media.numbered(index), index / 25)
    writer.close()
    return writer


def copy(source: Path, target: Path, **options: object) -> VideoWriter:
    """Through our reader and our writer, with sound, as `run` does."""
    with open_source(source, **options) as frames:  # type: ignore[arg-type]
        writer = VideoWriter(target, frames.size, frames.fps, audio_from=source)
        for frame in frames:
            writer.write(frame.bgr, frame.time_s)
        writer.close()
    return writer


def onset(path: Path) -> float:
    """When the beep begins, in seconds."""
    sound = np.abs(media.read_sound(path))
    return float(np.argmax(sound > 0.2)) / 44100


@pytest.mark.parametrize("fps", [Fraction(30000, 1001), Fraction(359, 12)])
def test_constant_rate_stays_strictly_constant(tmp_path: Path, fps: Fraction) -> None:
    path = tmp_path / "out.mp4"
    with VideoWriter(path, media.SIZE, fps) as writer:
        for index in range(30):  # with times to the whole millisecond, as Matroska gives them
            writer.write(media.numbered(index), round(float(index / fps), 3))
    pictures = media.read_timed(path)
    assert [media.number(picture) for _, picture in pictures] == list(range(30))
    np.testing.assert_allclose([t for t, _ in pictures], [float(k / fps) for k in range(30)], atol=1e-9)
    head = ours.run_ffmpeg(["-i", str(path)])[1]
    assert "h264" in head and "yuv420p" in head and "mp4" in head
    assert left_behind(tmp_path) == ["out.mp4"]


def test_variable_rate_stays_in_step_with_the_source(tmp_path: Path) -> None:
    gaps = [0.04] * 6 + [0.25] * 3 + [0.013] * 12 + [1.5, 0.04, 0.04]
    times = np.round(np.concatenate([[0.0], np.cumsum(gaps)]), 3)
    source = media.write_video(tmp_path / "vfr.mp4", frames=len(times), times=times.tolist(), sound=BEEP)
    copy(source, tmp_path / "out.mp4")
    pictures = media.read_timed(tmp_path / "out.mp4")
    shown = [t for t, _ in pictures]
    np.testing.assert_allclose(shown, times, atol=0.002)
    for moment in np.arange(0.005, times[-1], 0.0171):  # whenever one looks, both show the same frame
        expected = int(np.searchsorted(times, moment, side="right")) - 1
        if min(abs(times - moment)) > 0.003:
            assert media.number(pictures[np.searchsorted(shown, moment, side="right") - 1][1]) == expected
    assert onset(tmp_path / "out.mp4") == pytest.approx(0.5, abs=0.03)


def test_a_variable_rate_is_sought_by_number_in_opencv(tmp_path: Path) -> None:
    times = np.round(np.cumsum(np.random.default_rng(1).uniform(0.033, 0.043, 40)), 3)  # as of a telephone
    copy(media.write_video(tmp_path / "vfr.mp4", frames=40, times=times.tolist()), tmp_path / "out.mp4")
    capture = cv2.VideoCapture(str(tmp_path / "out.mp4"))
    for index in np.random.default_rng(0).permutation(40):
        capture.set(cv2.CAP_PROP_POS_FRAMES, int(index))
        assert media.number(capture.read()[1]) == index


@pytest.mark.parametrize("fps, ticks", [(FPS, 10_000), (Fraction(1, 60), 10_000), (Fraction(60000, 1001), 60_000)])
def test_times_never_fall_and_a_gap_is_shown_for_as_long_as_an_mp4_holds(
    tmp_path: Path, fps: Fraction, ticks: int
) -> None:
    longest_s = 2**29 / ticks
    steps = np.array([0.0, 1.0, 0.0, 0.5, 4_000.0, 1.0, 360_000.0, 0.5, 3600.0, 90_000.0])
    with VideoWriter(tmp_path / "out.mp4", media.SIZE, fps) as writer:
        for index, moment in enumerate(3 + np.cumsum(steps)):
            writer.write(media.numbered(index), moment)
    [warning] = writer.warnings
    assert warning == f"{tmp_path / 'out.mp4'}: a gap of 100.0 hours at 4006 s is shown as {longest_s / 3600:.1f}"
    pictures = media.read_timed(tmp_path / "out.mp4")
    assert [media.number(picture) for _, picture in pictures] == list(range(len(steps)))
    times = [t for t, _ in pictures]
    np.testing.assert_allclose(times, np.cumsum(np.minimum(steps, longest_s)), atol=0.0011)
    assert (np.diff(times) > 0).all()


@pytest.mark.parametrize(("size", "weight"), [((64, 48), 0.587), ((65, 47), 0.587), ((64, 720), 0.7152)])
def test_chroma_is_the_mean_of_four_pixels(tmp_path: Path, size: tuple[int, int], weight: float) -> None:
    image, means = np.zeros((size[1], size[0], 3), np.uint8), []
    for step in (1, 2):  # all green, then lines one pixel wide
        image[:], image[:, ::step, 1] = 0, 255
        with VideoWriter(tmp_path / "out.mp4", size, FPS) as writer:
            writer.write(image, 0.0)
        with av.open(str(tmp_path / "out.mp4")) as video:
            planes = next(video.decode(video=0)).to_ndarray()
        width, height = -(-size[0] // 2) * 2, -(-size[1] // 2) * 2
        y, chroma = np.split(planes.ravel(), [width * height])
        means.append(np.median(chroma.reshape(2, -1), axis=1) - 128)
    lit = [np.median(y.reshape(height, width)[:, first::2]) for first in (0, 1)]
    np.testing.assert_allclose(lit, [16 + 219 * weight, 16], atol=2)
    np.testing.assert_allclose(means[1], means[0] / 2, atol=2)


# sound


@pytest.mark.parametrize(
    "suffix",
    [".mp4", ".mkv", ".ts", *(pytest.param(f".{s}", marks=pytest.mark.nightly) for s in ("avi", "mpg", "webm", "mov"))],
)
def test_sound_stays_in_step(tmp_path: Path, suffix: str) -> None:
    start = 0 if suffix in (".mp4", ".avi", ".mpg") else 7
    source = media.write_video(tmp_path / f"clip{suffix}", frames=60, sound=BEEP)
    out = tmp_path / "out.mp4"
    writer = copy(source, out, start=start, stop=45)
    assert writer.warnings == []
    # lossy codecs start a packet early or late; a frame lasts 0.04 s
    sound = np.abs(media.read_sound(out))
    assert np.argmax(sound > 0.2) / 44100 == pytest.approx(0.5 - start / 25, abs=0.04)
    assert len(sound) / 44100 == pytest.approx((45 - start) / 25, abs=0.06)
    assert [media.number(picture) for _, picture in media.read_timed(out)] == list(range(start, 45))
    assert left_behind(tmp_path) == [f"clip{suffix}", "out.mp4"]


@pytest.mark.parametrize("delay", [-0.2, 0.24])
def test_sound_that_starts_before_or_after_the_pictures(tmp_path: Path, delay: float) -> None:
    source = media.write_video(tmp_path / "clip.mkv", frames=60, sound=BEEP, sound_delay_s=delay)
    copy(source, tmp_path / "out.mp4")
    assert onset(tmp_path / "out.mp4") == pytest.approx(0.5 + delay, abs=0.03)


def test_sound_lasts_as_long_as_the_last_picture_and_silence_is_no_fuss(tmp_path: Path) -> None:
    source = media.write_video(tmp_path / "clip.mp4", frames=6, fps=2, sound=BEEP)
    copy(source, tmp_path / "out.mp4", stop=4)
    assert len(media.read_sound(tmp_path / "out.mp4")) / 44100 == pytest.approx(4 / 2, abs=0.06)
    silent = media.write_video(tmp_path / "silent.mp4", frames=20)
    for source in (silent, tmp_path, tmp_path / "missing.mp4"):
        writer = write(tmp_path / "out.mp4", 3, audio_from=source)
        assert writer.warnings == []
        assert "Audio" not in ours.run_ffmpeg(["-i", str(tmp_path / "out.mp4")])[1]


def test_sound_that_fails_leaves_the_video_and_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = media.write_video(tmp_path / "clip.mp4", frames=20, sound=BEEP)
    real = ours.run_ffmpeg

    def failing(arguments: list[str]) -> tuple[int, str]:
        if "-itsoffset" in arguments:
            return 1, "[aist#0:1 @ 0x1] Error: no such codec\n"
        return real(arguments)

    monkeypatch.setattr(ours, "run_ffmpeg", failing)
    writer = write(tmp_path / "out.mp4", audio_from=source)
    (warning,) = writer.warnings
    assert "without sound" in warning and "no such codec" in warning and "\n" not in warning and "0x1" not in warning
    assert len(media.read_timed(tmp_path / "out.mp4")) == 20
    assert left_behind(tmp_path) == ["clip.mp4", "out.mp4"]


def test_sound_is_read_from_files_of_clips_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A playlist makes ffmpeg open the files and addresses that it names."""
    mine = media.write_video(tmp_path / "mine.mp4", frames=20, sound=BEEP)
    monkeypatch.setattr("facetrack_cli.video.writer.sound_of", lambda path: ("aac", 0.0))
    lists = {"a.m3u8": f"#EXTM3U\n#EXTINF:1,\n{mine}\n", "a.ffconcat": f"ffconcat version 1.0\nfile {mine}\n"}
    for name, text in lists.items():
        (tmp_path / name).write_text(text)
        written = write(tmp_path / f"{name}.mp4", audio_from=tmp_path / name)
        [warning] = written.warnings
        assert "written without sound" in warning and sound_of(written.path)[0] == ""


# files


def test_nothing_appears_at_the_path_before_it_is_whole_nor_without_frames(tmp_path: Path) -> None:
    path = tmp_path / "out.mp4"
    with VideoWriter(path, media.SIZE, FPS):
        pass
    assert left_behind(tmp_path) == []
    path.write_text("the former one")
    writer = VideoWriter(path, media.SIZE, FPS)
    writer.write(media.numbered(0), 0.0)
    (temporary,) = [name for name in left_behind(tmp_path) if name != "out.mp4"]
    assert temporary.startswith(".")
    writer.discard()
    writer.close()
    assert path.read_text() == "the former one" and left_behind(tmp_path) == ["out.mp4"]


@pytest.mark.parametrize("half", [b"", b"\x1f\x43\xb6\x75\x01\x00\x00"])
def test_what_was_written_until_an_interruption_is_kept(tmp_path: Path, half: bytes) -> None:
    with pytest.raises(KeyboardInterrupt), VideoWriter(tmp_path / "out.mp4", media.SIZE, FPS) as writer:
        for index in range(12):
            writer.write(media.numbered(index), index / 25)
        writer._pipe.write(half)  # a part of a frame
        raise KeyboardInterrupt
    assert [media.number(picture) for _, picture in media.read_timed(tmp_path / "out.mp4")] == list(range(12))


@pytest.mark.skipif(os.name != "posix", reason="signals to a process group")
def test_ctrl_c_of_the_terminal_does_not_reach_the_encoder(tmp_path: Path) -> None:
    script = (
        "import sys, time\nfrom fractions import Fraction\nfrom pathlib import Path\n"
        "from facetrack_cli.video.writer import VideoWriter\nfrom tests.support import media\n"
        "with VideoWriter(Path(sys.argv[1]), media.SIZE, Fraction(25)) as writer:\n"
        "    for index in range(200):\n"
        "        writer.write(media.numbered(index), index / 25)\n"
        "        if index == 9: print('go', flush=True)\n"
        "        if index > 9: time.sleep(0.05)\n"
    )
    command, pipes = [sys.executable, "-c", script, tmp_path / "out.mp4"], (subprocess.PIPE, subprocess.DEVNULL)
    child = subprocess.Popen(
        command, cwd=Path(__file__).parents[2], stdout=pipes[0], stderr=pipes[1], start_new_session=True
    )
    assert child.stdout is not None and child.stdout.readline()
    time.sleep(0.2)
    os.killpg(child.pid, signal.SIGINT)  # as a terminal does: to the whole group
    assert child.wait(timeout=30) != 0
    child.stdout.close()
    numbers = [media.number(picture) for _, picture in media.read_timed(tmp_path / "out.mp4")]
    assert numbers == list(range(len(numbers))) and 10 <= len(numbers) < 200
    assert left_behind(tmp_path) == ["out.mp4"]


def test_output_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    for path in (tmp_path / "missing" / "out.mp4", tmp_path / "file" / "out.mp4"):
        with pytest.raises(OutputError) as caught:
            VideoWriter(path, media.SIZE, FPS)
        assert str(path) in str(caught.value) and "another output folder" in str(caught.value)
    (tmp_path / "out.mp4").mkdir()
    with pytest.raises(OutputError, match=r"out\.mp4"):
        write(tmp_path / "out.mp4")
    assert left_behind(tmp_path) == ["file", "out.mp4"]
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / "nothing"))
    with pytest.raises(OutputError, match="ffmpeg cannot be started"):
        VideoWriter(tmp_path / "other.mp4", media.SIZE, FPS)
    assert left_behind(tmp_path) == ["file", "out.mp4"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = VideoWriter(tmp_path / "out.mp4", media.SIZE, FPS)
    writer.discard()
    # the encoder's file is the device that is always full
    monkeypatch.setattr(ours, "temporary_path", lambda path: Path("/dev/full"))
    writer = VideoWriter(tmp_path / "out.mp4", (640, 480), FPS)
    with pytest.raises(OutputError) as caught:
        for index in range(600):
            writer.write(media.numbered(index % 256, (640, 480)), index / 25)
        writer.close()
    message = str(caught.value)
    assert "No space left" in message and str(tmp_path / "out.mp4") in message and "\n" not in message
    with contextlib.suppress(ValueError):
        writer.write(media.numbered(0, (640, 480)), 99.0)
    writer.close()
    assert left_behind(tmp_path) == []


@pytest.mark.skipif(sys.platform != "linux", reason="a variable of glibc")
def test_the_same_frames_are_the_same_bytes_whatever_is_in_memory(tmp_path: Path) -> None:
    script = (
        "import sys\nfrom fractions import Fraction\nfrom pathlib import Path\n"
        "from facetrack_cli.video.writer import VideoWriter\nfrom tests.support import media\n"
        "with VideoWriter(Path(sys.argv[1]), (176, 144), Fraction(25)) as writer:\n"
        "    for index in range(8):\n"
        "        writer.write(media.numbered(index, (176, 144)), index / 25)\n"
    )
    for filled in ("0", "1"):
        env = {**os.environ, "MALLOC_PERTURB_": filled}
        command = [sys.executable, "-c", script, tmp_path / f"{filled}.mp4"]
        subprocess.run(command, cwd=Path(__file__).parents[2], env=env, check=True)
    assert (tmp_path / "0.mp4").read_bytes() == (tmp_path / "1.mp4").read_bytes()
