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

from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Final, TextIO

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.files import write_new
from facetrack_cli.core.types import Start, TargetStart
from facetrack_cli.core.yaml_tree import Node, Source, YamlProblems, parse, read_source
from facetrack_cli.tracking.start.corrections import read_corrections
from facetrack_cli.tracking.start.init_values import (
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
from facetrack_cli.tracking.start.init_writer import as_json, as_yaml

SUFFIXES: Final = (".yaml", ".yml", ".json")


TARGET: Final = "face"


KEYS: Final = ("box", "points", "windows")


MAX_BYTES: Final = 10**6  # some thousand corrections, which take seconds to read


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


def write_init(to: Path | TextIO, start: Start, *, clip: str = "", overwrite: bool = False) -> None:
    """Write an init file that `read_init` reads back as it was: JSON if `to` ends in .json, else YAML with comments.

    Raises OutputError if the file exists and `overwrite` is not set, or cannot be written.
    """
    if not isinstance(to, Path):
        to.write(as_yaml(start, clip))
        return
    text = as_json(start) if to.suffix.lower() == ".json" else as_yaml(start, clip)
    write_new(to, text.encode(), overwrite=overwrite)
