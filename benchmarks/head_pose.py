"""The generic face of trajectory/head.py, and how exact a pose is, by landmarks from five cameras.

    python benchmarks/head_pose.py muct76-opencv.csv

The file is that of the MUCT database (www.milbo.org/muct): name, tag, x00, y00, ...; `i000qa-fn` is person 000 by
camera a. Its five cameras take a picture at the same moment, so that the difference of two poses of a person is that of
the cameras. The shape is of all people, its spread of those with even numbers, and poses are measured of the others.
"""

import argparse
import csv
from pathlib import Path
from typing import Final

import numpy as np

from facetrack_cli.core.types import Array
from facetrack_cli.trajectory.head import SHAPE, SPREAD, euler, fit_pose, rotation_of

LANDMARKS: Final = {"eye_left": 31, "eye_right": 36, "nose": 67, "mouth_left": 48, "mouth_right": 54} | {
    "lip_upper": 51, "lip_lower": 57,
}  # fmt: skip
JAW: Final = 15  # landmarks of the visible outline, which are other places of the head from every side
CAMERAS: Final = "abcde"
EYES_MM: Final = 63.0
SETS: Final = {
    "eyes, nose, corners of the mouth": ("eye_left", "eye_right", "nose", "mouth_left", "mouth_right"),
    "nose, mouth, lips": ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower"),
}


def read(path: Path) -> tuple[Array, Array]:
    """(5, N, 68, 2) points of each camera, nan where not known, and (N,) the number of the person."""
    found: dict[str, list[tuple[str, list[str]]]] = {camera: [] for camera in CAMERAS}
    with path.open(newline="") as file:
        for row in csv.reader(file):
            if row[0][:1] == "i" and row[0][1:4].isdigit():  # not the mirror images
                found[row[0][5]].append((row[0][:5] + row[0][6:], row[2:]))
    ordered = [sorted(found[camera]) for camera in CAMERAS]
    points = np.array([[numbers for _, numbers in those] for those in ordered], dtype=np.float64)
    points = points.reshape(*points.shape[:2], -1, 2)
    points[(points == 0).all(axis=3)] = np.nan
    return points, np.array([int(name[1:4]) for name, _ in ordered[0]])


def factorized(points: Array) -> tuple[Array, Array]:
    """The mean face (L, 3) in mm, in the axes of SHAPE, and (5, 3) pitch, yaw, roll of the cameras in degrees.

    Tomasi & Kanade 1992, section 3.4: rows of the motion matrix have the same length in a camera, and are orthogonal.
    """
    seen = np.nanmean(points, axis=1)[:, JAW:]
    measured = (seen - seen.mean(axis=1, keepdims=True)).swapaxes(1, 2).reshape(2 * len(CAMERAS), -1)
    u, s, v = np.linalg.svd(measured, full_matrices=False)
    motion, shape = u[:, :3] * s[:3], v[:3]

    def products(i: int, j: int) -> Array:
        outer = np.outer(motion[i], motion[j])
        both = outer + outer.T
        return np.array([outer[0, 0], both[0, 1], both[0, 2], outer[1, 1], both[1, 2], outer[2, 2]])

    pairs = [(2 * f, 2 * f + 1) for f in range(len(CAMERAS))]
    rows = [row for i, j in pairs for row in (products(i, i) - products(j, j), products(i, j))]
    q = np.linalg.lstsq(np.array([*rows, products(0, 0)]), np.eye(len(rows) + 1)[-1], rcond=None)[0]
    metric = np.linalg.cholesky(np.array([[q[0], q[1], q[2]], [q[1], q[3], q[4]], [q[2], q[4], q[5]]]))
    motion, shape = motion @ metric, np.linalg.solve(metric, shape)
    at = {name: shape[:, number - JAW] for name, number in LANDMARKS.items()}
    across = at["eye_right"] - at["eye_left"]
    down = (at["mouth_left"] + at["mouth_right"] - at["eye_left"] - at["eye_right"]) / 2
    x = across / np.linalg.norm(across)
    y = down - (down @ x) * x
    y /= np.linalg.norm(y)
    axes = np.stack([x, y, np.cross(x, y)])
    if axes[2] @ (at["nose"] - (at["eye_left"] + at["eye_right"]) / 2) > 0:  # the nose is nearer to the camera
        axes[2] *= -1
    shape = axes @ (shape - ((at["eye_left"] + at["eye_right"]) / 2)[:, None]) * EYES_MM / np.linalg.norm(across)
    first = (motion @ axes.T).reshape(-1, 2, 3)
    first /= np.linalg.norm(first, axis=2, keepdims=True)
    rotation = np.concatenate([first, np.cross(first[:, :1], first[:, 1:])], axis=1)
    return shape.T, np.degrees(euler(rotation))


