"""The names of hands."""

from typing import Final

HANDS: Final = ("left_hand", "right_hand")
"""The first one hangs at the left of the picture, where a person faces the camera."""
