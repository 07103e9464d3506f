"""Render the sample clips and the gallery again, with init files and ground truth: `python tools/samples/make.py`.

Needs the `samples` extra (`pip install -e '.[samples]'`): the portraits are those that scikit-image and matplotlib
carry.
Everything is drawn from fixed seeds; the same versions of the libraries give the same files.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np
from clip_files import Clip, Start, TruthRow, fastest, write_init, write_truth, write_video
from faces_map import map_clip
from faces_passerby import passerby
from gestures import gestures
from hands import hands
from heads import textured, turning
from lamp import lamp
from numpy.typing import NDArray
from occluders import cover
from people import write_gallery
from portraits import PARTS, Portrait
from render import expose, face, truth
from scenes import Scene, expressions, occlusion
from signing import signing
from timeline import Array
from warp import Moment, to_skin, to_skull
from zoom import zoom

SAMPLES = Path(__file__).parents[2] / "sample_videos"
Truth = list[dict[str, tuple[float, float]]]


def _prove(portrait: Portrait, m: Moment, where: dict[str, tuple[float, float]], above: Array, below: Array) -> None:
    """The ground truth is what the image shows, by two ways back to the portrait.

    The warp is undone at the very points of the ground truth (to 0.02 px), and the rendered frame's own map, which says
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
        assert np.abs(at - neutral).max() < 0.15, f"{part}: the image shows {at}, not {neutral}, at {m}"


def frames(scene: Scene) -> tuple[list[NDArray[np.uint8]], Truth, list[set[str]]]:
    """The images (H, W, 3) BGR, the ground truth, and the parts hidden, for each frame."""
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


def talking_head(scene: Scene) -> Clip:
    """A clip of points of a face; its box is about brows, nose and mouth, as the frontal cascade would draw it."""
    pictures, where, hidden = frames(scene)
    rows = [
        TruthRow(t, "face", part, *points[part], hidden=part in out_of_sight)
        for t, (points, out_of_sight) in enumerate(zip(where, hidden, strict=True))
        for part in PARTS
    ]
    a, points = scene.portrait.anatomy, where[0]
    side = round(1.2 * (a.chin_y - a.brow_y))
    left, top = round(points["nose"][0] - side / 2), round(points["nose"][1] - 0.63 * side)
    return Clip(pictures, rows, {"face": Start((left, top, side, side), {part: points[part] for part in PARTS})})


# a clip is a name and a function that renders it: its images, its rows of ground truth, where its targets begin
CLIPS: Mapping[str, Callable[[], Clip]] = {
    "expressions": lambda: talking_head(expressions()),
    "occlusion": lambda: talking_head(occlusion()),
    "hands": hands,
    "map": map_clip,
    "passerby": passerby,
    "textured": textured,
    "turning": turning,
    "signing": signing,
    "gestures": gestures,
    "zoom": zoom,
    "lamp": lamp,
}


GALLERY = "gallery"


def _write_clip(name: str, out: Path) -> None:
    """The three files of a clip."""
    clip = CLIPS[name]()
    video = out / f"{name}.mp4"
    write_video(video, clip.pictures, clip.crf)
    write_truth(out / f"{name}.truth.csv", clip.truth)
    write_init(out / f"{name}.init.yaml", clip.starts)
    size, fast = video.stat().st_size / 1e6, fastest(clip.truth)
    print(f"{video}: {len(clip.pictures)} frames, {size:.2f} MB, at most {fast:.1f} px a frame")


def main() -> None:
    """Render the clips named, or all, and the gallery."""
    names = [*CLIPS, GALLERY]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="*", metavar="CLIP", help=f"of {', '.join(names)}; all unless named")
    parser.add_argument("-o", "--out", type=Path, default=SAMPLES, help=f"folder [default: {SAMPLES}]")
    args = parser.parse_args()
    for name in args.clips or names:
        if name not in names:
            parser.error(f"no clip {name!r}; there are {', '.join(names)}")
        args.out.mkdir(parents=True, exist_ok=True)
        try:
            if name == GALLERY:
                write_gallery(args.out / GALLERY)
            else:
                _write_clip(name, args.out)
        except ModuleNotFoundError as error:
            parser.error(f"{error.name} is not installed; pip install -e '.[samples]'")


if __name__ == "__main__":
    main()
