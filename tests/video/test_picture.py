"""The picture that players show: turned, of oblong pixels, of the right stream, in the colours of the file."""

import json
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from PIL import Image as Pictures

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.files import temporary_path
from facetrack_cli.core.types import Frame
from facetrack_cli.report.make import command
from facetrack_cli.runs.finished import open_run, repaint
from facetrack_cli.trajectory.measures import measures_of
from facetrack_cli.trajectory.trajectory import Trajectory, of_frame, one_part
from facetrack_cli.video.decode import pixels
from facetrack_cli.video.source import Frames, open_source
from facetrack_cli.video.writer import VideoWriter
from tests.support import media

CORNERS = np.zeros((48, 64, 3), np.uint8)
CORNERS[:24, :32], CORNERS[:24, 32:], CORNERS[24:, :32] = (30, 60, 220), (220, 90, 40), (40, 200, 60)
TURNS = [(degrees, flip) for degrees in (0, 90, 180, 270) for flip in ((), ("-display_hflip",))]


def shown_by_ffmpeg(path: Path) -> np.ndarray:
    return cv2.imdecode(
        np.frombuffer(media.ffmpeg("-i", path, "-frames:v", "1", "-f", "image2pipe", "-c:v", "png", "-"), np.uint8), 1
    )


@pytest.mark.parametrize(
    ("suffix", "degrees", "flip"),
    [*((".mp4", *turn) for turn in TURNS), (".mov", 90, ("-display_vflip",)), (".mkv", 270, ("-display_hflip",))],
)
def test_turned_and_mirrored_as_players_show_it(
    tmp_path: Path, suffix: str, degrees: int, flip: tuple[str, ...]
) -> None:
    stored = media.write_video(tmp_path / f"stored{suffix}", frames=[CORNERS] * 3)
    path = tmp_path / f"clip{suffix}"
    media.ffmpeg("-display_rotation", str(degrees), *flip, "-i", stored, "-c", "copy", path)
    right = shown_by_ffmpeg(path)
    with open_source(path) as source, Frames(path) as frames:
        first = next(iter(source))
        assert source.size == first.size == right.shape[1::-1] == frames.size
        assert np.abs(first.bgr.astype(int) - right).mean() < 6
        assert (frames.read(2).bgr.shape) == right.shape


@pytest.mark.parametrize("way", [4, 5, 8])
def test_motion_jpeg_with_exif_is_as_the_picture_alone(tmp_path: Path, way: int) -> None:
    exif = Pictures.Exif()
    exif[0x0112] = way
    picture = tmp_path / "picture.jpg"
    Pictures.fromarray(CORNERS[..., ::-1]).save(picture, exif=exif, quality=95)
    path = tmp_path / "clip.mov"
    media.ffmpeg("-f", "mjpeg", "-i", "-", "-c", "copy", path, stdin=picture.read_bytes() * 5)
    right = shown_by_ffmpeg(path)
    for clip in (path, picture):
        with open_source(clip) as source:
            first = next(iter(source)).bgr
        assert first.shape == right.shape and np.abs(first.astype(int) - right).mean() < 4


@pytest.mark.parametrize(
    ("suffix", "shape"), [(".mp4", Fraction(4, 3)), (".mp4", Fraction(8, 9)), (".mkv", Fraction(32, 27))]
)
def test_oblong_pixels_are_told_and_kept(tmp_path: Path, shape: Fraction, suffix: str) -> None:
    path = media.write_video(tmp_path / f"clip{suffix}", frames=4, options=("-vf", f"setsar={shape}"))
    with open_source(path) as source:
        assert source.size == media.SIZE and abs(source.aspect - shape) < 0.01
        with VideoWriter(tmp_path / "out.mp4", source.size, source.fps, source.aspect) as video:
            for frame in source:
                assert frame.aspect == pytest.approx(float(shape), rel=0.01)
                video.write(frame.bgr, frame.time_s)
    with av.open(str(tmp_path / "out.mp4")) as written:
        stream = written.streams.video[0]
        assert (stream.width, stream.height) == media.SIZE
        assert float(stream.sample_aspect_ratio) == pytest.approx(float(shape), rel=0.01)


def test_oblong_pixels_of_the_container_alone_and_turned_and_a_shape_that_no_pixel_has(tmp_path: Path) -> None:
    stored = media.write_video(tmp_path / "stored.mkv", frames=4)
    media.ffmpeg("-i", stored, "-c", "copy", "-aspect", "16:9", tmp_path / "clip.mkv")
    media.ffmpeg("-display_rotation", "90", "-i", tmp_path / "clip.mkv", "-c", "copy", tmp_path / "turned.mp4")
    media.write_video(tmp_path / "odd.mp4", frames=4, options=("-vf", "setsar=200/1"))
    for clip, aspect in (("clip.mkv", Fraction(4, 3)), ("turned.mp4", Fraction(3, 4)), ("odd.mp4", 1)):
        with open_source(tmp_path / clip) as source:
            turned = clip == "turned.mp4"
            assert (source.size, source.aspect) == (media.SIZE[::-1] if turned else media.SIZE, aspect)


