"""What a search of settings found: a table for people, JSON for programs, and the recipe with the best setting."""

import math
from collections.abc import Sequence
from typing import Any, Final

from facetrack_cli.core.numbers import document
from facetrack_cli.core.types import Array
from facetrack_cli.core.yaml_tree import rewritten
from facetrack_cli.evaluation.experiments.compare_text import TITLES
from facetrack_cli.evaluation.experiments.sheet import NO_FIGURE, Sheet, clip_name, rounded
from facetrack_cli.evaluation.experiments.tune import EVIDENCE, Range, Setting, Tuning, less_is_better
from facetrack_cli.recipe.files import read_recipe
from facetrack_cli.recipe.model import to_dict

_TITLES: Final = {**TITLES, EVIDENCE: ("evidence,\nnats a frame", 1, 2)}


def sheet(found: Tuning) -> Sheet:
    """A row for each held-out clip; the last note says whether the gain is larger than the spread."""
    title, factor, decimals = _TITLES.get(found.measure, (found.measure, 1, 3))
    only = len(found.clips) == 1

    def figure(values: Array) -> str:
        text = f"{factor * values.mean():.{decimals}f}"
        return text if len(values) < 2 else f"{text} ± {factor * values.std(ddof=1):.{decimals}f}"

    rows: list[tuple[str, ...]] = [
        (
            clip_name(fold.clip),
            ", ".join(fold.setting.values) or "as it is",
            figure(fold.before),
            figure(fold.after),
            f"{factor * fold.gain.mean():+.{decimals}f}",
        )
        for fold in found.folds
    ]
    mean = f"{factor * found.gain[0]:+.{decimals}f}"
    rows.append(("mean", "", *(f"{factor * _mean(found, after):.{decimals}f}" for after in (False, True)), mean))
    heads = "clip" if only else "held-out clip", "chosen on it" if only else "chosen on\nthe others"
    keys = ", ".join(one.key for one in found.ranges)
    return Sheet(
        f"{found.recipe.name}: {keys} by {' '.join(title.split())} on {len(found.clips)} clip{'s' * (not only)}",
        (*heads, "recipe\nas it is", "tuned", "gain"),
        tuple(rows),
        tuple(notes(found)),
        left=(0, 1),
    )


def notes(found: Tuning) -> list[str]:
    """What one must know to read the table, how far folds differ, and whether the gain is larger than the spread."""
    seeds = found.settings[0].scores.shape[1]
    better = "less" if less_is_better(found.measure) else "more"
    over = f"Mean ± standard deviation over {seeds} seeds" if seeds > 1 else "One run each"
    lines = [f"{over} of {found.measure}, {better} is better; of gains, more is."]
    if not found.complete:
        lines.append(f"Interrupted after {found.trials} of {found.search.trials} trials.")
    if len(found.clips) > 1:
        lines.append(
            f"{len(found.settings) - 1} settings and the recipe as it is ran on all clips; each clip is measured with "
            "what is best on the others. Trials were proposed by the mean over all clips."
        )
    best = found.best()
    for i, one in enumerate(found.ranges):
        chosen = [_value(found, fold.setting, i) for fold in found.folds]
        differ = _over(one, chosen) if len(found.clips) > 1 else ""
        was = _shipped(found, one.key)
        lines.append(f"{one.key}: {differ}{_value(found, best, i)} by all clips; {was} in the recipe as it is.")
    if found.refused:
        more = f" (and {len(found.refused) - 1} more reasons)" if len(found.refused) > 1 else ""
        lines.append(f"Settings that could not run: {found.refused[0]}{more}")
    if found.measure == EVIDENCE:
        lines.append(
            "Evidence compares settings of motion, filter and prior; not those of a likelihood whose density is not "
            "normalised, which grows with what it calls likely."
        )
    return [*lines, verdict(found)]


