"""Correcting a run on the page: what is dragged becomes a correction, and what follows from it is tracked anew.

Beyond what every session serves:
    GET api/rows?from=a&to=b     the rows of frames a to b, both included
    GET api/overview?bins=N      where the run is least certain, and what is corrected
    POST api/track {"base", "learn"}   the draft becomes a correction of its frame; learn false: as the start knows it
    POST api/remove {"frame", "target"}, POST api/undo
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar, Final, Literal

from facetrack_cli.core.errors import FacetrackError, InputError
from facetrack_cli.core.types import BOX, Correction
from facetrack_cli.editor.corrections import merged
from facetrack_cli.editor.history import Fixer
from facetrack_cli.editor.overview import overview
from facetrack_cli.editor.repaint import cells
from facetrack_cli.editor.retrack import Report as Done
from facetrack_cli.editor.retrack import StoppedError
from facetrack_cli.editor.save import keep, save
from facetrack_cli.editor.web.draft import Draft, Json
from facetrack_cli.editor.web.proposals import Proposer
from facetrack_cli.editor.web.requirements import about_box
from facetrack_cli.editor.web.routes import Answer, RefusedError, Request, Route
from facetrack_cli.editor.web.session import Report, Session
from facetrack_cli.recipe.model import OpenCvRecipe
from facetrack_cli.tracking.start import PARTS
from facetrack_cli.tracking.start.init_writer import WHAT_PARTS_ARE

if TYPE_CHECKING:
    from facetrack_cli.editor.web.pictures import Pictures
    from facetrack_cli.video.seek import Frames

MOST_ROWS: Final = 600
MOST_BINS: Final = 4000


class FixSession(Session):
    """The corrections of one run, in a `fixer`. With `video`, Save also paints the annotated video, if there is one.

    `unsaved` are the corrections of a session that was not saved, which are applied first.
    """

    mode: ClassVar[Literal["fix"]] = "fix"

    def __init__(
        self,
        fixer: Fixer,
        frames: Frames,
        pictures: Pictures,
        *,
        video: bool = True,
        unsaved: Sequence[Correction] = (),
    ) -> None:
        run = fixer.run
        self.fixer, self.video = fixer, video
        self._parts = run.parts
        wanted = [_want(name, parts) for name, parts in self._parts.items()]
        self._propose = Proposer(frames, run.recipe, run.recipe.points)
        super().__init__(
            clip=run.header.clip_name,
            recipe=run.recipe.name,
            frames=frames,
            pictures=pictures,
            saves_to=str(run.folder),
            wants=wanted,
            free=False,
            draft=Draft(run.first),
            first=run.first,
            last=run.last,
        )
        self._about["learns"] = not isinstance(run.recipe, OpenCvRecipe)  # those begin anew in any case
        if unsaved:
            what = "tracking what was corrected the last time"
            self.begin(what, None, self._step(lambda report: self._go_on(unsaved, report)))

    def routes(self) -> Sequence[Route]:
        return (
            Route("GET", "api/rows", self._rows),
            Route("GET", "api/overview", self._overview),
            Route("POST", "api/track", self._track),
            Route("POST", "api/remove", self._remove),
            Route("POST", "api/undo", self._undo),
        )

    def proposals(self, index: int) -> Json:
        found = self._propose(index)
        return {**found, "proposals": [one for given in found["proposals"] for one in self._for_targets(given)]}

    def check_draft(self, draft: Draft) -> None:
        if not self.fixer.run.first <= draft.frame <= self.fixer.run.last:
            raise RefusedError(400, f"the run has no frame {draft.frame}")
        for name, one in draft.targets.items():
            if name not in self._parts:
                raise RefusedError(400, f"the run has no {name}; it has {', '.join(self._parts)}")
            spoken = [*one.points, *(() if one.absent is True else one.absent)]
            if unknown := [part for part in spoken if part not in self._parts[name]]:
                raise RefusedError(400, f"{name} has no {unknown[0]}; it has {', '.join(self._parts[name])}")

    def save(self, draft: Draft) -> None:
        if not draft.empty:
            raise RefusedError(422, f"what was moved in frame {draft.frame} is not tracked yet; track it, or clear it")
        self.begin("saving", None, self._write, of=draft)

    def close(self) -> None:
        super().close()
        self._propose.close()

    # what this session alone serves

    def _rows(self, request: Request) -> Json:
        run, rows = self.fixer.run, self.fixer.rows
        first = max(request.whole("from", 0), run.first)
        last = min(request.whole("to", first), run.last)
        if last - first > MOST_ROWS:
            raise RefusedError(400, f"{last - first + 1} frames are too many; {MOST_ROWS} are given")
        return {
            "from": first,
            "parts": [[name, part] for name, parts in self._parts.items() for part in parts],
            "frames": cells(rows, first, last + 1),
        }

    def _overview(self, request: Request) -> Json:
        bins = request.whole("bins", 1, MOST_BINS, 400)
        corrections, rows = self.fixer.now
        return overview(rows, bins, corrections)

    def _track(self, request: Request) -> Answer:
        draft = self.fresh(request.body.get("base"))
        self.refuse_if_busy()
        given = self._corrections(draft)
        if "learn" in request.body:
            learn = request.body["learn"]
            if not (learn is None or isinstance(learn, bool)):
                raise RefusedError(400, "learn is true, false or null")
            given = [one if one.absent is True else replace(one, learn=learn) for one in given]
        for one in given:
            self.fixer.check(one)
        names = ", ".join(one.target for one in given)

        def work(report: Done) -> None:
            self.fixer.put(given, report=report, stop=self.stopping.is_set)
            with self.lock:
                if self.draft is draft:  # else somebody goes on with another one
                    self.change(Draft(draft.frame))

        self.begin(f"tracking {names}", None, self._step(work))
        return Answer({}, 202)

    def _remove(self, request: Request) -> Answer:
        frame, target = request.body.get("frame"), request.body.get("target")
        if not isinstance(frame, int) or not isinstance(target, str) or self.fixer.find(frame, target) is None:
            raise RefusedError(422, "there is no such correction")

        def work(report: Done) -> None:
            self.fixer.remove(frame, target, report=report, stop=self.stopping.is_set)

        self.begin(f"tracking {target}", None, self._step(work))
        return Answer({}, 202)

    def _undo(self, request: Request) -> Answer:
        if not self.fixer.can_undo:
            raise RefusedError(422, "there is nothing to undo")
        self.begin("undoing", None, self._step(lambda report: self.fixer.undo()))
        return Answer({}, 202)

    def _corrections(self, draft: Draft) -> list[Correction]:
        """What the draft puts right, over what its frame has already. Raises RefusedError (422) if that is nothing."""
        found = []
        for name, one in draft.targets.items():
            if one.empty:
                continue
            at = one.rounded()
            before = self.fixer.find(draft.frame, name)
            found.append(merged(draft.frame, name, at.box, at.points, one.absent, before, self._parts[name]))
        if not found:
            raise RefusedError(422, f"nothing is put right in frame {draft.frame}; move a part, or mark it as absent")
        return found

    def _go_on(self, corrections: Sequence[Correction], report: Done) -> None:
        """Take up what was not saved the last time."""
        try:
            self.fixer.apply(corrections, report=report, stop=self.stopping.is_set)
        except FacetrackError as e:
            raise InputError(f"the corrections of the last time were left out: {e}") from e
        self.say("the corrections of the last time, which were not saved, are taken up; undo leaves them out")

    def _step(self, work: Callable[[Done], None]) -> Callable[[Report], None]:
        """Work on the corrections, after which they are kept in a file, and the page asks for the rows again."""

        def job(report: Report) -> None:
            try:
                work(report)
            except StoppedError:
                return
            with self.lock:
                self.rows_revision += 1
                self.can_undo = self.fixer.can_undo
            keep(self.fixer)

        return job

    def _write(self, report: Report) -> None:
        try:
            said = save(self.fixer, video=self.video, report=report, stop=self.stopping.is_set)
        except StoppedError:
            return
        self.end(said, f"facetrack report {self.fixer.run.folder} --overwrite")

    def _for_targets(self, given: Json) -> list[Json]:
        """A proposal for the targets of the run: a face may be any of them where the recipe names none."""
        targets = given["targets"]
        if self.fixer.run.recipe.followed:
            known = {name: one for name, one in targets.items() if name in self._parts}
            return [{**given, "targets": {name: self._fitted(name, one) for name, one in known.items()}}]
        [face] = targets.values()
        label = f"{given['label']}: {{}}" if len(self._parts) > 1 else given["label"]
        return [{"label": label.format(name), "targets": {name: self._fitted(name, face)}} for name in self._parts]

    def _fitted(self, name: str, one: Json) -> Json:
        if self._parts[name] == (BOX,):
            return {"box": one["box"], "points": {}}
        return {"box": None, "points": one["points"]} if one["points"] else {"box": one["box"], "points": {}}


def _want(target: str, parts: tuple[str, ...]) -> Json:
    """What may be put right of a target. The box of points is where they are placed anew by the picture."""
    about = {part: WHAT_PARTS_ARE[part] for part in parts if part in WHAT_PARTS_ARE}
    boxed = parts == (BOX,)
    return {
        "target": target,
        "box": "needed" if boxed else "optional" if set(parts) <= set(PARTS) else "no",
        "points": [] if boxed else list(parts),
        "about": {**about, "box": about_box(target)},
    }
