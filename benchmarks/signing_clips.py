"""Further clips of a signer, as tools/samples/signing.py draws them, with random scripts, for docs/results.md.

    python benchmarks/signing_clips.py OUT 1 2 3      OUT/signing_1.mp4 and so on, with init file and ground truth

By chance one act follows another: the hands cross to the other side and stay there for a while, before the chest or
before the face; they touch, or wait together, and part to the sides from which they came; or each signs by itself.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

SAMPLES = Path(__file__).parent.parent / "tools" / "samples"
sys.path.insert(0, str(SAMPLES))

import signing  # noqa: E402
from clip_files import Clip, TruthRow, start_of, write_init, write_truth, write_video  # noqa: E402
from person import person, wall, wander  # noqa: E402
from person_hands import (  # noqa: E402
    TARGETS,
    Motion,
    Scene,
    face_covered,
    hand_box,
    hand_covered,
    loose,
    matched_skin,
    render,
)
from render import expose  # noqa: E402
from timeline import track, unrest  # noqa: E402

FRAMES = 160
MIDDLE = 160.0


def script(rng: np.random.Generator) -> tuple[list[signing.Stop], list[signing.Stop]]:
    """Where the hands are to be when; the first one begins on the left."""
    side, t = -1, 0
    stops: tuple[list[signing.Stop], list[signing.Stop]] = ([], [])

    def go(after: int, away: float, height: tuple[float, float]) -> None:
        """Both to their sides, `away` pixels from the middle."""
        nonlocal t
        t += after
        for hand, stop in enumerate(stops):
            x = MIDDLE + (side if hand == 0 else -side) * away
            stop.append((t, x + float(rng.uniform(-6, 6)), height[hand] + float(rng.uniform(-5, 5))))

    go(0, 52, (160.0, 160.0))
    while t < FRAMES:
        act = rng.choice(["cross", "touch", "wait", "apart"], p=[0.45, 0.2, 0.15, 0.2])
        level = float(rng.choice([160.0, 74.0]))
        apart = float(rng.uniform(-12, 12))
        height = (level + apart, level - apart)
        if act == "cross":
            go(int(rng.integers(8, 12)), float(rng.uniform(38, 50)), height)
            side = -side
            go(int(rng.integers(10, 15)), float(rng.uniform(32, 46)), (height[1], height[0]))
        elif act == "apart":
            go(int(rng.integers(10, 14)), float(rng.uniform(42, 60)), (float(rng.uniform(120, 175)), 150.0))
        else:
            go(int(rng.integers(9, 13)), float(rng.uniform(12, 22)), height)
            if act == "wait":
                go(int(rng.integers(4, 9)), float(rng.uniform(12, 22)), height)
            go(int(rng.integers(9, 13)), float(rng.uniform(45, 58)), (150.0, 150.0))
    return stops


def scene(seed: int) -> Scene:
    """What happens when."""
    rng = np.random.default_rng(seed)
    face = np.stack([160 + wander(rng, FRAMES, 20, 9.0), 69 + wander(rng, FRAMES, 20, 4.0)], axis=1)
    scale = 1.0 + wander(rng, FRAMES, 20, 0.05)
    motions = []
    for stops in script(rng):
        way = np.stack([track([(stop[0], stop[i]) for stop in stops], FRAMES) for i in (1, 2)], axis=1)
        shape = loose(rng, FRAMES, signing.HAND, (9, 22))
        motions.append(Motion(way + unrest(rng, FRAMES, 1.1, 1.5), **shape))
    who = person(signing.CLOTH, seed + 1, FRAMES, ((6, 60), (84, 150)))
    front = np.full(FRAMES, int(rng.integers(2)))
    ground = wall((148.0, 152.0, 140.0), seed + 2)
    return Scene(who, ground, face, scale, motions, front, matched_skin(signing.CLOTH, signing.HAND), signing.ZOOM)


def clip(seed: int) -> Clip:
    of, rng = scene(seed), np.random.default_rng(seed + 3)
    pictures, rows = [], []
    for t in range(FRAMES):
        picture, layers = render(of, t)
        box, front = of.box(t), int(of.front[t])
        rows.append(TruthRow(t, "head", "box", *box, hidden=face_covered(box, layers)[2] > 0.5))
        for target, pose, share in zip(TARGETS, of.poses(t), hand_covered(layers, front), strict=True):
            rows.append(TruthRow(t, target, "box", *hand_box(pose), hidden=share > 0.5))
        pictures.append(expose(picture, signing.LIGHT, rng))
    return Clip(pictures, rows, {row.target: start_of(row) for row in rows[:3]}, signing.CRF)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("seeds", type=int, nargs="+")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    for seed in given.seeds:
        made, name = clip(1000 * seed), given.out / f"signing_{seed}"
        write_video(name.with_suffix(".mp4"), made.pictures, made.crf)
        write_truth(name.with_suffix(".truth.csv"), made.truth)
        write_init(name.with_suffix(".init.yaml"), made.starts)
        print(name, flush=True)


if __name__ == "__main__":
    main()
