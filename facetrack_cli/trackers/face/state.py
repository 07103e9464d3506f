"""What is known of a face from frame to frame, and what a frame shows of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array, Frame
from facetrack_cli.engine.target import ParticleState, Rows
from facetrack_cli.trackers.face.descent import PlacedPoints
from facetrack_cli.trackers.face.detectors import Found
from facetrack_cli.trackers.face.evidence import Sighting
from facetrack_cli.trackers.face.mesh_points import MeshPoints
from facetrack_cli.trackers.face.motion import SensorReading
from facetrack_cli.trackers.face.sensors import Facing, Sensor
from facetrack_cli.trackers.face.stabilized import Similarity
from facetrack_cli.trackers.people.descriptor import Picture
from facetrack_cli.video.shots import Passing

_MAX_POSE: Final = np.array([math.inf, 0.7, 0.3, 0.3])  # a face may lie, and a head may turn over


class FaceState(NamedTuple):
    """The states of head and points, the last rows of `points` in the stabilized image; what is known of their sensors.

    `sensors` are regression, detector, network; `others` the network's points, None before it has seen the face;
    `eyes` those of the eyes, None where they have no rows.

    `pose` (4,) is that of the face in its head: roll in radians, the logarithm of its size, and its middle in sizes of
    the head's box; `pose_var` (4,) are their variances. `frames` counts those since the start. `sure` are the log odds
    that the sensors see the face where it is. `looks` are those of the face so far, and so are `pictures`; `sighting`
    is one of it while it is lost, `seen` where it was last seen for sure. `passing` is what the frames show; `cut` is
    the time of a cut, or what may be one, since which the face was not seen; `several` counts looks at several faces in
    one frame.
    """

    head: ParticleState
    features: ParticleState
    points: Rows
    sensors: tuple[Sensor, ...]
    facing: Facing
    pose: Array
    pose_var: Array
    others: MeshPoints | None
    eyes: MeshPoints | None
    looks: tuple[Array, ...]
    pictures: tuple[Picture, ...]
    seen: Similarity
    passing: Passing
    frames: int = 0
    sure: float = 0.0
    sighting: Sighting | None = None
    cut: float | None = None
    several: int = 0


class View(NamedTuple):
    """A frame as `seen` from the head, its `channels` for the regressions, and what sensors say of the points there.

    `places` are those (K, 2) by each sensor, `measured` what they say without their bias; `upright` (K, 2): what
    regression and network say together; `shift` (2,): how far the face is from where the head was expected; `sure`:
    log odds that it is there.
    """

    similarity: Similarity
    seen: Frame
    channels: NDArray[np.float32]
    due: bool
    found: Found | None
    parts: PlacedPoints
    others: PlacedPoints | None
    eyes: PlacedPoints | None
    places: tuple[Array, ...]
    measured: tuple[SensorReading, ...]
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
