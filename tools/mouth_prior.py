"""Makes configs/mouth_prior.npz, the shape prior that is shipped, from a small parametric model of the mouth.

    python tools/mouth_prior.py                 # writes configs/mouth_prior.npz, the same bytes everywhere
    python tools/mouth_prior.py -o other.npz

Nobody's face is in it. The model has fourteen numbers: five for the expression (opening, smile or pucker, its
asymmetry, sideways jaw, corners up or down), three for the lips, four for the head (yaw, pitch, roll, distance), and
two for the expression of the first frame. A shape is the displacement of the five points between two such faces,
relative to the nose, in mouth widths of the first. The head's numbers are there because the registration removes the
translation alone.

The constants marked "measured" are statistics of the MUCT landmark database (S. Milborrow, J. Morkel and F. Nicolls,
2010; 3,755 faces of 276 people, mirrored rows left out), taken from the five points in mouth widths of each person's
least open mouth: means over people for the neutral face; least squares of the displacements between images by the
frontal camera on the changes of width and opening; and, for the depths, the displacements between simultaneous
images by the five cameras, which see each face from five sides. Everybody in MUCT is nearly neutral (between two
images the mouth opens by 0.5 widths at most, and by less than 0.23 in 95 %), so how far an opening, a smile or a
pucker goes is set by hand, from faces that talk and laugh.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from statistics import NormalDist

import numpy as np

from facetrack_cli.trackers.points.shape_prior import DEFAULT, ShapePrior, suggested_sigma

PARTS = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")
PAIRS = 200  # shapes come in pairs, each with its mirror image

# measured: the neutral face, mouth widths from the tip of the nose; z is the depth behind it, from the five cameras
NEUTRAL = {
    "mouth_left": (-0.50, 0.63, 0.50),
    "mouth_right": (0.50, 0.63, 0.50),
    "lip_upper": (0.0, 0.48, 0.22),
    "lip_lower": (0.0, 0.84, 0.31),
}
# measured: for each unit by which the mouth opens, upper lip, lower lip and corners sink by this much
OPEN_UPPER, OPEN_LOWER, OPEN_CORNER = -0.23, 0.77, 0.10
# measured: for each unit by which the mouth widens, corners and lips rise by this much
WIDE_CORNER, WIDE_LIP = -0.50, -0.23
# measured: what is left of the lips' places when width, opening and head are accounted for, as standard deviations
LIP_X, LIP_Y = 0.025, 0.025
JAW_X, CORNER_Y = 0.025, 0.03

# set by hand: the ends of the expressions, in mouth widths
OPENING_MOST = 0.65
OPENING_NARROWS = 0.15  # a mouth that opens by one unit gets this much narrower
SMILE_MOST, PUCKER_MOST = 0.27, 0.30
PUCKER_LIPS = 0.15  # lips thicken by this much of the narrowing, up and down
ASYMMETRY = 0.06  # standard deviation of the difference between the two corners' way
FIRST_OPENING, FIRST_SMILE = 0.15, 0.10  # the first frame is neutral or nearly so: at most this open, wider by this sd
# set by hand: the head relative to the first frame: standard deviation and limit, degrees and share of the size
YAW, PITCH, ROLL, GROWTH = (6.0, 15.0), (4.0, 10.0), (4.0, 8.0), (0.04, 0.08)

Face = dict[str, tuple[float, float, float]]


def even(index: int, dimensions: int) -> list[float]:
    """Point `index` of an evenly spread sequence in the unit cube (additive recurrence of Roberts, 2018)."""
    g = 2.0
    for _ in range(60):
        g = (1.0 + g) ** (1.0 / (dimensions + 1))
    return [(0.5 + (index + 1) * g ** -(d + 1)) % 1.0 for d in range(dimensions)]


def normal(u: float, sd: float, limit: float = math.inf) -> float:
    return max(-limit, min(limit, sd * NormalDist().inv_cdf(min(max(u, 1e-6), 1.0 - 1e-6))))


def expression(
    opening: float, widening: float, asymmetry: float, jaw: float, corners: float, lips: tuple[float, float, float]
) -> Face:
    """The neutral face with an expression, in mouth widths; `lips`: both sideways, the upper down, the lower down."""
    smile, pucker = max(widening, 0.0), max(-widening, 0.0)
    narrowing = OPENING_NARROWS * opening
    face: Face = {}
    for part, side in (("mouth_left", -1.0), ("mouth_right", 1.0)):
        x, y, z = NEUTRAL[part]
        way = 0.5 * (widening - narrowing) + side * 0.5 * asymmetry
        y += corners + OPEN_CORNER * opening + WIDE_CORNER * (smile + side * 0.5 * asymmetry)
        face[part] = (x + side * way, y, z)
    x, y, z = NEUTRAL["lip_upper"]
    y += OPEN_UPPER * opening + WIDE_LIP * smile - PUCKER_LIPS * pucker + lips[1]
    face["lip_upper"] = (x + 0.25 * asymmetry + lips[0], y, z)
    x, y, z = NEUTRAL["lip_lower"]
    y += OPEN_LOWER * opening + WIDE_LIP * smile + PUCKER_LIPS * pucker + lips[2]
    face["lip_lower"] = (x + 0.25 * asymmetry + lips[0] + jaw, y, z)
    return face


def seen(face: Face, yaw: float, pitch: float, roll: float, growth: float) -> Face:
    """The face turned about the tip of the nose (degrees) and grown, as a distant camera sees it; z is kept."""
    (cy, sy), (cp, sp), (cr, sr) = ((math.cos(math.radians(a)), math.sin(math.radians(a))) for a in (yaw, pitch, roll))
    out: Face = {}
    for part, (x, y, z) in face.items():
        x, z = cy * x + sy * z, cy * z - sy * x
        y, z = cp * y + sp * z, cp * z - sp * y
        x, y = cr * x - sr * y, cr * y + sr * x
        out[part] = (growth * x, growth * y, z)
    return out


def shape(index: int) -> list[tuple[float, float]]:
    """The displacements of PARTS in the index-th shape."""
    u = even(index, 14)
    first = expression(
        FIRST_OPENING * u[0] ** 2, normal(u[1], FIRST_SMILE, 1.5 * FIRST_SMILE), 0.0, 0.0, 0.0, (0.0, 0.0, 0.0)
    )
    widening = 2.0 * u[3] - 1.0
    now = expression(
        opening=OPENING_MOST * u[2] ** 2,  # small openings are the most frequent
        widening=widening * abs(widening) ** 0.5 * (SMILE_MOST if widening > 0 else PUCKER_MOST),
        asymmetry=normal(u[4], ASYMMETRY),
        jaw=normal(u[5], JAW_X),
        corners=normal(u[6], CORNER_Y),
        lips=(normal(u[7], LIP_X), normal(u[8], LIP_Y), normal(u[9], LIP_Y)),
    )
    now = seen(now, normal(u[10], *YAW), normal(u[11], *PITCH), normal(u[12], *ROLL), 1.0 + normal(u[13], *GROWTH))
    width = math.dist(first["mouth_left"][:2], first["mouth_right"][:2])
    moved = [((now[p][0] - first[p][0]) / width, (now[p][1] - first[p][1]) / width) for p in PARTS[1:]]
    return [(0.0, 0.0), *moved]


def mirrored(moved: list[tuple[float, float]]) -> list[tuple[float, float]]:
    nose, left, right, upper, lower = ((-x, y) for x, y in moved)
    return [nose, right, left, upper, lower]


def make() -> ShapePrior:
    """The first shape is the first frame's own, no displacement at all."""
    shapes = [[(0.0, 0.0)] * len(PARTS)]
    for index in range(PAIRS):
        moved = shape(index)
        shapes += [moved, mirrored(moved)]
    # rounding makes the file the same where the mathematical library differs in its last digit
    return ShapePrior(PARTS, np.round(np.array(shapes), 4) + 0.0, "nose", ("mouth_left", "mouth_right"))


def main() -> None:
    parser = argparse.ArgumentParser(description="Make the shape prior that is shipped, configs/mouth_prior.npz.")
    parser.add_argument("-o", "--out", type=Path, default=Path(__file__).resolve().parent.parent / "configs" / DEFAULT)
    out = parser.parse_args().out
    prior = make()
    prior.save(out)
    print(f"{out}: {len(prior.shapes)} shapes, {suggested_sigma(prior):.3f} mouth widths apart")


if __name__ == "__main__":
    main()
