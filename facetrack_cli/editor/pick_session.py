"""Choosing the start of a track on the page: which parts a recipe requires, and whether a draft has them."""

import threading
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import ClassVar, Final, Literal

from pydantic_core import to_jsonable_python

from facetrack_cli.core.errors import FacetrackError, InputError, OutputError, UsageError, flat
from facetrack_cli.core.geometry import inside
from facetrack_cli.core.types import Box, Frame, Start, TargetStart
from facetrack_cli.editor.session import Draft, Json, Session, draft_of
from facetrack_cli.engine.spaces import check_size
from facetrack_cli.recipe.load import load_recipe, wants_gallery
from facetrack_cli.recipe.model import ParticlesRecipe, Recipe
from facetrack_cli.start.assembly import build_tracker, check_windows, name_targets
from facetrack_cli.start.init_file import (
    KEYS,
    OF_CORRECTIONS,
    OF_FILES,
    TARGET,
    WHAT_PARTS_ARE,
    check_start,
    write_init,
)
from facetrack_cli.start.search import box_start
from facetrack_cli.trackers.face.detectors import PARTS, NotHereError, detector, named, righted
from facetrack_cli.trackers.skin.settings import SkinCloudSettings
from facetrack_cli.video.overlay import write_preview
from facetrack_cli.video.seek import Frames

ORIGIN: Final = "the page"
MAX_FACES: Final = 12
NOTHING: Final = Start(0, {}, "")  # of no file
DEFAULT: Final = "factorized"  # the recipe of `facetrack run` without --config
_RESERVED: Final = (*OF_FILES, *KEYS, *OF_CORRECTIONS)
_ABOUT_BOXES: Final = {
    "hand": "the whole hand, from the wrist to the finger tips",
    "head": "the face of this head, from the brows to the chin",
    "face": "from the brows to the chin, as wide as the face",
}