def face(wide: float) -> list[Trajectory]:
    """A face that leans by 20 degrees, in pixels that are `wide` times as wide as high."""
    places = {
        "eye_left": (-31.5, 0), "eye_right": (31.5, 0), "nose": (0, 33.5),
        "mouth_left": (-26.5, 66), "mouth_right": (26.5, 66), "lip_upper": (0, 58.5), "lip_lower": (0, 80),
    }  # fmt: skip
    lean = np.exp(1j * np.radians(20))
    turned = {part: 200 + complex(*xy) * lean for part, xy in places.items()}
    header = {"source": {"pixel_aspect": wide}}
    return [
        one_part("face", part, [0, 1], x=[at.real / wide] * 2, y=[at.imag] * 2, std_x=[1 / wide] * 2, std_y=[1.0] * 2,
                 cov_xy=[0.0] * 2, status=["tracked"] * 2, time_s=[0, 0.04], header=header)
        for part, at in turned.items()
    ]  # fmt: skip


@pytest.mark.parametrize("wide", [4 / 3, 0.75])
def test_measures_of_oblong_pixels_are_those_of_square_ones(wide: float) -> None:
    square, oblong = measures_of(face(1.0)), measures_of(face(wide))
    assert square.keys() == oblong.keys() >= {"mouth_opening", "mouth_width", "roll", "yaw", "pitch"}
    assert oblong["roll"].value[0] == pytest.approx(20, abs=0.5)
    for name, measure in square.items():
        np.testing.assert_allclose(oblong[name].value, measure.value, atol=1e-6)
        np.testing.assert_allclose(oblong[name].std, measure.std, atol=1e-6)


def test_an_angle_is_that_of_the_picture_as_it_is_shown() -> None:
    image = np.zeros((48, 64, 3), np.uint8)
    seen = np.degrees(np.arctan2(np.sin(np.radians(30)), 0.75 * np.cos(np.radians(30))))
    rows = of_frame((("face", "box"),), Frame(0, 0.0, image, aspect=4 / 3), {}, x=[9], y=[9], angle=[seen])
    assert rows.angle[0] == pytest.approx(30)


# streams


def join(path: Path, *streams: Path, options: tuple[str, ...] = ()) -> Path:
    inputs = [word for stream in streams for word in ("-i", stream)]
    maps = [word for i in range(len(streams)) for word in ("-map", str(i))]
    media.ffmpeg(*inputs, *maps, "-c", "copy", *options, path)
    return path


def test_of_several_streams_the_recording_is_taken(tmp_path: Path) -> None:
    preview = media.write_video(tmp_path / "preview.mov", frames=3, size=(32, 24), fps=1)
    still = media.write_video(tmp_path / "still.mov", frames=1, size=(640, 480), fps=1)
    clip = media.write_video(tmp_path / "clip.mp4", frames=50)
    other = media.write_video(tmp_path / "other.mp4", frames=[media.numbered(100 + i) for i in range(50)])
    for name, order in {"a.mov": (preview, clip), "b.mkv": (clip, still), "c.mov": (still, preview, clip)}.items():
        with open_source(join(tmp_path / name, *order)) as source:
            assert source.size == media.SIZE and len(list(source)) == 50
    two = join(tmp_path / "two.mkv", clip, other, options=("-disposition:v:0", "0", "-disposition:v:1", "default"))
    with open_source(two) as source:
        assert media.number(next(iter(source)).bgr) == 100
        (warning,) = source.warnings
    assert warning.endswith("has 2 video streams, 0 (64x48) and 1 (64x48); 1 (64x48) is read, --stream N takes another")
    with open_source(two, stream=0, start=30) as source, Frames(two, stream=0) as frames:
        assert media.number(next(iter(source)).bgr) == 30 and not source.warnings
        assert media.number(frames.read(40).bgr) == 40
    with pytest.raises(InputError, match="no video stream 5; those there are 0, 1"):
        open_source(two, stream=5)


def test_a_stream_that_is_named_is_that_of_the_run_and_of_what_reads_it_again(tmp_path: Path) -> None:
    dark, bright = (
        media.write_video(tmp_path / f"{n}.mp4", frames=[np.full((96, 128, 3), n, np.uint8)] * 8) for n in (40, 200)
    )
    two, out = join(tmp_path / "two.mkv", dark, bright), tmp_path / "out"
    options = ["--box", "40,30,24,24", "--config", "correlation_filter", "-o", str(out), "-q"]
    assert main(["run", str(two), "--stream", "1", *options]) == 0
    header = json.loads((out / "trajectory.json").read_text())
    assert header["source"]["stream"] == 1 and not header["warnings"]
    with open_source(out / "annotated.mp4") as video:
        assert np.median(next(iter(video)).bgr) > 150
    run = open_run(out)
    repaint(run.rows, run.clip, path=out / "again.mp4", report=lambda *_: None, stop=lambda: False)
    with open_source(temporary_path(out / "again.mp4")) as video:
        assert np.median(next(iter(video)).bgr) > 150
    assert "--stream 1" in command(run.header, 7)


