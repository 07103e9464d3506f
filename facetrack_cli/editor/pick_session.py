"""Choosing the start of a track on the page: which parts a recipe requires, and whether a draft has them."""

import threading
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import ClassVar, Final, Literal

from pydantic_core import to_jsonable_python

from facetrack_cli.core.errors import FacetrackError, InputError, UsageError, flat
from facetrack_cli.core.geometry import inside
from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.editor.session import Draft, Json, Session, draft_of
from facetrack_cli.engine.spaces import check_size
from facetrack_cli.recipe.load import wants_gallery
from facetrack_cli.recipe.model import ParticlesRecipe, Recipe
from facetrack_cli.start.assembly import name_targets, tracker_for
from facetrack_cli.start.init_file import (
    KEYS,
    OF_CORRECTIONS,
    OF_FILES,
    TARGET,
    WHAT_PARTS_ARE,
    check_start,
    write_init,
)
from facetrack_cli.trackers.face.detectors import PARTS, NotHereError, detector, named, righted
from facetrack_cli.video.overlay import write_preview
from facetrack_cli.video.source import Frames

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
        proposals = [
            {"label": f"face {n}", "targets": to_jsonable_python(draft.targets)}
            for n, draft in enumerate(drafts, start=1)
        ]
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
            write_init(self.out, start, clip=self.clip.name, overwrite=self.overwrite)
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
    if unreadable := {*OF_FILES, *KEYS, *OF_CORRECTIONS}.intersection(chosen):  # the file could not be read again
        raise UsageError(f"a target cannot be called {min(unreadable)}, a key of init files; rename it")
    targets = {}
    for name, target in chosen.items():
        before = previous.targets.get(name, TargetStart())
        targets[name] = replace(target, windows={p: w for p, w in before.windows.items() if p in target.points})
    kept = tuple(fix for fix in previous.corrections if fix.target in targets and fix.frame > draft.frame)
    start = Start(draft.frame, targets, ORIGIN, kept)
    try:
        start = name_targets(start, recipe.followed, None, left_out=recipe.left_out, later=recipe.later)
        check_start(start, size, recipe.points, frames)
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
