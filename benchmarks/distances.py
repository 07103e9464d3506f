"""How the distances of the correlation likelihood grow with the error in x: figure 5 of Odobez et al. 2003.

    python benchmarks/distances.py                                    docs/distances.png again
    python benchmarks/distances.py CLIP --frame 20 -o distances.png --csv distances.csv
    python benchmarks/distances.py --speed                            what 200 and 2,000 particles take

a) random patches of a frame against the same frame, displaced by the error, for each distance; each profile is scaled
   to a maximum of 1
b), c) a patch wholly on an object, and one of which 60 % lie on it and the rest on the ground, by saturated L1 and by
   L2. An object cut from the frame moves by 2 px and the ground by -2 px; error 0 is the motion of the object, -4 px
   that of the ground. Both profiles have one scale.

Every pixel of a patch is compared, as in the paper; `--grid 16` compares what the recipes compare. Means over patches.
"""

from __future__ import annotations

import argparse
import csv
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from facetrack_cli.core.types import Array, Frame, Image
from facetrack_cli.report.figures.style import COLOURS, FAINT, WIDTH, heading, new_figure, render, style
from facetrack_cli.trackers.regions import settings as regions
from facetrack_cli.trackers.regions.correlation import Correlation
from facetrack_cli.video.source import open_source

ROOT = Path(__file__).parent.parent
SAMPLE = ROOT / "sample_videos" / "expressions.mp4"
REACH = 10  # pixels of error to either side
MOTION = 2  # pixels the object moves; the ground moves by as much the other way
SHARE = 0.6  # of the mixed patch that lies on the object
NAMES = {"l2": "L2", "saturated_l1": "saturated L1", "hausdorff": "Hausdorff"}
OBJECT, MIXED = "on the object", "60 % on the object"
# of panel a the distances, of the others the patches
LOOKS = {
    "l2": (COLOURS[0], "+"),
    "saturated_l1": (COLOURS[2], "o"),
    "hausdorff": (COLOURS[3], "x"),
    OBJECT: (COLOURS[4], "x"),
    MIXED: (COLOURS[1], "o"),
}


class Profile(NamedTuple):
    """Mean distance over patches at each error, before it is scaled, and the panel it belongs to."""

    panel: str
    distance: str
    patch: str
    mean: Array


def errors() -> Array:
    return np.arange(-REACH, REACH + 1.0)


def states(x: Array, y: float) -> Array:
    """(N, 1, 6) at scale 1, at rest."""
    out = np.zeros((len(x), 1, 6))
    out[:, 0, 0], out[:, 0, 1], out[:, 0, 2] = x, y, 1.0
    return out


def profile(likelihood: Correlation, before: Frame, now: Frame, centre: tuple[float, float], motion: float) -> Array:
    """Distances from the patch at `centre` in `before` of those in `now` whose motion errs by each of `errors`."""
    parent = states(np.full(len(errors()), centre[0]), centre[1])
    children = states(centre[0] + motion + errors(), centre[1])
    learned = likelihood.init(before, parent[0])
    return np.asarray(likelihood.differences(learned, now, children, parent)[:, 0])


def shifted(picture: Image, dx: int) -> Image:
    """The image moved by whole pixels; its border is repeated."""
    columns = np.clip(np.arange(picture.shape[1]) - dx, 0, picture.shape[1] - 1)
    return np.ascontiguousarray(picture[:, columns])


class Scene(NamedTuple):
    """Two frames of an object before a ground, and the centres of a patch on it and of one that it half fills."""

    before: Frame
    now: Frame
    whole: tuple[float, float]
    mixed: tuple[float, float]


