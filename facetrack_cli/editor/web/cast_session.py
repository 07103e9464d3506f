"""The cast of a film on a page: people are merged, renamed and split, and doubts are settled."""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Literal

from pydantic import StrictInt

from facetrack_cli.editor.web.session import Answer, Json, Page, RefusedError, Route, jpeg
from facetrack_cli.runs.people import people_in, recast, rows_in, still_of
from facetrack_cli.trajectory import people as changes
from facetrack_cli.trajectory.clock import Clock
from facetrack_cli.trajectory.people import Tracks
from facetrack_cli.video.seek import Frames

Change = tuple[str, Callable[[Tracks], Tracks]]


class CastSession(Page):
    """The people of the run in `folder`, whose frames are at hand. Nothing is written before it is saved."""

    index, edits = "cast.html", "cast"

    def __init__(self, folder: Path, frames: Frames, clip: Path, *, video: bool) -> None:
        super().__init__()
        self.folder, self.frames, self.clip, self.video = folder, frames, clip, video
        self.before, self._rows = people_in(folder), rows_in(folder)
        self._clock = Clock(self._rows, self.before.fps)
        self._steps: list[tuple[Change, Tracks]] = []
        self.saved = 0  # changes
        self._still = lru_cache(256)(self._picture)

    @property
    def tracks(self) -> Tracks:
        """Each track, with the target of the run's rows that it belongs to."""
        return self._steps[-1][1] if self._steps else changes.tracks_of(self.before)

    def routes(self) -> Sequence[Route]:
        return (
            Route("GET", "api/state", self.state),
            Route("GET", "api/still/{first}/{stop}.jpg", self._still_of),
            Route("GET", "api/frame/{frame}.jpg", self._frame),
            Route("POST", "api/change", self._change),
            Route("POST", "api/undo", self._undo),
            Route("POST", "api/save", self._save),
            Route("POST", "api/done", self._done),
        )

    def state(self) -> Json:
        with self.lock:
            records = [track for _, track in self.tracks]
            still = changes.photographs(self.before, self.tracks)
            people = changes.people_of(self._clock, self.before.shots, records, {}, still)
            return {
                **super().state(),
                "clip": self.clip.name,
                "folder": str(self.folder),
                "people": [person.model_dump(mode="json") for person in people.people],
                "tracks": [track.model_dump(mode="json") for track in people.tracks],
                "doubts": [doubt.model_dump(mode="json") for doubt in people.doubts],
                "cuts": [shot.first for shot in people.shots[1:]],
                "fps": people.fps,
                "clock": self._clock.points(),
                "first": people.shots[0].first,
                "last": max(int(self._rows.frame.max()), *(track.stop - 1 for track in people.tracks)),
                "changes": [words for (words, _), _ in self._steps],
            }

    def _change(
        self,
        base: StrictInt,
        what: Literal["merge", "rename", "split", "give"],
        name: str,
        to: str | None = None,
        frame: StrictInt = 0,
    ) -> Json:
        """`name` is merged into `to`, renamed to it, split at `frame`, or its track in `frame` is given to `to`."""
        change: Callable[[Tracks], Tracks]
        if what == "merge":
            words, change = f"merge {name}={to}", partial(changes.merge, name=name, into=to or "")
        elif what == "rename":
            words, change = f"rename {name}={to}", partial(changes.rename, name=name, to=to or "")
        elif what == "split":
            words, change = f"split {name}@{frame}f", partial(changes.split, name=name, frame=frame)
        else:
            words, change = f"give {name}@{frame}f={to or ''}", partial(changes.give, name=name, frame=frame, to=to)
        with self.lock:
            self._check(base)
            self._steps.append(((words, change), change(self.tracks)))
            self.revision += 1
            return self.state()

    def _undo(self, base: StrictInt) -> Json:
        with self.lock:
            self._check(base)
            if self._steps:
                self._steps.pop()
                self.revision += 1
            return self.state()

    def _save(self, base: StrictInt) -> Answer:
        with self.lock:
            self._check(base)
            self.start_job("saving", self._write)
            return Answer(self.state(), 202)

    def _write(self, report: Callable[[int, int | None], None]) -> None:
        steps = [change for change, _ in self._steps]
        if steps:
            recast(
                self.folder, steps, clip=self.clip, video=self.video, stop=self.stopping.is_set,
                report=lambda done, total, *_: report(done, total),
            )  # fmt: skip
        with self.lock:
            self.before, self._rows, self._steps = people_in(self.folder), rows_in(self.folder), []
            self._still.cache_clear()
            self.saved += len(steps)
            self.revision += 1
            self.message = self._said()

    def _said(self) -> str:
        return f"{self.folder}: {self.saved} change{'s' if self.saved != 1 else ''} saved"

    def _done(self, base: StrictInt) -> Json:
        """End the session; changes that are not saved are gone."""
        with self.lock:
            self._check(base)
            self.end([self._said()], f"facetrack people {self.folder}")
            return self.state()

    def _check(self, base: int) -> None:
        """RefusedError (409) while a job runs, after the end, and for what was meant for an earlier state."""
        self.refuse_if_busy()
        self.refuse_unless(base == self.revision)

    def _frame(self, frame: int, reduce: Literal["1", "2", "4", "8"] = "1") -> Answer:
        return Answer(jpeg(self.frames, frame, int(reduce)), kind="image/jpeg")

    def _still_of(self, first: int, stop: int, person: str) -> Answer:
        with self.lock:
            targets = {(track.person, track.first, track.stop): target for target, track in self.tracks}
        if (person, first, stop) not in targets:
            raise RefusedError(404, "there is no such track any more")
        return Answer(self._still(targets[person, first, stop], first, stop), kind="image/jpeg")

    def _picture(self, target: str, first: int, stop: int) -> bytes:
        return still_of(self._rows, target, first, stop, self.frames.read)
