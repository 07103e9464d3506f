"""Reading clips: every frame, in order, with its time; and what is said of clips that cannot be read."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import pytest

from facetrack_cli.core.errors import FacetrackError, InputError, UsageError
from facetrack_cli.core.types import Frame
from facetrack_cli.video.source import Source, open_source
from tests.support import media

CLIPS = Path(os.environ.get("FACETRACK_CLIPS", "clips"))


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
    assert message.startswith(str(path)) or str(path) in message
    assert "\n" not in message and ";" in message
    return message


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


def test_avi_with_b_frames_keeps_its_clock(tmp_path: Path) -> None:
    # OpenCV starts these late and gives the last frames no time at all
    options = ("-c:v", "libx264", "-preset", "medium", "-bf", "3")
    path = media.write_video(tmp_path / "b.avi", frames=30, options=options)
    source, frames = read(path)
    assert numbers(frames) == list(range(30))
    np.testing.assert_allclose([frame.time_s for frame in frames], np.arange(30) / 25, atol=1e-6)
    assert source.variable is False and source.complete


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_variable_rate(tmp_path: Path, suffix: str) -> None:
    gaps = [0.04] * 8 + [0.12] * 5 + [0.02] * 10 + [0.5, 0.04]
    times = np.concatenate([[0.0], np.cumsum(gaps)])
    path = media.write_video(tmp_path / f"vfr{suffix}", frames=len(times), times=times.tolist())
    source, frames = read(path)
    assert numbers(frames) == list(range(len(times)))
    np.testing.assert_allclose([frame.time_s for frame in frames], times, atol=0.0011)
    assert source.variable is True and source.complete


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


def test_start_past_the_end_names_the_real_number_of_frames(tmp_path: Path) -> None:
    path = media.write_video(tmp_path / "clip.mp4", frames=24)
    assert "24 frames (0 to 23)" in refusal(path, start=24)
    short = media.cut(path, tmp_path / "short.mp4", 0.6)
    real = len(read(short)[1])
    assert 0 < real < 24
    assert f"{real} frames" in refusal(short, start=23)
    folder = media.write_pictures(tmp_path / "frames", 5)
    assert "5 frames (0 to 4)" in refusal(folder, start=5)


def test_rotation_is_applied(tmp_path: Path) -> None:
    picture = np.zeros((48, 64, 3), np.uint8)
    picture[:24, :32] = 255
    plain = media.write_video(tmp_path / "plain.mp4", frames=[picture] * 5)
    for degrees, size, corner in ((90, (48, 64), (1, 0)), (180, (64, 48), (1, 1)), (270, (48, 64), (0, 1))):
        source, frames = read(media.rotated(plain, tmp_path / f"{degrees}.mp4", degrees))
        assert source.size == size and frames[0].size == size
        image = frames[0].bgr.mean(axis=2)
        height, width = image.shape
        bright = {
            (row, column): image[row * height // 2 :][: height // 2, column * width // 2 :][:, : width // 2].mean()
            for row in (0, 1)
            for column in (0, 1)
        }
        assert max(bright, key=lambda key: bright[key]) == corner


def test_odd_sizes_and_grey_video(tmp_path: Path) -> None:
    pictures = [media.numbered(index, (63, 47)) for index in range(5)]
    path = media.write_video(tmp_path / "odd.mkv", frames=pictures, options=("-c:v", "ffv1", "-pix_fmt", "gray"))
    source, frames = read(path)
    assert source.size == (63, 47)
    assert numbers(frames) == list(range(5))
    np.testing.assert_array_equal(frames[3].bgr, pictures[3])


def test_a_source_is_read_once(tmp_path: Path) -> None:
    source = open_source(media.write_pictures(tmp_path / "frames", 2))
    list(source)
    with pytest.raises(RuntimeError, match="open it again"):
        iter(source)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".webm", ".avi"])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_a_cut_video_gives_what_is_there_and_says_so(tmp_path: Path, suffix: str, share: float) -> None:
    whole = media.write_video(tmp_path / f"whole{suffix}", frames=100, sound="0.1*sin(2000*t)")
    assert read(whole)[0].complete
    path = media.cut(whole, tmp_path / f"short{suffix}", share)
    source, frames = read(path)
    assert source.complete is False
    (warning,) = source.warnings
    assert str(path) in warning and f"{len(frames)} frames" in warning
    assert "of about 10" in warning
    assert len(frames) <= 100 * share + 8
    assert len(frames) >= 100 * share - 20
    # the last image may be half there
    assert numbers(frames)[:-1] == list(range(len(frames) - 1))


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_a_program_stream_that_ends_within_a_frame(tmp_path: Path, share: float) -> None:
    whole = media.write_video(tmp_path / "whole.mpg", frames=100)
    source, frames = read(media.cut(whole, tmp_path / "short.mpg", share))
    (warning,) = source.warnings
    assert not source.complete and f"at about frame {len(frames) - 1}" in warning


def test_damage_in_the_middle_is_said(tmp_path: Path) -> None:
    path = media.write_video(tmp_path / "clip.mp4", frames=100)
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + len(data) // 8] = bytes(len(data) // 8)
    path.write_bytes(data)
    source, frames = read(path)
    assert 20 < len(frames) < 100
    assert source.complete is False and len(source.warnings) == 1


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("fragments.mp4", ("-movflags", "+frag_keyframe+empty_moov")),
        ("trimmed.mp4", ()),
        ("longsound.mkv", ()),
        ("nolength.webm", ("-live", "1")),
    ],
)
def test_whole_clips_raise_no_alarm(tmp_path: Path, name: str, options: tuple[str, ...]) -> None:
    path = tmp_path / name
    media.write_video(path, frames=50, sound="0.1*sin(2000*t)", options=options)
    if name == "trimmed.mp4":  # an edit list hides the frames before the cut, the container still counts them
        media.ffmpeg("-ss", "0.9", "-i", path, "-c", "copy", tmp_path / "cut.mp4")
        path = tmp_path / "cut.mp4"
    if name == "longsound.mkv":
        media.ffmpeg(
            "-i", path, "-f", "lavfi", "-i", "sine=d=9", "-map", "0:v", "-map", "1", "-c:v", "copy", tmp_path / "l.mkv"
        )
        path = tmp_path / "l.mkv"
    source, frames = read(path)
    assert source.complete and source.warnings == []
    assert len(frames) >= 20


def test_stopping_early_says_nothing_of_a_cut(tmp_path: Path) -> None:
    whole = media.write_video(tmp_path / "whole.mp4", frames=60)
    source, frames = read(media.cut(whole, tmp_path / "short.mp4", 0.6), stop=10)
    assert len(frames) == 10 and source.complete and source.warnings == []


@pytest.mark.nightly
@pytest.mark.clips
def test_real_clips_raise_no_alarm() -> None:
    if not CLIPS.is_dir():
        pytest.skip(f"no clips at {CLIPS}; set FACETRACK_CLIPS")
    videos = sorted(p for p in CLIPS.glob("*/*") if p.suffix in (".avi", ".mp4", ".mpg", ".webm"))
    for path in [*videos, *sorted(CLIPS.glob("*/img"))]:
        with open_source(path) as source:
            last = -1.0
            count = 0
            for frame in source:
                assert frame.time_s > last and frame.size == source.size
                last = frame.time_s
                count += 1
            assert source.complete and source.warnings == [] and source.variable is False, path
            assert source.frames_hint == count, path
    assert videos


def test_close_from_another_thread_ends_the_iteration(tmp_path: Path) -> None:
    path = media.write_video(tmp_path / "clip.mp4", frames=200)
    source = open_source(path)
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


# what cannot be read


def test_refused_files(tmp_path: Path) -> None:
    (tmp_path / "empty.mp4").touch()
    (tmp_path / "text.mp4").write_text("not a film at all\n" * 50)
    (tmp_path / "notes.txt").write_text("not a film at all\n" * 50)
    (tmp_path / "noise.avi").write_bytes(np.random.default_rng(1).bytes(20000))
    for name, words in {
        "missing.mp4": "no such file",
        "empty.mp4": "empty",
        "text.mp4": "not a video",
        "notes.txt": "not a video",
        "noise.avi": "not a video",
    }.items():
        with pytest.raises(InputError):
            read(tmp_path / name)
        assert words in refusal(tmp_path / name)
    assert "moov" in refusal(media.without_moov(tmp_path / "cut.mp4"))
    whole = media.write_video(tmp_path / "whole.mkv", frames=5)
    assert "before its first frame" in refusal(media.cut(whole, tmp_path / "nearly.mkv", 0.12))
    assert "sound but no video" in refusal(media.sound_only(tmp_path / "tune.mp4"))
    assert "pipe" in refusal(Path("-"))


def test_cover_picture_of_a_tune_is_no_video(tmp_path: Path) -> None:
    cover = media.write_pictures(tmp_path / "c", 1) / "0.png"
    path = tmp_path / "tune.mp3"
    media.ffmpeg(
        *("-f", "lavfi", "-i", "sine=d=1", "-i", cover, "-map", "0", "-map", "1", "-c:v", "copy"),
        *("-disposition:v", "attached_pic", path),
    )
    assert "sound but no video" in refusal(path)


def test_unreadable_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = media.write_video(tmp_path / "clip.mp4", frames=3)

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)  # the tests may run as root, whom no file mode stops
    assert "Permission denied" in refusal(path)


def test_impossible_arguments(tmp_path: Path) -> None:
    folder = media.write_pictures(tmp_path / "frames", 3)
    video = media.write_video(tmp_path / "clip.mp4", frames=3)
    for path, options in (
        (folder, {"start": -1}),
        (folder, {"start": 2, "stop": 2}),
        (folder, {"fps": Fraction(0)}),
        (video, {"fps": Fraction(30)}),
    ):
        with pytest.raises(UsageError):
            open_source(path, **options)  # type: ignore[arg-type]


def test_nothing_reaches_stderr(tmp_path: Path) -> None:
    whole = media.write_video(tmp_path / "whole.mp4", frames=60)
    short = media.cut(whole, tmp_path / "short.mp4", 0.5)
    script = (
        "import sys\nfrom pathlib import Path\nfrom facetrack_cli.video.source import open_source\n"
        "source = open_source(Path(sys.argv[1]))\nlist(source)\nassert not source.complete\n"
        "try: open_source(Path(sys.argv[2]))\nexcept Exception: pass\n"
    )
    broken = media.without_moov(tmp_path / "broken.mp4")
    done = subprocess.run([sys.executable, "-c", script, short, broken], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


# image folders


def test_folder_in_natural_order_among_other_files(tmp_path: Path) -> None:
    folder = media.write_pictures(tmp_path / "frames", 12)
    for other in ("notes.txt", "Thumbs.db", ".DS_Store", "._1.png", ".hidden.png"):
        (folder / other).write_text("x")
    (folder / "more.png").mkdir()
    source, frames = read(folder)
    assert numbers(frames) == list(range(12))
    assert (source.fps, source.variable, source.is_video) == (25, False, False)
    assert source.frames_hint == 12 and source.complete
    assert [frame.time_s for frame in frames] == [index / 25 for index in range(12)]
    source, frames = read(folder, fps=Fraction(30000, 1001), start=9)
    assert [frame.index for frame in frames] == [9, 10, 11]
    assert frames[0].time_s == pytest.approx(9 * 1001 / 30000, abs=1e-12)


def test_folder_equals_the_video_of_the_same_frames(tmp_path: Path) -> None:
    path = media.write_video(tmp_path / "clip.mp4", frames=10)
    frames = read(path)[1]
    folder = media.write_pictures(tmp_path / "frames", [frame.bgr for frame in frames])
    for a, b in zip(frames, read(folder)[1], strict=True):
        np.testing.assert_array_equal(a.bgr, b.bgr)
        assert (a.index, round(a.time_s, 9)) == (b.index, round(b.time_s, 9))


def test_glob_in_one_folder_and_folder_named_like_a_video(tmp_path: Path) -> None:
    folder = media.write_pictures(tmp_path / "clip.mp4", 12)
    assert numbers(read(folder / "1*.png")[1]) == [1, 10, 11]
    source, frames = read(folder)
    assert not source.is_video and len(frames) == 12
    assert "no images" in refusal(folder / "x*.png")


def test_kinds_of_pictures_become_bgr(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    bgr = rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)
    grey, alpha = bgr[..., 0], rng.integers(0, 256, (20, 30), dtype=np.uint8)
    over_black = np.round(bgr * (alpha[..., None] / 255.0)).astype(np.uint8)
    cases = {
        "bgr.png": (bgr, bgr),
        "bgr.bmp": (bgr, bgr),
        "bgr.tif": (bgr, bgr),
        "grey.png": (grey, np.dstack([grey] * 3)),
        "grey16.png": (grey.astype(np.uint16) * 257, np.dstack([grey] * 3)),
        "grey16.tif": (grey.astype(np.uint16) * 257, np.dstack([grey] * 3)),
        "bgr16.png": (bgr.astype(np.uint16) * 257, bgr),
        "opaque.png": (np.dstack([bgr, np.full_like(alpha, 255)]), bgr),
        "alpha.png": (np.dstack([bgr, alpha]), over_black),
    }
    for name, (written, expected) in cases.items():
        folder = tmp_path / name.replace(".", "_")
        folder.mkdir()
        assert cv2.imwrite(str(folder / name), written)
        (frame,) = read(folder)[1]
        assert frame.bgr.dtype == np.uint8 and frame.bgr.flags.c_contiguous
        np.testing.assert_array_equal(frame.bgr, expected, err_msg=name)


def test_exif_orientation(tmp_path: Path) -> None:
    picture = np.zeros((32, 48, 3), np.uint8)
    picture[:16, :24] = (0, 0, 255)
    ok, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 100])
    assert ok
    # a little-endian Exif block with one entry: orientation 6, to be turned clockwise by a quarter
    exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
    jpeg = data.tobytes()
    segment = b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif
    folder = tmp_path / "frames"
    folder.mkdir()
    for name in ("1.jpg", "2.jpg"):
        (folder / name).write_bytes(jpeg[:2] + segment + jpeg[2:])
    source, frames = read(folder)
    assert source.size == (32, 48) and len(frames) == 2
    assert frames[0].bgr[:20, 20:, 2].mean() > 240, "the red corner is not at the top right"
    assert frames[0].bgr[30:, :, 2].mean() < 15


def test_folder_without_images(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("x")
    assert "no images" in refusal(tmp_path)


def test_images_of_another_size_are_scaled_to_the_first_and_not_squeezed(tmp_path: Path) -> None:
    folder = media.write_pictures(tmp_path / "frames", 12)
    for index, size in ((9, (128, 96)), (10, (48, 64))):
        cv2.imwrite(str(folder / f"{index}.png"), np.full((*size[::-1], 3), 200, np.uint8))
    source, frames = read(folder)
    assert {frame.size for frame in frames} == {(64, 48)} and source.complete
    (warning,) = source.warnings
    assert warning == f"{folder / '9.png'} is 128x96, the first is 64x48; all are scaled to the first"
    assert (frames[9].bgr == 200).all()
    seen = frames[10].bgr[:, :, 0] > 100  # upright, between black borders
    assert seen[:, 14:50].all() and not seen[:, :13].any() and not seen[:, 51:].any()


@pytest.mark.parametrize("kind", ["garbage", "half"])
def test_broken_picture_in_the_middle(tmp_path: Path, kind: str) -> None:
    folder = media.write_pictures(tmp_path / "frames", 12, size=(128, 96), name="{}.jpg".format)
    broken = folder / "7.jpg"
    broken.write_bytes(b"nothing" if kind == "garbage" else broken.read_bytes()[:-300])
    source, frames = read(folder)
    assert numbers(frames) == list(range(7))
    assert source.complete is False
    (warning,) = source.warnings
    assert warning.startswith(str(broken)) and "7 of 12" in warning and "\n" not in warning
    assert str(broken) in refusal(folder, start=7)


@pytest.mark.parametrize("suffix", [".mp4", ".avi", ".mkv"])
def test_a_clip_cut_within_its_head(tmp_path: Path, suffix: str) -> None:
    whole = media.write_video(tmp_path / f"whole{suffix}")
    part = tmp_path / f"part{suffix}"
    part.write_bytes(whole.read_bytes()[:200])
    with pytest.raises(InputError, match=r"damaged before its first frame.*; copy or download it again"):
        open_source(part)


def test_what_to_do_about_a_picture(tmp_path: Path) -> None:
    text, deep = tmp_path / "text", tmp_path / "deep"
    text.mkdir()
    deep.mkdir()
    (text / "0.png").write_text("no image")
    with pytest.raises(
        InputError, match=r"0.png: is not an image, or of an unknown kind; repair the image or remove it$"
    ):
        open_source(text)
    cv2.imwrite(str(deep / "0.tif"), np.zeros((4, 4), np.float32))
    with pytest.raises(InputError, match=r"which has no agreed range; convert it to 8 or 16 bits$"):
        open_source(deep)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere names are text")
def test_a_name_that_is_no_text_is_refused_before_opencv_ends_the_process(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no UTF-8 text; rename the file"):
        open_source(tmp_path / os.fsdecode(b"caf\xe9.mp4"))


@pytest.mark.parametrize("text", ["ffconcat version 1.0\nfile a.mp4\nfile b.mp4\n", "# chapters\nfile 'GX01 1.mp4'\n"])
def test_a_list_of_chapters_is_told_how_to_join(tmp_path: Path, text: str) -> None:
    path = tmp_path / "list.txt"
    path.write_text(text)
    assert f"ffmpeg -f concat -safe 0 -i {path} -c copy joined.mp4" in refusal(path)


@pytest.mark.parametrize("suffix", sorted(media.CODECS))
def test_a_clip_that_is_cut_within_its_headers_is_refused(tmp_path: Path, suffix: str) -> None:
    """PyAV's error at the end of a file is Python's EOFError, which is no OSError."""
    data = media.write_video(tmp_path / f"whole{suffix}", frames=5).read_bytes()
    path = tmp_path / f"cut{suffix}"
    for length in {*range(1, 100, 7), *range(100, min(len(data), 6000), 197)}:
        path.write_bytes(data[:length])
        try:
            read(path)
        except InputError as error:
            assert str(path) in str(error)


def test_a_frame_that_claims_more_pixels_than_are_read(tmp_path: Path) -> None:
    path, whole = tmp_path / "canvas.gif", tmp_path / "whole.gif"
    pictures = [PIL.Image.new("P", (16, 16), n) for n in range(3)]
    pictures[0].save(whole, save_all=True, append_images=pictures[1:])
    data = whole.read_bytes()
    path.write_bytes(data[:6] + (16_000).to_bytes(2, "little") * 2 + data[10:])
    assert "is too large for a frame: 16000x16000, and at most 100 megapixels are read" in refusal(path)