def scenes(picture: Image, size: int, count: int, rng: np.random.Generator) -> Iterator[Scene]:
    """An object from anywhere in the image, so large that a displaced patch stays on it, at a random place of it."""
    side, height, width = size + 2 * REACH, *picture.shape[:2]
    beyond = round((1 - SHARE) * size) + REACH + MOTION  # how far the mixed patch may reach over the object's edge
    for number in range(count):
        left, top = int(rng.integers(0, width - side + 1)), int(rng.integers(0, height - side + 1))
        thing = picture[top : top + side, left : left + side]
        x, y = int(rng.integers(beyond, width - side - beyond + 1)), int(rng.integers(0, height - side + 1))

        def composed(motion: int, thing: Image = thing, x: int = x, y: int = y) -> Frame:
            frame = shifted(picture, -motion)
            frame[y : y + side, x + motion : x + motion + side] = thing
            return Frame(0, 0.0, frame)

        middle = y + (side - 1) / 2
        whole = x + (side - 1) / 2, middle
        # ground on its left and on its right in turn
        over = side / 2 + (0.5 - SHARE) * size
        mixed = whole[0] + (over if number % 2 else -over), middle
        yield Scene(composed(0), composed(MOTION), whole, mixed)


def correlation(name: str, size: int, grid: int = 16, saturation: float = 20.0) -> Correlation:
    capped = saturation if name == "saturated_l1" else None
    settings = {"distance": name, "grid": (grid, grid), "saturation": capped, "sigma": 100.0}
    return Correlation(regions.Correlation.model_validate(settings), (size, size))


def profiles(picture: Image, size: int, count: int, grid: int, saturation: float, seed: int) -> list[Profile]:
    rng = np.random.default_rng(seed)
    height, width = picture.shape[:2]
    models = {name: correlation(name, size, grid, saturation) for name in NAMES}
    frame = Frame(0, 0.0, picture)
    half = (size - 1) / 2
    centres = [
        (half + int(rng.integers(REACH, width - size - REACH + 1)), half + int(rng.integers(0, height - size + 1)))
        for _ in range(count)
    ]
    found = [
        Profile("a", name, "", np.mean([profile(model, frame, frame, c, 0.0) for c in centres], axis=0))
        for name, model in models.items()
    ]
    made = list(scenes(picture, size, count, rng))
    for panel, name in (("b", "saturated_l1"), ("c", "l2")):
        for patch in (OBJECT, MIXED):
            each = [
                profile(models[name], s.before, s.now, s.whole if patch == OBJECT else s.mixed, MOTION) for s in made
            ]
            found.append(Profile(panel, name, patch, np.mean(each, axis=0)))
    return found


def scaled(found: Sequence[Profile]) -> list[Array]:
    """Each profile of panel a to a maximum of 1; those of another panel to one maximum, so that they compare."""
    most = {p.panel: max(q.mean.max() for q in found if q.panel == p.panel) for p in found}
    return [p.mean / max(p.mean.max() if p.panel == "a" else most[p.panel], 1e-9) for p in found]


def figure_of(found: Sequence[Profile], note: str) -> bytes:
    titles = {"a": "a) distances", "b": "b) saturated L1", "c": "c) L2"}
    with style():
        figure = new_figure(WIDTH, 3.8)
        axes = dict(zip("abc", figure.subplots(1, 3, sharey=True), strict=True))
        for p, values in zip(found, scaled(found), strict=True):
            colour, marker = LOOKS[p.patch or p.distance]
            look: dict[str, Any] = {"color": colour, "marker": marker, "markersize": 4.5, "markeredgewidth": 1.1}
            axes[p.panel].plot(errors(), values, label=p.patch or NAMES[p.distance], markerfacecolor="none", **look)
        for panel, one in axes.items():
            heading(one, titles[panel], note if panel == "a" else "")
            one.set_xlabel("error in x (px)")
            one.set_xticks(np.arange(-REACH, REACH + 1, 5))
            one.set_xlim(-REACH - 0.6, REACH + 0.6)
            one.set_ylim(0, 1.24)
            one.set_yticks(np.arange(0, 1.01, 0.2))
            # above the highest profile, all in one row
            one.legend(loc="upper center", ncols=3, handlelength=1.5, columnspacing=1.2, fontsize=8, borderaxespad=0.2)
            if panel != "a":
                one.vlines(-2 * MOTION, 0, 1.03, color=FAINT, linewidth=0.9, linestyle=(0, (3, 2)), zorder=1)
                one.text(-2 * MOTION, 1.045, "motion of the ground", ha="center", color=FAINT, fontsize=8)
        axes["a"].set_ylabel("distance (scaled)")
    return render(figure)


