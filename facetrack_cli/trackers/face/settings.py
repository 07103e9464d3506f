"""The sections of a recipe that follows the points of a face inside of its head.

Ours, around the filter of Patras & Pantic (FG 2004), who publish that of a head at rest. No numerics are imported here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

from pydantic import Field

from facetrack_cli.core.face_points import DetectorName
from facetrack_cli.recipe.sections import (
    Length,
    LengthPerPart,
    LikelihoodSettings,
    MotionSettings,
    PerPart,
    PriorSettings,
    Refusal,
    Section,
    Share,
)
from facetrack_cli.trackers.box.settings import (
    BoxSettings,
    CorrelationFilterSettings,
    GuidedSettings,
    VisibleWalkSettings,
)

if TYPE_CHECKING:
    from facetrack_cli.recipe.model import ParticleFilterSettings


class DetectionsSettings(Section):
    """A detector of faces that measures the face's box every so many frames."""

    every: Annotated[int, Field(ge=1, le=1000)] = 3
    """Frames from one look for the face to the next; while it is lost, the whole frame is searched as often."""
    by: DetectorName | Literal["auto"] = "auto"
    """OpenCV's Haar cascades or YuNet (extra `detect`); auto: what found the start, else the best that is installed."""


class LandmarksSettings(Section):
    """What places the points of the face in every frame: a regression, and a network where its file is there."""

    network: Literal["auto", "mesh"] | None = "auto"
    """MediaPipe's face mesh, which adds points: `mesh`, brought by `facetrack models get mesh`; null: only the
    regression; auto: mesh where it is there."""
    iris: Literal["auto", "iris"] | None = "auto"
    """MediaPipe's network for an eye, beside the other: `iris`, brought with `mesh`; null: none; auto: iris where both
    are there."""
    points: Literal["features", "all"] = "features"
    """The points of the network: 28 of mouth, eyes, brows, nose and jaw, or all 468."""


class HeadSettings(Section):
    """The head that carries the points: a box, followed by a correlation filter."""

    target: BoxSettings = BoxSettings(type="box")
    """The box of the face."""
    motion: VisibleWalkSettings
    """How it moves."""
    likelihood: CorrelationFilterSettings
    """How it looks."""
    filter: GuidedSettings = GuidedSettings(type="guided", particles=100)
    """Its particle filter."""
    lost_below: Share = 0.5
    """The head is lost while its confidence is below this, and all points with it."""
    detections: DetectionsSettings | None = DetectionsSettings()
    """Detections of the face as measurements of its box; null: none."""
    landmarks: LandmarksSettings = LandmarksSettings()
    """What places the points."""


class JumpingWalkSettings(MotionSettings):
    """A walk with heavy tails around rest: N(m, sigma) or, with probability `jumps`, N(m, jump) (ours).

    m_i = rest_i + keep (a_i^- - rest_i), where rest is the shape of the first frame, carried by the head.
    """

    engine = "facetrack_cli.trackers.face.motion:jumping_walk"
    goes_with = ("points",)
    type: Literal["jumping_walk"]
    sigma: LengthPerPart
    """Standard deviation of a part's usual step, along x and along y."""
    jump: LengthPerPart
    """Standard deviation of a part's step when it jumps."""
    jumps: Share = 0.2
    """Probability of a jump in a frame."""
    keep: Share = 0.98
    """Share of the distance from the place at rest that is left after a frame."""

    def mismatches(self, whole: ParticleFilterSettings) -> Iterable[Refusal]:
        for key in ("sigma", "jump"):
            yield from getattr(self, key).refusals(("motion", key), whole.points)


Shift: TypeAlias = tuple[Annotated[float, Field(ge=-2, le=2)], Annotated[float, Field(ge=-2, le=2)]]


class ShiftPerPart(PerPart[Annotated[Shift, Field(strict=False)]]):
    """One shift for all parts, or `part: shift` for each; `default` serves the parts not named."""


class WindowNccSettings(LikelihoodSettings):
    """Normalised correlation of windows in brightness and redness with several templates of a part (ours)."""

    engine = "facetrack_cli.trackers.face.window_ncc:WindowNcc"
    goes_with = ("points",)
    type: Literal["window_ncc"]
    sharpness: Annotated[float, Field(gt=0, le=1000)] = 30.0
    """The log-likelihood of a visible part is this times its correlation."""
    templates: Annotated[int, Field(ge=1, le=20)] = 4
    """Templates of a part at most: that of the first frame, and others of other looks, such as an open mouth."""
    reach: Length = Length(0.5)
    """How far from its last place a part is looked for, along x and along y."""
    shift: ShiftPerPart = ShiftPerPart((0.0, 0.0))
    """Where the middle of a window lies, seen from its part, in sizes of the window: [across, down]."""

    def mismatches(self, whole: ParticleFilterSettings) -> Iterable[Refusal]:
        return self.shift.refusals(("likelihood", "shift"), whole.points)


class StudentTSettings(PriorSettings):
    """Shape prior: one Student t density with the second moments of registered training shapes (ours)."""

    engine = "facetrack_cli.trackers.face.assembly:build_student"
    goes_with = ("points",)
    type: Literal["student_t"]
    file: Annotated[str, Field(min_length=1)]
    """The training shapes, as for `parzen`."""
    freedom: Annotated[float, Field(gt=0, le=1000)] = 4.0
    """Degrees of freedom: the fewer, the heavier the tails."""

    @property
    def files(self) -> Mapping[str, str]:
        return {"file": self.file}

    def mismatches(self, whole: ParticleFilterSettings) -> Iterable[Refusal]:
        if getattr(whole.filter, "from_prior", 0):
            yield Refusal(("filter", "from_prior"), "student_t proposes no parts; remove from_prior, or write parzen")
