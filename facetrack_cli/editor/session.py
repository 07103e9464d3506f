"""What pages have in common: one job in a thread; of picking and fixing one draft and its frames.

All methods are thread-safe."""

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Final, Literal, NamedTuple, TypeAlias

import cv2
import numpy as np
from pydantic import ConfigDict, Field, validate_call
from pydantic_core import to_jsonable_python

from facetrack_cli.core.errors import FacetrackError, UsageError, flat
from facetrack_cli.core.types import TargetStart
from facetrack_cli.runs.plan import Report
from facetrack_cli.runs.signals import StoppedError
from facetrack_cli.start.init_file import NAME
from facetrack_cli.trajectory.reader import FrameNumber, Pixels, Side
from facetrack_cli.video.source import Frames

LINGER_S: Final = 3.0  # the server goes on so long after the end: each page asks for the state once a second
JPEG_QUALITY: Final = 90
Json: TypeAlias = dict[str, Any]
Name: TypeAlias = Annotated[str, Field(pattern=f"^(?:{NAME.pattern})$")]


@dataclass(frozen=True, slots=True)
class DraftTarget:
    """One target of a draft: box (left, top, width, height), points (x, y), and absent parts, True for all of them."""

    __pydantic_config__ = ConfigDict(extra="forbid")
    box: tuple[Pixels, Pixels, Side, Side] | None = None
    points: Mapping[Name, tuple[Pixels, Pixels]] = field(default_factory=dict)
    absent: tuple[Name, ...] | Literal[True] = ()

    @property
    def empty(self) -> bool:
        return self.box is None and not self.points and not self.absent

    def rounded(self) -> TargetStart:
        """Its box and points to 0.01 px, as init files have them."""
        box: Any = self.box and tuple(round(value, 2) for value in self.box)
        return TargetStart(box, {part: (round(x, 2), round(y, 2)) for part, (x, y) in self.points.items()})


@dataclass(frozen=True, slots=True)
class Draft:
    """What is chosen in one frame, by target: well formed, and not necessarily complete."""

    __pydantic_config__ = ConfigDict(extra="forbid")
    frame: FrameNumber
    targets: Mapping[Name, DraftTarget]

    def placed(self) -> dict[str, TargetStart]:
        """The targets that have a box or points, to 0.01 px."""
        return {name: draft.rounded() for name, draft in self.targets.items() if draft.box is not None or draft.points}


def draft_of(frame: int, targets: Mapping[str, TargetStart]) -> Draft:
    """The draft of a start or a proposal."""
    return Draft(frame, {name: DraftTarget(target.box, dict(target.points)) for name, target in targets.items()})


def jpeg(frames: Frames, index: int, reduce: int = 1) -> bytes:
    """A frame as JPEG. Its sides are divided by `reduce` and rounded up, and its pixels are area means.

    Raises what `Frames.read` raises. Nothing is kept here: the page keeps the images that it has received.
    """
    image = frames.read(index).bgr
    if reduce > 1:
        size = -(-image.shape[1] // reduce), -(-image.shape[0] // reduce)
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    return cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))[1].tobytes()


class Answer(NamedTuple):
    """What a handler returns if it is not JSON with code 200: the `body` is JSON's value, or bytes or a file."""

    body: Any
    code: int = 200
    kind: str = "application/json"
    headers: Mapping[str, str] = {}