def table_of(found: Sequence[Profile]) -> None:
    print("panel  distance      patch                      " + "".join(f"{e:>7.0f}" for e in range(-4, 5)))
    for p, values in zip(found, scaled(found), strict=True):
        row = "".join(f"{v:7.2f}" for v in values[REACH - 4 : REACH + 5])
        print(f"{p.panel:6s} {NAMES[p.distance]:13s} {p.patch or 'random':26s} {row}")


def speed() -> None:
    """What one frame takes, its image made grey and reduced included, as a share of decoding it."""
    from speed import best, decode, enlarged

    rng, frames = np.random.default_rng(0), 200
    with tempfile.TemporaryDirectory() as folder:
        path, _ = enlarged(Path(folder), frames)
        with open_source(path) as source:
            before, now = (frame for frame, _ in zip(source, range(2), strict=False))
        print("640x480, grid 16x16: share of the time that decoding the frame takes")
        print("| box | particles | " + " | ".join(NAMES.values()) + " |\n|---|---|---|---|---|")
        for side in (40, 80, 160):
            for count in (200, 2000):
                parents = states(320 + rng.normal(0, 0.07 * side, count), 240.0)[np.sort(rng.integers(0, count, count))]
                x = parents + rng.normal(0, 1, (count, 1, 6)) * [0.07 * side, 0.07 * side, 0.05, 0, 0, 0]

                def work(name: str, side: int = side, x: Array = x, parents: Array = parents) -> None:
                    model = correlation(name, side)
                    # the frame before is grey and reduced already, from when it was tracked
                    model.score(model.init(before, x[0]), Frame(1, 0.0, now.bgr), x, parents)

                works = [lambda name=name: work(name) for name in NAMES]
                # the first one after decoding waits for the image to come from memory; it does not count
                _, *ours, theirs = best(works[0], *works, lambda: decode(path), times=15)
                shares = " | ".join(f"{seconds / theirs * frames:.2f}" for seconds in ours)
                print(f"| {side}x{side} | {count:,} | {shares} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clip", type=Path, nargs="?", default=SAMPLE)
    parser.add_argument("--frame", type=int, default=0)
    parser.add_argument("--patches", type=int, default=20)
    parser.add_argument("--size", type=int, default=40, help="side of a patch in pixels (default 40)")
    parser.add_argument("--grid", type=int, help="points along a side (default: every pixel)")
    parser.add_argument("--saturation", type=float, default=20.0, help="grey levels (default 20)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", dest="out", type=Path, default=ROOT / "docs" / "distances.png")
    parser.add_argument("--csv", type=Path, help="the scaled profiles as a table")
    parser.add_argument("--speed", action="store_true", help="measure time instead")
    given = parser.parse_args()
    if given.speed:
        return speed()
    with open_source(given.clip, start=given.frame) as source:
        picture = next(iter(source)).bgr
    need = given.size + 2 * REACH + 2 * (round((1 - SHARE) * given.size) + REACH + MOTION), given.size + 2 * REACH
    if picture.shape[1] < need[0] or picture.shape[0] < need[1]:
        parser.error(f"{given.clip}: patches of {given.size} pixels need an image of at least {need[0]}x{need[1]}")
    grid = given.grid or given.size
    found = profiles(picture, given.size, given.patches, grid, given.saturation, given.seed)
    table_of(found)
    points = "every pixel" if grid == given.size else f"{grid}x{grid} points"
    given.out.write_bytes(figure_of(found, f"{given.patches} patches, {given.size} px, {points}"))
    if given.csv:
        with given.csv.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["panel", "distance", "patch", "error_px", "value"])
            for p, values in zip(found, scaled(found), strict=True):
                for error, value in zip(errors(), values, strict=True):
                    writer.writerow([p.panel, p.distance, p.patch or "random", f"{error:.0f}", f"{value:.6f}"])
    return None


if __name__ == "__main__":
    main()
