"""Faces by skin and template, heads with two hands: tables 1 and 2 of Gonzalez & Collet, for docs/results.md.

    python benchmarks/skin.py                     table 1: a face is covered in three ways
    python benchmarks/skin.py --hands             table 2: a head and two hands that sign
    python benchmarks/skin.py --clips clips       table 1 on real clips, the folders in clips/ that hold a ground truth,
    with
                                                  the options that go beyond the paper

Recipes are named as for `facetrack compare`, the seeds are 0 on; a tracker without chance runs once. A cell is

    good ± spread / strict / good of visible frames (away)

good is the good tracking rate, the share in % of *all* frames with a true box, covered ones too, whose centre lies in
the true box; its mean and standard deviation over seeds. strict asks for half of the box's sides. `facetrack eval`
counts visible frames alone, which is the third number, left out where nothing is hidden. (away): runs whose centre is
outside of the true box in most of the last tenth of the visible frames. The mean is over the clips that no recipe
refuses. For hands, *names aside* takes them in each frame as they fit best. The first row is what no tracker at all
would have: boxes that stay where they begin.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from accuracy import paired

from facetrack_cli.core.errors import FacetrackError, InputError
from facetrack_cli.core.types import Array, Mask
from facetrack_cli.evaluation.boxes import measure_boxes, normalised_errors, within
from facetrack_cli.evaluation.compare import TAIL, default_truth
from facetrack_cli.evaluation.rows import Pair
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.plan import ClipRequest
from facetrack_cli.runs.seeds import SeedPlan, labels, variant
from facetrack_cli.trajectory.formats.read import read_truth

SAMPLES = Path(__file__).parent.parent / "sample_videos"
OCCLUSIONS = tuple(SAMPLES / f"{name}.mp4" for name in ("map", "gestures", "passerby"))
SIGNING = (SAMPLES / "signing.mp4",)
TABLE_1 = ("skin", "skin_ncc", "skin_ncc:likelihood.cost=printed", "ncc", "skin_ncc_robust", "mil")
TABLE_2 = ("head_hands_cloud", "head_hands")
STILL = "boxes that never move"
BEYOND = (
    "skin_ncc_robust:likelihood.ncc.adapt=0.1,likelihood.ncc.adapt_above=0.5",
    "skin_ncc_robust:motion.scale=0.01",
)


class Boxes(NamedTuple):
    """A target's boxes of one run (T, 4), the true ones, which of them are visible, and whether the first was given."""

    ours: Array
    truth: Array
    seen: Mask
    given: bool

    @classmethod
    def of(cls, pair: Pair) -> Boxes:
        seen = pair.truth.status != "hidden"
        return cls(pair.ours.boxes, pair.truth.boxes, seen, bool(pair.ours.status[0] == "init"))


class Rate(NamedTuple):
    """Shares, 0..1, of the frames of one run, `visible` of its visible ones if some are hidden; `away` at the end."""

    good: float
    strict: float
    visible: float | None
    away: bool


def rate(targets: Sequence[Boxes]) -> Rate:
    """The means over some targets; away if one of them is."""
    each = []
    for one in targets:
        init = one.given & (np.arange(len(one.ours)) == 0)
        every = measure_boxes(one.ours, one.truth, init=init)
        visible = measure_boxes(one.ours, one.truth, visible=one.seen, init=init)
        last = within(one.ours, one.truth)[one.seen & np.isfinite(one.truth).all(axis=1)]
        away = last[-max(int(TAIL * len(last)), 1) :].mean() < 0.5
        each.append((every.good_rate, every.strict_rate, visible.good_rate, away))
    good, strict, seen, gone = zip(*each, strict=True)
    hidden = any(not one.seen.all() for one in targets)
    return Rate(float(np.mean(good)), float(np.mean(strict)), float(np.mean(seen)) if hidden else None, any(gone))


def names_aside(a: Boxes, b: Boxes) -> list[Boxes]:
    """Two targets, exchanged in the frames in which both together are nearer to each other's ground truth."""
    straight = normalised_errors(a.ours, a.truth) + normalised_errors(b.ours, b.truth)
    crossed = normalised_errors(b.ours, a.truth) + normalised_errors(a.ours, b.truth)
    swap = (crossed < straight)[:, None]
    return [a._replace(ours=np.where(swap, b.ours, a.ours)), b._replace(ours=np.where(swap, a.ours, b.ours))]


