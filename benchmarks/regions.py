"""Errors of region recipes, by target and by span of the clip: tables of docs/results.md, "Regions".

    python benchmarks/regions.py sample_videos/hands.mp4 --particles 100 --particles 200 --span 0-139 --span 0-249 \
        --config histogram --config histogram_correlation --figure docs/regions-hands.png
    python benchmarks/regions.py sample_videos/turning.mp4 sample_videos/textured.mp4 --config contour --trust

Recipes are named as for `facetrack compare`, which has success, precision and failures too, but no pixels and no spans.
The seeds are 0 on; frames of a span are both included. Of each target and span:

    error    mean distance of the centres in pixels over all frames with a true box, and its standard deviation of seeds
    AUC      success AUC, as OTB has it, of visible rows
    off      runs that leave the target, IoU below 0.1 for 5 rows on end, and the median of the frames when they do
    failed   runs that end the span lost: the median IoU over the last tenth of its rows is below 0.1

--figure draws the error over time, averaged over the runs (figure 7 of Odobez et al. 2003).
--trust prints instead, of the visible rows of all clips but the first frames: those *off* (IoU below 0.1), how many of
these are called lost, the rows *on* (IoU above 0.5) called lost, and AUROC, the chance that a row that is on has more
confidence than one that is off.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from accuracy import paired

from facetrack_cli.core.errors import FacetrackError
from facetrack_cli.core.geometry import iou
from facetrack_cli.core.types import Array, Start, TargetStart
from facetrack_cli.evaluation.boxes import centre_errors, measure_boxes
from facetrack_cli.evaluation.compare import TAIL_IOU, default_truth, tail_overlap
from facetrack_cli.evaluation.reliability import auroc
from facetrack_cli.evaluation.rows import Pair
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.runs.plan import ClipRequest
from facetrack_cli.runs.seeds import SeedPlan, variant
from facetrack_cli.trajectory.formats.read import read_truth
from facetrack_cli.trajectory.trajectory import Trajectory

Span = tuple[int, int]
AWAY = 5  # rows


@dataclass(frozen=True)
class Case:
    """A recipe with so many particles, and its pairs with the ground truth, a list a seed."""

    label: str
    particles: int
    seeds: list[list[Pair]]


def cases(clip: Path, given: argparse.Namespace) -> Iterator[Case]:
    """Every recipe with every number of particles, all its seeds run."""
    truth = read_truth(given.truth or default_truth(clip))
    plans, particles = [], {}
    for config, count in itertools.product(given.config, given.particles):
        name, overrides = variant(config)
        label = f"{config} {count}"
        recipe: Recipe = load_recipe(name, [*overrides, *given.overrides, f"filter.particles={count}"])
        if given.start is None:
            start = ClipRequest(clip, init=given.init).find(recipe, truth)
        else:
            start = true_start(truth, given.start)
        plans.append(SeedPlan(label, clip, recipe, start, tuple(range(given.seeds))))
        particles[label] = config, count
    for label, _, seeds in paired(plans, truth, given.jobs, partial=given.partial):
        yield Case(*particles[label], seeds)


def true_start(truth: Trajectory, frame: int) -> Start:
    """The true boxes of a frame."""
    found = {}
    for one in truth.parts:
        ((left, top, width, height),) = one.boxes[one.frame == frame].tolist()
        found[one.target] = TargetStart(box=(left, top, width, height))
    return Start(frame, found, "the truth")


def in_span(pair: Pair, span: Span | None) -> Pair:
    if span is None:
        return pair
    rows = (pair.ours.frame >= span[0]) & (pair.ours.frame <= span[1])
    return Pair(pair.ours.take(rows), pair.truth.take(rows))


def measured(pairs: Sequence[Pair]) -> tuple[Array, Array, list[int], int]:
    """Of one target, one pair a seed: mean errors (S,), success AUC (S,), frames of leaving, how many end lost."""
    errors, auc, off, failed = [], [], [], 0
    for pair in pairs:
        ours, truth = pair.ours.boxes, pair.truth.boxes
        errors.append(np.nanmean(centre_errors(ours, truth)))
        seen = pair.truth.status != "hidden"
        found = measure_boxes(ours, truth, visible=seen, init=pair.ours.status == "init")
        auc.append(found.success_auc)
        away = np.convolve(found.overlap < TAIL_IOU, np.ones(AWAY), "valid") == AWAY
        if away.any():
            off.append(int(pair.ours.frame[away.argmax()]))
        tail = tail_overlap(found.overlap)
        failed += tail is not None and tail < TAIL_IOU
    return np.array(errors), np.array(auc), off, failed


def table(done: Sequence[Case], spans: Sequence[Span | None]) -> None:
    names = [f"frames {s[0]}-{s[1]}" if s else "all frames" for s in spans]
    print("| target | recipe | particles | " + " | ".join(f"{n}: error | AUC | off | failed" for n in names) + " |")
    print("|---" * (3 + 4 * len(spans)) + "|")
    for target in range(len(done[0].seeds[0])):
        for case in done:
            cells = [case.seeds[0][target].ours.target, case.label, f"{case.particles}"]
            for span in spans:
                errors, auc, off, failed = measured([in_span(pairs[target], span) for pairs in case.seeds])
                spread = np.std(errors, ddof=1) if len(errors) > 1 else 0.0
                left = f"{len(off)}/{len(errors)}" + (f" at {np.median(off):.0f}" if off else "")
                cells += [f"{errors.mean():.1f} ± {spread:.1f}", f"{auc.mean():.3f}", left, f"{failed}/{len(errors)}"]
            print(f"| {' | '.join(cells)} |", flush=True)


def trust(label: str, pairs: Sequence[Pair]) -> None:
    """A row over all rows of all pairs."""
    overlap, lost, confidence = [], [], []
    for pair in pairs:
        told = (pair.ours.status != "init") & (pair.truth.status != "hidden") & np.isfinite(pair.truth.w)
        overlap.append(iou(pair.ours.boxes, pair.truth.boxes)[told])
        lost.append((pair.ours.status == "lost")[told])
        confidence.append(pair.ours.confidence[told])
    of, said, sure = (np.concatenate(values) for values in (overlap, lost, confidence))
    off, on = of < 0.1, of > 0.5
    called = said[off].mean() if off.any() else np.nan
    worth = auroc(sure[on | off], on[on | off])
    quiet = (off & ~said).mean()
    print(
        f"| {label} | {100 * off.mean():.1f} % | {100 * called:.0f} % | {100 * quiet:.1f} % "
        f"| {100 * said[on].mean():.1f} % | {np.nan if worth is None else worth:.2f} |",
        flush=True,
    )


def figure(done: Sequence[Case], names: Mapping[str, str], out: Path, clip: Path) -> None:
    """The error over time, mean over the runs: a row of panels a target, a column a number of particles."""
    from facetrack_cli.report.figures.style import heading, line_style, new_figure, render, style

    counts = sorted({case.particles for case in done})
    labels = list(dict.fromkeys(case.label for case in done))
    targets = [pair.ours.target for pair in done[0].seeds[0]]
    with style():
        drawn = new_figure(4.7 * len(counts), 2.3 * len(targets) + 0.5)
        axes = drawn.subplots(len(targets), len(counts), sharex=True, sharey=True, squeeze=False)
        for (t, target), (c, count) in itertools.product(enumerate(targets), enumerate(counts)):
            one = axes[t, c]
            for case in (case for case in done if case.particles == count):
                pairs = [pairs[t] for pairs in case.seeds]
                errors = np.mean([centre_errors(pair.ours.boxes, pair.truth.boxes) for pair in pairs], axis=0)
                look = line_style(labels.index(case.label))
                label = names.get(case.label, case.label) if t == c == 0 else None
                one.plot(pairs[0].ours.frame, errors, linewidth=1.5, label=label, **look)
            heading(one, f"{target.replace('_', ' ')}, {count} particles", "")
            one.set_ylim(bottom=0)
            one.margins(x=0)
            if t == len(targets) - 1:
                one.set_xlabel(f"frame of {clip.name}")
            if c == 0:
                one.set_ylabel("error (px)")
        drawn.legend(loc="outside lower center", ncols=len(labels), handlelength=2.8)
        out.write_bytes(render(drawn))


def span_of(text: str) -> Span:
    first, _, last = text.partition("-")
    return int(first), int(last)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="+", type=Path)
    parser.add_argument("--config", action="append", required=True)
    parser.add_argument("--set", dest="overrides", action="append", default=[])
    parser.add_argument("--particles", action="append", type=int)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--span", action="append", type=span_of, help="FIRST-LAST; repeat (default: all frames)")
    parser.add_argument("--start", type=int, metavar="FRAME", help="begin there, with the true boxes")
    parser.add_argument("--truth", type=Path)
    parser.add_argument("--init", type=Path)
    parser.add_argument("--partial", action="store_true", help="measure the frames that both have")
    parser.add_argument("--trust", action="store_true")
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--name", action="append", default=[], help="RECIPE>NAME in the figure's legend")
    parser.add_argument("-j", dest="jobs", type=int, default=2)
    given = parser.parse_args()
    given.particles = given.particles or [200]
    pooled: dict[str, list[Pair]] = {}
    for clip in given.clips:
        done = list(cases(clip, given))
        for case in done:
            pooled.setdefault(case.label, []).extend(pair for pairs in case.seeds for pair in pairs)
        if not given.trust:
            print(f"\n{clip.stem}: {given.seeds} seeds\n")
            table(done, given.span or [None])
        if given.figure:
            figure(done, dict(text.split(">", 1) for text in given.name), given.figure, clip)
    if given.trust:
        print("| recipe | off | of these called lost | off and not called lost | of those on called lost | AUROC |")
        print("|---|---|---|---|---|---|")
        for label, pairs in pooled.items():
            trust(label, pairs)


if __name__ == "__main__":
    try:
        main()
    except FacetrackError as e:
        raise SystemExit(str(e)) from None
