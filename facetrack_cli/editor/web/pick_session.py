"""Choosing where a track begins, on the page."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

from facetrack_cli.core.types import Box, Start
from facetrack_cli.editor.web.draft import Draft, draft_of
from facetrack_cli.editor.web.proposals import Proposer
from facetrack_cli.editor.web.requirements import ORIGIN, MissingError, carried, fitted, requirements, start_of
from facetrack_cli.editor.web.session import RefusedError, Session
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.tracking.start import write_init
from facetrack_cli.tracking.start.preview import write_preview
from facetrack_cli.video.seek import Frames


class PickSession(Session):
    """A start to be chosen, at first in frame `frame`. `begun` is the start of the file that will be replaced.

    Save writes to `out`, and an image of it to `preview`; without `out` the start is left in `saved`, to be printed.
    `box`, of a face in that frame, gives the first draft, with its points. Raises InputError if there is no such frame,
    or no face can be in that box.
    """

    mode: ClassVar[Literal["pick"]] = "pick"

    def __init__(
        self,
        clip: Path,
        frames: Frames,
        *,
        out: Path | None,
        overwrite: bool = False,
        recipe: Recipe | None = None,
        frame: int | None = None,
        box: Box | None = None,
        begun: Start | None = None,
        next_: str | None = None,
        preview: Path | None = None,
    ) -> None:
        self.clip, self.out, self.overwrite, self.recipe = clip, out, overwrite, recipe
        self.next, self.preview = next_, preview
        self.begun = begun = None if begun is None else fitted(begun, recipe)
        self.saved: Start | None = None
        self._previewed = False
        self._required = requirements(recipe)
        proposer = Proposer(frames, recipe, self._required[0]["points"])
        shown = frame if frame is not None else begun.frame if begun is not None else 0
        first = frames.read(shown)  # raises InputError before anything is served
        if box is not None:
            draft = proposer.in_box(first, box, str(clip))
        else:
            draft = draft_of(shown, begun.targets if begun is not None else {})
        self._unchanged = draft if box is None else None
        about = {
            "clip": clip.name or str(clip),
            "recipe": None if recipe is None else recipe.name,
            "requirements": self._required,
            "free": recipe is None or not recipe.followed,
            "saves_to": "standard output" if out is None else str(out),
        }
        super().__init__(frames, proposer, draft, about)
        if begun is not None and box is None:
            self.message = f"taken from {begun.origin}"

    def save(self, draft: Draft) -> None:
        frames = self.frames.count if self.frames.exact else None
        try:
            start = start_of(draft, self._required, self.frames.size, frames, self.recipe, self.begun)
        except MissingError as e:
            raise RefusedError(422, str(e)) from None
        if frames is None:
            self.frames.read(start.frame)  # how long the clip is may be known only then
        self.begin("writing the init file", lambda _: self._write(start), saves=draft)

    def unsaved(self) -> Start | None:
        """What was chosen and not saved; None if that is nothing, or nothing new."""
        with self.lock:
            draft = self.draft
            if self.ended is not None or draft == self._unchanged:
                return None
        chosen = draft.placed()
        return carried(Start(draft.frame, chosen, ORIGIN), self.begun) if chosen else None

    def _write(self, start: Start) -> None:
        messages = []
        if self.preview is not None:
            frame = self.frames.read(start.frame)
            write_preview(self.preview, frame, start, overwrite=self.overwrite or self._previewed)
            self._previewed = True  # if what follows fails, the next attempt may replace it
            messages.append(f"{self.preview}: the start drawn on frame {start.frame}")
        if self.out is not None:
            write_init(self.out, start, clip=self.clip.name, overwrite=self.overwrite)
        messages.append(f"{self.out}: written" if self.out is not None else "standard output: what was chosen")
        if self.begun is not None and (lost := len(self.begun.corrections) - len(start.corrections)):
            messages.append(f"corrections left out, since they come before the start or have no target: {lost}")
        self.saved = start
        self.end(messages, self.next)