def verdict(found: Tuning) -> str:
    """Whether the gain is larger than the spread, in a sentence."""
    gain, reach = found.gain
    _, factor, decimals = _TITLES.get(found.measure, ("", 1, 3))
    said = f"{factor * gain:+.{decimals}f} ± {factor * reach:.{decimals}f} (2 standard errors)"
    if not math.isfinite(reach):
        return f"The gain is {factor * gain:+.{decimals}f}; one seed tells nothing of its spread, give --seeds."
    larger = gain > reach
    if len(found.clips) == 1:
        over = "larger" if larger else "not larger"
        return (
            f"No clip was held out: the gain of {said} is {over} than the spread of the seeds, but it is on the clip "
            "that the setting was chosen on, which flatters it. Give more clips."
        )
    on = sum(fold.gain.mean() > 0 for fold in found.folds)
    where = f"on {on} of {len(found.clips)} held-out clips it is better"
    if larger:
        return f"The gain of {said} is larger than the spread: {where}."
    return f"The gain of {said} is not larger than the spread: {where}. Keep the recipe as it is, or give more clips."


def as_json(found: Tuning) -> str:
    """Everything, with every setting's values, and the recipe as it is in full."""
    gain, reach = found.gain
    fields = {
        "recipe": found.recipe.name,
        "clips": list(map(str, found.clips)),
        "measure": found.measure,
        "less_is_better": less_is_better(found.measure),
        "seeds": found.settings[0].scores.shape[1],
        "trials": found.trials,
        "seed": found.search.seed,
        "complete": found.complete,
        "best": _named(found, found.best()),
        "gain": rounded(gain, 6),
        "spread": rounded(reach, 6),
        "larger_than_spread": gain > reach,
        "held_out": len(found.clips) > 1,
        "folds": [
            {
                "clip": str(fold.clip),
                "chosen": _named(found, fold.setting),
                "before": [rounded(value, 6) for value in fold.before.tolist()],
                "after": [rounded(value, 6) for value in fold.after.tolist()],
            }
            for fold in found.folds
        ],
        "settings": [
            {"values": _named(found, one), "scores": [[rounded(v, 6) for v in row] for row in one.scores.tolist()]}
            for one in found.settings
        ],
        "refused": found.refused,
        "warnings": found.warnings,
        "notes": notes(found),
        "as_it_is": to_dict(found.recipe),
    }
    return document("facetrack-tune", fields, indent=1)


def tuned_recipe(found: Tuning, overrides: Sequence[str]) -> str:
    """The recipe's own text, comments too, with the overrides and the best setting of all clips, below a line on it."""
    best = [f"{one.key}={text}" for one, text in zip(found.ranges, found.best().values, strict=False)]
    what = f"{', '.join(best) or 'as it is'}, the best by {found.measure}"
    clips = ", ".join(clip_name(clip) for clip in found.clips)
    text = rewritten(read_recipe(found.recipe.path), [*overrides, *best])
    return f"# {found.recipe.name}, tuned: {what} on {clips}.\n{text}"


def _mean(found: Tuning, after: bool) -> float:
    return float(sum((one.after if after else one.before).mean() for one in found.folds)) / len(found.folds)


def _named(found: Tuning, one: Setting) -> dict[str, str]:
    return {each.key: text for each, text in zip(found.ranges, one.values, strict=False)}


def _value(found: Tuning, one: Setting, i: int) -> str:
    return one.values[i] if one.values else _shipped(found, found.ranges[i].key)


def _over(one: Range, chosen: Sequence[str]) -> str:
    """What the folds chose of a range."""
    different = list(dict.fromkeys(chosen))
    if len(different) == 1:
        return f"all folds choose {different[0]}, "
    try:
        ordered = sorted(different, key=lambda text: float(text.removesuffix("px")))
    except ValueError:
        return f"folds choose {', '.join(different)}, "
    return f"folds choose {ordered[0]} to {ordered[-1]}, "


def _shipped(found: Tuning, key: str) -> str:
    """A setting of the recipe as it is; a dash for what it has not."""
    node: Any = to_dict(found.recipe)
    for name in key.split("."):
        node = node.get(name.strip()) if isinstance(node, dict) else None
    return NO_FIGURE if node is None or isinstance(node, dict) else str(node)