class Page:
    """What a server shows, until it is saved or stopped: one job in a thread, and how it ended.

    GET api/state is answered by the method `get_state`, POST api/draft by `post_draft`, and so on: it takes the fields
    of the query and the members of the JSON body by name, as its annotations allow (pydantic), and returns an Answer or
    the value of its JSON. PUT comes with the bytes `data`. A FacetrackError is shown on the page.
    """

    index: ClassVar[str] = "index.html"

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.stopping = threading.Event()  # a job looks at it regularly
        self.message: str | None = None
        self.ended: Json | None = None
        self.fault: str | None = None  # the first error of the program itself, a line
        self.opened: dict[str, Page] = {}  # the pages below this one, by the first part of their addresses
        self.resources = ExitStack()  # what is closed with the page
        self._handlers: dict[str, Callable[..., Any]] = {}
        self._job: Json | None = None
        self._worker: threading.Thread | None = None
        self._ended_at = 0.0

    def handler(self, name: str) -> Callable[..., Any] | None:
        """The method, as get_state, that checks what it is given; None if there is none."""
        if name not in self._handlers and hasattr(self, name):
            self._handlers[name] = validate_call(getattr(self, name))
        return self._handlers.get(name)

    def page_at(self, below: str) -> tuple["Page", str]:
        """Who serves an address below the token: this page, or one that is opened from it; and the rest of it."""
        name, slash, rest = below.partition("/")
        page = self.opened.get(name) if slash else None
        return (self, below) if page is None else (page, rest)

    def left(self) -> str:
        """What becomes of what was not saved, where the page is stopped; it may be written for the next time."""
        return "nothing was written"

    def get_state(self) -> Json:
        """What the page shows."""
        with self.lock:
            return {"job": self._job, "ended": self.ended, "message": self.message}

    def start_job(self, what: str, work: Callable[[Report], None]) -> Json:
        """Run `work` as the job. Its error is shown as the message. UsageError as of `refuse_if_busy`."""
        with self.lock:
            self.refuse_if_busy()
            self._job = {"what": what, "done": 0, "total": None}
            self.message = None
            self._worker = threading.Thread(target=self._run, args=(work,), daemon=True)
            self._worker.start()
        return {}

    def refuse_if_busy(self) -> None:
        """UsageError while a job runs, and after the end."""
        with self.lock:
            if self.ended is not None:
                raise UsageError("everything is saved, and this page has ended")
            if self._job is not None:
                raise UsageError(f"busy: {self._job['what']}; wait until it has finished")

    def end(self, messages: Sequence[str], next_: str | None) -> Json:
        """End the session: show the `messages`, a line each, and the command to continue with."""
        with self.lock:
            self.ended, self.message = {"messages": list(messages), "next": next_}, None
            self._ended_at = time.monotonic()
        return {}

    def over(self) -> bool:
        """Whether the server may stop: the session has ended, and the pages had time to learn of it."""
        with self.lock:
            return self.ended is not None and time.monotonic() - self._ended_at >= LINGER_S

    def close(self) -> None:
        """Stop the job, wait for it, and close the resources."""
        self.stopping.set()
        if self._worker is not None:
            self._worker.join()
        self.resources.close()

    def record(self, error: Exception) -> str:
        """The line that reports an error of the program itself; the first one is remembered for the end."""
        line = flat(f"internal error; please report it: {type(error).__name__}: {error}")
        with self.lock:
            self.fault = self.fault or line
        return line

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
            message = flat(str(e))
        except Exception as e:
            message = self.record(e)
        finally:
            with self.lock:
                self._job = None
                self.message = message or self.message


class Session(Page):
    """A page of picking or fixing; `post_save` of a subclass begins the job that writes the draft.

    `about`: {"clip", "recipe", "requirements", "free", "saves_to"} and more, for the page. Frames go from `first` to
    `last`, None for the clip's last one.
    """

    mode: ClassVar[Literal["pick", "fix"]]

    def __init__(self, frames: Frames, draft: Draft, about: Json, *, first: int = 0, last: int | None = None) -> None:
        super().__init__()
        self.frames, self.draft, self.first, self.last = frames, draft, first, last
        self._about = about

    def get_session(self) -> Json:
        """What does not change while the page is open, but that the clip's last frame may become known later."""
        clip = {"size": self.frames.size, "fps": float(self.frames.fps), "frames": self._range()}
        return {"mode": self.mode, **self._about, **clip}

    def get_state(self) -> Json:
        with self.lock:
            return {**super().get_state(), "draft": to_jsonable_python(self.draft), "frames": self._range()}

    def _range(self) -> Json:
        last = max(self.frames.count - 1, self.first) if self.last is None else self.last
        return {"first": self.first, "last": last, "exact": self.frames.exact or self.last is not None}

    def _check_frame(self, frame: int) -> None:
        frames = self._range()
        if frame < self.first or (frames["exact"] and frame > frames["last"]):
            raise UsageError(f"there is no frame {frame}; they go from {self.first} to {frames['last']}")

    def post_draft(self, draft: Draft) -> Json:
        with self.lock:
            self.refuse_if_busy()
            self._check_frame(draft.frame)
            self.message, self.draft = None, draft
            return {}

    def get_frame(self, frame: int, reduce: Literal["1", "2", "4", "8"] = "1") -> Answer:
        self._check_frame(frame)
        return Answer(jpeg(self.frames, frame, int(reduce)), kind="image/jpeg")
