"""Correcting a run on the page: what is dragged becomes a correction, and what follows from it is tracked again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Annotated, Any, ClassVar, Final, Literal

from pydantic import Field, StrictBool, StrictInt

from facetrack_cli.core.errors import FacetrackError, InputError
from facetrack_cli.core.types import BOX, Correction
from facetrack_cli.editor.corrections import merged
from facetrack_cli.editor.history import Fixer
from facetrack_cli.editor.overview import overview
from facetrack_cli.editor.repaint import cells
from facetrack_cli.editor.save import keep, save
from facetrack_cli.editor.web.draft import Draft, FrameNumber, Json
from facetrack_cli.editor.web.proposals import Proposer
from facetrack_cli.editor.web.requirements import requirement
from facetrack_cli.editor.web.session import Answer, RefusedError, Report, Route, Session
from facetrack_cli.recipe.model import OpenCvRecipe
from facetrack_cli.tracking.start import PARTS
from facetrack_cli.video.seek import Frames

MOST_ROWS: Final = 600


class FixSession(Session):
    """The corrections of one run, in a `fixer`. With `video`, Save also writes the annotated video again, if any.

    `unsaved` are the corrections of a session that was not saved, which are applied first.
    """

    mode: ClassVar[Literal["fix"]] = "fix"

    def __init__(self, fixer: Fixer, frames: Frames, *, video: bool = True, unsaved: Sequence[Correction] = ()) -> None:
        run = fixer.run
        self.fixer, self.video = fixer, video
        self._parts = run.parts
        about = {
            "clip": run.header.clip_name,
            "recipe": run.recipe.name,
            "requirements": [_requirement(name, parts) for name, parts in self._parts.items()],
            "free": False,
            "saves_to": str(run.folder),
            "learns": not isinstance(run.recipe, OpenCvRecipe),  # those trackers always begin again
        }
        proposer, draft = Proposer(frames, run.recipe, run.recipe.points), Draft(run.first, {})
        super().__init__(frames, proposer, draft, about, first=run.first, last=run.last)
        if unsaved:
            self._begin("tracking the corrections of the last session", partial(self._resume, unsaved))

    def routes(self) -> Sequence[Route]:
        return (
            *super().routes(),
            Route("GET", "api/rows", self._rows),
            Route("GET", "api/overview", self._overview),
            Route("POST", "api/track", self._track),
            Route("POST", "api/remove", self._remove),
            Route("POST", "api/undo", self._undo),
        )

    def proposals(self, frame: int) -> Json:
        """Those for the targets of the run: a face may be any of them where the recipe names none."""
        found = super().proposals(frame)
        proposals = []
        for one in found["proposals"]:
            if self.fixer.run.recipe.followed:
                proposals.append({**one, "targets": {n: t for n, t in one["targets"].items() if n in self._parts}})
            else:
                [face] = one["targets"].values()
                several = len(self._parts) > 1
                for name in self._parts:
                    label = f"{one['label']}: {name}" if several else one["label"]
                    proposals.append({"label": label, "targets": {name: face}})
        for one in proposals:
            one["targets"] = {name: self._fitted(name, target) for name, target in one["targets"].items()}
        return {**found, "proposals": proposals}

    def check_draft(self, draft: Draft) -> None:
        for name, one in draft.targets.items():
            if name not in self._parts:
                raise RefusedError(400, f"the run has no {name}; it has {', '.join(self._parts)}")
            named = [*one.points, *(() if one.absent is True else one.absent)]
            if unknown := [part for part in named if part not in self._parts[name]]:
                raise RefusedError(400, f"{name} has no {unknown[0]}; it has {', '.join(self._parts[name])}")

    def save(self, draft: Draft) -> None:
        if not draft.empty:
            frame = draft.frame
            raise RefusedError(422, f"what was moved in frame {frame} is not tracked yet; track it, or discard it")
        self.begin("saving", self._write, saves=draft)

    # handlers

    def _rows(self, first: int, last: int) -> Json:
        """The rows of frames `first` to `last`, both included."""
        run = self.fixer.run
        first, last = max(first, run.first), min(last, run.last)
        if last - first > MOST_ROWS:
            raise RefusedError(400, f"{last - first + 1} frames are too many; at most {MOST_ROWS} are sent")
        parts = [(name, part) for name, parts in self._parts.items() for part in parts]
        return {"first": first, "parts": parts, "frames": cells(self.fixer.rows, first, last + 1)}

    def _overview(self, bins: Annotated[int, Field(ge=1, le=4000)] = 400) -> Json:
        """Where the run is least certain, and what is corrected."""
        corrections, rows = self.fixer.now
        return overview(rows, bins, corrections)

    def _track(self, base: StrictInt, learn: StrictBool | Literal["keep"] | None = "keep") -> Answer:
        """Make the draft a correction of its frame. `learn` as of Correction; "keep" leaves that as it is."""
        draft = self.current(base)
        self.refuse_if_busy()
        given = self._corrections(draft)
        if learn != "keep":
            given = [one if one.absent is True else replace(one, learn=learn) for one in given]
        for one in given:
            self.fixer.check(one)

        def work(**options: Any) -> None:
            self.fixer.put(given, **options)
            with self.lock:
                if self.draft is draft:  # else somebody continues with another one
                    self.change(Draft(draft.frame, {}))

        return self._begin(f"tracking {', '.join(one.target for one in given)}", work)

    def _remove(self, frame: FrameNumber, target: str) -> Answer:
        if self.fixer.find(frame, target) is None:
            raise RefusedError(422, "there is no such correction")
        return self._begin(f"tracking {target}", partial(self.fixer.remove, frame, target))

    def _undo(self) -> Answer:
        if not self.fixer.can_undo:
            raise RefusedError(422, "there is nothing to undo")
        return self._begin("undoing", lambda **_: self.fixer.undo())

    # jobs

    def _begin(self, what: str, work: Callable[..., None]) -> Answer:
        """Begin a job that changes the corrections: `work`, a method of Fixer with its `report` and `stop` left open.

        Afterwards the corrections are kept in a file, and the pages request the rows again.
        """

        def job(report: Report) -> None:
            work(report=report, stop=self.stopping.is_set)
            with self.lock:
                self.rows_revision += 1
                self.can_undo = self.fixer.can_undo
            keep(self.fixer)

        self.begin(what, job)
        return Answer({}, 202)

    def _corrections(self, draft: Draft) -> list[Correction]:
        """What the draft corrects, merged with the corrections of its frame. Raises RefusedError (422) if nothing."""
        found = []
        for name, one in draft.targets.items():
            if not one.empty:
                at, before = one.rounded(), self.fixer.find(draft.frame, name)
                found.append(merged(draft.frame, name, at.box, at.points, one.absent, before, self._parts[name]))
        if not found:
            raise RefusedError(422, f"nothing is corrected in frame {draft.frame}; move a part, or mark it as absent")
        return found

    def _resume(self, corrections: Sequence[Correction], **options: Any) -> None:
        """Apply what was not saved the last time."""
        try:
            self.fixer.apply(corrections, **options)
        except FacetrackError as e:
            raise InputError(f"the corrections of the last session were left out: {e}") from e
        with self.lock:
            self.message = "the corrections of the last session, which were not saved, are applied; undo removes them"

    def _write(self, report: Report) -> None:
        messages = save(self.fixer, video=self.video, report=report, stop=self.stopping.is_set)
        self.end(messages, f"facetrack report {self.fixer.run.folder} --overwrite")

    def _fitted(self, name: str, target: Json) -> Json:
        """A proposal has the points of a target, if it follows any, else the box."""
        points = {} if self._parts[name] == (BOX,) else target["points"]
        return {"box": None if points else target["box"], "points": points}


def _requirement(target: str, parts: tuple[str, ...]) -> Json:
    """What may be corrected of a target. With the box of points, all of them are placed again in the image."""
    if parts == (BOX,):
        return requirement(target, [], "needed")
    return requirement(target, parts, "optional" if set(parts) <= set(PARTS) else "no")
