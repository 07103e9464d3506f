"""What pages have in common: one job in a thread; of picking and fixing, one draft. All methods are thread-safe."""

import re
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Annotated, Any, ClassVar, Final, Literal, NamedTuple, TypeAlias

from pydantic import Field, StrictInt, validate_call

from facetrack_cli.core.errors import FacetrackError
from facetrack_cli.editor.web.frame import Draft, Json, Proposer, crop, jpeg
from facetrack_cli.runs.plan import Report
from facetrack_cli.runs.signals import StoppedError
from facetrack_cli.video.seek import Frames

LINGER_S: Final = 3.0  # the server goes on so long after the end: each page asks for the state once a second
CropSide: TypeAlias = Annotated[int, Field(ge=1, le=1024)]


class RefusedError(Exception):
    """An answer in the 400s: its code, one line for the user, and more members of the JSON."""

    def __init__(self, code: int, message: str, more: Mapping[str, Any] | None = None) -> None:
        super().__init__(message)
        self.code, self.more = code, more or {}


class Answer(NamedTuple):
    """What a route returns if it is not JSON with code 200: `body` is JSON's value, or bytes or a file of a `kind`."""

    body: Any
    code: int = 200
    kind: str = "application/json"
    headers: tuple[tuple[str, str], ...] = ()


class Route(NamedTuple):
    """An address below the token; {name} in the `path` stands for a whole number, as in api/frame/{frame}.jpg.

    The handler takes the numbers of the path, the fields of the query and the members of the JSON body by name, as its
    annotations allow (pydantic; else 400), and returns an Answer or the value of its JSON. It may raise RefusedError;
    an InputError becomes 404 of a GET, any other FacetrackError 422. A `raw` body comes as the bytes `data`.
    """

    method: Literal["GET", "PUT", "POST"]
    path: str
    handler: Callable[..., Any]
    raw: bool = False


class Page(ABC):
    """What a server shows, until it is saved or stopped: one job in a thread, and how it ended."""

    index: ClassVar[str] = "index.html"
    edits: ClassVar[str] = "draft"  # what windows change

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.stopping = threading.Event()  # a job looks at it regularly
        self.revision = 0
        self.message: str | None = None
        self.ended: Json | None = None
        self.first_error: Exception | None = None  # of the program itself
        self._job: Json | None = None
        self._worker: threading.Thread | None = None
        self._saving = False
        self._ended_at = 0.0
        self.opened: dict[str, Page] = {}  # the pages below this one, by the first part of their addresses

    @cached_property
    def table(self) -> list[tuple[Route, re.Pattern[str], Callable[..., Any]]]:
        """The routes, with the pattern of their path, and a handler that checks what it is given."""
        patterns = (re.sub(r"\\{(\w+)\\}", r"(?P<\1>[0-9]{1,9})", re.escape(one.path)) for one in self.routes())
        both = zip(self.routes(), patterns, strict=True)
        return [(one, re.compile(pattern), validate_call(one.handler)) for one, pattern in both]

    def page_at(self, below: str) -> tuple["Page", str]:
        """Who serves an address below the token: this page, or one that is opened from it; and the rest of it."""
        name, slash, rest = below.partition("/")
        page = self.opened.get(name) if slash else None
        return (self, below) if page is None else (page, rest)

    @abstractmethod
    def routes(self) -> Sequence[Route]:
        """The addresses of the page."""

    @abstractmethod
    def state(self) -> Json:
        """What the page shows."""

    def start_job(self, what: str, work: Callable[[Report], None], *, saves: bool = False) -> None:
        """Run `work` as the job. Its error is shown as the message. RefusedError (409) as of `refuse_if_busy`."""
        with self.lock:
            self.refuse_if_busy()
            self._job = {"what": what, "done": 0, "total": None}
            self._saving = saves
            self.message = None
            self._worker = threading.Thread(target=self._run, args=(work,), daemon=True)
            self._worker.start()

    def refuse_if_busy(self) -> None:
        """RefusedError (409) while a job runs, and after the end."""
        with self.lock:
            if self.ended is not None:
                raise RefusedError(409, "everything is saved, and this page has ended", self.state())
            if self._job is not None:
                raise RefusedError(409, f"busy: {self._job['what']}; wait until it has finished", self.state())

    def refuse_if_stale(self, base: int) -> None:
        """RefusedError (409) with the state, unless `base` is the revision."""
        if base != self.revision:
            raise self._stale()

    def _stale(self) -> RefusedError:
        return RefusedError(409, f"another window has changed the {self.edits}", self.state())

    def end(self, messages: Sequence[str], next_: str | None) -> None:
        """End the session: show the `messages`, a line each, and the command to continue with."""
        with self.lock:
            self.ended = {"messages": list(messages), "next": next_}
            self._ended_at = time.monotonic()

    def over(self) -> bool:
        """Whether the server may stop: the session has ended, and the pages had time to learn of it."""
        with self.lock:
            return self.ended is not None and time.monotonic() - self._ended_at >= LINGER_S

    def close(self) -> None:
        """Stop the job, and wait for it."""
        self.stopping.set()
        if self._worker is not None:
            self._worker.join()

    def record(self, error: Exception) -> str:
        """The line that reports an internal error; the first one is remembered for the end."""
        with self.lock:
            self.first_error = self.first_error or error
        return internal_error(error)

    def _run(self, work: Callable[[Report], None]) -> None:
        def report(done: int, total: int | None) -> None:
            with self.lock:
                self._job = {**(self._job or {}), "done": done, "total": total}

        message: str | None = None
        try:
            work(report)
        except StoppedError:
            pass
        except FacetrackError as e:
            message = " ".join(str(e).splitlines())
        except Exception as e:
            message = self.record(e)
        finally:
            with self.lock:
                self._job = None
                self._saving = False
                self.message = message or self.message


