"""Init files: where a track begins, as a YAML or JSON file that people edit.

    frame: 0
    face:
      box: [100, 60, 80, 80]                   # left, top, width, height
      points: {nose: [141.0, 112.5], mouth_left: [120, 140]}
      windows: {nose: [25, 25]}                # optional, pixels

There may be several targets. With a single one `box`, `points` and `windows` may stand at the top level; the target is
then called `face`. What was put right by hand in later frames follows as `corrections` (corrections.py).
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Final, TextIO

from facetrack_cli.errors import InputError, OutputError
from facetrack_cli.start.corrections import read_corrections
from facetrack_cli.start.init_text import as_json, as_yaml
from facetrack_cli.start.node_values import (
    NAME,
    Branch,
    area,
    box_of,
    frame_number,
    mapping,
    named,
    nearest,
    numbers,
    points_of,
    refuse,
)
from facetrack_cli.types import Box, Point, Start, TargetStart
from facetrack_cli.yaml_text import Node, Source, YamlProblems, parse, read_source

SUFFIXES: Final = (".yaml", ".yml", ".json")
TARGET: Final = "face"
KEYS: Final = ("box", "points", "windows")
MAX_BYTES: Final = 10**6  # some thousand corrections, which take seconds to read
LEAST_BOX: Final = 6  # pixels of a side; in less there is nothing to see
OF_CORRECTIONS: Final = ("kept", "absent", "learn")


def find_init(clip: Path) -> Path | None:
    """The init file beside a video `clip.mp4` or a folder `clip/`: clip.init.yaml, else .yml, else .json; or None."""
    return next((path for path in (default_path(clip, suffix) for suffix in SUFFIXES) if path.is_file()), None)


def default_path(clip: Path, suffix: str = ".yaml") -> Path:
    """Where `find_init` looks first: `clip.init.yaml` beside the clip."""
    if clip.is_dir():
        clip = clip if clip.name not in ("", "..") else clip.resolve()
        return clip.parent / f"{clip.name}.init{suffix}"
    return clip.parent / f"{clip.stem}.init{suffix}"


def read_init(path: Path) -> Start:
    """The start that an init file describes.

    Raises InputError, one line with file, line and column, for whatever cannot be meant: a key that is unknown or
    repeated, no frame, no number where one belongs, no area, neither box nor points, and what YAML itself refuses.
    """
    name = str(path)
    try:
        source = read_source(path, name, MAX_BYTES)
        if path.suffix.lower() == ".json":  # JSON may be indented by tabs, YAML may not
            source = replace(source, text=source.text.replace("\t", " "))
        root = parse(source)
    except FileNotFoundError:
        raise InputError(f"{name}: no such init file; correct the name, or make one with facetrack init") from None
    except IsADirectoryError:
        raise InputError(f"{name}: is a folder; name the init file, as in clip.init.yaml") from None
    except OSError as e:
        raise InputError(f"{name}: cannot be read: {e.strerror or e}; make it readable, or name another") from None
    except YamlProblems as refused:
        more = f" (and {len(refused.problems) - 1} more)" if len(refused.problems) > 1 else ""
        raise InputError(f"{refused.problems[0]}{more}") from None
    if root is None:
        raise InputError(f"{name}:1: the init file is empty; make one with facetrack init")
    return _start(root, source)


def _start(root: Node, source: Source) -> Start:
    top = mapping(root, "an init file", "frame: 0 and box: [left, top, width, height]")
    if "frame" not in top:
        refuse(root, 'the key "frame" is missing; add frame: N, counted from 0')
    frame = frame_number(top["frame"])
    rest = {key: node for key, node in top.items() if key not in ("frame", "corrections")}
    if not rest:
        refuse(root, "neither a box nor points are given; add box: [left, top, width, height] or points:")
    targets = _targets(rest, root)
    found = read_corrections(top["corrections"], frame, targets) if "corrections" in top else ()
    return Start(frame, targets, source.name, found)


def _targets(rest: Branch, root: Node) -> dict[str, TargetStart]:
    if any(key in KEYS for key in rest):
        return {TARGET: _target(rest, root, "")}
    targets = {}
    for key, node in rest.items():
        if key in OF_CORRECTIONS:
            refuse(node, f'"{key}" cannot name a target; it is a key of corrections', at_key=True)
        near = get_close_matches(key, ("frame", "corrections", *KEYS), n=1, cutoff=0.7)
        if not isinstance(node.value, dict) or near or not NAME.fullmatch(key):
            meant = f'did you mean "{near[0]}"?' if near else "a target holds box: and points:, indented below its name"
            refuse(node, f'unknown key "{key}"; {meant}', at_key=True)
        targets[key] = _target(node.value, node, f" of {key}")
    return targets


def _target(found: Branch, node: Node, of: str) -> TargetStart:
    for key, child in found.items():
        if key not in KEYS:
            keys = f"keys{of} are {', '.join(KEYS)}"
            meant = "only corrections have it" if key in OF_CORRECTIONS else nearest(key, (*KEYS, "frame"), keys)
            refuse(child, f'unknown key "{key}"{of}; {meant}', at_key=True)
    if "box" not in found and "points" not in found:
        refuse(node, f"neither a box nor points{of} are given; add box: [left, top, width, height] or points:")
    box = box_of(found["box"], f"the box{of}") if "box" in found else None
    points = points_of(found["points"], "points", "point", of) if "points" in found else {}
    windows: dict[str, tuple[float, float]] = {}
    if "windows" in found:
        for name, child in named(found["windows"], f"windows{of}", "nose: [width, height]").items():
            if "points" in found and name not in points:
                meant = nearest(name, points, "give the point, or remove the window")
                refuse(child, f'a window for "{name}"{of}, which has no point; {meant}', at_key=True)
            w, h = numbers(child, f"the window of {name}{of}", ("width", "height"))
            windows[name] = area((w, h), child, f"the window of {name}{of}")
    return TargetStart(box, points, windows)


def inside(point: Point, size: tuple[int, int]) -> bool:
    """Whether a point is on a pixel of a picture of that (width, height)."""
    return -0.5 <= point[0] <= size[0] - 0.5 and -0.5 <= point[1] <= size[1] - 0.5


def centre_inside(box: Box, size: tuple[int, int]) -> bool:
    """Whether the centre of a box is on a pixel of the picture; its edges may stand out, as a face may."""
    return inside((box[0] + (box[2] - 1) / 2, box[1] + (box[3] - 1) / 2), size)


def common_area(a: Box, b: Box) -> float:
    """Of two boxes, in pixels squared."""
    across = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0])
    down = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    return max(across, 0) * max(down, 0)


def check_size(origin: str, name: str, box: Box) -> None:
    """InputError if a target's box, which `origin` gave, is too small to see anything in it."""
    if min(box[2:]) < LEAST_BOX:
        least = f"{LEAST_BOX}x{LEAST_BOX} pixels"
        raise InputError(f"{origin}: the box of {name} is smaller than {least}; give a larger one")


