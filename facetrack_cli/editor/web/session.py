"""What choosing targets and correcting them have in common: a draft, of which there is one, and who may change it.

A subclass says what is wanted, proposes, and saves; what only it serves is its own table of routes. Every method may
be called from several threads at once. Whatever takes long runs as the one job, in a thread of its own.
"""

from __future__ import annotations

import contextlib
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, ClassVar, Final, Literal, TypeAlias

from facetrack_cli.core.errors import FacetrackError, InputError
from facetrack_cli.editor.web.draft import Draft, DraftError, Json, read_draft
from facetrack_cli.editor.web.routes import Answer, RefusedError, Request, Route

if TYPE_CHECKING:
    from facetrack_cli.editor.web.pictures import Pictures
    from facetrack_cli.video.seek import Frames

LINGER_S: Final = 2.0  # after the last client was told that all is over
LAST_S: Final = 5.0  # after it was over, told or not
LARGEST_CROP: Final = 1024  # pixels of a side
Report: TypeAlias = Callable[[int, "int | None"], None]  # done, and in all if that is known


class Session(ABC):
    """One page, until it is saved or stopped. `saves_to` is what the page calls the place that it writes to."""

    mode: ClassVar[Literal["pick", "fix"]]

    def __init__(
        self,
        *,
        clip: str,
        recipe: str | None,
        frames: Frames,
        pictures: Pictures,
        saves_to: str,
        wants: Sequence[Json],
        free: bool,
        draft: Draft,
        first: int = 0,
        last: int | None = None,
    ) -> None:
        self.frames = frames
        self.pictures = pictures
        self.first, self.last = first, last  # None: the clip's last frame
        self.lock = threading.RLock()
        self.stopping = threading.Event()  # a job looks at it now and then
        self.draft = draft
        self.revision = 0
        self.rows_revision = 0
        self.can_undo = False
        self.message: str | None = None
        self.ended: Json | None = None
        self._job: Json | None = None
        self._worker: threading.Thread | None = None
        self._closing = False
        self._ended_at = self._seen_at = 0.0
        self.first_fault: Exception | None = None
        self._about: Json = {
            "mode": self.mode,
            "clip": clip,
            "recipe": recipe,
            "wants": list(wants),
            "free": free,
            "saves_to": saves_to,
        }

    # what a subclass says

    @abstractmethod
    def proposals(self, index: int) -> Json:
        """{"frame", "proposals", "note"} of a frame."""

    @abstractmethod
    def save(self, draft: Draft) -> None:
        """Begin the job that writes the draft and calls `end`; raises RefusedError (422) if it lacks something.

        Called without the lock.
        """

    def check_draft(self, draft: Draft) -> None:  # noqa: B027 -- any draft will do
        """Raises RefusedError (400) for a draft that this session cannot hold; called with the lock."""

    def routes(self) -> Sequence[Route]:
        """What it serves beyond `shared_routes`."""
        return ()

    # what a subclass may use

    def change(self, draft: Draft) -> None:
        """Put another draft in the place of this one, for every client."""
        with self.lock:
            self.draft = draft
            self.revision += 1

    def begin(self, what: str, total: int | None, work: Callable[[Report], None], *, of: Draft | None = None) -> None:
        """Run `work` as the job, in its own thread. Raises RefusedError (409) as `refuse_if_busy`.

        What it raises becomes the message: one line, and the session goes on. With `of` it is the last job, of that
        draft: refused (409) if there is another by now, and no draft is taken during it.
        """
        with self.lock:
            self.refuse_if_busy()
            if of is not None and of is not self.draft:
                raise RefusedError(409, "another window has changed the draft", self.state())
            self._job = {"what": what, "done": 0, "total": total}
            self._closing = of is not None
            self.message = None
            self._worker = threading.Thread(target=self._run, args=(work,), daemon=True)
            self._worker.start()

    def refuse_if_busy(self) -> None:
        """Raises RefusedError (409) while a job runs, and after the end."""
        with self.lock:
            if self.ended is not None:
                raise RefusedError(409, "all is saved, and this page is over", self.state())
            if self._job is not None:
                raise RefusedError(409, f"busy: {self._job['what']}; wait for its end", self.state())

    def fresh(self, base: object) -> Draft:
        """The draft, if `base` is its revision. Raises RefusedError: 409, with the state, if not; 400 for no number."""
        if isinstance(base, bool) or not isinstance(base, int):
            raise RefusedError(400, "base is the revision of the draft, a whole number")
        with self.lock:
            if base != self.revision:
                raise RefusedError(409, "another window has changed the draft", self.state())
            return self.draft

    def say(self, message: str | None) -> None:
        """Have the page show one line, or none."""
        with self.lock:
            self.message = message

    def end(self, said: Sequence[str], next_: str | None) -> None:
        """All is done: `said`, a line each, and the command to go on with."""
        with self.lock:
            self.ended = {"said": list(said), "next": next_}
            self._ended_at = time.monotonic()

    # what the server asks

    def shared_routes(self) -> Sequence[Route]:
        return (
            Route("GET", "api/session", lambda _: self.about()),
            Route("GET", "api/state", lambda _: self.told_state()),
            Route("PUT", "api/draft", self._put_draft),
            Route("GET", "api/frame/{}.jpg", self._frame),
            Route("GET", "api/crop/{}.png", self._crop),
            Route("GET", "api/proposals/{}", self._proposals),
            Route("POST", "api/save", self._save),
        )

    def about(self) -> Json:
        """What does not change while the page is open, but for how long the clip is known to be."""
        return {
            **self._about,
            "size": list(self.frames.size),
            "fps": float(self.frames.fps),
            "frames": self._range(),
        }

    def state(self) -> Json:
        """What changes."""
        with self.lock:
            return {
                "revision": self.revision,
                "draft": self.draft.to_json(),
                "rows_revision": self.rows_revision,
                "job": None if self._job is None else dict(self._job),
                "can_undo": self.can_undo,
                "ended": self.ended,
                "frames": self._range(),
                "message": self.message,
            }

    def told_state(self) -> Json:
        """The state, and a note that a client was told of the end."""
        with self.lock:
            if self.ended is not None:
                self._seen_at = time.monotonic()
            return self.state()

    def over(self) -> bool:
        """Whether the server may go: it has ended, and the pages had time to hear of it."""
        with self.lock:
            if self.ended is None:
                return False
            now = time.monotonic()
            told = self._seen_at > 0 and now - self._seen_at >= LINGER_S
            return told or now - self._ended_at >= LAST_S

    def close(self) -> None:
        """Have the job end, and wait for it."""
        self.stopping.set()
        worker = self._worker
        if worker is not None:
            worker.join()

    def _run(self, work: Callable[[Report], None]) -> None:
        def report(done: int, total: int | None) -> None:
            with self.lock:
                self._job = {**(self._job or {}), "done": done, "total": total}

        said: str | None = None
        try:
            work(report)
        except FacetrackError as e:
            said = str(e)
        except Exception as e:
            said = f"this is our fault, not yours: {type(e).__name__}: {e}"
            self.fault(e)
        finally:
            with self.lock:
                self._job = None
                self._closing = False
                if said is not None:
                    self.message = " ".join(said.splitlines())

    def fault(self, error: Exception) -> None:
        """Remembers the first error of our own, for the end."""
        with self.lock:
            if self.first_fault is None:
                self.first_fault = error

    def _range(self) -> Json:
        last = max(self.frames.count - 1, self.first) if self.last is None else self.last
        return {"first": self.first, "last": last, "exact": self.frames.exact or self.last is not None}

    def _put_draft(self, request: Request) -> Json:
        try:
            draft = read_draft(request.body.get("draft"))
        except DraftError as e:
            raise RefusedError(400, str(e)) from None
        with self.lock:
            self.fresh(request.body.get("base"))
            if self.ended is not None or self._closing:
                self.refuse_if_busy()
            self.check_draft(draft)
            self.message = None
            self.change(draft)
            return {"revision": self.revision}

    def _save(self, request: Request) -> Answer:
        draft = self.fresh(request.body.get("base"))
        self.refuse_if_busy()
        self.save(draft)
        return Answer({"job": self.state()["job"]}, 202)

    def _frame(self, request: Request) -> Answer:
        index = self._index(request)
        reduce = request.whole("reduce", 1, 8, 1)
        if reduce not in (1, 2, 4, 8):
            raise RefusedError(400, f"reduce is {reduce}; it may be 1, 2, 4 or 8")
        with _past_end():
            return Answer(self.pictures.jpeg(index, reduce), kind="image/jpeg")

    def _crop(self, request: Request) -> Answer:
        index = self._index(request)
        x, y = request.whole("x"), request.whole("y")
        w, h = request.whole("w", 1, LARGEST_CROP), request.whole("h", 1, LARGEST_CROP)
        width, height = self.frames.size
        if not (-w < x < width and -h < y < height):
            raise RefusedError(404, f"nothing of the picture of {width}x{height} pixels is there")
        with _past_end():
            return Answer(self.pictures.crop(index, x, y, w, h), kind="image/png")

    def _proposals(self, request: Request) -> Json:
        index = self._index(request)
        with _past_end():
            return self.proposals(index)

    def _index(self, request: Request) -> int:
        [index] = request.numbers
        known = self._range()
        if index < self.first or (known["exact"] and index > known["last"]):
            raise RefusedError(404, f"there is no frame {index}; they go from {self.first} to {known['last']}")
        return index


@contextlib.contextmanager
def _past_end() -> Iterator[None]:
    """A frame that cannot be read is not there."""
    try:
        yield
    except InputError as e:
        raise RefusedError(404, str(e)) from None
