"""What pages have in common: one job in a thread; of picking and fixing one draft and its frames.

All methods are thread-safe. The page that chooses the start of a track knows which parts a recipe requires, and
whether a draft has them.
"""

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal, NamedTuple, TypeAlias

import cv2
import numpy as np
from pydantic import ConfigDict, Field, validate_call
from pydantic_core import to_jsonable_python

from facetrack_cli.core.errors import FacetrackError, InputError, UsageError, flat
from facetrack_cli.core.geometry import inside
from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.engine.spaces import check_size
from facetrack_cli.recipe.load import wants_gallery
from facetrack_cli.recipe.model import ParticlesRecipe, Recipe
from facetrack_cli.runs.plan import Report
from facetrack_cli.runs.signals import StoppedError
from facetrack_cli.start import init_file
from facetrack_cli.start.assembly import name_targets, tracker_for
from facetrack_cli.start.init_file import TARGET, WHAT_PARTS_ARE
from facetrack_cli.trackers.face.detectors import PARTS, NotHereError, detector, named, righted
from facetrack_cli.trajectory.reader import FrameNumber, Pixels, Side
from facetrack_cli.video.overlay import write_preview
from facetrack_cli.video.source import Frames

LINGER_S: Final = 3.0  # the server goes on so long after the end: each page asks for the state once a second
JPEG_QUALITY: Final = 90
Json: TypeAlias = dict[str, Any]
Name: TypeAlias = Annotated[str, Field(pattern=f"^(?:{init_file.NAME.pattern})$")]


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


ORIGIN: Final = "the page"
MAX_FACES: Final = 12
NOTHING: Final = Start(0, {}, "")  # of no file
_ABOUT_BOXES: Final = {
    "hand": "the whole hand, from the wrist to the finger tips",
    "head": "the face of this head, from the brows to the chin",
    "face": "from the brows to the chin, as wide as the face",
}


class Proposer:
    """The faces of a frame as starts, one frame at a time. `points`: of the first target."""

    def __init__(self, frames: Frames, recipe: Recipe, points: Sequence[str]) -> None:
        self._frames, self._recipe = frames, recipe
        self._points = [part for part in points if part in PARTS]
        self._by_hand = [part for part in points if part not in PARTS]
        self._looking = threading.Lock()

    def __call__(self, index: int) -> tuple[list[Start], str]:
        """A start for each face, and what is to be said of them. Raises InputError if there is no such frame."""
        frame, faces, starts, notes = self._frames.read(index), detector(), list[Start](), list[str]()
        with self._looking:
            for seen in faces.find(frame)[:MAX_FACES]:
                face = righted(faces, frame, seen)
                placed = named(face.placed(frame))
                points = {part: (round(placed[part][0], 2), round(placed[part][1], 2)) for part in self._points}
                visible = {part: at for part, at in points.items() if inside(at, frame.size)}
                start, note = self._complete(frame, Start(index, {TARGET: TargetStart(face.box, visible)}, ORIGIN))
                starts.append(start)
                notes.append(note)
        if not starts:
            notes.append("no face is found in this frame; draw a box, or look at another frame")
        elif self._by_hand:
            notes.append(f"{', '.join(self._by_hand)}: only by hand")
        return starts, "; ".join(dict.fromkeys(filter(None, notes)))

    def _complete(self, frame: Frame, start: Start) -> tuple[Start, str]:
        """With the other targets that the recipe names, if they are found; else the first one alone, and why."""
        recipe = self._recipe
        if not recipe.followed:
            return start, ""
        first, *others = recipe.followed
        [face] = start.targets.values()
        alone = replace(start, targets={first: face})
        try:
            return name_targets(alone, recipe.followed, frame, left_out=recipe.left_out, later=recipe.later), ""
        except NotHereError:
            return alone, f"{', '.join(others)}: not found by the colour of the skin; draw the boxes"
        except InputError as e:
            return alone, flat(str(e))


