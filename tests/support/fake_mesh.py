"""In place of the network `mesh`: it knows where the face of `moving_face` is and says so with noise, or sees none."""

from functools import cache
from pathlib import Path

import numpy as np

from facetrack_cli.core.face_points import MESH
from facetrack_cli.core.types import Frame
from facetrack_cli.trackers.face.mesh import CROPS, NAMES, Mesh
from facetrack_cli.trackers.face.stabilized import FACE, Similarity
from tests.support import moving_face as moving
from tests.support.moving_face import PARTS, Pose

IN_CLIP = Pose(moving._X + moving._SIDE / 2, moving._Y + moving._SIDE / 2, moving._SIDE)
"""The face of the sample clip `expressions` where it is."""
# what the network says of the clip's first frame, in the stabilized image
_AT = {
    "mouth_left": (55, 108), "mouth_right": (104, 109), "lip_upper": (79, 108), "lip_lower": (78, 122),
    "inner_lip_upper": (79, 111), "inner_lip_lower": (79, 116), "eye_left_outer": (49, 66), "eye_left_inner": (69, 69),
    "eye_left_upper": (58, 64), "eye_left_lower": (59, 69), "eye_right_inner": (94, 70), "eye_right_outer": (115, 70),
    "eye_right_upper": (106, 66), "eye_right_lower": (104, 72), "brow_left_outer": (42, 56),
    "brow_left_middle": (53, 50), "brow_left_inner": (72, 53), "brow_right_inner": (93, 54),
    "brow_right_middle": (112, 54), "brow_right_outer": (123, 60), "nose": (79, 97), "nose_left": (65, 96),
    "nose_right": (94, 98), "jaw_left": (40, 116), "chin_left": (51, 129), "chin": (77, 142), "chin_right": (106, 132),
    "jaw_right": (119, 120),
}  # fmt: skip


def head_of(pose: Pose) -> Similarity:
    """The stabilized image of a face in that pose."""
    return Similarity(np.array([pose.x, pose.y]), pose.side / FACE, np.radians(pose.roll))


@cache
def layout() -> np.ndarray:
    """(468, 2): the mesh in the first frame of the sample clip; points without a name lie between others."""
    known = np.array([_AT[part] for part in MESH], float)
    shares = np.random.default_rng(0).dirichlet(np.full(len(known), 0.2), len(NAMES))
    at = shares @ known
    at[list(MESH.values())] = known
    return head_of(IN_CLIP).to_frame(at)


def clip(poses: list[Pose | None]) -> list[Frame]:
    """A frame for each pose, as of `moving_face`, of a face that does not talk."""
    grounds = (moving.ground() if pose is None else moving.paste(moving.ground(), pose, 0) for pose in poses)
    return [moving.frame(i, picture) for i, picture in enumerate(grounds)]


class FakeMesh(Mesh):
    """Of frame t it sees the face in `poses[t]`, none where that is None; its noise, in pixels, is the frame's own."""

    def __init__(self, poses: list[Pose | None], noise: float = 0.0) -> None:
        self.path, self.poses, self.noise = Path("fake"), poses, noise

    def truth(self, t: int) -> np.ndarray:
        """(468, 2): the points in frame t."""
        pose = self.poses[t]
        at = layout() @ moving.matrix(pose)[:, :2].T + moving.matrix(pose)[:, 2]
        at[[NAMES[part] for part in PARTS]] = moving.truth(pose, 0)
        return at

    def measure(self, frame, head, crops=CROPS):
        if self.poses[frame.index] is None:
            return None
        found = self.truth(frame.index)
        rng = np.random.default_rng(frame.index)
        return head.to_stabilized(found + self.noise * rng.standard_normal((len(crops), *found.shape)))
