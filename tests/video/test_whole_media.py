"""Unusual clips that are whole, clips that change while they are read, where damage is, and playlists."""

from __future__ import annotations

import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import pytest

from facetrack_cli.core.errors import InputError
from facetrack_cli.video.source import Source, open_source
from tests.support import media
from tests.support.damage import damaged

X264 = ("-c:v", "libx264", "-preset", "veryfast")
OPEN_GOP = (*X264, "-x264-params", "open-gop=1:keyint=12:bframes=3:scenecut=0")
KINDS = {
    "b.mp4": (*X264, "-bf", "3"),
    "open.mp4": OPEN_GOP,
    "open.ts": OPEN_GOP,
    "rows.mp4": (*X264, "-flags", "+ildct+ilme", "-x264-params", "interlaced=1"),
    "deep.mkv": (*X264, "-profile:v", "high10", "-pix_fmt", "yuv420p10le"),
    "fragments.mp4": (*X264, "-movflags", "+frag_keyframe+empty_moov"),
    "nine.webm": ("-c:v", "libvpx-vp9", "-deadline", "realtime", "-cpu-used", "8"),
    "eight.webm": ("-c:v", "libvpx", "-auto-alt-ref", "1", "-lag-in-frames", "8"),
    "still.avi": ("-c:v", "mjpeg", "-pix_fmt", "yuvj420p"),
    "four.avi": ("-c:v", "mpeg4", "-bf", "2"),
    "two.ts": ("-c:v", "mpeg2video", "-bf", "2"),
}


def read(path: Path) -> tuple[Source, int]:
    with open_source(path) as source:
        return source, sum(1 for _ in source)


@pytest.mark.parametrize("name", KINDS)
def test_whole_clips_of_many_kinds(tmp_path: Path, name: str) -> None:
    path = media.write_video(tmp_path / name, frames=50, size=(128, 96), options=KINDS[name])
    source, count = read(path)
    assert (source.complete, source.warnings, count) == (True, [], 50)


@pytest.mark.parametrize("name", ["cut.mp4", "cut.mkv", "cut.ts"])
def test_a_clip_that_begins_between_two_keyframes_is_whole(tmp_path: Path, name: str) -> None:
    whole = media.write_video(tmp_path / f"whole{Path(name).suffix}", frames=60, size=(128, 96), options=OPEN_GOP)
    media.ffmpeg("-ss", "0.7", "-i", whole, "-c", "copy", tmp_path / name)
    source, count = read(tmp_path / name)
    assert (source.complete, source.warnings) == (True, []) and count >= 30


def test_a_clock_that_begins_late(tmp_path: Path) -> None:
    path = media.write_video(tmp_path / "late.mkv", frames=50, options=("-output_ts_offset", "10"))
    source, count = read(path)
    assert (source.complete, source.warnings, count) == (True, [], 50)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_sound_that_outlasts_the_images_by_far(tmp_path: Path, suffix: str) -> None:
    whole = media.write_video(tmp_path / f"whole{suffix}", frames=30, options=("-c:v", "libx264", "-bf", "3"))
    path = tmp_path / f"long{suffix}"
    media.ffmpeg("-i", whole, "-f", "lavfi", "-i", "sine=d=110", "-c:v", "copy", "-c:a", "aac", path)
    source, count = read(path)
    assert (source.complete, source.warnings, count) == (True, [], 30)


@pytest.mark.parametrize("period", [1, 60, 3600, 40_000])
def test_time_lapses(tmp_path: Path, period: int) -> None:
    whole = media.write_video(tmp_path / "whole.mkv", frames=5, fps=1, options=("-g", "1"))
    path = tmp_path / "lapse.mp4"
    media.ffmpeg("-i", whole, "-c", "copy", "-bsf:v", f"setts=ts=N*{period}/TB:duration={period}/TB", path)
    with open_source(path) as source:
        times = [frame.time_s for frame in source]
    assert times == pytest.approx([index * period for index in range(5)], rel=1e-4)
    assert source.complete and source.fps == pytest.approx(Fraction(1, period), rel=0.01)