class Session(Page):
    """A page of picking or fixing. `about`: {"clip", "recipe", "requirements", "free", "saves_to"} and more,
    for the page. Frames go from `first` to `last`, None for the clip's last one.
    """

    mode: ClassVar[Literal["pick", "fix"]]

    def __init__(
        self, frames: Frames, proposer: Proposer, draft: Draft, about: Json, *, first: int = 0, last: int | None = None
    ) -> None:
        super().__init__()
        self.frames, self.draft = frames, draft
        self.first, self.last = first, last
        self.rows_revision = 0
        self.can_undo = False
        self._proposer, self._about = proposer, about

    @abstractmethod
    def save(self, draft: Draft) -> None:
        """Begin the job that writes the draft and calls `end`; RefusedError (422) if something is missing. No lock."""

    def check_draft(self, draft: Draft) -> None:
        """RefusedError (400) for a draft that this session cannot hold; called with the lock."""

    def proposals(self, frame: int) -> Json:
        """{"frame", "proposals", "note"} of a frame."""
        return self._proposer(frame)

    def change(self, draft: Draft) -> None:
        """Replace the draft, for every client."""
        with self.lock:
            self.draft = draft
            self.revision += 1

    def begin(self, what: str, work: Callable[[Report], None], *, saves: Draft | None = None) -> None:
        """As `start_job`; RefusedError (409) if the job `saves` a draft that has changed meanwhile.

        While such a job runs, no draft is accepted.
        """
        with self.lock:
            self.refuse_if_busy()
            if saves is not None and saves is not self.draft:
                raise self._stale()
            self.start_job(what, work, saves=saves is not None)

    def current(self, base: int) -> Draft:
        """The draft, if `base` is its revision; else RefusedError (409) with the state."""
        with self.lock:
            self.refuse_if_stale(base)
            return self.draft

    def routes(self) -> Sequence[Route]:
        return (
            Route("GET", "api/session", self.about),
            Route("GET", "api/state", self.state),
            Route("PUT", "api/draft", self._put_draft),
            Route("GET", "api/frame/{frame}.jpg", self._frame),
            Route("GET", "api/crop/{frame}.png", self._crop),
            Route("GET", "api/proposals/{frame}", self._proposals),
            Route("POST", "api/save", self._save),
        )

    def about(self) -> Json:
        """What does not change while the page is open, but that the clip's last frame may become known later."""
        fps = float(self.frames.fps)
        return {"mode": self.mode, **self._about, "size": self.frames.size, "fps": fps, "frames": self._range()}

    def state(self) -> Json:
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

    def close(self) -> None:
        super().close()
        self._proposer.close()

    def _range(self) -> Json:
        last = max(self.frames.count - 1, self.first) if self.last is None else self.last
        return {"first": self.first, "last": last, "exact": self.frames.exact or self.last is not None}

    def _check_frame(self, frame: int) -> None:
        known = self._range()
        if frame < self.first or (known["exact"] and frame > known["last"]):
            raise RefusedError(404, f"there is no frame {frame}; they go from {self.first} to {known['last']}")

    def _put_draft(self, base: StrictInt, draft: Draft) -> Json:
        with self.lock:
            self.current(base)
            if self.ended is not None or self._saving:
                self.refuse_if_busy()
            self._check_frame(draft.frame)
            self.check_draft(draft)
            self.message = None
            self.change(draft)
            return {"revision": self.revision}

    def _save(self, base: StrictInt) -> Answer:
        draft = self.current(base)
        self.refuse_if_busy()
        self.save(draft)
        return Answer({"job": self.state()["job"]}, 202)

    def _frame(self, frame: int, reduce: Literal["1", "2", "4", "8"] = "1") -> Answer:
        self._check_frame(frame)
        return Answer(jpeg(self.frames, frame, int(reduce)), kind="image/jpeg")

    def _crop(self, frame: int, x: int, y: int, w: CropSide, h: CropSide) -> Answer:
        self._check_frame(frame)
        return Answer(crop(self.frames, frame, x, y, w, h), kind="image/png")

    def _proposals(self, frame: int) -> Json:
        self._check_frame(frame)
        return self.proposals(frame)


def internal_error(error: Exception) -> str:
    """The line that reports an error of the program itself."""
    return " ".join(f"internal error; please report it: {type(error).__name__}: {error}".splitlines())
