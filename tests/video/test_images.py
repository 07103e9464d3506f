"""Images as clips: folders, globs, stacks, animations; the order of their names, and 16 bits."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image as Pictures

from facetrack_cli.runs.batch import expand
from facetrack_cli.video.images import ordered
from facetrack_cli.video.source import Frames
from tests.support import media
from tests.video.test_source import numbers, read, refusal


def put(folder: Path, files: Mapping[str, np.ndarray]) -> Path:
    folder.mkdir(exist_ok=True)
    for name, image in files.items():
        assert cv2.imwrite(str(folder / name), image)
    return folder


# folders


def test_folder_in_natural_order_among_other_files(tmp_path: Path) -> None:
    folder = media.write_pictures(tmp_path / "clip.mp4", 12)  # named like a video
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
    assert numbers(read(folder / "1*.png")[1]) == [1, 10, 11]
    assert "no images" in refusal(folder / "x*.png")
    assert "12 frames (0 to 11)" in refusal(folder, start=12)
    (tmp_path / "empty").mkdir()
    assert "no images" in refusal(tmp_path / "empty")


def test_kinds_of_pictures_become_bgr(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    bgr = rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)
    grey, alpha = bgr[..., 0], rng.integers(0, 256, (20, 30), dtype=np.uint8)
    cases = {
        "bgr.png": (bgr, bgr),
        "bgr.bmp": (bgr, bgr),
        "bgr.tif": (bgr, bgr),
        "grey.png": (grey, np.dstack([grey] * 3)),
        "grey16.png": (grey.astype(np.uint16) * 257, np.dstack([grey] * 3)),
        "grey16.tif": (grey.astype(np.uint16) * 257, np.dstack([grey] * 3)),
        "bgr16.png": (bgr.astype(np.uint16) * 257, bgr),
        "opaque.png": (np.dstack([bgr, np.full_like(alpha, 255)]), bgr),
        "alpha.png": (np.dstack([bgr, alpha]), np.round(bgr * (alpha[..., None] / 255.0)).astype(np.uint8)),
    }
    for name, (written, expected) in cases.items():
        put(tmp_path, {name: written})
        (frame,) = read(tmp_path / name)[1]
        assert frame.bgr.dtype == np.uint8 and frame.bgr.flags.c_contiguous
        np.testing.assert_array_equal(frame.bgr, expected, err_msg=name)


def test_images_of_another_size_are_scaled_to_the_first_and_not_squeezed(tmp_path: Path) -> None:
    folder = media.write_pictures(tmp_path / "frames", 12)
    put(folder, {f"{i}.png": np.full((*size[::-1], 3), 200, np.uint8) for i, size in ((9, (128, 96)), (10, (48, 64)))})
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


def test_what_to_do_about_a_picture(tmp_path: Path) -> None:
    (tmp_path / "text.png").write_text("no image")
    remedy = "is not an image, or of an unknown kind; repair the image or remove it"
    assert refusal(tmp_path / "text.png").endswith(remedy)
    put(tmp_path, {"deep.tif": np.zeros((4, 4), np.float32)})
    assert refusal(tmp_path / "deep.tif").endswith("which has no agreed range; convert it to 8 or 16 bits")
    first, *others = [Pictures.fromarray(media.numbered(i)) for i in range(4)]
    first.save(tmp_path / "a.webp", save_all=True, append_images=others)
    (tmp_path / "half.webp").write_bytes((tmp_path / "a.webp").read_bytes()[:300])
    assert "plugin" not in refusal(tmp_path / "half.webp"), "that is what imageio says of it"


# animations, stacks


@pytest.mark.parametrize("kind", ["JPEG", "BMP"])
def test_a_picture_under_the_name_of_another_kind_is_read(tmp_path: Path, kind: str) -> None:
    for name in ("a.png", "a.webp"):
        Pictures.fromarray(media.numbered(3)).save(tmp_path / name, format=kind)
        assert numbers(read(tmp_path / name)[1]) == [3]


@pytest.mark.parametrize("suffix", [".gif", ".png", ".webp"])
def test_an_animation_is_a_clip(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    first, *others = [Pictures.fromarray(media.numbered(i)) for i in range(4)]
    first.save(path, save_all=True, append_images=others, duration=100, loop=0, lossless=True)
    source, frames = read(path)
    assert numbers(frames) == [0, 1, 2, 3] and source.fps == (25 if suffix == ".webp" else 10)
    assert expand([tmp_path])[0] == [path]
    if suffix == ".webp":
        assert read(path, fps=Fraction(10))[0].fps == 10


def stack(path: Path, numbers: range, deep: bool = False, **options: object) -> Path:
    pages = [media.numbered(i)[..., 0] for i in numbers]
    first, *others = [Pictures.fromarray(page.astype(np.uint16) * 257 if deep else page) for page in pages]
    first.save(path, save_all=True, append_images=others, **options)
    return path


@pytest.mark.parametrize("options", [{}, {"deep": True}, {"big_tiff": True}])
def test_every_page_of_a_stack_is_a_frame(tmp_path: Path, options: dict[str, bool]) -> None:
    path = stack(tmp_path / "stack.tif", range(20), **options)
    source, frames = read(path)
    assert numbers(frames) == list(range(20)) and source.complete and not source.warnings
    assert numbers(read(path, start=7, stop=9)[1]) == [7, 8]
    with Frames(path) as pages:
        assert pages.count == 20 and media.number(pages.read(13).bgr) == 13
    assert "has 20 frames" in refusal(path, start=20)


def test_stacks_of_a_folder_follow_each_other(tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    stack(folder / "2.tif", range(10)), stack(folder / "10.tif", range(10, 15))
    assert numbers(read(folder)[1]) == list(range(15))
    assert expand([folder / "2.tif", folder / "10.tif"])[0] == [folder / "2.tif", folder / "10.tif"]


def test_a_thumbnail_is_no_frame(tmp_path: Path) -> None:
    large, small = (Pictures.fromarray(media.numbered(3, size)[..., 0]) for size in ((64, 48), (32, 24)))
    large.save(tmp_path / "photo.tif", save_all=True, append_images=[small])
    assert numbers(read(tmp_path / "photo.tif")[1]) == [3]


# 16 bits


def deep(folder: Path, scale: float, low: int = 0, colour: bool = False, suffix: str = ".png") -> Path:
    ramp = np.tile(np.linspace(0, 1, 64), (48, 1))
    pictures = [(low + ramp * scale * (i + 1) / 4).astype(np.uint16) for i in range(4)]
    return put(folder, {f"{i}{suffix}": np.dstack([p] * 3) if colour else p for i, p in enumerate(pictures)})


@pytest.mark.parametrize(("suffix", "colour"), [(".png", True), (".tif", False)])
@pytest.mark.parametrize(("white", "low"), [(1023, 0), (4095, 0), (4000, 27000)])
def test_pictures_of_few_bits_use_all_levels(tmp_path: Path, white: int, low: int, colour: bool, suffix: str) -> None:
    path = deep(tmp_path / "frames", white, low, colour, suffix)
    source, frames = read(path)
    first, last = frames[0].bgr, frames[-1].bgr
    assert last.min() == 0 and last.max() == 255 and len(np.unique(last)) >= 60
    assert 60 <= first.max() <= 66  # one range for all frames
    (warning,) = source.warnings
    assert f"use the numbers {low} to {low + white}" in warning
    np.testing.assert_array_equal(read(path, start=2)[1][-1].bgr, last)


def test_pictures_of_all_16_bits_are_as_they_were(tmp_path: Path) -> None:
    source, frames = read(deep(tmp_path / "frames", 65535))
    last = frames[-1].bgr
    assert not source.warnings and last.max() == 255 and last[0, 10, 0] == int(65535 * 10 / 63) >> 8


# names


@pytest.mark.parametrize(
    "names",
    [
        "1632012345.12 1632012345.5 1632012345.9 1632012346",
        "-12 -3 -1.5 0 2 10",
        "frame_2 frame_10 frame_100",
        "shot1.08 shot1.09 shot1.100",
        "1-02-03.45 1-02-03.50 1-02-10.10",
        "v1.2_2 v1.2_10 v1.10_1",
    ],
)
def test_names_are_in_the_order_of_what_they_say(names: str) -> None:
    right = [Path(f"{name}.jpg") for name in names.split()]
    assert ordered(sorted(right, reverse=True)) == ordered(right) == right


# more pixels than are read


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
def test_what_claims_more_pixels_than_are_read(tmp_path: Path) -> None:
    first, second = [Pictures.new("L", (16, 16), n) for n in (0, 99)]
    pages = [second, Pictures.new("1", (12_000, 12_000))]
    first.save(tmp_path / "stack.tif", save_all=True, append_images=pages, compression="tiff_deflate")
    source, frames = read(tmp_path / "stack.tif")
    assert len(frames) == 2 and not source.complete
    assert "is too large for a frame: 12000x12000" in source.warnings[0]
    for name, side in (("canvas.webp", 11_000), ("canvas.webp", 16_384), ("canvas.gif", 16_000)):  # Pillow bounds, too
        path = tmp_path / name
        first.convert("RGB").save(path, save_all=True, append_images=[second])
        data = bytearray(path.read_bytes())
        if path.suffix == ".gif":
            data[6:10] = side.to_bytes(2, "little") * 2
        else:
            at = data.index(b"VP8X") + 12
            data[at : at + 6] = (side - 1).to_bytes(3, "little") * 2
        path.write_bytes(data)
        large = f"is too large for a frame: {side}x{side}, and at most 100 megapixels are read"
        assert (large if name.endswith("gif") else "canvas.webp") in refusal(path)