# clips that change while they are read


def test_a_clip_that_is_removed_while_it_is_read(tmp_path: Path) -> None:
    path = media.write_video(tmp_path / "clip.mpg", frames=60)
    with open_source(path) as source:
        frames = iter(source)
        next(frames)
        path.unlink()
        assert 1 + sum(1 for _ in frames) == 60


@pytest.mark.one_in(3)
@pytest.mark.parametrize("kept", [0, 3000])
@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".avi"])
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


# damage


def test_where_the_errors_are_is_said(tmp_path: Path) -> None:
    path = media.write_video(tmp_path / "clip.mp4", frames=200, size=(320, 240), options=("-g", "10"))
    data = bytearray(path.read_bytes())
    at = len(data) * 3 // 5
    for place in range(at, at + 3000, 37):
        data[place] ^= 0xA5
    path.write_bytes(data)
    source, count = read(path)
    (warning,) = source.warnings
    assert count == 200 and source.complete is False
    assert "damaged: the decoder reports errors at about frame" in warning and "; copy or download it again" in warning
    first = int(warning.partition("about frame")[2].lstrip("s ").split(",")[0].split()[0])
    assert 95 <= first <= 125
    with open_source(path, stop=60) as source:  # what comes later does not matter
        assert sum(1 for _ in source) == 60 and source.complete


def test_two_clips_at_a_time_are_told_apart(tmp_path: Path) -> None:
    whole = media.write_video(tmp_path / "whole.mp4", frames=60)
    hurt = tmp_path / "hurt.mp4"
    hurt.write_bytes(damaged(whole.read_bytes(), "bytes", 1))
    with open_source(whole) as one, open_source(hurt) as other:
        assert len(list(other)) and len(list(one)) == 60
    assert one.complete and not other.complete


def test_a_clip_that_is_open_at_the_end_of_the_process(tmp_path: Path) -> None:
    path = media.write_video(tmp_path / "clip.mp4", frames=60)
    script = (
        "import sys\nfrom pathlib import Path\nfrom facetrack_cli.video.source import open_source\n"
        "frames = iter(open_source(Path(sys.argv[1])))\nnext(frames)\n"
    )
    done = subprocess.run([sys.executable, "-c", script, path], capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")


# playlists


@pytest.mark.parametrize(
    "text",
    [
        "#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:1,\n{}\n#EXT-X-ENDLIST\n",
        "ffconcat version 1.0\nfile '{}'\n",
        '<?xml version="1.0"?>\n<MPD profiles="urn:mpeg:dash:profile:isoff-on-demand:2011"><BaseURL>{}</BaseURL></MPD>',
        "v=0\no=- 0 0 IN IP4 127.0.0.1\nc=IN IP4 127.0.0.1\nm=video 5004 RTP/AVP 96\n",
        "ID3\3\0\0\0\0\0\0ffconcat version 1.0\nfile '{}'\n",
    ],
)
def test_playlists_are_refused(tmp_path: Path, text: str) -> None:
    secret = media.write_video(tmp_path / "other.ts", frames=10)
    path = tmp_path / "clip.mp4"
    path.write_text(text.format(secret.name))
    with pytest.raises(InputError, match=r"clip\.mp4: not a video; give a video file"):
        open_source(path)


def test_references_of_quicktime_are_not_followed(tmp_path: Path) -> None:
    whole = media.write_video(tmp_path / "other.mov", frames=10)
    data = whole.read_bytes()
    assert data.count(b"url \0\0\0\1") >= 1  # a data reference: to the file itself
    path = tmp_path / "clip.mov"
    path.write_bytes(data.replace(b"url \0\0\0\1", b"url \0\0\0\0"))  # to another, which is not named
    source, count = read(path)
    assert count == 10 and source.complete  # as if it were to the file itself
