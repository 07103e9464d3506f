"""Fit the log odds that two tracks show one person: SENSES of facetrack_cli/trackers/people/descriptor.py.

    python tools/same_person.py CLIP... [--tracks 14] --keep views.npz
    python tools/same_person.py views.npz...

Each CLIP, a file or a folder of images, shows one person, whose name is that of the file. Tracks are cut out of it at
random. What the frames of a track show is changed as films do: small, blurred, turned, dark or in coloured light,
partly covered, with other clothes and ground. The views of tracks of real films may be added: files of `save_people`
with the names PERSON/TRACK. Needs SciPy.

Pairs of tracks are told apart by logistic regressions, one for each sense. Pairs of one person and of two weigh alike,
each person does, and so do pairs of clear faces and of others. Each person is left out once: how often a sense is right
is printed of people whom it was not fitted to.
"""

import argparse
import math
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import minimize  # type: ignore[import-untyped, unused-ignore]

from facetrack_cli.core.geometry import overlap
from facetrack_cli.core.types import Array, Frame, Mask
from facetrack_cli.trackers.face.detectors import detector
from facetrack_cli.trackers.face.stabilized import Similarity, slope
from facetrack_cli.trackers.people.descriptor import (
    VIEWS,
    Describer,
    FaceDescriptor,
    View,
    distances,
    load_people,
    save_people,
    worth_of,
)
from facetrack_cli.video.source import open_source

FRAMES = (30, 70)  # of a track
SURE = (2.0, 1.0, 0.5, 0.0)  # log odds above which a sense is asked how often it is wrong: the first with enough pairs
ENOUGH = 50
CLEAR = 0.85  # what a pair of clear faces is worth at least


