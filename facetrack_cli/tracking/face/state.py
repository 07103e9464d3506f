"""What is known of a face from frame to frame, and what a frame shows of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from facetrack_cli.core.types import Array, Frame
from facetrack_cli.tracking.face.descent import PlacedPoints
from facetrack_cli.tracking.face.found_again import Sighting
from facetrack_cli.tracking.face.mesh_points import MeshPoints
from facetrack_cli.tracking.face.sensors import Facing, Sensor
from facetrack_cli.tracking.face.stabilized import Similarity
from facetrack_cli.tracking.models.motion import SensorReading
from facetrack_cli.tracking.people.looks import Picture
from facetrack_cli.tracking.start.detectors import Found
from facetrack_cli.tracking.target import ParticleState
from facetrack_cli.trajectory.trajectory import TargetResult
from facetrack_cli.video.shots import Passing

_MAX_POSE: Final = np.array([math.inf, 0.7, 0.3, 0.3])  # a face may lie, and a head may turn over


@dataclass(frozen=True)
class FaceState:
    """The states of head and points, the last `points` as rows of the stabilized image; what is known of their sensor.

    `second` is that of the detector; `others` are the points of the network, None before it has seen the face.

    `pose` (4,) is that of the face in its head: roll in radians, the logarithm of its size, and its middle in sizes of
    the head's box; `pose_var` (4,) are their variances. `frames` counts those since the start. `sure` are the log odds
    that the sensors see the face where it is. `looks` are those of the face so far, and so are `pictures`; `sighting`
    is one of it while it is lost. `passing` is what the frame shows; `cut`: since a cut, the face was not recognised;
    `film`: there was a cut, and a lost face is only where it is recognised.
    """

    head: ParticleState
    features: ParticleState
    points: TargetResult
    sensor: Sensor
    second: Sensor
    facing: Facing
    pose: Array
    pose_var: Array
    others: MeshPoints | None
    looks: tuple[Array, ...]
    pictures: tuple[Picture, ...]
    passing: Passing
    frames: int = 0
    sure: float = 0.0
    sighting: Sighting | None = None
    cut: bool = False
    film: bool = False


class View(NamedTuple):
    """A frame as `seen` from the head, and what sensors say of the points there.

    `z2` (K, 2) are the detector's places. `measured`: what all sensors say together; `upright` (K, 2): the first one
    alone, without its bias; `shift` (2,): how far the face is from where the head was expected; `sure`: log odds
    that it is there.
    """

    similarity: Similarity
    seen: Frame
    due: bool
    found: Found | None
    z2: Array
    parts: PlacedPoints
    others: PlacedPoints | None
    measured: SensorReading
    upright: Array
    shift: Array
    sure: float


def updated(pose: Array, var: Array, off: Array, std: Array) -> tuple[Array, Array]:
    """A pose (4,) and its variances, measured to be `off` with standard deviations."""
    gain = var / (var + std**2)
    return np.clip(pose + gain * off, -_MAX_POSE, _MAX_POSE), (1 - gain) * var


def shifted(features: ParticleState, to: Callable[[Array], Array]) -> ParticleState:
    """The points' state at other places."""
    particles = features.particles._replace(x=to(features.particles.x))
    return replace(
        features, particles=particles, estimated=features.estimated._replace(state=to(features.estimated.state))
    )


def sure_of(head: ParticleState) -> float:
    assert head.judgement is not None
    return float(head.judgement.confidence[0])