class Proposer:
    """The faces of a frame as starts, which is searched once; one frame at a time. `points`: of the first target."""

    def __init__(self, frames: Frames, recipe: Recipe | None, points: Sequence[str]) -> None:
        self._frames, self._recipe = frames, recipe
        self._points = [part for part in points if part in PARTS]
        self._by_hand = [part for part in points if part not in PARTS]
        self._looking = threading.Lock()
        self.found: dict[int, tuple[list[Start], str]] = {}

    def __call__(self, index: int) -> tuple[list[Start], str]:
        """A start for each face, and what is to be said of them. Raises InputError if there is no such frame."""
        with self._looking:
            if index not in self.found:
                self.found[index] = self._find(self._frames.read(index))
            return self.found[index]

    def in_box(self, frame: Frame, box: Box, clip: str) -> Start:
        """The face in a given box. Raises InputError as `box_start` does."""
        return self._complete(frame, box_start(frame, box, self._points, clip=clip))[0]

    def _find(self, frame: Frame) -> tuple[list[Start], str]:
        faces, starts, notes = detector(), list[Start](), list[str]()
        for seen in faces.find(frame)[:MAX_FACES]:
            face = righted(faces, frame, seen)
            placed = named(face.placed(frame))
            points = {part: (round(placed[part][0], 2), round(placed[part][1], 2)) for part in self._points}
            visible = {part: at for part, at in points.items() if inside(at, frame.size)}
            start, note = self._complete(frame, Start(frame.index, {TARGET: TargetStart(face.box, visible)}, ORIGIN))
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
        if recipe is None or not recipe.followed:
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
    """The choice of a start. The page first shows `frame`, where the `box` of a face may give the first draft.

    `previous` is the start in the file to be replaced. Save writes to `out`, and an image to `preview`; without `out`
    the start is left in `saved`. What is not saved goes to `unsaved`, if that is given. Raises InputError for a frame
    that does not exist or a box outside of it.
    """

    mode: ClassVar[Literal["pick"]] = "pick"

    def __init__(
        self,
        clip: Path,
        *,
        out: Path | None,
        overwrite: bool = False,
        recipe: Recipe | None = None,
        frame: int | None = None,
        box: Box | None = None,
        previous: Start = NOTHING,
        next_: str | None = None,
        preview: Path | None = None,
        unsaved: Path | None = None,
    ) -> None:
        self.clip, self.out, self.overwrite, self.recipe = clip, out, overwrite, recipe
        self.next, self.preview, self._unsaved = next_, preview, unsaved
        self.previous = previous = fitted(previous, recipe)
        self.saved: Start | None = None
        self._previewed = False
        required = requirements(recipe)
        about = {
            "clip": clip.name or str(clip),
            "recipe": None if recipe is None else recipe.name,
            "requirements": required,
            "free": recipe is None or not recipe.followed,
            "saves_to": "standard output" if out is None else str(out),
        }
        shown = previous.frame if frame is None else frame
        draft = draft_of(shown, previous.targets)
        # drafts that a detector has placed, and its name
        self._placed = [(draft_of(previous.frame, previous.targets), previous.placed_by)]
        self._unchanged = draft if box is None else None
        with ExitStack() as stack:
            frames = stack.enter_context(Frames(clip))
            self._proposer = Proposer(frames, recipe, required[0]["points"])
            image = frames.read(shown)  # raises InputError before anything is served
            if box is not None:
                draft = draft_of(image.index, self._proposer.in_box(image, box, str(clip)).targets)
                self._placed.append((draft, detector().name))
            super().__init__(frames, draft, about)
            self.resources = stack.pop_all()
        if previous.origin and box is None:
            self.message = f"taken from {previous.origin}"

    def get_proposals(self, frame: int) -> Json:
        """{"frame", "proposals", "note"} of a frame."""
        self._check_frame(frame)
        starts, note = self._proposer(frame)
        proposals = [
            {"label": f"face {n}", "targets": to_jsonable_python(draft_of(frame, start.targets).targets)}
            for n, start in enumerate(starts, start=1)
        ]
        return {"frame": frame, "proposals": proposals, "note": note or None}

    def post_save(self) -> Json:
        with self.lock:
            self.refuse_if_busy()
            frames = self.frames.count if self.frames.exact else None
            start = start_of(self.draft, self.frames.size, frames, self.recipe, self.previous)
            if frames is None:
                self.frames.read(start.frame)  # how long the clip is may be known only then
            by = self._placed_by(self.draft)
            start = replace(start, detector=by, placed=by != "")
            return self.start_job("writing the init file", lambda _: self._write(start))

    def left(self) -> str:
        kept, chosen = self._unsaved, self.draft.placed()
        if kept is None or not chosen or self.draft == self._unchanged:
            return f"what was chosen the last time is still in {kept}" if kept and kept.is_file() else super().left()
        start = carried(Start(self.draft.frame, chosen, ORIGIN), self.previous)
        try:
            write_init(kept, start, clip=self.clip.name, overwrite=True)
        except OutputError as e:
            return f"what was chosen is lost: {e}"
        return f"what was chosen is kept in {kept}; the same command goes on with it"

    def _placed_by(self, chosen: Draft) -> str:
        """The detector that has placed all chosen parts; "" if the user has moved or drawn one of them."""
        starts, _ = self._proposer.found.get(chosen.frame, ((), ""))
        drafts = [*self._placed, *((draft_of(chosen.frame, start.targets), detector().name) for start in starts)]
        same = chosen.frame, chosen.placed()
        return max((by for draft, by in drafts if (draft.frame, draft.placed()) == same), default="")

    def _write(self, start: Start) -> None:
        messages = []
        if self.preview is not None:
            frame = self.frames.read(start.frame)
            write_preview(self.preview, frame, start, overwrite=self.overwrite or self._previewed)
            self._previewed = True  # if the init file cannot be written, the next attempt may replace the preview
            messages.append(f"{self.preview}: the start drawn on frame {start.frame}")
        if self.out is not None:
            write_init(self.out, start, clip=self.clip.name, overwrite=self.overwrite)
        messages.append(f"{self.out}: written" if self.out is not None else "standard output: what was chosen")
        if lost := len(self.previous.corrections) - len(start.corrections):
            messages.append(f"corrections left out, since they come before the start or have no target: {lost}")
        self.saved = start
        self.end(messages, self.next)


def requirement(target: str, points: Sequence[str], box: Literal["needed", "optional", "no"]) -> Json:
    """The parts that the page asks for of one target; "about" describes each point, and the box, in words."""
    about = {part: WHAT_PARTS_ARE[part] for part in points if part in WHAT_PARTS_ARE}
    about["box"] = next((text for name, text in _ABOUT_BOXES.items() if name in target.lower()), "all of it, no more")
    return {"target": target, "box": box, "points": list(points), "about": about}


