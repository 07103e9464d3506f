"""Correcting a finished run on a page.

A part that is dragged is a correction, and its target is tracked again from there. The people of a film are merged,
renamed and split, and doubts are settled.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal

import numpy as np
from pydantic import Field, StrictBool, StrictInt
from pydantic_core import to_jsonable_python

from facetrack_cli.core.errors import FacetrackError, InputError, UsageError, flat
from facetrack_cli.core.face_points import HANDS
from facetrack_cli.core.numbers import spans
from facetrack_cli.core.types import BOX, Correction
from facetrack_cli.editor.fixer import corrections_of, fixing, is_tracked_again, keep, merged, save
from facetrack_cli.editor.session import Answer, Draft, Json, Page, Session, jpeg, requirement
from facetrack_cli.engine.corrected import correctable_parts
from facetrack_cli.recipe.model import OpenCvRecipe
from facetrack_cli.run_folder.manifest import read_run
from facetrack_cli.runs.finished import Run
from facetrack_cli.runs.people import film_of, people_in, recast, still_of
from facetrack_cli.runs.plan import Report
from facetrack_cli.trackers.face.detectors import PARTS
from facetrack_cli.trajectory import people as changes
from facetrack_cli.trajectory.diagnostics import outlines
from facetrack_cli.trajectory.people import Change, Tracks
from facetrack_cli.trajectory.reader import UNSAVED, FrameNumber
from facetrack_cli.trajectory.trajectory import Trajectory
from facetrack_cli.trajectory.views import Clock, choose
from facetrack_cli.trajectory.writers import by_frame
from facetrack_cli.video.source import Frames

MAX_ROWS: Final = 600
MAX_DOUBTFUL: Final = 100


class FixSession(Session):
    """The corrections of one run. Those that the last session did not save are applied first.

    With `video`, Save also writes the annotated video again, if the run has one.
    """

    mode: ClassVar[Literal["fix"]] = "fix"

    def __init__(self, run: Run, *, video: bool = True) -> None:
        self.video = video
        self.saved: list[str] = []  # a line on each file, of the last save
        self.saves = self.rows_revision = 0
        self._parts = run.parts
        # the box of points places all of them again in the image
        points = {name: () if parts == (BOX,) else correctable_parts(parts) for name, parts in self._parts.items()}
        about = {
            "clip": run.header.clip_name + f": {run.rows.targets[0]}" * run.film,
            "recipe": run.recipe.name,
            "lost_below": {name: run.recipe.lost_below(name) for name in self._parts},
            "requirements": [requirement(n, own, "" if set(own) <= set(PARTS) else "no") for n, own in points.items()],
            "free": False,
            "saves_to": str(run.folder),
            "again": is_tracked_again(run),
            "learns": not isinstance(run.recipe, OpenCvRecipe),  # OpenCV's trackers always learn again
        }
        with ExitStack() as stack:
            self.fixer, frames = stack.enter_context(fixing(run))
            super().__init__(frames, Draft(run.first, {}), about, first=run.first, last=run.last)
            self.resources = stack.pop_all()
        self._kept: Path | None = None  # the file with which the next session goes on
        unsaved = run.folder / UNSAVED
        try:
            last = corrections_of(unsaved, run) if unsaved.is_file() else ()
        except FacetrackError as e:  # they are not of this run any more
            last, self.message = (), f"{flat(str(e))}; the page begins without it"
        if last:
            self._kept = unsaved
            self._begin("tracking the corrections of the last session", partial(self._resume, last))

    def post_save(self) -> Json:
        if not all(target.empty for target in self.draft.targets.values()):
            frame = self.draft.frame
            raise UsageError(f"what was moved in frame {frame} is not tracked yet; track it, or discard it")
        return self.start_job("saving", self._write)

    def get_rows(self, first: int, last: int) -> Json:
        """The rows of frames `first` to `last`, both included, of so many as are sent at a time."""
        first = max(first, self.fixer.run.first)
        last = min(last, self.fixer.run.last, first + MAX_ROWS)
        parts = [(name, part) for name, parts in self._parts.items() for part in parts]
        return {"first": first, "parts": parts, "frames": cells(self.fixer.rows, first, last + 1)}

    def get_overview(self, bins: Annotated[int, Field(ge=1, le=4000)] = 400) -> Json:
        corrections, rows = self.fixer.now
        return overview(rows, bins, corrections, self._about["lost_below"])

    def post_track(self, learn: StrictBool | None = None) -> Json:
        """Make the draft a correction of its frame. `learn` as of Correction."""
        frame, parts = self.draft.frame, self._parts
        new = [
            Correction(frame, name, start.box, start.points, absent=target.absent)
            for name, target in self.draft.targets.items()
            for start in [target.rounded()]
            if name in parts and not target.empty
        ]
        if not new:
            raise UsageError(f"nothing is corrected in frame {frame}; move a part, or mark it as absent")
        both = [merged(fix, self.fixer.find(frame, fix.target), parts[fix.target]) for fix in new]
        corrections = [replace(correction, learn=learn) for correction in both]

        def work(**options: Any) -> None:
            self.fixer.put(corrections, **options)
            self.draft = Draft(frame, {})  # it is a correction now

        return self._begin(f"tracking {', '.join(correction.target for correction in corrections)}", work)

    def post_remove(self, frame: FrameNumber, target: str) -> Json:
        if self.fixer.find(frame, target) is None:
            raise UsageError("there is no such correction")
        return self._begin(f"tracking {target}", partial(self.fixer.remove, frame, target))

    def post_exchange(self, frame: FrameNumber) -> Json:
        """From a frame on each of two hands is where the other is: a correction of both."""
        hands, rows = [name for name in HANDS if name in self._parts], self.fixer.rows.at(frame)
        boxes = {name: choose(rows, other).boxes[0].round(2) for name, other in zip(hands, hands[::-1], strict=True)}
        seen = {name: tuple(box.tolist()) for name, box in boxes.items() if np.isfinite(box).all()}
        if len(hands) < 2 or not seen:
            raise UsageError(f"there are no two hands in frame {frame}")
        both = [Correction(frame, hand, seen.get(hand), absent=hand not in seen or ()) for hand in hands]
        return self._begin(f"tracking {', '.join(hands)}", partial(self.fixer.put, both))

    def post_confirm(self, frame: FrameNumber, target: str, part: str, stretch: StrictBool = False) -> Json:
        """A part lies right in a frame, or in the whole `stretch` around it in which it is called lost."""
        row = self.fixer.rows.find(target, part)
        at = None if row is None else row.row(frame)
        if row is None or at is None or not np.isfinite(row.x[at]) or row.status[at] == "absent":
            raise UsageError(f"{target} {part} has no place in frame {frame}; give it one")
        lost = next((span for span in spans(row.status == "lost") if span[0] <= at < span[1]), (at, at + 1))
        first, stop = lost if stretch else (at, at + 1)
        corrections = []
        for index in row.frame[first:stop][:MAX_ROWS].tolist():
            before = self.fixer.find(index, target)
            if before is not None and not before.confirmed:
                raise UsageError(f"{target} is corrected in frame {index} already; place {part} there")
            corrections.append(merged(Correction(index, target, confirmed=(part,)), before, self._parts[target]))
        return self._begin(f"confirming {target}", partial(self.fixer.put, corrections))

    def post_done(self) -> Json:
        """End the session; what is not saved is kept for the next one."""
        self.refuse_if_busy()
        folder, by = self.fixer.run.folder, self.fixer.run.fixed_by
        left = [f"{self._kept}: corrections that are not saved; {by} goes on with them"] if self._kept else []
        nothing = [f"{folder}: nothing was corrected, all is as it was"]
        return self.end(self.saved + left or nothing, f"facetrack report {folder} --overwrite")

    def left(self) -> str:
        if kept := self._kept:
            goes_on = f"all else is as it was; {self.fixer.run.fixed_by} goes on with them"
            return f"the corrections are kept in {kept}, {goes_on}"
        return "what was saved stays" if self.saves else super().left()

    def post_undo(self) -> Json:
        if not self.fixer.can_undo:
            raise UsageError("there is nothing to undo")
        return self._begin("undoing", lambda **_: self.fixer.undo())

    def _begin(self, what: str, work: Callable[..., None]) -> Json:
        """Begin the job `work`, which takes `report` and `stop` and changes the corrections; these are then kept."""

        def job(report: Report) -> None:
            work(report=report, stop=self.stopping.is_set)
            with self.lock:
                self.rows_revision += 1
                self._kept = keep(self.fixer)

        return self.start_job(what, job)

    def _resume(self, corrections: Sequence[Correction], **options: Any) -> None:
        """Apply the corrections that the last session did not save."""
        try:
            self.fixer.apply(corrections, **options)
        except FacetrackError as e:
            self._kept = None
            raise InputError(f"the corrections of the last session were left out: {e}") from e
        with self.lock:
            self.message = "the corrections of the last session, which were not saved, are applied; undo removes them"

    def _write(self, report: Report) -> None:
        messages = save(self.fixer, video=self.video, report=report, stop=self.stopping.is_set)
        with self.lock:
            self.saved, self.saves, self.rows_revision = messages, self.saves + 1, self.rows_revision + 1
            self._kept = None

    def get_state(self) -> Json:
        with self.lock:
            undo = {"can_undo": self.fixer.can_undo, "rows_revision": self.rows_revision}
            saved = {"saves": self.saves, "saved": self.saved, "unsaved": self.fixer.changed}
            return {**super().get_state(), **undo, **saved}


def overview(rows: Trajectory, bins: int, corrections: Sequence[Correction], lost_below: Mapping[str, float]) -> Json:
    """Ready for JSON: of each of `bins` equal spans the least confidence of all parts, None if unknown, whether a part
    is lost, and whether some parts are absent, 1, or all of them, 2; the doubtful frames; the corrections.
    """
    first, last = int(rows.frame[0]), int(rows.frame[-1])
    count = last - first + 1
    bins = min(bins, count)
    edges = np.arange(bins) * count // bins
    status = np.array([part.status for part in rows.parts])
    absent, lost = status == "absent", (status == "lost").any(axis=0)
    least = np.fmin.reduceat(np.fmin.reduce([part.confidence for part in rows.parts]), edges).tolist()
    return {
        "first": first,
        "last": last,
        "least": [None if math.isnan(sure) else sure for sure in least],
        "lost": np.logical_or.reduceat(lost, edges).tolist(),
        "absent": np.maximum.reduceat(absent.any(axis=0).astype(int) + absent.all(axis=0), edges).tolist(),
        "doubtful": doubtful(rows, lost_below),
        "corrections": to_jsonable_python([fix for fix in corrections if fix.frame <= last]),
    }


def doubtful(rows: Trajectory, lost_below: Mapping[str, float]) -> list[dict[str, Any]]:
    """The worst frame of each span in which a part is lost, or its confidence below that of its target, worst first."""
    worst = []
    for column, part in enumerate(rows.parts):
        sure = part.confidence
        low = (part.status == "lost") | (sure < lost_below[part.target])
        doubts = spans(np.isfinite(sure) & (part.status != "absent") & low)
        rows_of = [begin + int(np.argmin(sure[begin:end])) for begin, end in doubts]
        worst += sorted((float(sure[row]), row, column) for row in rows_of)[:MAX_DOUBTFUL]
    keys, first = ("frame", "target", "part", "confidence", "status"), int(rows.frame[0])
    cells = (
        (first + row, *rows.names[column], sure, str(rows.parts[column].status[row]))
        for sure, row, column in sorted(worst)[:MAX_DOUBTFUL]
    )
    return [dict(zip(keys, cell, strict=True)) for cell in cells]


def cells(rows: Trajectory, first: int, stop: int) -> list[list[list[Any]]]:
    """Of each frame in [first, stop) and each part: x, y, w, h, angle, confidence, status, whether by hand, corners."""
    some = rows.between(first, stop)
    numbers = np.stack([getattr(some, name) for name in ("x", "y", "w", "h", "angle", "confidence")], axis=1).tolist()
    shapes: list[Any] = [None] * len(some)
    if (corners := outlines(some)) is not None:
        shapes = [None if math.isnan(shape[0][0]) else shape for shape in corners.round(2).tolist()]
    lines = [
        [*(None if math.isnan(value) else value for value in row), *others]
        for row, *others in zip(numbers, some.status.tolist(), some.by_hand.tolist(), shapes, strict=True)
    ]
    return [[lines[i] for i in at] for _, at in by_frame(some)]


class CastSession(Page):
    """The people of the run in `folder`; its clip may be elsewhere now. Nothing is written before it is saved."""

    index = "cast.html"

    def __init__(self, folder: Path, elsewhere: Path | None = None, *, video: bool = True) -> None:
        super().__init__()
        self.before, self._rows = people_in(folder), read_run(folder)
        clip, how = film_of(self.before, self._rows, elsewhere)
        if clip is None:
            raise UsageError(f"{folder}: does not name its clip; give it with --clip")
        self.folder, self.clip, self.video = folder, clip, video
        self.frames = self.resources.enter_context(Frames(clip, **how))
        self._clock = Clock(self._rows, self.before.fps)
        self._steps: list[tuple[Change, Tracks]] = []
        self.saved = 0  # changes
        self._still = lru_cache(256)(lambda who, first, stop: still_of(self._rows, who, first, stop, self.frames.read))

    @property
    def tracks(self) -> Tracks:
        return self._steps[-1][1] if self._steps else self.before.tracks

    def get_state(self) -> Json:
        with self.lock:
            still = changes.photographs(self.before, self.tracks)
            people = changes.people_of(self._clock, self.before.shots, self.tracks, {}, still)
            return {
                **super().get_state(),
                "clip": self.clip.name,
                "folder": str(self.folder),
                **people.model_dump(mode="json", include={"people", "tracks", "fps"}),
                "doubts": [doubt.model_dump(mode="json") for doubt in people.doubts],
                "cuts": [shot.first for shot in people.shots[1:]],
                "clock": self._clock.points(),
                "first": people.shots[0].first,
                "last": max(int(self._rows.frame.max()), *(track.stop - 1 for track in people.tracks)),
                "changes": [words for (words, _), _ in self._steps],
            }

    def post_merge(self, name: str, to: str) -> Json:
        return self._change(f"merge {name}={to}", partial(changes.merge, name=name, into=to))

    def post_rename(self, name: str, to: str) -> Json:
        return self._change(f"rename {name}={to}", partial(changes.rename, name=name, to=to))

    def post_split(self, name: str, frame: StrictInt) -> Json:
        return self._change(f"split {name}@{frame}f", partial(changes.split, name=name, frame=frame))

    def post_give(self, name: str, frame: StrictInt, to: str | None = None) -> Json:
        """The track of `name` in a frame is of `to`, or of somebody new."""
        return self._change(f"give {name}@{frame}f={to or ''}", partial(changes.give, name=name, frame=frame, to=to))

    def _change(self, words: str, change: Callable[[Tracks], Tracks]) -> Json:
        with self.lock:
            self.refuse_if_busy()
            self._steps.append(((words, change), change(self.tracks)))
            return self.get_state()

    def post_undo(self) -> Json:
        with self.lock:
            self.refuse_if_busy()
            del self._steps[-1:]
            return self.get_state()

    def post_save(self) -> Json:
        self.start_job("saving", self._write)
        return self.get_state()

    def left(self) -> str:
        lost = f"; not saved: {', '.join(words for (words, _), _ in self._steps)}" if self._steps else ""
        return ("what was saved stays" if self.saved else super().left()) + lost

    def _write(self, report: Callable[[int, int | None], None]) -> None:
        steps = [change for change, _ in self._steps]
        if steps:
            recast(
                self.folder, steps, clip=self.clip, video=self.video, stop=self.stopping.is_set,
                report=lambda done, total, *_: report(done, total),
            )  # fmt: skip
        with self.lock:
            self.before, self._rows, self._steps = people_in(self.folder), read_run(self.folder), []
            self._still.cache_clear()
            self.saved += len(steps)
            self.message = self._said()

    def _said(self) -> str:
        return f"{self.folder}: {self.saved} change{'s' if self.saved != 1 else ''} saved"

    def post_done(self) -> Json:
        """End the session; changes that are not saved are gone."""
        with self.lock:
            self.refuse_if_busy()
            self.end([self._said()], f"facetrack people {self.folder}")
            return self.get_state()

    def get_frame(self, frame: int, reduce: Literal["1", "2", "4", "8"] = "1") -> Answer:
        return Answer(jpeg(self.frames, frame, int(reduce)), kind="image/jpeg")

    def get_still(self, first: int, stop: int, person: str) -> Answer:
        with self.lock:
            targets = {(track.person, track.first, track.stop): track.target for track in self.tracks}
        if (person, first, stop) not in targets:
            raise UsageError("there is no such track any more")
        return Answer(self._still(targets[person, first, stop], first, stop), kind="image/jpeg")
