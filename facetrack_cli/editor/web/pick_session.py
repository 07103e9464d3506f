"""Choosing where a track begins, on the page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

from facetrack_cli.core.types import Start
from facetrack_cli.editor.web.draft import Draft, Json, draft_of
from facetrack_cli.editor.web.proposals import Proposer
from facetrack_cli.editor.web.requirements import ORIGIN, LackingError, carried, fitted, start_of, wants
from facetrack_cli.editor.web.routes import RefusedError
from facetrack_cli.editor.web.session import Report, Session
from facetrack_cli.tracking.start import write_init
from facetrack_cli.tracking.start.preview import write_preview

if TYPE_CHECKING:
    from facetrack_cli.core.types import Box
    from facetrack_cli.editor.web.pictures import Pictures
    from facetrack_cli.recipe.model import Recipe
    from facetrack_cli.video.seek import Frames


class PickSession(Session):
    """A start to be, in frame `first` to begin with. `begun` is what the file held that will be replaced.

    Save writes to `out`, and a picture of it to `preview`; without `out` the start is left in `saved`, to be printed.
    `box`, of a face in that frame, is drawn with its points to begin with. Raises InputError if there is no such frame,
    or no face can be in that box.
    """

    mode: ClassVar[Literal["pick"]] = "pick"

    def __init__(
        self,
        clip: Path,
        frames: Frames,
        pictures: Pictures,
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
        self._drawn = False
        wanted = wants(recipe)
        self._wants = wanted
        self._propose = Proposer(frames, recipe, wanted[0]["points"])
        shown = frame if frame is not None else begun.frame if begun is not None else 0
        first = frames.read(shown)  # or an InputError before anything is served
        if box is not None:
            draft = self._propose.in_box(first, box, str(clip))
        else:
            draft = draft_of(shown, begun.targets if begun is not None else {})
        self._at_first = draft if box is None else None
        super().__init__(
            clip=clip.name or str(clip),
            recipe=None if recipe is None else recipe.name,
            frames=frames,
            pictures=pictures,
            saves_to="standard output" if out is None else str(out),
            wants=wanted,
            free=recipe is None or not recipe.followed,
            draft=draft,
        )
        if begun is not None and box is None:
            self.message = f"begun with what {begun.origin} holds"

    def proposals(self, index: int) -> Json:
        return self._propose(index)

    def check_draft(self, draft: Draft) -> None:
        if self.frames.exact and draft.frame >= self.frames.count:
            raise RefusedError(400, f"there is no frame {draft.frame}; the clip ends with {self.frames.count - 1}")

    def save(self, draft: Draft) -> None:
        frames = self.frames.count if self.frames.exact else None
        try:
            start = start_of(draft, self._wants, self.frames.size, frames, self.recipe, self.begun)
        except LackingError as e:
            raise RefusedError(422, str(e)) from None
        if frames is None:
            self.frames.read(start.frame)  # how long the clip is may be known only then
        self.begin("writing the init file", None, lambda report: self._write(start, report), of=draft)

    def unsaved(self) -> Start | None:
        """What was chosen and not saved; None if that is nothing, or nothing new."""
        with self.lock:
            draft = self.draft
            if self.ended is not None or draft == self._at_first:
                return None
        chosen = {name: one.rounded() for name, one in draft.targets.items() if one.box is not None or one.points}
        return carried(Start(draft.frame, chosen, ORIGIN), self.begun) if chosen else None

    def close(self) -> None:
        super().close()
        self._propose.close()

    def _write(self, start: Start, report: Report) -> None:
        said = []
        if self.preview is not None:
            frame = self.frames.read(start.frame)
            write_preview(self.preview, frame, start, overwrite=self.overwrite or self._drawn)
            self._drawn = True  # if what follows fails, the next attempt may replace it
            said.append(f"{self.preview}: the start drawn on frame {start.frame}")
        if self.out is not None:
            write_init(self.out, start, clip=self.clip.name, overwrite=self.overwrite)
        said.append(f"{self.out}: written" if self.out is not None else "standard output: what was chosen")
        if self.begun is not None and (lost := len(self.begun.corrections) - len(start.corrections)):
            said.append(f"corrections that were left out, since they come before it or are of no target: {lost}")
        self.saved = start
        self.end(said, self.next)
