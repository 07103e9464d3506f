"""Whether the confidence that a recipe gives is a probability."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import PurePath
from typing import Any

from facetrack_cli.core.models import shipped_recipes
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import completed, to_dict

_FREE = frozenset(("name", "description", "seed"))  # what a calibration does not depend on


def calibrated(settings: Mapping[str, Any]) -> bool:
    """Whether all filters of a recipe with these settings name a calibration that was made for it.

    The calibration of a shipped recipe holds for it as it is shipped. Of a file of one's own its name alone is known.
    """
    for file in (files := _files(settings)):
        ours = _shipped(PurePath(file).stem)
        if ours is not None and file == ours["confidence"]["calibration"] and _bare(completed(settings)) != ours:
            return False
    return bool(files)


def fitted(settings: Mapping[str, Any]) -> bool:
    """Whether all filters name a calibration, be it made for other settings."""
    return bool(_files(settings))


def _files(settings: Mapping[str, Any]) -> list[str]:
    """The calibrations of all filters; none if one has none."""
    targets = settings.get("targets")
    those = [one for one in targets.values() if one] if isinstance(targets, Mapping) else [settings]
    sections = [one.get("confidence") for one in those if isinstance(one, Mapping)]
    files = [one.get("calibration") if isinstance(one, Mapping) else None for one in sections]
    return [] if None in files else [str(file) for file in files]


@lru_cache
def _shipped(name: str) -> dict[str, Any] | None:
    """The settings of the shipped recipe of this name that has a calibration; None if there is none."""
    if all(file.stem != name for file in shipped_recipes()):
        return None
    ours = _bare(to_dict(load_recipe(name, installed=False)))  # whatever networks this machine has
    return ours if (ours.get("confidence") or {}).get("calibration") else None


def _bare(settings: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in settings.items() if key not in _FREE}