def requirements(recipe: Recipe | None) -> list[Json]:
    """The `requirement` of each target, or one for all where the recipe names none: without a recipe, of a face."""
    if not isinstance(recipe, ParticlesRecipe):
        points = PARTS if recipe is None else recipe.points
        return [requirement(TARGET, points, _box_for(points))]
    # the first target's face is where the others are looked for, and a cloud learns its colours from a box
    boxed = {next(iter(recipe.filters))}
    for name, followed in recipe.filters.items():
        if isinstance(followed.likelihood, SkinCloudSettings):
            boxed.add(followed.likelihood.learn_from or name)
    needs = [
        requirement(name, followed.points, "needed" if name in boxed else _box_for(followed.points))
        for name, followed in recipe.filters.items()
    ]
    return [*needs, *(requirement(name, (), "optional") for name in recipe.later)]


def _box_for(points: Sequence[str]) -> Literal["needed", "optional"]:
    """The box is the unit of length where there is no second point."""
    return "needed" if len(points) < 2 else "optional"


def start_of(draft: Draft, size: tuple[int, int], frames: int | None, recipe: Recipe | None, previous: Start) -> Start:
    """The start of a draft, to 0.01 px, as a run accepts it, with windows and corrections `carried` from `previous`.

    `frames` is the number of frames where it is certain. Raises UsageError that names what is missing.
    """
    left_out = () if recipe is None else recipe.left_out
    chosen = {name: target for name, target in draft.placed().items() if name not in left_out}
    if not chosen:
        raise UsageError("nothing is chosen yet; take a face that was found, or choose a part")
    required = {asked["target"]: asked for asked in requirements(recipe)}
    if recipe is None or not recipe.followed:  # whatever they are called
        required = dict.fromkeys(chosen, *required.values())
    for name, asked in required.items():
        needs_box = asked["box"] == "needed"
        if (needs_box and chosen.get(name, TargetStart()).box is None) or (asked["points"] and name not in chosen):
            raise UsageError(f"still to choose: {'the box of ' * needs_box}{name}")
    for name in chosen:
        if get_close_matches(name, _RESERVED, n=1, cutoff=0.7):
            raise UsageError(f"a target cannot be called {name}, too like a key of init files; rename it")
    start = carried(Start(draft.frame, chosen, ORIGIN), previous)
    try:
        if recipe is not None:
            start = name_targets(start, recipe.followed, None, left_out=recipe.left_out, later=recipe.later)
        check_start(start, size, recipe.points if recipe is not None else PARTS, frames)
        for name, target in start.targets.items():
            if target.box is not None:
                check_size(ORIGIN, name, target.box)
        runs = recipe or load_recipe(DEFAULT)
        if not wants_gallery(runs):
            check_windows(runs, build_tracker(runs, start), size, ORIGIN)
    except FacetrackError as e:
        raise UsageError(flat(str(e)).removeprefix(f"{ORIGIN}: ")) from None
    return start


def fitted(start: Start, recipe: Recipe | None) -> Start:
    """The start with the targets that the recipe follows. A single target of another name is taken for the first."""
    if recipe is None or not recipe.followed:
        return start
    names = {name: name for name in start.targets if name in recipe.followed}
    if len(start.targets) == 1 and not names:
        names = dict.fromkeys(start.targets, recipe.followed[0])
    targets = {names[name]: target for name, target in start.targets.items() if name in names}
    kept = tuple(replace(fix, target=names[fix.target]) for fix in start.corrections if fix.target in names)
    return replace(start, targets=targets, corrections=kept)


def carried(start: Start, previous: Start) -> Start:
    """The start with the windows and corrections of `previous` that still have their target and come after it."""
    targets = {}
    for name, target in start.targets.items():
        before = previous.targets.get(name, TargetStart())
        targets[name] = replace(target, windows={p: w for p, w in before.windows.items() if p in target.points})
    kept = tuple(fix for fix in previous.corrections if fix.target in targets and fix.frame > start.frame)
    return replace(start, targets=targets, corrections=kept)