def groups(pairs: Sequence[Pair], *, still: bool = False) -> dict[str, Rate]:
    """What a run is measured by: its only target, or head, hands, and hands whatever their names.

    `still`: as if all boxes had stayed where they began.
    """
    found = {pair.ours.target: Boxes.of(pair) for pair in pairs}
    if still:
        found = {name: one._replace(ours=np.repeat(one.ours[:1], len(one.ours), 0)) for name, one in found.items()}
    if len(found) == 1:
        return {"": rate(list(found.values()))}
    hands = [boxes for name, boxes in found.items() if name != "head"]
    return {
        "head": rate([found["head"]]),
        "hands": rate(hands),
        "hands, names aside": rate(names_aside(*hands)),
    }


def runs_of(clip: Path, config: str, label: str, given: argparse.Namespace) -> list[list[Pair]]:
    """One a seed."""
    truth = read_truth(default_truth(clip))
    name, overrides = variant(config)
    recipe = load_recipe(name, [*overrides, *given.overrides])
    seeds = tuple(range(given.seeds if recipe.random else 1))
    plan = SeedPlan(label, clip, recipe, ClipRequest(clip).find(recipe, truth), seeds)
    ((_, _, pairs),) = paired([plan], truth, given.jobs)
    return pairs


def cell(rates: Sequence[Rate]) -> str:
    good = 100 * np.array([one.good for one in rates])
    text = f"{good.mean():.1f}"
    if len(good) > 1:
        text += f" ± {good.std(ddof=1):.1f}"
    text += f" / {100 * np.mean([one.strict for one in rates]):.1f}"
    visible = [one.visible for one in rates if one.visible is not None]
    if visible:
        text += f" / {100 * np.mean(visible):.1f}"
    away = sum(one.away for one in rates)
    return f"{text} ({away})" if away else text


def real_clips(folder: Path) -> Iterator[Path]:
    """The clip in each folder that has a true box in every frame: its one video, or its images."""
    for truth in sorted(folder.glob("*/groundtruth.csv")):
        videos = [path for path in truth.parent.iterdir() if path.is_file() and path != truth]
        yield videos[0] if videos else truth.parent / "img"


def name_of(clip: Path) -> str:
    return clip.parent.name if clip.name == "img" else clip.stem


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    what = parser.add_mutually_exclusive_group()
    what.add_argument("files", nargs="*", type=Path, default=[], metavar="CLIP", help="default: those of table 1")
    what.add_argument("--hands", action="store_true")
    what.add_argument("--clips", type=Path, metavar="FOLDER")
    parser.add_argument("--config", action="append")
    parser.add_argument("--set", dest="overrides", action="append", default=[])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("-j", dest="jobs", type=int, default=2)
    given = parser.parse_args()
    if given.clips:
        clips, configs = list(real_clips(given.clips)), [*TABLE_1, *BEYOND]
    elif given.hands:
        clips, configs = list(SIGNING), list(TABLE_2)
    else:
        clips, configs = given.files or list(OCCLUSIONS), list(TABLE_1)
    configs = given.config or configs

    found: dict[str, dict[str, list[Rate]]] = {STILL: {}}
    refused: set[str] = set()
    for config, label in zip(configs, labels(configs), strict=True):
        row = found.setdefault(label, {})
        for clip in clips:
            try:
                pairs = runs_of(clip, config, label, given)
            except InputError as e:
                print(e, file=sys.stderr)
                refused.add(name_of(clip))
                continue
            runs, still = [groups(those) for those in pairs], groups(pairs[0], still=True)
            for group in still:
                name = f"{name_of(clip)}: {group}" if group else name_of(clip)
                row[name] = [run[group] for run in runs]
                found[STILL][name] = [still[group]]
            print(f"{label}, {name_of(clip)}: done", file=sys.stderr, flush=True)
    table(found, refused, clips, given.seeds)


def table(found: dict[str, dict[str, list[Rate]]], refused: set[str], clips: Sequence[Path], seeds: int) -> None:
    columns = list(dict.fromkeys(name for row in found.values() for name in row))
    in_mean = [name for name in columns if name not in refused] if len(clips) > 1 else []
    print(f"\n{seeds} seeds\n\n| recipe | {' | '.join(columns)} |{' mean |' if in_mean else ''}")
    print("|---" * (1 + len(columns) + bool(in_mean)) + "|")
    for label, row in found.items():
        cells = [cell(row[name]) if name in row else "refused" for name in columns]
        if in_mean:
            means = np.mean([[np.mean([[r.good, r.strict] for r in row[name]], axis=0)] for name in in_mean], axis=0)
            cells.append(" / ".join(f"{100 * value:.1f}" for value in means[0]))
        print(f"| {label if label == STILL else f'`{label}`'} | {' | '.join(cells)} |")


if __name__ == "__main__":
    try:
        main()
    except FacetrackError as e:
        raise SystemExit(str(e)) from None
