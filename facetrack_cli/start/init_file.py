"""Init files: where a track begins, and its corrections, as a YAML or JSON file that people edit.

    frame: 0
    placed_by: yunet                             # optional, the detector that has placed all that follows, or haar
    face:
      box: [100, 60, 80, 80]                     # left, top, width, height
      points: {nose: [141.0, 112.5], mouth_left: [120, 140], lip_upper: [131, 133]}
      windows: {nose: [25, 25]}                  # optional, pixels
    corrections:                                 # optional, frames in any order
    - frame: 31
      face:
        points: {mouth_left: [137.2, 153.9]}     # by hand
        kept: {nose: [160, 138.4]}               # where other parts were; optional
        absent: [lip_upper]                      # not visible from there on; or true: all of the target
        learn: true                              # the appearance is learned again; optional

There may be several targets, also in a correction. With a single target its keys may stand at the top level, then it is
called `face`, and beside the `frame` of a correction.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from itertools import groupby
from pathlib import Path
from typing import Any, Final, NoReturn, TextIO

from pydantic import ValidationError

from facetrack_cli.core.errors import InputError, reading
from facetrack_cli.core.face_points import DETECTORS, HANDS
from facetrack_cli.core.files import write_new
from facetrack_cli.core.geometry import centre, inside
from facetrack_cli.core.types import BOX, Point, Start, TargetStart
from facetrack_cli.core.yaml_tree import Node, Problem, YamlProblems, parse, read_source
from facetrack_cli.recipe.load import problems
from facetrack_cli.recipe.sections import suggest
from facetrack_cli.trajectory.reader import CorrectionRecord, StartRecord, TargetRecord, corrected, to_record, whole

SUFFIXES: Final = (".yaml", ".yml", ".json")
TARGET: Final = "face"
KEYS: Final = tuple(TargetRecord.model_fields)
OF_FILES: Final = ("frame", "placed_by", "corrections")
OF_CORRECTIONS: Final = tuple(key for key in CorrectionRecord.model_fields if key not in ("frame", "target"))
MAX_TARGETS: Final = 100
NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_-]{0,63}")
MAX_BYTES: Final = 10**6  # some thousand corrections, which take seconds to read
WHAT_PARTS_ARE: Final = {
    "nose": "the tip of the nose",
    "mouth_left": "the corner of the mouth on the picture's left",
    "mouth_right": "the corner on the picture's right",
    "lip_upper": "the middle of the upper lip, at its upper edge",
    "lip_lower": "the middle of the lower lip, at its lower edge",
}
_WIDE: Final = 88  # characters of a line; longer ones are split, a point on each


def find_init(clip: Path) -> Path | None:
    """The init file beside a video `clip.mp4` or a folder `clip/`: clip.init.yaml, else .yml, else .json; or None."""
    return next((path for path in (default_path(clip, suffix) for suffix in SUFFIXES) if path.is_file()), None)


def default_path(clip: Path, suffix: str = ".yaml") -> Path:
    """Where `find_init` looks first: `clip.init.yaml` beside the clip."""
    folder = clip.is_dir()
    if folder and clip.name in ("", ".."):
        clip = clip.resolve()
    return clip.parent / f"{clip.name if folder else clip.stem}.init{suffix}"


def write_init(to: Path | TextIO, start: Start, *, clip: str = "", overwrite: bool = False) -> None:
    """Write an init file that `read_init` reads back as it was: JSON if `to` ends in .json, else YAML with comments.

    Raises OutputError if the file exists and `overwrite` is not set, or cannot be written.
    """
    if isinstance(to, Path):
        text = as_json(start) if to.suffix.lower() == ".json" else as_yaml(start, clip)
        write_new(to, text.encode(), overwrite=overwrite)
    else:
        to.write(as_yaml(start, clip))


def as_json(start: Start) -> str:
    """As JSON, with the keys of the YAML form."""
    by = start.placed_by
    record = {"frame": start.frame, **({"placed_by": by} if by else {}), **to_record(start)["targets"]}
    entries = groupby(start.corrections, key=lambda correction: correction.frame)
    if corrections := [{"frame": frame, **{fix.target: corrected(fix) for fix in group}} for frame, group in entries]:
        record["corrections"] = corrections
    return json.dumps(record, indent=2) + "\n"


def as_yaml(start: Start, clip: str = "") -> str:
    """As YAML with comments; `clip` is named at the top."""
    of = f" of {''.join(char if char.isprintable() else '?' for char in clip)}" if clip else ""
    lines = [
        f"# Where the track{of} begins.",
        "# Edit the numbers: pixels of this frame, x to the right, y down; the centre of the first pixel is 0, 0.",
        f"frame: {start.frame}  # counted from 0",
    ]
    if by := start.placed_by:
        lines.append(f"placed_by: {by}  # remove this line once you have edited a point or the box")
    for name, target in start.targets.items():
        lines.append(f"{_key(name)}:")
        if target.box is not None:
            lines.append(f"  box: {_flow(target.box)}  # left, top, width, height")
        if target.points:
            rows = list(zip(_below(target.points, 4), map(WHAT_PARTS_ARE.get, target.points), strict=True))
            wide = max(len(row) for row, _ in rows)
            lines.append("  points:  # x, y of each part; left and right as seen in the image")
            lines += [f"{row:<{wide}}  # {what}" if what else row for row, what in rows]
        if target.windows:
            lines += ["  windows:  # width, height of the window that is compared", *_below(target.windows, 4)]
    if start.corrections:
        lines += [
            "# What was corrected by hand; from each of these frames on the target begins again.",
            "# points, box: by hand; kept: where its other points were; absent: not to be seen from there on;",
            "# learn: whether what it looks like is learned again there; if it is not said, what is given is;",
            "# confirmed: it lies right there, whatever the tracker says.",
            "corrections:",
        ]
    for frame, group in groupby(start.corrections, key=lambda correction: correction.frame):
        lines.append(f"- frame: {frame}")
        for correction in group:
            lines.append(f"  {_key(correction.target)}:")
            for key, value in corrected(correction).items():
                line = f"    {key}: {_flow(value)}"
                split = isinstance(value, dict) and len(line) > _WIDE
                lines += [f"    {key}:", *_below(value, 6)] if split else [line]
    return "\n".join(lines) + "\n"


def _below(pairs: Mapping[str, Point], indent: int) -> list[str]:
    return [f"{' ' * indent}{_key(name)}: {_flow(pair)}" for name, pair in pairs.items()]


def _flow(value: Any) -> str:
    """Numbers, names, lists and mappings on one line."""
    if isinstance(value, list | tuple):
        value = [item if isinstance(item, str) else whole(item) for item in value]
    return re.sub('"(.+?)"', lambda name: _key(name[1]), json.dumps(value))


def _key(name: str) -> str:
    return f'"{name}"' if name.lower() in ("null", "true", "false", "yes", "no", "on", "off", "y", "n") else name


def read_init(path: Path) -> Start:
    """The start and the corrections that an init file describes, the corrections by their frames.

    Raises InputError, with file, line and column, for what is not valid: refused by YAML or `trajectory.reader`, an
    unknown key, a missing frame, a target without box and points, a correction of a frame that is not after the first,
    of a target or part that the start does not have, or of the same part twice.
    """
    name = str(path)
    try:
        with reading(path, "correct the name, or make one with facetrack init"):
            source = read_source(path, name, MAX_BYTES)
        if path.suffix.lower() == ".json":  # JSON may be indented by tabs, YAML may not
            source = source._replace(text=source.text.replace("\t", " "))
        root = parse(source)
        if root is None:
            raise InputError(f"{name}:1: the init file is empty; make one with facetrack init")
        tree = _as_record(root)
        record = StartRecord.model_validate(tree.plain())
        _check(record, tree)
        start = record.start_from(name)
        return replace(start, corrections=tuple(sorted(start.corrections, key=lambda fix: fix.frame)))
    except ValidationError as error:
        refused = problems(error, tree)
    except YamlProblems as error:
        refused = [*error.problems]
    raise InputError(f"{refused[0]}{f' (and {len(refused) - 1} more)' if len(refused) > 1 else ''}")


def _as_record(root: Node) -> Node:
    """The tree of a file as `StartRecord` has it: the keys of targets and corrections may stand in shorter forms."""
    keys = _mapping(root, "an init file", "frame: 0 and box: [left, top, width, height]")
    frame, by, corrections = (keys.pop(key, None) for key in OF_FILES)
    if frame is None:
        _refuse(root, 'the key "frame" is missing; add frame: N, counted from 0')
    if len(keys) > MAX_TARGETS:
        _refuse(root, f"{len(keys)} targets, and at most {MAX_TARGETS} are followed at a time; split the file")
    alone = not keys or any(key in KEYS for key in keys)
    targets = {TARGET: Node(root.span, keys)} if alone else keys
    known = (*OF_FILES, *KEYS) if alone else KEYS
    for key, node in ({} if alone else keys).items():
        if not isinstance(node.value, dict) and get_close_matches(key, (*OF_FILES, *KEYS), n=1, cutoff=0.7):
            _check_key(node, key, (*OF_FILES, *KEYS))  # no target, but a key that is misspelt
    below = {
        name: Node(node.span, _fields(node, f"the target {name}", "box: or points: below its name", known), node.key)
        for name, node in targets.items()
    }
    members = {"frame": frame, "targets": Node(root.span, below)}
    if by is not None:
        if by.value not in DETECTORS:
            _refuse(by, f"placed_by names a detector, {' or '.join(DETECTORS)}; remove the line if none did")
        members |= {"detector": by, "placed": Node(by.span, True)}
    if corrections is not None:
        if not isinstance(corrections.value, list):
            _refuse(corrections, "corrections is a list; write - frame: 31 and, below it, what is corrected")
        each = [fix for entry in corrections.value for fix in _of_entry(entry, [*targets])]
        members["corrections"] = Node(corrections.span, each, corrections.key)
    return Node(root.span, members)


def _of_entry(entry: Node, targets: Sequence[str]) -> Iterator[Node]:
    """The corrections of one frame, as `CorrectionRecord` has them."""
    keys = _mapping(entry, "a correction", "- frame: 31 and, below it, what is corrected")
    frame = keys.pop("frame", None)
    if frame is None:
        _refuse(entry, 'the key "frame" is missing; add frame: N, counted from 0')
    if any(key in (*KEYS, *OF_CORRECTIONS) for key in keys):
        if len(targets) > 1:
            _refuse(entry, f"which target is corrected? Indent the keys below its name: {', '.join(targets)}")
        keys = {name: Node(entry.span, keys) for name in targets}
    if not keys:
        _refuse(entry, "nothing is corrected here; add points: or box: by hand, or absent: true")
    for name, node in keys.items():
        _check_key(node, name, (*targets, *HANDS, *OF_CORRECTIONS))  # hands may appear after the start
        fields = _fields(node, f"the correction of {name}", "points: or absent: below the name", OF_CORRECTIONS)
        yield Node(node.span, {"target": Node(node.span, name, node.key), "frame": frame, **fields}, node.key)


def _check(record: StartRecord, tree: Node) -> None:
    """YamlProblems for what is right by itself, and not beside the rest."""
    for path, node in tree.walk():
        if len(path) in (2, 4) and isinstance(name := path[-1], str) and not NAME.fullmatch(name):
            _refuse(node, f'"{name}" is no name; use letters, digits, _ and -', at_key=True)
    for name, target in record.targets.items():
        at = tree.at(("targets", name))[0]
        if target.box is None and not target.points:
            _refuse(at, f"no box or points of {name}; add box: [left, top, width, height] or points:")
        for part in target.windows:
            _check_part(at.at(("windows", part))[0], "windows", part, tuple(target.points))
    seen: set[tuple[int, str]] = set()
    for number, fix in enumerate(record.corrections):
        at, name = tree.at(("corrections", number))[0], fix.target
        if fix.frame <= record.frame:
            begins = f"the track begins in frame {record.frame}; corrections come after it"
            _refuse(at.at(("frame",))[0], f"corrects frame {fix.frame}, but {begins}")
        if (fix.frame, name) in seen:
            _refuse(at, f"{name} is corrected in frame {fix.frame} already; join them", at_key=True)
        seen.add((fix.frame, name))
        if not (fix.box or fix.points or fix.absent or fix.confirmed):
            _refuse(at, f"nothing of {name} is corrected; add points: or box: by hand, or absent: true, or remove it")
        whole = fix.absent is True or bool(fix.confirmed)
        if (whole and len(fix.model_fields_set) > 3) or (fix.box is not None and fix.kept):
            alone = "absent: true and confirmed stand alone, and nothing is kept beside a box"
            _refuse(at, f"{alone}; remove the other keys of {name}", at_key=True)
        # a start of a box alone leaves the parts to the recipe
        start = record.targets.get(name, TargetRecord())
        parts = (*start.points, *((BOX,) if start.box is not None else ())) if start.points else ()
        placed = {BOX: "box"} if fix.box is not None else {}
        lists = {"absent": fix.absent, "confirmed": fix.confirmed}
        for key, names in {"points": fix.points, "kept": fix.kept, **lists}.items():
            for place, part in enumerate(() if names is True else names):
                child = at.at((key, place if key in lists else part))[0]
                if part in placed:
                    _refuse(child, f"{part} is in {placed[part]} already; leave it in one place", at_key=True)
                _check_part(child, key, part, parts)
                placed[part] = key


def _check_part(node: Node, key: str, part: str, parts: Sequence[str]) -> None:
    if parts and part not in parts:
        _refuse(node, f'{key} names "{part}", which the start does not have; it has {", ".join(parts)}', at_key=True)


def _fields(node: Node, what: str, example: str, known: Sequence[str]) -> dict[str, Node]:
    """A copy of the mapping that a node is, which has `known` keys alone."""
    fields = _mapping(node, what, example)
    for key in fields:
        _check_key(fields[key], key, known)
    return fields


def _check_key(node: Node, key: str, known: Sequence[str]) -> None:
    if key not in known:
        _refuse(node, f'unknown key "{key}"; {suggest(key, known, "the keys there are")}', at_key=True)


def _mapping(node: Node, what: str, example: str) -> dict[str, Node]:
    """A copy of the mapping that a node is."""
    if not isinstance(node.value, dict):
        _refuse(node, f"{what} is a mapping of keys; write {example}")
    return dict(node.value)


def _refuse(node: Node, message: str, *, at_key: bool = False) -> NoReturn:
    """Refuse the value of a node. An empty value has no place, so the error points at its key."""
    span = node.key if (at_key or node.value is None) and node.key is not None else node.span
    raise YamlProblems(Problem(span, message))


def check_start(start: Start, size: tuple[int, int], parts: Sequence[str], frames: int | None = None) -> None:
    """InputError if the start does not fit the clip of that (width, height) in pixels, or lacks any of the `parts`.

    `frames` is the clip's number of frames if it is known for certain.
    """
    origin, of_frame = start.origin, f"the frame of {size[0]}x{size[1]} pixels"
    if frames is not None and start.frame >= frames:
        more = f"the clip ends with frame {frames - 1}; choose one that it has"
        raise InputError(f"{origin}: starts at frame {start.frame}, but {more}")
    for name, target in start.targets.items():
        if missing := ", ".join(part for part in parts if part not in target.points):
            boxes = ", or follow its box by a recipe of regions, as contour_histogram" if target.box is not None else ""
            remedy = f"add it, or have all points placed with --box X,Y,W,H{boxes}"
            raise InputError(f"{origin}: no point for {missing} of {name}, which the recipe follows; {remedy}")
    placed = list(start.targets.items())
    for correction in start.corrections:
        name = f"{correction.target} at frame {correction.frame}"
        if correction.frame <= start.frame:
            begins = f"but the track begins at frame {start.frame}; remove that correction, or begin earlier"
            raise InputError(f"{origin}: corrects {name}, {begins}")
        # kept points are where the tracker saw them, which may be beyond the border
        placed.append((name, TargetStart(correction.box, correction.points)))
        if (box := correction.box) is not None and (box[2] > size[0] or box[3] > size[1]):
            larger = f"{box[2]:g}x{box[3]:g} pixels, is larger than {of_frame}; make it smaller"
            raise InputError(f"{origin}: the box of {name}, {larger}")
    for name, target in placed:
        points = {f"{part} of {name} at [{x:g}, {y:g}]": (x, y) for part, (x, y) in target.points.items()}
        if target.box is not None:
            numbers = ", ".join(f"{value:g}" for value in target.box)
            points[f"the centre of the box [{numbers}] of {name}"] = centre(target.box)
        for what, point in points.items():
            if not inside(point, size):
                raise InputError(f"{origin}: {what} is outside {of_frame}; correct it")
        for part, (w, h) in target.windows.items():
            if w > size[0] or h > size[1]:
                larger = f"{w:g}x{h:g}, is larger than {of_frame}; make it smaller"
                raise InputError(f"{origin}: the window of {part} of {name}, {larger}")
