"""Reading videos: every frame, in order, with its time; what is said of damage, and of clips that cannot be read."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import FacetrackError, InputError, UsageError
from facetrack_cli.core.types import Frame
from facetrack_cli.video.source import Source, open_source
from tests.support import media
from tests.support.damage import raising


def read(path: Path, **options: object) -> tuple[Source, list[Frame]]:
    with open_source(path, **options) as source:  # type: ignore[arg-type]
        return source, list(source)


def numbers(frames: list[Frame]) -> list[int]:
    return [media.number(frame.bgr) for frame in frames]


def refusal(path: Path, **options: object) -> str:
    """The message with which a clip is refused, which must be one line and name the path."""
    with pytest.raises(FacetrackError) as caught:
        read(path, **options)
    message = str(caught.value)
    assert str(path) in message and "\n" not in message and ";" in message
    return message


def check_whole(path: Path, count: int, least: int = 0) -> None:
    """All frames are there, and nothing is said of them."""
    source, frames = read(path)
    assert (source.complete, source.warnings) == (True, [])
    assert len(frames) == count or (least and len(frames) >= least)


# frames and times


@pytest.mark.parametrize("suffix", sorted(media.CODECS))
def test_every_frame_of_a_whole_video_with_its_time(tmp_path: Path, suffix: str) -> None:
    path = media.write_video(tmp_path / f"clip{suffix}", frames=40, fps=Fraction(30000, 1001), sound="sin(2000*t)")
    source, frames = read(path)
    assert source.is_video and source.size == media.SIZE
    assert abs(source.fps - Fraction(30000, 1001)) < 0.01
    assert source.complete and source.warnings == []
    assert numbers(frames) == list(range(40))
    assert [frame.index for frame in frames] == list(range(40))
    steps = np.diff([frame.time_s for frame in frames])
    assert frames[0].time_s == 0.0
    if suffix == ".avi":  # this container starts with a gap, to make room for the sound's first packet
        steps = steps[1:]
    np.testing.assert_allclose(steps, 1001 / 30000, atol=0.0011)
    for frame in frames:
        assert frame.bgr.dtype == np.uint8 and frame.bgr.flags.c_contiguous and frame.bgr.shape == (48, 64, 3)
    assert len({frame.bgr.ctypes.data for frame in frames}) == 40, "frames share memory"


# OpenCV starts the first of them late and gives the last frames no time at all
CLOCKS = [("b.avi", ("-c:v", "libx264", "-preset", "medium", "-bf", "3"), [0.04] * 29)]
CLOCKS += [(name, (), [0.04] * 8 + [0.12] * 5 + [0.02] * 10 + [0.5, 0.04]) for name in ("variable.mp4", "variable.mkv")]


@pytest.mark.parametrize(("name", "options", "gaps"), CLOCKS)
def test_the_clock_of_a_clip_is_kept(tmp_path: Path, name: str, options: tuple[str, ...], gaps: list[float]) -> None:
    times = np.concatenate([[0.0], np.cumsum(gaps)])
    more = {"times": times.tolist()} if "variable" in name else {}
    source, frames = read(media.write_video(tmp_path / name, frames=len(times), options=options, **more))
    assert numbers(frames) == list(range(len(times)))
    np.testing.assert_allclose([frame.time_s for frame in frames], times, atol=0.0011)
    assert source.variable is ("variable" in name) and source.complete


@pytest.mark.parametrize("suffix", [".mkv", ".mp4", ".ts"])
def test_the_first_frame_is_late_where_sound_comes_first(tmp_path: Path, suffix: str) -> None:
    written = media.write_video(tmp_path / "late.mkv", frames=60, sound="sin(2000*t)", sound_delay_s=-0.3)
    path = tmp_path / f"copy{suffix}"
    media.ffmpeg("-i", written, "-c", "copy", path)
    source, frames = read(path)
    late = pytest.approx(0.3, abs=0.05)  # the sound's encoder begins early
    assert source.begins_s == late == frames[0].time_s
    np.testing.assert_allclose([one.time_s - source.begins_s for one in frames], np.arange(60) / 25, atol=0.0011)
    assert source.complete
    assert read(path, start=40)[1][0].time_s == frames[40].time_s


@pytest.mark.parametrize("suffix", [".mp4", ".webm"])
def test_start_and_stop_are_exact(tmp_path: Path, suffix: str) -> None:
    path = media.write_video(tmp_path / f"clip{suffix}", frames=60)
    source, frames = read(path, start=37, stop=41)
    assert source.frames_hint == 4
    assert numbers(frames) == [37, 38, 39, 40]
    assert [frame.index for frame in frames] == [37, 38, 39, 40]
    np.testing.assert_allclose([frame.time_s for frame in frames], np.arange(37, 41) / 25, atol=1e-6)
    assert numbers(read(path, start=58, stop=500)[1]) == [58, 59]
    assert numbers(read(path, stop=1)[1]) == [0]
    assert "60 frames (0 to 59)" in refusal(path, start=60)
    real = len(read(short := media.cut(path, tmp_path / f"short{suffix}", 0.6))[1])
    assert 0 < real < 60 and f"{real} frames" in refusal(short, start=59)


@pytest.mark.parametrize("period", [60, 40_000])
def test_time_lapses(tmp_path: Path, period: int) -> None:
    whole = media.write_video(tmp_path / "whole.mkv", frames=5, fps=1, options=("-g", "1"))
    path = tmp_path / "lapse.mp4"
    media.ffmpeg("-i", whole, "-c", "copy", "-bsf:v", f"setts=ts=N*{period}/TB:duration={period}/TB", path)
    source, frames = read(path)
    assert [frame.time_s for frame in frames] == pytest.approx([index * period for index in range(5)], rel=1e-4)
    assert source.complete and source.fps == pytest.approx(Fraction(1, period), rel=0.01)


def test_odd_sizes_and_grey_video(tmp_path: Path) -> None:
    pictures = [media.numbered(index, (63, 47)) for index in range(5)]
    path = media.write_video(tmp_path / "odd.mkv", frames=pictures, options=("-c:v", "ffv1", "-pix_fmt", "gray"))
    source, frames = read(path)
    assert source.size == (63, 47)
    assert numbers(frames) == list(range(5))
    np.testing.assert_array_equal(frames[3].bgr, pictures[3])


def test_a_source_is_closed_from_another_thread(tmp_path: Path) -> None:
    source = open_source(media.write_video(tmp_path / "clip.mp4", frames=100))
    seen = 0
    for seen, _ in enumerate(source, 1):
        if seen == 5:
            closer = threading.Thread(target=source.close)
            closer.start()
            closer.join()
    source.close()
    assert seen == 5 and source.complete


def test_names_that_look_like_options_or_protocols(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = media.write_video(tmp_path / "plain.mp4", frames=8)
    monkeypatch.chdir(tmp_path)
    for name in ("-i.mp4", "a:b.mp4", "frame%03d.mp4", "ünï çødé.mp4", "a b'c.mp4", "clip[1].mp4"):
        plain.with_name(name).write_bytes(plain.read_bytes())
        assert numbers(read(Path(name))[1]) == list(range(8)), name


# whole clips of many kinds

X264 = ("-c:v", "libx264", "-preset", "veryfast")
OPEN_GOP = (*X264, "-x264-params", "open-gop=1:keyint=12:bframes=3:scenecut=0")
KINDS = {
    "open.mp4": OPEN_GOP,
    "open.ts": OPEN_GOP,
    "rows.mp4": (*X264, "-flags", "+ildct+ilme", "-x264-params", "interlaced=1"),
    "deep.mkv": (*X264, "-profile:v", "high10", "-pix_fmt", "yuv420p10le"),
    "nine.webm": ("-c:v", "libvpx-vp9", "-deadline", "realtime", "-cpu-used", "8"),
    "still.avi": ("-c:v", "mjpeg", "-pix_fmt", "yuvj420p"),
    "four.avi": ("-c:v", "mpeg4", "-bf", "2"),
    "two.ts": ("-c:v", "mpeg2video", "-bf", "2"),
    "late.mkv": ("-output_ts_offset", "10"),
    "ten.mp4": (
        *("-c:v", "libx265", "-preset", "ultrafast", "-x265-params", "log-level=none"),
        *("-pix_fmt", "yuv420p10le", "-tag:v", "hvc1"),
    ),
    "av1.mp4": ("-c:v", "libaom-av1", "-cpu-used", "8", "-usage", "realtime"),
}


@pytest.mark.parametrize("name", KINDS)
def test_whole_clips_of_many_kinds(tmp_path: Path, name: str) -> None:
    path = media.write_video(tmp_path / name, frames=20, size=(128, 96), options=KINDS[name])
    check_whole(path, 20)


@pytest.mark.parametrize("name", ["cut.mp4", "cut.mkv", "cut.ts"])
def test_a_clip_that_begins_between_two_keyframes_is_whole(tmp_path: Path, name: str) -> None:
    whole = media.write_video(tmp_path / f"whole{Path(name).suffix}", frames=60, size=(128, 96), options=OPEN_GOP)
    media.ffmpeg("-ss", "0.7", "-i", whole, "-c", "copy", tmp_path / name)
    check_whole(tmp_path / name, 0, least=30)


def test_an_edit_list_that_hides_frames_and_sound_that_outlasts_the_images(tmp_path: Path) -> None:
    whole = media.write_video(tmp_path / "whole.mp4", frames=50, sound="0.1*sin(2000*t)")
    media.ffmpeg("-ss", "0.9", "-i", whole, "-c", "copy", tmp_path / "cut.mp4")  # the container still counts them
    check_whole(tmp_path / "cut.mp4", 0, least=20)
    b_frames = media.write_video(tmp_path / "b.mp4", frames=30, options=("-c:v", "libx264", "-bf", "3"))
    tone = ("-f", "lavfi", "-i", "sine=d=20:r=8000", "-c:v", "copy", "-c:a", "aac")
    for suffix in (".mp4", ".mkv"):
        media.ffmpeg("-i", b_frames, *tone, tmp_path / f"long{suffix}")
        check_whole(tmp_path / f"long{suffix}", 30)


def test_references_of_quicktime_are_not_followed(tmp_path: Path) -> None:
    data = media.write_video(tmp_path / "other.mov", frames=10).read_bytes()
    assert data.count(b"url \0\0\0\1") >= 1  # a data reference: to the file itself
    path = tmp_path / "clip.mov"
    path.write_bytes(data.replace(b"url \0\0\0\1", b"url \0\0\0\0"))  # to another, which is not named
    check_whole(path, 10)  # as if it were to the file itself


# cut and damaged


@pytest.mark.parametrize(
    ("suffix", "share"), [(".mp4", 0.3), (".mp4", 0.9), (".mkv", 0.6), (".webm", 0.3), (".avi", 0.6), (".avi", 0.9)]
)
def test_a_cut_video_gives_what_is_there_and_says_so(tmp_path: Path, suffix: str, share: float) -> None:
    whole = media.write_video(tmp_path / f"whole{suffix}", frames=100, sound="0.1*sin(2000*t)")
    path = media.cut(whole, tmp_path / f"short{suffix}", share)
    source, frames = read(path)
    assert source.complete is False
    (warning,) = source.warnings
    assert str(path) in warning and f"{len(frames)} frames" in warning
    assert "of about 10" in warning
    assert 100 * share - 20 <= len(frames) <= 100 * share + 8
    # the last image may be half there
    assert numbers(frames)[:-1] == list(range(len(frames) - 1))
    assert read(path, stop=10)[0].complete, "what comes later does not matter"


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_a_program_stream_that_ends_within_a_frame(tmp_path: Path, share: float) -> None:
    source, frames = read(media.cut(media.write_video(tmp_path / "whole.mpg", frames=60), tmp_path / "a.mpg", share))
    assert f"at about frame {len(frames) - 1}" in source.warnings[0] and not source.complete


def test_where_the_errors_are_is_said_and_two_clips_at_a_time_are_told_apart(tmp_path: Path) -> None:
    whole = media.write_video(tmp_path / "whole.mp4", frames=100, size=(320, 240), options=("-g", "10"))
    path, data = tmp_path / "clip.mp4", bytearray(whole.read_bytes())
    at = len(data) * 3 // 5
    for place in range(at, at + 3000, 37):
        data[place] ^= 0xA5
    path.write_bytes(data)
    with open_source(whole) as good, open_source(path) as bad:
        assert len(list(bad)) == len(list(good)) == 100
    assert good.complete and not bad.complete
    (warning,) = bad.warnings
    assert "damaged: the decoder reports errors at about frame" in warning and "; copy or download it again" in warning
    first = int(warning.partition("about frame")[2].lstrip("s ").split(",")[0].split()[0])
    assert 45 <= first <= 65
    assert read(path, stop=30)[0].complete
    data = bytearray(whole.read_bytes())
    data[len(data) // 2 : len(data) * 5 // 8] = bytes(len(data) // 8)
    path.write_bytes(data)
    source, frames = read(path)
    assert 20 < len(frames) <= 100 and source.complete is False and len(source.warnings) == 1


@pytest.mark.parametrize(("suffix", "kept"), [(".mp4", 0), (".mkv", 3000)])
def test_a_clip_that_is_cut_while_it_is_read(tmp_path: Path, suffix: str, kept: int) -> None:
    path = media.write_video(tmp_path / f"clip{suffix}", frames=100, size=(320, 240))
    with open_source(path) as source:
        frames = iter(source)
        next(frames)
        with path.open("r+b") as file:
            file.truncate(kept)
        count = 1 + sum(1 for _ in frames)
    assert count < 100 and source.complete is False
    assert source.warnings == [f"{path}: changed while it was read, after {count} frames; run it again"]


def test_nothing_reaches_stderr(tmp_path: Path) -> None:
    """Neither of damage, nor where a clip is open at the end of the process."""
    whole = media.write_video(tmp_path / "whole.mp4", frames=60)
    script = (
        "import sys\nfrom pathlib import Path\nfrom facetrack_cli.video.source import open_source\n"
        "source = open_source(Path(sys.argv[1]))\nlist(source)\nassert not source.complete\n"
        "try: open_source(Path(sys.argv[2]))\nexcept Exception: pass\n"
        "frames = iter(open_source(Path(sys.argv[3])))\nnext(frames)\n"
    )
    short, broken = media.cut(whole, tmp_path / "short.mp4", 0.5), media.without_moov(tmp_path / "broken.mp4")
    command = [sys.executable, "-c", script, short, broken, whole]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


# what cannot be read


def test_refused_files(tmp_path: Path) -> None:
    text = b"not a film at all\n" * 50
    for name, data, words in (
        ("missing.mp4", None, "no such file"),
        ("empty.mp4", b"", "empty"),
        ("text.mp4", text, "not a video"),
        ("notes.txt", text, "not a video"),
        ("noise.avi", np.random.default_rng(1).bytes(20000), "not a video"),
    ):
        if data is not None:
            (tmp_path / name).write_bytes(data)
        assert words in refusal(tmp_path / name)
    assert "moov" in refusal(media.without_moov(tmp_path / "cut.mp4"))
    assert "not a video" in refusal(media.sound_only(tmp_path / "tune.mp4"))
    assert "pipe" in refusal(Path("-"))
    cover = media.write_pictures(tmp_path / "c", 1) / "0.png"
    inputs = ("-f", "lavfi", "-i", "sine=d=1", "-i", cover, "-map", "0", "-map", "1", "-c:v", "copy")
    media.ffmpeg(*inputs, "-disposition:v", "attached_pic", tmp_path / "tune.mp3")
    assert "not a video" in refusal(tmp_path / "tune.mp3"), "the picture of its cover is none"


@pytest.mark.parametrize("suffix", sorted(media.CODECS))
def test_a_clip_that_is_cut_within_its_headers_is_refused(tmp_path: Path, suffix: str) -> None:
    """PyAV's error at the end of a file is Python's EOFError, which is no OSError."""
    data = media.write_video(tmp_path / f"whole{suffix}", frames=5).read_bytes()
    path = tmp_path / f"cut{suffix}"
    for length in {*range(1, 100, 24), *range(200, min(len(data), 6000), 601)}:
        path.write_bytes(data[:length])
        try:
            read(path)
        except InputError as error:
            assert str(path) in str(error)
            assert suffix != ".avi" or length != 200 or "cut short or damaged (" in str(error)


def test_what_the_system_refuses_and_impossible_arguments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = media.write_pictures(tmp_path / "frames", 3)
    path = media.write_video(tmp_path / "clip.mp4", frames=3)
    for clip, options in (
        (folder, {"start": 2, "stop": 2}),
        (path, {"fps": Fraction(30)}),
    ):
        with pytest.raises(UsageError):
            open_source(clip, **options)  # type: ignore[arg-type]
    refuse = raising(PermissionError(13, "Permission denied"))
    monkeypatch.setattr(Path, "open", refuse)  # the tests may run as root, whom no file mode stops
    assert "Permission denied" in refusal(path)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere names are text")
def test_a_name_that_is_no_text_is_refused_before_opencv_ends_the_process(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no UTF-8 text; rename the file"):
        open_source(tmp_path / os.fsdecode(b"caf\xe9.mp4"))


@pytest.mark.parametrize(
    "text",
    [
        "#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:1,\n{}\n#EXT-X-ENDLIST\n",
        "ffconcat version 1.0\nfile '{}'\n",
        '<MPD profiles="urn:mpeg:dash:profile:isoff-on-demand:2011"><BaseURL>{}</BaseURL></MPD>',
        "v=0\no=- 0 0 IN IP4 127.0.0.1\nc=IN IP4 127.0.0.1\nm=video 5004 RTP/AVP 96\n",
        "ID3\3\0\0\0\0\0\0ffconcat version 1.0\nfile '{}'\n",
    ],
)
def test_playlists_are_refused(tmp_path: Path, text: str) -> None:
    other = media.write_video(tmp_path / "other.ts", frames=10)
    for name in ("clip.mp4", "list.txt"):
        (tmp_path / name).write_text(text.format(other.name))
        assert "not a video that can be read; give another" in refusal(tmp_path / name)


@pytest.mark.parametrize("address", ["https://example.org/a.mp4?x=1", "rtsp://camera/1", "HTTP://example.org/a"])
def test_an_address_is_refused(
    address: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["run", address]) == 3
    [line] = capsys.readouterr().err.splitlines()
    assert line == f"facetrack: error: {address}: is an address on the network; download it first, then give the file"
    assert main(["init", address, "-o", "-"]) == 3