class PickSession(Session):
    """The choice of a start, on a page that first shows `frame`.

    `previous` is the start in the file to be replaced. Save writes to `out`, and an image to `preview`; without `out`
    the start is left in `saved`. Raises InputError for a frame that does not exist.
    """

    mode: ClassVar[Literal["pick"]] = "pick"

    def __init__(
        self,
        clip: Path,
        recipe: Recipe,
        *,
        out: Path | None,
        overwrite: bool = False,
        frame: int | None = None,
        previous: Start = NOTHING,
        next_: str | None = None,
        preview: Path | None = None,
    ) -> None:
        self.clip, self.out, self.overwrite, self.recipe = clip, out, overwrite, recipe
        self.next, self.preview = next_, preview
        self.previous = previous = fitted(previous, recipe)
        self.saved: Start | None = None
        required = requirements(recipe)
        about = {
            "clip": clip.name or str(clip),
            "recipe": recipe.name,
            "requirements": required,
            "free": not recipe.followed,
            "saves_to": "standard output" if out is None else str(out),
        }
        draft = draft_of(previous.frame, previous.targets)
        self._placed = [(draft, previous.placed_by)]  # drafts that a detector has placed, and its name
        with ExitStack() as stack:
            frames = stack.enter_context(Frames(clip))
            self._proposer = Proposer(frames, recipe, required[0]["points"])
            # raises InputError before anything is served
            shown = frames.read(previous.frame if frame is None else frame)
            super().__init__(frames, replace(draft, frame=shown.index), about)
            self.resources = stack.pop_all()
        if previous.origin:
            self.message = f"taken from {previous.origin}"

    def get_proposals(self, frame: int) -> Json:
        """{"frame", "proposals", "note"} of a frame."""
        self._check_frame(frame)
        starts, note = self._proposer(frame)
        drafts = [draft_of(frame, start.targets) for start in starts]
        self._placed += [(draft, detector().name) for draft in drafts]
        targets = to_jsonable_python([draft.targets for draft in drafts])
        proposals = [{"label": f"face {n}", "targets": each} for n, each in enumerate(targets, start=1)]
        return {"frame": frame, "proposals": proposals, "note": note or None}

    def post_save(self) -> Json:
        with self.lock:
            self.refuse_if_busy()
            frames = self.frames.count if self.frames.exact else None
            start = start_of(self.draft, self.frames.size, frames, self.recipe, self.previous)
            if frames is None:
                self.frames.read(start.frame)  # how long the clip is may be known only then
            # the detector that has placed all chosen parts; "" if the user has moved or drawn one of them
            same = self.draft.frame, self.draft.placed()
            by = max((by for draft, by in self._placed if (draft.frame, draft.placed()) == same), default="")
            start = replace(start, detector=by, placed=by != "")
            return self.start_job("writing the init file", lambda _: self._write(start))

    def _write(self, start: Start) -> None:
        messages = []
        if self.preview is not None:
            write_preview(self.preview, self.frames.read(start.frame), start, overwrite=True)
            messages.append(f"{self.preview}: the start drawn on frame {start.frame}")
        if self.out is not None:
            init_file.write_init(self.out, start, clip=self.clip.name, overwrite=self.overwrite)
        messages.append(f"{self.out}: written" if self.out is not None else "standard output: what was chosen")
        if lost := len(self.previous.corrections) - len(start.corrections):
            messages.append(f"corrections left out, since they come before the start or have no target: {lost}")
        self.saved = start
        self.end(messages, self.next)


def requirement(target: str, points: Sequence[str], box: Literal["needed", "optional", "no", ""] = "") -> Json:
    """The parts that the page asks for of one target; "about" describes each point, and the box, in words.

    The box is the unit of length where there is no second point.
    """
    about = {part: WHAT_PARTS_ARE[part] for part in points if part in WHAT_PARTS_ARE}
    about["box"] = next((text for name, text in _ABOUT_BOXES.items() if name in target.lower()), "all of it, no more")
    asked = box or ("needed" if len(points) < 2 else "optional")
    return {"target": target, "box": asked, "points": list(points), "about": about}


def requirements(recipe: Recipe) -> list[Json]:
    """The `requirement` of each target, or one for all where the recipe names none."""
    if not isinstance(recipe, ParticlesRecipe):
        return [requirement(TARGET, recipe.points)]
    # beside the first target's face the others are looked for
    (first, face), *others = recipe.filters.items()
    needs = [requirement(first, face.points, "needed"), *(requirement(name, each.points) for name, each in others)]
    return [*needs, *(requirement(name, (), "optional") for name in recipe.later)]


def start_of(draft: Draft, size: tuple[int, int], frames: int | None, recipe: Recipe, previous: Start) -> Start:
    """The start of a draft, to 0.01 px, as a run accepts it, with the windows and corrections of `previous` that still
    have their target and come after it.

    `frames` is the number of frames where it is certain. Raises UsageError that names what is missing.
    """
    chosen = {name: target for name, target in draft.placed().items() if name not in recipe.left_out}
    if not chosen:
        raise UsageError("nothing is chosen yet; take a face that was found, or choose a part")
    required = {asked["target"]: asked for asked in requirements(recipe)}
    if not recipe.followed:  # whatever they are called
        required = dict.fromkeys(chosen, *required.values())
    for name, asked in required.items():
        needs_box = asked["box"] == "needed"
        if (needs_box and chosen.get(name, TargetStart()).box is None) or (asked["points"] and name not in chosen):
            raise UsageError(f"still to choose: {'the box of ' * needs_box}{name}")
    keys = {*init_file.OF_FILES, *init_file.KEYS, *init_file.OF_CORRECTIONS}
    if unreadable := keys.intersection(chosen):  # the file could not be read again
        raise UsageError(f"a target cannot be called {min(unreadable)}, a key of init files; rename it")
    targets = {}
    for name, target in chosen.items():
        before = previous.targets.get(name, TargetStart())
        targets[name] = replace(target, windows={p: w for p, w in before.windows.items() if p in target.points})
    kept = tuple(fix for fix in previous.corrections if fix.target in targets and fix.frame > draft.frame)
    start = Start(draft.frame, targets, ORIGIN, kept)
    try:
        start = name_targets(start, recipe.followed, None, left_out=recipe.left_out, later=recipe.later)
        init_file.check_start(start, size, recipe.points, frames)
        for name, target in start.targets.items():
            if target.box is not None:
                check_size(ORIGIN, name, target.box)
        if not wants_gallery(recipe):
            tracker_for(recipe, start, size)
    except FacetrackError as e:
        raise UsageError(flat(str(e)).removeprefix(f"{ORIGIN}: ")) from None
    return start


def fitted(start: Start, recipe: Recipe) -> Start:
    """The start with the targets that the recipe follows. A single target of another name is taken for the first."""
    if not recipe.followed:
        return start
    names = {name: name for name in start.targets if name in recipe.followed}
    if len(start.targets) == 1 and not names:
        names = dict.fromkeys(start.targets, recipe.followed[0])
    targets = {names[name]: target for name, target in start.targets.items() if name in names}
    kept = tuple(replace(fix, target=names[fix.target]) for fix in start.corrections if fix.target in names)
    return replace(start, targets=targets, corrections=kept)