def spread(points: Array, shape: Array) -> dict[str, Array]:
    """(3,) standard deviations over people of each landmark, in mm: those of its place by least squares over cameras.

    The scatter about that place, as of the landmarks themselves, is taken off.
    """
    axes, offs = [], []
    for seen in points[:, :, JAW:]:
        cov = np.broadcast_to(np.eye(2), (*seen.shape, 2))
        angles, _, scale, origin, *_ = fit_pose(
            seen, cov, np.isfinite(seen).all(axis=2), shape, np.full(shape.shape, 3.0)
        )
        axes.append(rotation_of(np.radians(angles))[:, :2])
        offs.append((seen - origin[:, None]) / scale[:, None, None] - np.einsum("tij,kj->tki", axes[-1], shape))
    towards, found = np.concatenate(axes, axis=1), {}
    for name, number in LANDMARKS.items():
        off = np.concatenate([one[:, number - JAW] for one in offs], axis=1)
        known = np.isfinite(off).all(axis=1)
        normal = np.einsum("tia,tib->tab", towards[known], towards[known])
        slope = np.einsum("tia,ti->ta", towards[known], off[known])
        place = np.linalg.solve(normal, slope[..., None])[..., 0]
        noise = (off[known] - np.einsum("tia,ta->ti", towards[known], place)).var()
        own = place.var(axis=0) - noise * np.diag(np.linalg.inv(normal).mean(axis=0))
        found[name] = np.sqrt(np.maximum(own, 0))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("landmarks", type=Path)
    points, person = read(parser.parse_args().landmarks)
    shape, cameras = factorized(points)
    deviations = spread(points[:, person % 2 == 0], shape)
    print("| point | shape, mm | of people, mm |\n|---|---|---|")
    for name, number in LANDMARKS.items():
        of = (" ".join(f"{value:.1f}" for value in those) for those in (shape[number - JAW], deviations[name]))
        print(f"| {name} | {' | '.join(of)} |")
    others = points[:, person % 2 == 1]
    for title, names in SETS.items():
        face, wide = (np.array([table[name] for name in names]) for table in (SHAPE, SPREAD))
        seen = others[:, :, [LANDMARKS[name] for name in names]]
        cov = np.broadcast_to(np.eye(2), (*seen.shape[1:], 2))
        angles = np.stack([fit_pose(one, cov, np.isfinite(one).all(axis=2), face, wide)[0] for one in seen])
        print(f"\n| {title}: {angles.shape[1]} moments | pitch | yaw | roll | all landmarks |\n|---|---|---|---|---|")
        for i, camera in enumerate(CAMERAS[1:], 1):
            off = angles[i] - angles[0]
            cells = (f"{mean:.1f} ± {std:.1f}" for mean, std in zip(np.nanmean(off, 0), np.nanstd(off, 0), strict=True))
            known = " ".join(f"{value:.1f}" for value in cameras[i] - cameras[0])
            print(f"| {camera} - a | {' | '.join(cells)} | {known} |")


if __name__ == "__main__":
    main()