def check_start(start: Start, size: tuple[int, int], parts: Sequence[str], frames: int | None = None) -> None:
    """InputError if the start does not fit the clip of that (width, height) in pixels, or the recipe's parts.

    `parts` are the points that the recipe follows in every target, `frames` the clip's number of them where it is known
    for certain.
    """
    picture = f"the picture of {size[0]}x{size[1]} pixels"
    if frames is not None and start.frame >= frames:
        raise InputError(
            f"{start.origin}: starts at frame {start.frame}, but the clip ends with frame {frames - 1}; "
            "choose one that it has"
        )
    for name, target in start.targets.items():
        missing = [part for part in parts if part not in target.points]
        if missing:
            boxes = ", or follow its box by a recipe of regions, as contour_histogram" if target.box is not None else ""
            raise InputError(
                f"{start.origin}: no point for {', '.join(missing)} of {name}, which the recipe follows; "
                f"add it, or have all points placed with --box X,Y,W,H{boxes}"
            )
        _check_places(start.origin, name, target.box, target.points, size)
        for part, (w, h) in target.windows.items():
            if w > size[0] or h > size[1]:
                raise InputError(
                    f"{start.origin}: the window of {part} of {name}, {w:g}x{h:g}, is larger than {picture}; shrink it"
                )
    for one in start.corrections:
        if one.frame <= start.frame:
            raise InputError(
                f"{start.origin}: corrects {one.target} at frame {one.frame}, but the track begins at frame "
                f"{start.frame}; remove that correction, or begin earlier"
            )
        name, box = f"{one.target} at frame {one.frame}", one.given.box
        # what is kept is where the tracker saw it, which may be beyond the border
        _check_places(start.origin, name, box, one.given.points, size)
        if box is not None and max(box[2] / size[0], box[3] / size[1]) > 1:
            raise InputError(
                f"{start.origin}: the box of {name}, {box[2]:g}x{box[3]:g} pixels, is larger than {picture}; make it "
                "smaller"
            )


