"""Render the sample clips anew, with their init files and their truth: `python sample_videos/make.py`.

Needs the `samples` extra (`pip install -e '.[samples]'`): the portraits are those that scikit-image and matplotlib
carry.
Everything is drawn from fixed seeds; the same versions of the libraries give the same files.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import cv2
import imageio_ffmpeg
import numpy as np
from numpy.typing import NDArray
from occluders import cover
from portraits import PARTS, Portrait
from render import SIZE, expose, face, truth
from scenes import FPS, SCENES, Scene
from timeline import Array
from warp import Moment, to_skin, to_skull

HEADER = "frame,time_s,target,part,x,y,w,h,angle,confidence,status,std_x,std_y,particles,ess,identity,identity_prob"
CRF = 16
Truth = list[dict[str, tuple[float, float]]]


def _prove(portrait: Portrait, m: Moment, where: dict[str, tuple[float, float]], above: Array, below: Array) -> None:
    """The truth is what the picture shows, by two ways back to the portrait.

    The warp is undone at the very points of the truth (to 0.02 px), and the rendered frame's own map, which says
    what point of the portrait each pixel shows, is read there between its pixels (to 0.15 px: it is bent there).

    Raises:
        AssertionError: it is not.
    """
    a = portrait.anatomy
    for part, q in where.items():
        neutral = np.array(a.points[part])
        back = to_skin(to_skull(np.array([q]), a, m, portrait.origin), part == "lip_lower", a, m)[0]
        assert np.abs(back - neutral).max() < 0.02, f"{part}: inverted to {back}, not {neutral}, at {m}"
        shown = below if part == "lip_lower" else above
        at = cv2.remap(shown, np.array([[q[0]]], np.float32), np.array([[q[1]]], np.float32), cv2.INTER_LINEAR)[0, 0]
        assert np.abs(at - neutral).max() < 0.15, f"{part}: the picture shows {at}, not {neutral}, at {m}"


def frames(scene: Scene) -> tuple[list[NDArray[np.uint8]], Truth, list[set[str]]]:
    """The pictures (H, W, 3) BGR, the truth, and the parts hidden, for each frame."""
    rng = np.random.default_rng(scene.seed)
    pictures, where, hidden = [], [], []
    for t, m in enumerate(scene.moments):
        points = truth(scene.portrait, m)
        picture, above, below = face(scene.portrait, m)
        _prove(scene.portrait, m, points, above, below)
        out: set[str] = set()
        for held in scene.objects:
            picture, alpha = cover(picture, held, t)
            out |= {part for part, (x, y) in points.items() if alpha[round(y), round(x)] > 0.5}
        pictures.append(expose(picture, scene.portrait.exposure * m.light, rng))
        where.append(points)
        hidden.append(out)
    return pictures, where, hidden


def _write_video(path: Path, pictures: list[NDArray[np.uint8]]) -> None:
    # one thread and bit-exact headers, so that the same frames give the same file
    params = ["-crf", str(CRF), "-preset", "veryslow", "-g", "50", "-flags", "+cgop", "-threads", "1", "-fflags",
              "+bitexact", "-flags:v", "+bitexact+cgop", "-movflags", "+faststart"]  # fmt: skip
    writer = imageio_ffmpeg.write_frames(
        str(path), SIZE, fps=FPS, codec="libx264", pix_fmt_out="yuv420p", quality=None, macro_block_size=1,
        output_params=params, ffmpeg_log_level="error",
    )  # fmt: skip
    writer.send(None)
    for picture in pictures:
        writer.send(np.ascontiguousarray(picture[:, :, ::-1]))
    writer.close()


def _write_truth(path: Path, where: Truth, hidden: list[set[str]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(HEADER.split(","))
        for t, (points, out_of_sight) in enumerate(zip(where, hidden, strict=True)):
            for part in PARTS:
                x, y = points[part]
                status = "hidden" if part in out_of_sight else "visible"
                row = [t, f"{t / FPS:.2f}", "face", part, f"{x:.2f}", f"{y:.2f}", "", "", "", "", status]
                out.writerow(row + [""] * 6)


def _write_init(path: Path, scene: Scene, points: dict[str, tuple[float, float]]) -> None:
    a = scene.portrait.anatomy
    # a square about brows, nose and mouth, as the frontal cascade would draw it
    side = round(1.2 * (a.chin_y - a.brow_y))
    left, top = round(points["nose"][0] - side / 2), round(points["nose"][1] - 0.63 * side)
    lines = [f"# {path.name}: the truth of the clip's first frame", "frame: 0", "face:"]
    lines += [f"  box: [{left}, {top}, {side}, {side}]  # left, top, width, height", "  points:"]
    lines += [f"    {part}: [{points[part][0]:.2f}, {points[part][1]:.2f}]" for part in PARTS]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> None:
    """Render the clips named, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="*", metavar="CLIP", help=f"of {', '.join(SCENES)}; all unless named")
    parser.add_argument("-o", "--out", type=Path, default=Path(__file__).parent, help="folder (default: this one)")
    args = parser.parse_args()
    for name in args.clips or SCENES:
        if name not in SCENES:
            parser.error(f"no clip {name!r}; there are {', '.join(SCENES)}")
        try:
            scene = SCENES[name]()
        except ModuleNotFoundError as error:
            parser.error(f"{error.name} is not installed; pip install -e '.[samples]'")
        pictures, where, hidden = frames(scene)
        args.out.mkdir(parents=True, exist_ok=True)
        video = args.out / f"{name}.mp4"
        _write_video(video, pictures)
        _write_truth(args.out / f"{name}.truth.csv", where, hidden)
        _write_init(args.out / f"{name}.init.yaml", scene, where[0])
        path = np.array([[points[part] for part in PARTS] for points in where])
        fastest = float(np.linalg.norm(np.diff(path, axis=0), axis=2).max())
        print(f"{video}: {len(pictures)} frames, {video.stat().st_size / 1e6:.2f} MB, at most {fastest:.1f} px a frame")


if __name__ == "__main__":
    main()