# colours

COLOURS = [
    (0, 0, 255), (0, 255, 0), (255, 0, 0), (255, 255, 255), (90, 130, 200), (40, 60, 20), (128, 128, 128), (0, 0, 0),
]  # fmt: skip
FORMS = {("bt709", False, "yuv420p"), ("bt709", True, "yuv420p"), ("bt2020nc", False, "yuv420p")}
FORMS |= {("smpte170m", False, "yuv420p"), ("smpte240m", False, "yuv444p"), ("bt470bg", True, "yuv444p")}


def patches(size: tuple[int, int] = (128, 64)) -> np.ndarray:
    return np.repeat(np.array([COLOURS], np.uint8), size[1], axis=0).repeat(size[0] // 8, axis=1)


def middles(image: np.ndarray) -> np.ndarray:
    width = image.shape[1] // 8
    return np.array([np.median(image[:, i * width + 4 : (i + 1) * width - 4], axis=(0, 1)) for i in range(8)])


def coded(path: Path, tags: str, form: str, size: tuple[int, int] = (128, 64)) -> Path:
    options = ("-vf", f"{tags}", "-c:v", "libx264", "-crf", "1", "-pix_fmt", form)
    return media.write_video(path, frames=[patches(size)] * 3, options=options)


@pytest.mark.parametrize(("matrix", "full", "form"), sorted(FORMS))
def test_colours_are_those_that_the_file_says(tmp_path: Path, matrix: str, full: bool, form: str) -> None:
    span = "pc" if full else "tv"
    way = f"scale=out_color_matrix={matrix}:out_range={span},format={form}"
    path = coded(tmp_path / "clip.mkv", f"{way},setparams=colorspace={matrix}:range={span}", form)
    with open_source(path) as source, Frames(path) as frames:
        first = next(iter(source))
        np.testing.assert_allclose(middles(first.bgr), COLOURS, atol=6)
        np.testing.assert_allclose(middles(frames.read(2).bgr), COLOURS, atol=6)
        grey = cv2.cvtColor(first.bgr, cv2.COLOR_BGR2GRAY)
        np.testing.assert_allclose(first.grey(1, (0, 0, 127, 63))[0], grey[: grey.shape[0]], atol=6)


@pytest.mark.parametrize("size", [(128, 64), (1280, 720)])
def test_what_is_written_is_read_with_its_colours_and_by_opencv(tmp_path: Path, size: tuple[int, int]) -> None:
    with VideoWriter(tmp_path / "out.mp4", size, 25) as video:
        video.write(patches(size), 0.0)
    with open_source(tmp_path / "out.mp4") as source:
        np.testing.assert_allclose(middles(next(iter(source)).bgr), COLOURS, atol=6)
    (_, decoded), *_ = media.read_timed(tmp_path / "out.mp4")
    np.testing.assert_allclose(middles(decoded), COLOURS, atol=6)


def test_a_file_that_says_nothing_is_read_as_opencv_reads_it(tmp_path: Path) -> None:
    way = "scale=out_color_matrix=bt709:out_range=tv,format=yuv420p,setparams=colorspace=unknown:range=unknown"
    path = coded(tmp_path / "clip.mp4", way, "yuv420p", (1280, 720))
    got, theirs = cv2.VideoCapture(str(path)).read()
    with open_source(path) as source:
        ours = middles(next(iter(source)).bgr)
    assert got
    np.testing.assert_allclose(ours, middles(theirs), atol=4)


def test_planes_that_lie_upside_down_in_memory_are_read_as_they_are_shown():
    shown = np.arange(96 * 64, dtype=np.uint8).reshape(96, 64)
    frame, graph = av.VideoFrame.from_ndarray(shown, format="yuv420p"), av.filter.Graph()
    frame.pts = 0
    source = graph.add_buffer(width=64, height=64, format="yuv420p", time_base=Fraction(1, 25))
    flip, sink = graph.add("vflip"), graph.add("buffersink")
    source.link_to(flip)
    flip.link_to(sink)
    graph.configure()
    graph.push(frame)
    flipped = graph.pull()
    assert all(plane.line_size < 0 for plane in flipped.planes)
    np.testing.assert_array_equal(Frame(0, 0.0, pixels(flipped)).pixels[:64], shown[63::-1])
