"""Proposals: the faces of a frame, with the points that the recipe requires of them."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import inside
from facetrack_cli.core.types import Box, Frame, Start, TargetStart
from facetrack_cli.editor.web.draft import Draft, Json, draft_of
from facetrack_cli.editor.web.frame_images import OnceCache
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.tracking.start import PARTS, box_start, name_targets
from facetrack_cli.tracking.start.haar import NotHereError, find_faces
from facetrack_cli.tracking.start.init_file import TARGET
from facetrack_cli.tracking.start.points import place
from facetrack_cli.video.seek import Frames

MOST_KEPT: Final = 256  # frames
MOST_FACES: Final = 12


class Proposer:
    """Proposals of any frame, each computed once. All run in one thread, which keeps the cascades.

    `points` are those that the recipe requires of the first target.
    """

    def __init__(self, frames: Frames, recipe: Recipe | None, points: Sequence[str]) -> None:
        self._frames = frames
        self._recipe = recipe
        self._points = [part for part in points if part in PARTS]
        self._by_hand = [part for part in points if part not in PARTS]
        self._worker = ThreadPoolExecutor(1, "proposals")
        self._found: OnceCache[int, Json] = OnceCache(MOST_KEPT, lambda _: 1)

    def __call__(self, index: int) -> Json:
        """{"frame", "proposals": [{"label", "targets"}], "note"}. Raises InputError if there is no such frame."""
        return self._found.get(index, lambda: self._worker.submit(self._find, index).result())

    def close(self) -> None:
        self._worker.shutdown(wait=True, cancel_futures=True)

    def in_box(self, frame: Frame, box: Box, clip: str) -> Draft:
        """The draft of the face in a given box. Raises InputError as `box_start` does."""
        start = box_start(frame, box, self._points, clip=clip)
        return draft_of(frame.index, self._complete(frame, start)[0].targets)

    def _find(self, index: int) -> Json:
        frame = self._frames.read(index)
        notes = []
        proposals = []
        for number, box in enumerate(find_faces(frame.bgr)[:MOST_FACES], start=1):
            placed = place(frame.bgr, box) if self._points else {}
            points = {part: (round(placed[part][0], 2), round(placed[part][1], 2)) for part in self._points}
            visible = {part: at for part, at in points.items() if inside(at, frame.size)}
            start, note = self._complete(frame, Start(index, {TARGET: TargetStart(box, visible)}, "the face found"))
            targets = {name: {"box": one.box, "points": one.points} for name, one in start.targets.items()}
            proposals.append({"label": f"face {number}", "targets": targets})
            notes.append(note)
        if not proposals:
            notes.append("no face is found in this frame; draw a box, or look at another frame")
        elif self._by_hand:
            notes.append(f"{', '.join(self._by_hand)}: only by hand")
        return {"frame": index, "proposals": proposals, "note": "; ".join(dict.fromkeys(filter(None, notes))) or None}

    def _complete(self, frame: Frame, start: Start) -> tuple[Start, str]:
        """With the other targets that the recipe names, if they are found; else the first one alone, and why."""
        if self._recipe is None or not self._recipe.followed:
            return start, ""
        first, *others = self._recipe.followed
        [face] = start.targets.values()
        alone = Start(start.frame, {first: face}, start.origin)
        try:
            return name_targets(alone, self._recipe.followed, frame, left_out=self._recipe.left_out), ""
        except NotHereError:
            return alone, f"{', '.join(others)}: not found by the colour of the skin; draw the boxes"
        except InputError as e:
            return alone, " ".join(str(e).splitlines())
