"""The section of a recipe that follows two hands of a person beside the head (ours, after Gonzalez & Collet).

No numerics are imported here.
"""

from collections.abc import Iterable
from typing import Annotated

from pydantic import Field

from facetrack_cli.recipe.sections import Refusal, Section, Share

Sizes = Annotated[float, Field(gt=0, le=10)]


class HandsSettings(Section):
    """Two hands of the first target, which is a head: absent until they appear. Lengths are in sizes of its box."""

    particles: Annotated[int, Field(ge=10, le=100_000)] = 400
    """Particles of the joint state of both hands."""
    radius: Sizes = 0.36
    """Radius of a hand."""
    steps: Annotated[tuple[Sizes, Sizes, Sizes], Field(strict=False)] = (0.05, 0.15, 0.6)
    """Standard deviations of steps from one frame to the next, about where the last velocity leads."""
    shares: Annotated[tuple[Share, Share, Share], Field(strict=False)] = (0.5, 0.48, 0.02)
    """How often each of these steps is taken; they add up to 1."""
    appears: Share = 0.08
    """Probability that a hand that is not seen is seen in the next frame."""
    vanishes: Share = 0.03
    """Probability that a hand that is seen is not seen in the next frame."""
    proposed: Annotated[float, Field(ge=0, lt=1)] = 0.15
    """Share of the particles that are drawn where there is most skin; their weights take it into account."""
    evidence: Annotated[float, Field(gt=0, le=1000)] = 20.0
    """What the share of skin in a hand, above `skin`, adds to log p(y | x)."""
    skin: Share = 0.18
    """Share of skin in a hand, from which on it is more likely a hand than not."""
    lost_below: Share = 0.6
    """A hand is lost while its confidence, the probability that it is there, is below this."""

    def mistakes(self) -> Iterable[Refusal]:
        if abs(sum(self.shares) - 1) > 1e-6:
            yield Refusal(("shares",), f"the shares add up to {sum(self.shares):g}; make that 1")