class Change:
    """What is done to all frames of a track."""

    def __init__(self, rng: np.random.Generator) -> None:
        def some(share: float, *values: float) -> float:
            return float(rng.choice(values)) if rng.random() < share else 0.0

        self.size, self.blur, self.turn = some(0.4, 22, 32, 45, 70), some(0.25, 0.03, 0.06, 0.1), some(0.3, 12, -20, 28)
        self.light = rng.uniform(0.5, 1.3, 3) if rng.random() < 0.15 else np.ones(3)
        self.dark = float(rng.uniform(0.25, 0.6)) if rng.random() < 0.1 else 1.0
        self.covered, self.side = some(0.3, 0.25, 0.4, 0.6), rng.uniform(0, 2 * math.pi)
        self.clothes = rng.uniform(0.3, 1.6, 3) if rng.random() < 0.15 else np.ones(3)
        self.narrow = some(0.25, 0.8, 0.68) or 1.0

    def made(self, frame: Frame, face: Similarity, rng: np.random.Generator) -> tuple[Frame, Similarity]:
        """The frame around a face, changed, and where the face is in it, about as a tracker would say."""
        size = self.size or min(face.scale, 220.0)
        side, middle = int(4.4 * size), 2.2 * size
        around = Similarity(face.centre, 4.4 * face.scale / side, math.radians(self.turn)).read(frame, side).bgr
        wide = np.array([[self.narrow, 0, middle * (1 - self.narrow)], [0, 1, 0]])
        image: Array = cv2.warpAffine(around, wide, (side, side), borderMode=cv2.BORDER_REPLICATE).astype(np.float64)
        mask = np.zeros((side, side), np.float32)
        cv2.ellipse(mask, (side // 2, side // 2), (int(0.55 * size), int(0.75 * size)), 0, 0, 360, 1, -1)
        head: Array = cv2.GaussianBlur(mask, (0, 0), 0.08 * size + 0.5)[..., None].astype(np.float64)
        image = image * head + np.clip(image * self.clothes, 0, 255) * (1 - head)
        if self.covered:
            skin = np.median(image[side // 2 :, side // 2 - 2 : side // 2 + 3][: max(int(size / 6), 1)], axis=(0, 1))
            off = 0.5 * size * (1.9 - 1.6 * self.covered * rng.uniform(0.6, 1.1))
            at = (int(middle + off * math.cos(self.side)), int(middle + off * math.sin(self.side)))
            hand = cv2.circle(np.zeros((side, side), np.float32), at, int(0.55 * size), 1, -1)[..., None]
            image = image * (1 - hand) + (skin * 0.9 + rng.normal(0, 6, image.shape)) * hand
        image = image * self.light * self.dark + rng.normal(0, 3, image.shape) * (self.dark < 1)
        if self.blur:
            image = np.asarray(cv2.GaussianBlur(image, (0, 0), self.blur * size), np.float64)
        packed = cv2.imencode(".jpg", np.clip(image, 0, 255).astype(np.uint8), (cv2.IMWRITE_JPEG_QUALITY, 88))[1]
        there = np.full(2, (side - 1) / 2) + rng.normal(0, 0.015 * size, 2)
        found = Similarity(there, size * math.exp(rng.normal(0, 0.03)), face.angle - math.radians(self.turn))
        return Frame(frame.index, frame.time_s, np.asarray(cv2.imdecode(packed, 1), np.uint8)), found


def tracks(clip: Path, count: int, rng: np.random.Generator) -> Iterator[FaceDescriptor]:
    """The looks of tracks that are cut out of a clip of one person."""
    look = detector("yunet")
    with open_source(clip) as source:
        total = source.frames_hint or sum(1 for _ in source)
    spans = [(int(rng.integers(total - long + 1)), long) for long in np.minimum(rng.integers(*FRAMES, count), total)]
    views = [np.linspace(first, first + long - 1, VIEWS).astype(int).tolist() for first, long in spans]
    wanted = {k for those in views for k in those}
    with open_source(clip) as source:
        frames = {frame.index: frame for frame in source if frame.index in wanted}
    for those in views:
        change, reader, last = Change(rng), Describer(look), None
        for k in sorted(frames.keys() & those):
            faces = look.find(frames[k])
            face = max(faces, key=lambda one: one.box[2] if last is None else overlap(one.box, last), default=None)
            if face is None or face.eyes is None:
                continue
            last, (x, y, w, _) = face.box, face.box
            at = Similarity(np.array([x + (w - 1) / 2, y + (w - 1) / 2]), w, slope(np.array(face.eyes)))
            changed, there = change.made(frames[k], at, rng)
            reader.see(changed, View(k, there, 1.0))
        if len(reader.scores) >= 3:
            yield reader.looks()


def fitted(x: Array, same: Mask, weight: Array) -> Array:
    """The weights of a logistic regression on x (M, D)."""
    sign = np.where(same, 1.0, -1.0)

    def loss(v: Array) -> tuple[float, Array]:
        odds = sign * (x @ v)
        slope = -weight * sign / (1 + np.exp(np.clip(odds, -50, 50)))
        return float(weight @ np.logaddexp(0, -odds)) + 1e-6 * float(v @ v), x.T @ slope + 2e-6 * v

    return np.asarray(minimize(loss, np.zeros(x.shape[1]), jac=True, method="BFGS").x)


def weights(same: Mask, who: Array, clear: Mask) -> Array:
    """(M,) of pairs of tracks of the people `who` (M, 2)."""
    found = np.zeros(len(same))
    for shown in (clear, ~clear):
        different = shown & ~same
        found[different] = 0.25 / max(different.sum(), 1)
        people = np.unique(who[shown & same])
        for one in people:
            mine = shown & same & (who[:, 0] == one)
            found[mine] = 0.25 / len(people) / mine.sum()
    return found


def trusted(wrong: Mask, odds: Array, weight: Array) -> float:
    """The log odds that a sense is right where it is sure."""
    for sure in SURE:
        asked = odds > sure
        if asked.sum() >= ENOUGH:
            share = max(float(weight[asked & wrong].sum() / weight[asked].sum()), 1 / asked.sum())
            return math.log((1 - share) / share)
    return 0.0


def report(known: Mapping[str, FaceDescriptor]) -> None:
    """Fit and print all senses."""
    names = np.array([name.rpartition("/")[0] for name in known])
    i, j = np.triu_indices(len(names), 1)
    who, same = np.column_stack([names[i], names[j]]), names[i] == names[j]
    worth = np.array([worth_of(one) for one in known.values()])
    clear = np.minimum(worth[i], worth[j]) > CLEAR
    weight, total, bounded = weights(same, who, clear), np.zeros(len(i)), np.zeros(len(i))
    print(f"{len(names)} tracks of {len(set(names))} people, {same.sum()} pairs of one and {(~same).sum()} of two")
    for sense, far in distances(list(known.values())).items():
        x, left = far[:, i, j].T, np.zeros(len(i))
        for one in sorted(set(names)):
            out = (who == one).any(axis=1)
            left[out] = x[out] @ fitted(x[~out], same[~out], weights(same[~out], who[~out], clear[~out]))
        against, speaks_for = trusted(same, -left, weight), trusted(~same, left, weight)
        total, bounded = total + left, bounded + np.clip(left, -against, speaks_for)
        whole = ", ".join(f"{one:.2f}" for one in fitted(x, same, weight))
        right = weight[(left > 0) == same].sum()
        print(f"{sense:10s} {whole}; against {against:.1f}, for {speaks_for:.1f}; right {right:.3f}")
    for name, odds in (("sum", total), ("bounded", bounded)):
        loss = weight @ np.logaddexp(0, -np.where(same, odds, -odds))
        p = 1 / (1 + np.exp(-odds))
        bins = [(p >= lo) & (p < lo + 0.1) for lo in np.arange(0, 1, 0.1)]
        error = sum(abs(float(weight[b] @ (p[b] - same[b]))) for b in bins)
        right = weight[(odds > 0) == same].sum()
        print(f"{name:10s} right {right:.3f}, log loss {loss:.3f}, calibration error {error:.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("clips", nargs="+", type=Path)
    parser.add_argument("--tracks", type=int, default=14)
    parser.add_argument("--keep", type=Path, help="file for what the tracks look like, from which it is fitted again")
    given = parser.parse_args()
    found: dict[str, FaceDescriptor] = {}
    for clip in given.clips:
        if clip.suffix == ".npz":
            found |= load_people(clip)
            continue
        seed = zlib.crc32(clip.stem.encode())
        found |= {
            f"{clip.stem}/{n}": one for n, one in enumerate(tracks(clip, given.tracks, np.random.default_rng(seed)))
        }
    if given.keep:
        save_people(given.keep, found)
    else:
        report(found)


if __name__ == "__main__":
    main()
