"""Files that hold many pictures, numbers that do not fill their 16 bits, names that are times."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image as Pictures

from facetrack_cli.core.errors import FacetrackError, InputError
from facetrack_cli.runs.batch import expand
from facetrack_cli.video.images import ordered
from facetrack_cli.video.seek import Frames
from facetrack_cli.video.source import Source, open_source
from tests.support import media


def read(path: Path, **options: object) -> tuple[Source, list[int]]:
    with open_source(path, **options) as source:
        return source, [media.number(frame.bgr) for frame in source]


def stack(path: Path, numbers: range, deep: bool = False, **options: object) -> Path:
    pages = [media.numbered(i)[..., 0] for i in numbers]
    pictures = [Pictures.fromarray(page.astype(np.uint16) * 257 if deep else page) for page in pages]
    pictures[0].save(path, save_all=True, append_images=pictures[1:], **options)
    return path


@pytest.mark.parametrize("options", [{}, {"deep": True}, {"big_tiff": True}])
def test_every_page_of_a_stack_is_a_frame(tmp_path: Path, options: dict[str, bool]) -> None:
    path = stack(tmp_path / "stack.tif", range(20), **options)
    source, numbers = read(path)
    assert numbers == list(range(20)) and source.complete and not source.warnings
    assert read(path, start=7, stop=9)[1] == [7, 8]
    with Frames(path) as frames:
        assert frames.count == 20 and media.number(frames.read(13).bgr) == 13
    with pytest.raises(FacetrackError, match="has 20 frames"):
        read(path, start=20)


def test_stacks_of_a_folder_and_of_an_archive_follow_each_other(tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    stack(folder / "2.tif", range(10)), stack(folder / "10.tif", range(10, 15))
    assert read(folder)[1] == list(range(15))
    assert read(Path(shutil.make_archive(str(tmp_path / "frames"), "zip", folder)))[1] == list(range(15))
    assert expand([folder / "2.tif", folder / "10.tif"]).clips == [folder / "2.tif", folder / "10.tif"]


def test_pages_that_are_channels_are_refused_and_a_thumbnail_is_no_frame(tmp_path: Path) -> None:
    told = stack(tmp_path / "two.ome.tif", range(6), description='<Image SizeC="2" SizeT="3" SizeZ="1">')
    with pytest.raises(FacetrackError, match="6 pages, of which 2 are channels"):
        read(told)
    large, small = (Pictures.fromarray(media.numbered(3, size)[..., 0]) for size in ((64, 48), (32, 24)))
    large.save(tmp_path / "photo.tif", save_all=True, append_images=[small])
    assert read(tmp_path / "photo.tif")[1] == [3]


def test_an_animated_webp_keeps_its_clock(tmp_path: Path) -> None:
    pictures = [Pictures.fromarray(media.numbered(i)) for i in range(6)]
    path = tmp_path / "clip.webp"
    each = [40, 40, 120, 40, 40, 40]
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=each, lossless=True)
    with open_source(path) as source:
        frames = list(source)
    assert [media.number(frame.bgr) for frame in frames] == list(range(6))
    assert source.fps == 25 and source.variable
    np.testing.assert_allclose([frame.time_s for frame in frames], [0, 0.04, 0.08, 0.2, 0.24, 0.28])
    with pytest.raises(FacetrackError, match="its own frame rate"):
        read(path, fps=10)
    assert expand([tmp_path]).clips == [path]


def deep(folder: Path, scale: float, low: int = 0, colour: bool = False, suffix: str = ".png") -> Path:
    folder.mkdir()
    ramp = np.tile(np.linspace(0, 1, 64), (48, 1))
    for i in range(4):
        image = (low + ramp * scale * (i + 1) / 4).astype(np.uint16)
        cv2.imwrite(str(folder / f"{i}{suffix}"), np.dstack([image] * 3) if colour else image)
    return folder


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize(("white", "low"), [(1023, 0), (4095, 0), (4000, 27000)])
def test_pictures_of_few_bits_use_all_levels(tmp_path: Path, white: int, low: int, colour: bool, suffix: str) -> None:
    path = deep(tmp_path / "frames", white, low, colour, suffix)
    with open_source(path) as source:
        first, *_, last = [frame.bgr for frame in source]
    assert last.min() == 0 and last.max() == 255 and len(np.unique(last)) >= 60
    assert 60 <= first.max() <= 66  # one range for all frames
    (warning,) = source.warnings
    assert f"use the numbers {low} to {low + white}" in warning
    with open_source(path, start=2) as later:
        np.testing.assert_array_equal([frame.bgr for frame in later][-1], last)


def test_pictures_of_all_16_bits_are_as_they_were(tmp_path: Path) -> None:
    with open_source(deep(tmp_path / "frames", 65535)) as source:
        last = [frame.bgr for frame in source][-1]
    assert not source.warnings and last.max() == 255 and last[0, 10, 0] == int(65535 * 10 / 63) >> 8


@pytest.mark.parametrize(("form", "scale"), [("gray12le", 1), ("gray16le", 1), ("gray16le", 16)])
def test_a_video_of_12_bits(tmp_path: Path, form: str, scale: int) -> None:
    ramp = np.tile(np.linspace(0, 4095, 64).astype(np.uint16), (48, 1)) * scale
    path = tmp_path / "clip.mkv"
    head = ("-f", "rawvideo", "-pix_fmt", form, "-s", "64x48", "-framerate", "25", "-i", "-")
    media.ffmpeg(*head, "-c:v", "ffv1", path, stdin=np.stack([ramp] * 5).astype("<u2").tobytes())
    with open_source(path) as source:
        frames = [frame.bgr for frame in source]
    assert len(frames) == 5 and frames[0].max() >= 254 and len(np.unique(frames[0])) >= 60


@pytest.mark.parametrize(
    "names",
    [
        "0 0.04 0.08 0.1 0.12 0.2 1 1.04",
        "1632012345.12 1632012345.5 1632012345.9 1632012346",
        "-12 -3 -1.5 0 2 10",
        "2 10 100",
        "frame_2 frame_10 frame_100",
        "t0 t0.04 t0.08 t0.1 t0.12 t1 t10",
        "cam1.2 cam1.9 cam1.10",
        "shot1.08 shot1.09 shot1.100",
        "10-00-01.45 10-00-01.5 10-00-02.05 10-01-00.1",
        "1-2-3.45 1-2-3.5 1-2-10.1",
        "0a 0f 10 1a 1b ff",
        "a2 a10 b1",
        "v1.2_2 v1.2_10 v1.10_1",
    ],
)
def test_names_are_in_the_order_of_what_they_say(names: str) -> None:
    right = [f"{name}.jpg" for name in names.split()]
    assert ordered(sorted(right, reverse=True), str) == right
    assert ordered(right, str) == right


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (("cam0_{:04}", "cam1_{:04}"), "cam0_*.png and cam1_*.png"),
        (("left{}", "right{}"), "left*.png and right*.png"),
        (("{}", "{}_mask"), "*.png and *_mask.png"),
        (("10-00-{:02}", "10-01-{:02}"), ""),
        (("2024_{}", "2025_{}"), ""),
        (("frame_{:03}",), ""),
    ],
)
def test_two_cameras_in_one_folder_are_told(tmp_path: Path, names: tuple[str, ...], told: str) -> None:
    for name in names:
        for i in range(5):
            cv2.imwrite(str(tmp_path / f"{name.format(i)}.png"), media.numbered(i))
    with open_source(tmp_path) as source:
        assert len(list(source)) == 5 * len(names)
    assert [told in line and "one after the other" in line for line in source.warnings] == [True] * bool(told)


def test_a_later_page_that_claims_more_pixels_than_are_read(tmp_path: Path) -> None:
    stack = [Pictures.new("L", (16, 16), n) for n in range(2)]
    path = tmp_path / "stack.tif"
    pages = [stack[1], Pictures.new("1", (12_000, 12_000))]
    stack[0].save(path, save_all=True, append_images=pages, compression="tiff_deflate")
    with open_source(path) as source:
        assert len(list(source)) == 2 and not source.complete
    assert "is too large for a frame: 12000x12000" in source.warnings[0]


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
def test_a_canvas_of_webp_that_claims_more_pixels_than_are_read(tmp_path: Path) -> None:
    path = tmp_path / "canvas.webp"
    pictures = [Pictures.new("RGB", (16, 16), (n, 0, 0)) for n in (0, 99)]
    pictures[0].save(path, save_all=True, append_images=pictures[1:])
    data = bytearray(path.read_bytes())
    at = data.index(b"VP8X") + 12
    for side in (11_000, 16_384):  # more than we read, and more than Pillow does
        data[at : at + 6] = (side - 1).to_bytes(3, "little") * 2
        path.write_bytes(data)
        with pytest.raises(InputError, match=r"canvas\.webp"):
            open_source(path)
