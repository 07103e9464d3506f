"""How a measure is declared: once, with the field of the dataclass that holds its value.

    @dataclass(frozen=True)
    class PointMeasures:
        mean_px: Annotated[Value, Measure("mean\\npx", PX, "less")]

From the declarations follow the names (`points.mean_px`), the columns of tables, and the order of recipes by a measure.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias, get_type_hints

import numpy as np

from facetrack_cli.core.types import Array, Mask

Value: TypeAlias = float | int | None
"""A measured value; None where the measure is not defined, as the precision without any row called lost."""


@dataclass(frozen=True)
class Measure:
    """`title`: the head of its column, in two lines, without one it has none; `write`: a value as text; `better`: None
    where neither is. One that is `rare` has a column only where one of its values is not 0.
    """

    title: str
    write: Callable[[float], str]
    better: Literal["more", "less"] | None = None
    rare: bool = False


def measures_of(kind: type) -> dict[str, Measure]:
    """The measures that a dataclass declares, by the names of its fields."""
    hints = get_type_hints(kind, include_extras=True)
    return {name: hint.__metadata__[0] for name, hint in hints.items() if hasattr(hint, "__metadata__")}


COUNT: Final = "{:,.0f}".format
HALVES: Final = "{:g}".format  # the median of whole frames
PX: Final = "{:.2f}".format
UNIT: Final = "{:.3f}".format


def PERCENT(value: float) -> str:  # noqa: N802 -- a constant like the others
    """A share of 0 to 1 as a percentage."""
    return f"{100 * value:.1f}"


def mean(values: Array | Mask) -> Value:
    return float(np.mean(values)) if len(values) else None


def median(values: Array) -> Value:
    return float(np.median(values)) if len(values) else None


def share(of: Mask, those: Mask) -> Value:
    """The share of the rows in `of` that are also in `those`, 0 to 1; None if `of` is empty."""
    return mean(those[of])
