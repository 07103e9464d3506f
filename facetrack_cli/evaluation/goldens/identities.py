"""Who runs of a tracker say that a target is, where they say so: what a golden keeps of it.

The name is that of the last frame in most runs. How sure they are of it is a statistic like any other (`bands.py`):
the probability of that name, 0 in frames in which another one is more likely.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from facetrack_cli.core.types import Array
from facetrack_cli.trajectory.trajectory import Trajectory


def last_names(tables: Sequence[Trajectory]) -> dict[str, Counter[str]]:
    """How many runs end with which name, for each target that is named in any of them."""
    found: dict[str, Counter[str]] = {}
    for table in tables:
        for target in table.targets:
            if named := [name for name in table.of_target(target)[0].identity.tolist() if name]:
                found.setdefault(target, Counter())[named[-1]] += 1
    return found


def names(tables: Sequence[Trajectory]) -> dict[str, str]:
    """The name of each target, the one with which most runs end; of as many, the first by the alphabet."""
    return {
        target: min(counted, key=lambda name: (-counted[name], name)) for target, counted in last_names(tables).items()
    }


def probability(one: Trajectory, name: str) -> Array:
    """(T,) of this name in each row of a part, 0 where another is more likely, nan where nobody is named."""
    return np.where(one.identity == "", np.nan, np.where(one.identity == name, one.identity_prob, 0.0))


def sentence(recorded: Mapping[str, str], tables: Sequence[Trajectory]) -> str:
    """With which names runs end, as `grace in 4 of 4`, and of which target if there are several; "" for nobody."""
    counted = last_names(tables)
    said = []
    for target in dict.fromkeys([*recorded, *counted]):
        whose = f"{target}: " if len({*recorded, *counted}) > 1 else ""
        each = counted.get(target, Counter())
        most = sorted(each, key=lambda name: (-each[name], name))
        said.append(whose + (", ".join(f"{name} in {each[name]} of {len(tables)}" for name in most) or "nobody"))
    return "; ".join(said)