def _check_places(origin: str, name: str, box: Box | None, points: Mapping[str, Point], size: tuple[int, int]) -> None:
    """InputError if the box's centre, or a point, is outside of a picture of that (width, height)."""
    picture = f"the picture of {size[0]}x{size[1]} pixels"
    if box is not None and not centre_inside(box, size):
        numbers = ", ".join(f"{value:g}" for value in box)
        raise InputError(f"{origin}: the centre of the box [{numbers}] of {name} is outside {picture}; correct it")
    for part, (x, y) in points.items():
        if not inside((x, y), size):
            raise InputError(f"{origin}: {part} of {name} at [{x:g}, {y:g}] is outside {picture}; correct it")


def write_init(to: Path | TextIO, start: Start, *, clip: str = "", overwrite: bool = False) -> None:
    """Write an init file that `read_init` reads back as it was: JSON if `to` ends in .json, else YAML with comments.

    Raises OutputError if the file exists and `overwrite` is not set, or cannot be written.
    """
    if not isinstance(to, Path):
        to.write(as_yaml(start, clip))
        return
    text = as_json(start) if to.suffix.lower() == ".json" else as_yaml(start, clip)
    write_new(to, text.encode(), overwrite=overwrite)


def check_new(path: Path, *, overwrite: bool, inputs: Iterable[Path | None] = ()) -> None:
    """Refuse before the work what `write_new` would refuse after it, and a file that the work is made from.

    Raises OutputError. Of `inputs`, those that are None or not there are passed over.
    """
    try:
        if path.is_dir():
            raise OutputError(f"{path}: is a folder; name a file in it")
        if path.exists() and any(_is_same(path, given) for given in inputs if given is not None):
            raise OutputError(f"{path}: is read here, and would be replaced; name another file")
        if os.path.lexists(path) and not overwrite and not _is_stream(path):
            raise OutputError(f"{path}: exists already; replace it with --overwrite, or name another file")
        if not path.parent.is_dir():
            raise OutputError(f"{path}: there is no folder {path.parent}; make it, or name another file")
    except OSError as e:
        raise OutputError(f"{path}: cannot be written: {e.strerror or e}; name another file") from None


def write_new(path: Path, data: bytes, *, overwrite: bool) -> None:
    """All of a small file or nothing. OutputError if it exists and `overwrite` is not set, or cannot be written.

    A link stays one: the file that it leads to is replaced. A device or a pipe is written to, never replaced.
    """
    try:
        if _is_stream(path):
            path.write_bytes(data)
            return
        if not overwrite and os.path.lexists(path):
            raise OutputError(f"{path}: exists already; replace it with --overwrite, or name another file")
        whole = Path(os.path.realpath(path))
        part = whole.with_name(f".{whole.name}.{os.getpid()}.part")
        try:
            part.write_bytes(data)
            part.replace(whole)
        finally:  # also on Ctrl-C
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)
    except OSError as e:
        raise OutputError(f"{path}: cannot be written: {e.strerror or e}; write it elsewhere") from None


def _is_same(path: Path, other: Path) -> bool:
    try:
        return path.samefile(other)
    except (OSError, ValueError):  # it is not there, may not be looked at, or no name at all
        return False


def _is_stream(path: Path) -> bool:
    """Whether there is a device or a pipe: to put a file in the place of /dev/null would break the whole machine."""
    return path.exists() and not path.is_file() and not path.is_dir()
