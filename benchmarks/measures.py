"""How well measures and events of faces agree with MediaPipe's points, by person: the tables of docs/results.md.

    python benchmarks/measures.py --regressions left_out --networks models --picture docs/measures.png
    python benchmarks/measures.py --false-events

Clips are those of $FACETRACK_CLIPS (../shared/clips) in `people/`, each with mesh.csv (frame, part, x, y, unit) and
eyes.csv (frame, opening_left, opening_right); where they are absent it says so. `--regressions` is a folder of
regressions that have not seen a person: without_NAME.npz by `tools/mouth_descent.py --without NAME`, and
eyes_without_NAME.npz by `tools/eye_descent.py`. `--networks` is the folder of `facetrack models get mesh`: then all is
measured a second time, with it.

    opening, width, eyes   correlation over frames of the distance of the outer lips, of that of the corners of the
                           mouth and of the opening of the eyes, times the share of frames that have it
    changes                share of changes of these between two frames, drawn at random, within 1.645 times the noise
    recall, precision      of mouths that open, smiles, blinks: of events in the reference the share that is found, of
                           events found the share in the reference. They agree if they overlap, or are 2 frames apart
    error                  expected calibration error of the probabilities of all events, ten bins

What an event is in the reference:

    open    the distance of the outer lips is above its level at rest, the 10 % quantile of the clip, by .10 eye
            distances in 3 frames or more; widened to where it passes .05
    smile   the same of the running median over 31 frames of the distance of the corners, by .10 and .05, 15 frames
    blink   the opening is below half of its running median over 61 frames; widened to where it passes .75; 15 frames
            at most

`--false-events` makes ten minutes from a frame of each person with a shut mouth, in which nothing is done: 25 s at
rest, 25 s turned and moved, 25 s covered by a board every four seconds. Every event of a face is false.
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from boxes import clip_in
from reference import EYES, MESH, openings_in, points_in, take_regression

from facetrack_cli.core.models import VARIABLE
from facetrack_cli.core.numbers import spans
from facetrack_cli.core.types import Array, Image, Mask
from facetrack_cli.evaluation.accuracy import calibration_error
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.api import track_frames, track_video
from facetrack_cli.trajectory.measures import Measured
from facetrack_cli.trajectory.trajectory import Collector, Trajectory
from facetrack_cli.video.source import open_source

MEASURES: Final = {"opening": "mouth_opening", "width": "mouth_width", "eyes": "eye_opening"}
KINDS: Final = {"open": "mouth", "smile": "smile", "blink": "blinks"}
NEAR, PAIRS, RATE, HEIGHT = 2, 4000, 25, 360  # frames, changes, frames a second, pixels
Spans = list[tuple[int, int]]


class Found(NamedTuple):
    """Of one clip: correlations and coverages by measure; of each kind recalled, in all, right, found; of each event
    found its probability and whether it is right.
    """

    alike: dict[str, float]
    covered: dict[str, float]
    counts: dict[str, tuple[int, int, int, int]]
    sure: list[tuple[float, bool]]


def running(value: Array, reach: int) -> Array:
    """(T,) the median over `reach` frames before and after."""
    return np.array([np.median(value[max(i - reach, 0) : i + reach + 1]) for i in range(len(value))])


def widened(core: Mask, wide: Mask) -> Spans:
    """Spans of `wide` that hold some of `core`, both ends included."""
    return [(a, b - 1) for a, b in spans(wide | core) if core[a:b].any()]


def openings(value: Array) -> Spans:
    above = value - np.quantile(value, 0.1)
    return [one for one in widened(above > 0.1, above > 0.05) if np.sum(above[one[0] : one[1] + 1] > 0.1) >= 3]


def smiles(value: Array) -> Spans:
    held = running(value, 15)
    above = held - np.quantile(held, 0.1)
    return [(a, b) for a, b in widened(above > 0.1, above > 0.05) if b - a + 1 >= 15]


def blinks(value: Array) -> Spans:
    usual = running(value, 30)
    return [(a, b) for a, b in widened(value < 0.5 * usual, value < 0.75 * usual) if b - a + 1 <= 15]


def reference(clip: Path) -> dict[str, tuple[Array, Array]]:
    """The frames and values of each measure in the reference."""
    points = points_in(clip / MESH)
    frames = np.array(sorted(points))

    def apart(one: str, other: str) -> Array:
        at = np.array([[points[t][one], points[t][other]] for t in frames.tolist()])
        return np.asarray(np.hypot(*(at[:, 0] - at[:, 1]).T[:2]) / at[:, 0, 2])

    lids = openings_in(clip / EYES)
    return {
        "opening": (frames, apart("lip_upper", "lip_lower")),
        "width": (frames, apart("mouth_left", "mouth_right")),
        "eyes": (np.array(lids[0]), lids[1]),
    }


def compared(one: Measured | None, frames: Array, true: Array) -> tuple[float, float]:
    """Correlation times the share of frames, and the share of changes within their interval."""
    if one is None:
        return 0.0, float("nan")
    rows = np.searchsorted(one.frame, frames)
    value, noise = one.value[rows], one.noise[rows]
    seen = np.isfinite(value)
    off, noise = (value - true)[seen], noise[seen]
    a, b = np.random.default_rng(0).integers(0, len(off), (2, PAIRS))
    within = np.abs(off[a] - off[b]) <= 1.645 * np.hypot(noise[a], noise[b])
    return float(np.corrcoef(value[seen], true[seen])[0, 1] * seen.mean()), float(within.mean())


def measure(clip: Path, regressions: Path | None, networks: Path | None, seed: int) -> Found:
    cv2.setNumThreads(1)
    os.environ[VARIABLE] = str(networks or clip / "none")
    take_regression(regressions, clip.name)
    ours = track_video(clip_in(clip), load_recipe("face"), seed=seed)
    true, mine = reference(clip), ours.measures["face"]
    both = {name: compared(mine.get(MEASURES[name]), *at) for name, at in true.items()}
    labels = {"open": openings(true["opening"][1]), "smile": smiles(true["width"][1]), "blink": blinks(true["eyes"][1])}
    counts, sure = {}, []
    for (name, wanted), frames in zip(labels.items(), [at for at, _ in true.values()], strict=True):
        real = [(int(frames[a]), int(frames[b])) for a, b in wanted]
        got = [one for one in ours.events if one.tier == KINDS[name] and one.value == name]
        told = [(one.first_frame, one.last_frame) for one in got]
        right = [any(near(one, other) for other in real) for one in told]
        counts[name] = (sum(any(near(one, other) for other in told) for one in real), len(real), sum(right), len(told))
        sure += [(one.probability, ok) for one, ok in zip(got, right, strict=True)]
    alike, covered = ({name: pair[i] for name, pair in both.items()} for i in (0, 1))
    return Found(alike, covered, counts, sure)


def near(one: tuple[int, int], other: tuple[int, int]) -> bool:
    return one[0] - NEAR <= other[1] and other[0] - NEAR <= one[1]


def table(title: str, people: Mapping[str, Sequence[Found]]) -> str:
    """A line for each person over all seeds, and one for all together."""
    heads = ["", *MEASURES, "changes", *(f"{name}: {what}" for name in KINDS for what in ("recall", "precision"))]
    lines = [f"\n**{title}**\n", f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    every = [one for runs in people.values() for one in runs]
    for name, runs in (*people.items(), ("all", every)):
        means = [f"{np.mean([one.alike[key] for one in runs]):.2f}" for key in MEASURES]
        covered = f"{np.nanmean([share for one in runs for share in one.covered.values()]):.2f}"
        cells = []
        for kind in KINDS:
            hit, real, right, found = np.sum([one.counts[kind] for one in runs], axis=0).tolist()
            cells += [f"{hit} of {real}" if real else "–", f"{right} of {found}" if found else "–"]
            if name == "all":
                cells[-2:] = [f"{hit / max(real, 1):.2f}", f"{right / max(found, 1):.2f}"]
        lines.append(f"| {name} | {' | '.join([*means, covered, *cells])} |")
    sure = np.array([pair for one in every for pair in one.sure], float).reshape(-1, 2)
    error = calibration_error(sure[:, 0], sure[:, 1] > 0)
    lines.append(f"\nerror {error:.3f} of {len(sure)} events; changes within 90 % by measure: ")
    lines[-1] += ", ".join(f"{key} {np.nanmean([one.covered[key] for one in every]):.2f}" for key in MEASURES)
    return "\n".join(lines)


def picture(path: Path, known: Mapping[str, Mapping[str, Sequence[Found]]]) -> None:
    """Correlations by person, a panel a measure, without and with networks."""
    from facetrack_cli.report.figures import style

    with style.style():
        figure = style.new_figure(8, 2.6)
        for axes, (key, name) in zip(figure.subplots(1, len(MEASURES), sharey=True), MEASURES.items(), strict=True):
            for k, (title, people) in enumerate(known.items()):
                values = [np.mean([one.alike[key] for one in runs]) for runs in people.values()]
                at = np.arange(len(values)) + 0.38 * k - 0.19 * (len(known) - 1)
                axes.bar(at, values, width=0.36, color=style.COLOURS[k], label=title)
            axes.set(ylim=(0, 1), xticks=range(len(values)), xticklabels=[one[-1] for one in people], xlabel="person")
            style.heading(axes, name.replace("_", " "))
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8)
        path.write_bytes(style.render(figure, path.suffix[1:]))


def still(image: Image, box: tuple[float, float, float, float], rng: np.random.Generator) -> Iterator[Image]:
    """75 s of one picture: at rest, turned and moved, covered now and then."""
    (height, width), (x, y, w, h) = image.shape[:2], box
    centre = np.array([x + w / 2, y + h / 2])
    board = cv2.resize(rng.integers(0, 255, (8, 8, 3)).astype(np.uint8), (int(0.8 * w), int(0.9 * h)))
    phase = rng.uniform(0, 2 * np.pi, 6)
    for t in range(75 * RATE):
        s, part = t / RATE, t // (25 * RATE)
        swing = (0.1, 1.0, 0.2)[part] * np.sin(np.array([0.7, 0.3, 0.5, 0.9, 1.1, 0.8]) * s + phase)
        moved = np.eye(3)
        moved[:2] = cv2.getRotationMatrix2D(tuple(centre.tolist()), 10 * swing[0], 1 + 0.1 * swing[1])
        moved[:2, 2] += 0.25 * w * swing[2:4] * (1, 0.5)
        yaw, pitch = 0.4 * swing[4], 0.25 * swing[5]
        turned = np.diag([np.cos(yaw), np.cos(pitch), 1.0])
        turned[2, :2] = 0.3 * np.sin([yaw, pitch]) / w
        there, back = np.eye(3), np.eye(3)
        there[:2, 2], back[:2, 2] = -centre, centre
        frame = cv2.warpPerspective(
            image, moved @ back @ turned @ there, (width, height), borderMode=cv2.BORDER_REFLECT
        )
        if part == 2 and (across := (s % 4) / 1.5) < 1:
            left, top = int(x - w + 2.2 * across * w), int(y + 0.25 * h)
            into = frame[max(top, 0) : top + board.shape[0], max(left, 0) : max(left + board.shape[1], 0)]
            into[:] = board[max(-top, 0) :, max(-left, 0) :][: into.shape[0], : into.shape[1]]
        light = 1 + 0.05 * np.sin(0.4 * s)
        yield np.clip(frame * light + rng.normal(0, 3, frame.shape), 0, 255).astype(np.uint8)


def at_rest(clip: Path, networks: Path | None) -> Trajectory:
    """The track of a picture of somebody with a shut mouth."""
    cv2.setNumThreads(1)
    os.environ[VARIABLE] = str(networks or clip / "none")
    points, (frames, value) = points_in(clip / MESH), reference(clip)["opening"]
    shut = int(frames[np.argmin(np.abs(value - np.quantile(value, 0.1)))])
    with open_source(clip_in(clip)) as source:
        image = next(frame.bgr for frame in source if frame.index == shut)
    scale = min(1.0, HEIGHT / min(image.shape[:2]))
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    at = np.array([*points[shut].values()])
    unit, (x, y) = float(at[0, 2]) * scale, at[:, :2].mean(axis=0) * scale
    box = (x - 1.4 * unit, y - 1.9 * unit, 2.8 * unit, 3.2 * unit)
    rng, found = np.random.default_rng(sum(clip.name.encode())), Collector()
    for result in track_frames(still(np.asarray(small, np.uint8), box, rng), load_recipe("face"), fps=RATE):
        found.add(result.rows)
    return found.trajectory()


def false_events(clip: Path, networks: Path | None) -> list[tuple[str, str, int, int, float]]:
    rows = [
        (e.tier, e.value, e.first_frame, e.last_frame, round(e.probability, 2)) for e in at_rest(clip, networks).events
    ]
    return [(clip.name, *row[1:]) for row in rows]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=Path, default=Path(os.environ.get("FACETRACK_CLIPS", "../shared/clips")))
    parser.add_argument("--regressions", type=Path)
    parser.add_argument("--networks", type=Path)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--false-events", action="store_true")
    parser.add_argument("-j", "--jobs", type=int, default=2)
    args = parser.parse_args()
    clips = sorted(path.parent for path in args.clips.glob(f"people/*/{EYES}"))
    if not clips:
        print(f"{args.clips}: has no people; nothing is measured")
        return
    known: dict[str, dict[str, Any]] = {}
    with ProcessPoolExecutor(args.jobs) as pool:
        for title, networks in {"without networks": None, "with networks": args.networks}.items():
            if networks is None and title == "with networks":
                continue
            if args.false_events:
                events = [one for found in pool.map(false_events, clips, [networks] * len(clips)) for one in found]
                by_value = dict(Counter(value for _, value, *_ in events))
                print(
                    f"{title}: {len(events)} events in {75 * len(clips) / 60:.0f} min of nothing, {by_value}: {events}"
                )
                continue
            jobs = list(product(clips, [args.regressions], [networks], range(args.seeds)))
            found = list(pool.map(measure, *zip(*jobs, strict=True)))
            by = {clip.name: found[i * args.seeds : (i + 1) * args.seeds] for i, clip in enumerate(clips)}
            known[title] = by
            print(table(title, by), flush=True)
    if args.picture and known:
        picture(args.picture, known)


if __name__ == "__main__":
    main()
