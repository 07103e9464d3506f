"""Clips that people have beside videos and folders: archives of images, animations, single images, phone clips."""

import subprocess
import zipfile

import cv2
import numpy as np
import pytest
from imageio_ffmpeg import get_ffmpeg_exe as executable
from PIL import Image

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError
from facetrack_cli.video import images
from facetrack_cli.video.seek import Frames
from facetrack_cli.video.source import open_source


def pictures(n=4, size=(64, 48)):
    """Frames of flat colours, each brighter than the one before."""
    return [np.full((size[1], size[0], 3), 40 + 40 * i, np.uint8) for i in range(n)]


def png(image):
    return cv2.imencode(".png", image)[1].tobytes()


def packed(path, entries):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in entries.items():
            file.writestr(name, data)
    return path


def levels(path, **options):
    with open_source(path, **options) as source:
        return [round(float(frame.bgr.mean())) for frame in source]


def test_an_archive_of_images_is_a_clip(tmp_path):
    named = {f"frames/{10 * i}.png": png(one) for i, one in enumerate(pictures())}  # 0, 10, 20, 30: by number
    path = packed(
        tmp_path / "a.zip", {**dict(reversed(named.items())), "frames/notes.txt": b"x", "__MACOSX/._0.png": b""}
    )
    assert levels(path) == [40, 80, 120, 160] and levels(path, start=1, stop=3) == [80, 120]
    with Frames(path) as frames:
        assert frames.count == 4 and frames.read(2).bgr.mean() == 120
    with open_source(path, fps=10) as source:
        assert [frame.time_s for frame in source] == pytest.approx([0, 0.1, 0.2, 0.3])


def test_archives_that_are_no_clips(tmp_path, monkeypatch):
    one = png(pictures()[0])
    several = packed(tmp_path / "several.zip", {"a/1.png": one, "b/1.png": one})
    with pytest.raises(InputError, match="several folders, as a and b"):
        open_source(several)
    with pytest.raises(InputError, match="no images in this archive"):
        open_source(packed(tmp_path / "none.zip", {"a.txt": b"x"}))
    whole = packed(tmp_path / "cut.zip", {f"{i}.png": one for i in range(3)}).read_bytes()
    (tmp_path / "cut.zip").write_bytes(whole[:40] + bytes(20) + whole[60:])
    with pytest.raises(InputError, match=r"cut\.zip/0\.png"):
        open_source(tmp_path / "cut.zip")
    (tmp_path / "half.zip").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"half\.zip"):
        open_source(tmp_path / "half.zip")
    monkeypatch.setattr(images, "MOST_BYTES", 1000)
    with pytest.raises(InputError, match="too large for a frame"):
        open_source(packed(tmp_path / "bomb.zip", {"0.png": bytes(5000)}))


@pytest.mark.parametrize("suffix", [".gif", ".png"])
def test_an_animation_is_a_clip(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    first, *others = [Image.fromarray(one) for one in pictures()]
    first.save(path, save_all=True, append_images=others, duration=100, loop=0)
    found = levels(path)
    assert found == pytest.approx([40, 80, 120, 160], abs=3)


def test_a_single_image_is_a_clip_of_one_frame(tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(png(pictures()[1]))
    assert levels(path) == [80]


@pytest.mark.parametrize("address", ["https://example.org/a.mp4?x=1", "rtsp://camera/1", "HTTP://example.org/a"])
def test_an_address_is_refused(address, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["run", address]) == 3
    [line] = capsys.readouterr().err.splitlines()
    assert line == f"facetrack: error: {address}: is an address on the network; download it first, then give the file"
    assert main(["init", address, "-o", "-"]) == 3


def encoded(path, *options, size=(64, 96), rate=30):
    """A clip of noise that moves, by the encoder that comes with imageio-ffmpeg; skips where it lacks the codec."""
    source = f"testsrc2=size={size[0]}x{size[1]}:rate={rate}:duration=0.4"
    command = [executable(), "-v", "error", "-f", "lavfi", "-i", source, *options, "-y", str(path)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"this ffmpeg cannot: {done.stderr.strip().splitlines()[-1]}")
    return path


@pytest.mark.parametrize(
    ("name", "options", "rate"),
    [
        ("hevc.mp4", ["-c:v", "libx265", "-tag:v", "hvc1"], 30),
        ("hevc10.mp4", ["-c:v", "libx265", "-pix_fmt", "yuv420p10le", "-tag:v", "hvc1"], 30),
        ("av1.mp4", ["-c:v", "libsvtav1"], 30),
        ("av1.webm", ["-c:v", "libaom-av1", "-cpu-used", "8"], 30),
        ("fast.mp4", ["-c:v", "libx264"], 120),
        ("ten.mp4", ["-c:v", "libx264", "-pix_fmt", "yuv420p10le"], 30),
    ],
)
def test_clips_of_phones(tmp_path, name, options, rate):
    path = encoded(tmp_path / name, *options, rate=rate)
    with open_source(path) as source:
        frames = list(source)
        assert source.size == (64, 96) and source.complete and float(source.fps) == pytest.approx(rate)
    assert len(frames) == pytest.approx(0.4 * rate, abs=1)
    assert frames[-1].time_s == pytest.approx((len(frames) - 1) / rate, abs=0.01)


def test_a_portrait_clip_stands_upright(tmp_path):
    flat = encoded(tmp_path / "flat.mp4", "-c:v", "libx264", size=(96, 64))
    turned = tmp_path / "turned.mp4"
    command = [executable(), "-v", "error", "-display_rotation", "90", "-i", str(flat), "-c", "copy", str(turned)]
    if subprocess.run(command, capture_output=True).returncode:
        pytest.skip("this ffmpeg cannot set a rotation")
    with open_source(turned) as source:
        assert source.size == (64, 96)
        assert next(iter(source)).bgr.shape == (96, 64, 3)
