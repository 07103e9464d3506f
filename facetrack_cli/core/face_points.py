"""Points of a face: their names, the groups they belong to, and the lines between them; and who may place them.

Left and right are as seen in the frame.
"""

from typing import Final, Literal, TypeAlias

HANDS: Final = ("left_hand", "right_hand")
"""The first one hangs at the left of the picture, where a person faces the camera."""


DetectorName: TypeAlias = Literal["haar", "yunet"]
DETECTORS: Final[tuple[DetectorName, ...]] = ("haar", "yunet")

GROUPS: Final[dict[str, tuple[str, ...]]] = {
    "mouth": ("mouth_left", "mouth_right", "lip_upper", "lip_lower", "inner_lip_upper", "inner_lip_lower"),
    "eyes": (
        "eye_left_outer", "eye_left_inner", "eye_left_upper", "eye_left_lower",
        "eye_right_inner", "eye_right_outer", "eye_right_upper", "eye_right_lower",
    ),
    "brows": (
        "brow_left_outer", "brow_left_middle", "brow_left_inner",
        "brow_right_inner", "brow_right_middle", "brow_right_outer",
    ),
    "nose": ("nose", "nose_left", "nose_right"),
    "jaw": ("jaw_left", "chin_left", "chin", "chin_right", "jaw_right"),
}  # fmt: skip
"""The points of each group. `lip_upper` and `lip_lower` are on the outer edge of the lips."""
POINTS: Final = tuple(point for group in GROUPS.values() for point in group)
"""All 28 points, in the order of files and columns."""
IRISES: Final = ("iris_left", "iris_right")
"""The middles of the irises, which a network sees."""
LINES: Final = (
    ("mouth_left", "lip_upper", "mouth_right", "lip_lower", "mouth_left"),
    ("mouth_left", "inner_lip_upper", "mouth_right", "inner_lip_lower", "mouth_left"),
    ("eye_left_outer", "eye_left_upper", "eye_left_inner", "eye_left_lower", "eye_left_outer"),
    ("eye_right_inner", "eye_right_upper", "eye_right_outer", "eye_right_lower", "eye_right_inner"),
    ("brow_left_outer", "brow_left_middle", "brow_left_inner"),
    ("brow_right_inner", "brow_right_middle", "brow_right_outer"),
    ("jaw_left", "chin_left", "chin", "chin_right", "jaw_right"),
)
"""What a drawing connects. A closed line ends with its first point."""
MESH: Final[dict[str, int]] = {
    "mouth_left": 61, "mouth_right": 291, "lip_upper": 0, "lip_lower": 17,
    "inner_lip_upper": 13, "inner_lip_lower": 14,
    "eye_left_outer": 33, "eye_left_inner": 133, "eye_left_upper": 159, "eye_left_lower": 145,
    "eye_right_inner": 362, "eye_right_outer": 263, "eye_right_upper": 386, "eye_right_lower": 374,
    "brow_left_outer": 70, "brow_left_middle": 105, "brow_left_inner": 107,
    "brow_right_inner": 336, "brow_right_middle": 334, "brow_right_outer": 300,
    "nose": 1, "nose_left": 98, "nose_right": 327,
    "jaw_left": 172, "chin_left": 150, "chin": 152, "chin_right": 379, "jaw_right": 397,
}  # fmt: skip
"""The number of each point in MediaPipe's mesh of 468 points."""
EYE_DISTANCE: Final = 0.363
"""The distance between the centres of the eyes, in widths of the face's box."""
