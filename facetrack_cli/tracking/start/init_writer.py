"""An init file's text, YAML with comments or JSON, which `read_init` reads back as it was."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any, Final

from facetrack_cli.core.types import Correction, Point, Start, TargetStart

_HOW: Final = {
    "haar": ", found by Haar cascades",
    "--box": ", placed in the box given",
    "the page": ", picked on the page",
}
WHAT_PARTS_ARE: Final = {
    "nose": "the tip of the nose",
    "mouth_left": "the corner of the mouth on the picture's left",
    "mouth_right": "the corner on the picture's right",
    "lip_upper": "the middle of the upper lip, at its upper edge",
    "lip_lower": "the middle of the lower lip, at its lower edge",
}
_WIDE: Final = 88  # characters of a line, beyond which points stand on lines of their own


def as_json(start: Start) -> str:
    """As JSON: a line a part of the start, and a line a target of a correction."""
    members = [f'"frame": {start.frame}']
    for name, target in start.targets.items():
        keys = [] if target.box is None else [f'"box": {_list(target.box)}']
        for key, pairs in (("points", target.points), ("windows", target.windows)):
            if pairs:
                rows = ",\n".join(f'      "{part}": {_list(pair)}' for part, pair in pairs.items())
                keys.append(f'"{key}": {{\n{rows}\n    }}')
        members.append(f'"{name}": {{\n    ' + ",\n    ".join(keys) + "\n  }")
    if start.corrections:
        entries = []
        for frame, group in groupby(start.corrections, key=lambda one: one.frame):
            targets = "".join(f',\n     "{one.target}": {json.dumps(members_of(one))}' for one in group)
            entries.append(f'    {{"frame": {frame}{targets}}}')
        members.append('"corrections": [\n' + ",\n".join(entries) + "\n  ]")
    return "{\n  " + ",\n  ".join(members) + "\n}\n"


def members_of(correction: Correction) -> dict[str, Any]:
    """What a correction says of its target, by the keys of init files and of a trajectory's header."""
    found: dict[str, Any] = {}
    if correction.given.box is not None:
        found["box"] = [_number(value) for value in correction.given.box]
    for key, points in (("points", correction.given.points), ("kept", correction.kept)):
        if points:
            found[key] = {part: [_number(value) for value in point] for part, point in points.items()}
    if correction.absent:
        found["absent"] = True if correction.absent is True else list(correction.absent)
    if correction.learn is not None:
        found["learn"] = correction.learn
    return found


def record_of(correction: Correction) -> dict[str, Any]:
    """A correction as the header of a trajectory and a golden have it: its frame, its target, and what it says."""
    return {"frame": correction.frame, "target": correction.target, **members_of(correction)}


def as_yaml(start: Start, clip: str = "") -> str:
    """As YAML that says what is what; `clip` is named at the top."""
    how = _HOW.get(start.origin, "")
    lines = [
        f"# Where the track{f' of {_comment(clip)}' if clip else ''} begins{how}.",
        "# Edit the numbers: pixels of this frame, x to the right, y down; the centre of the first pixel is 0, 0.",
        f"frame: {start.frame}  # counted from 0",
    ]
    for name, target in start.targets.items():
        lines += [f"{_key(name)}:", *_target(target)]
    if start.corrections:
        lines += [
            "# What was put right by hand; from each of these frames on the target begins anew.",
            "# points, box: by hand; kept: where its other points were; absent: not to be seen from there on;",
            "# learn: whether what it looks like is learned anew there; if it is not said, what is given is.",
            "corrections:",
        ]
    for frame, group in groupby(start.corrections, key=lambda one: one.frame):
        lines.append(f"- frame: {frame}")
        for one in group:
            lines += [f"  {_key(one.target)}:", *_correction(one)]
    return "\n".join(lines) + "\n"


def _target(target: TargetStart) -> list[str]:
    lines = []
    if target.box is not None:
        lines.append(f"  box: {_list(target.box)}  # left, top, width, height")
    lines += _pairs("points", "x, y of each part; left and right as seen in the picture", target.points)
    if target.windows:
        lines += _pairs("windows", "width, height of the window that is compared", target.windows)
    elif target.points:
        example = next(iter(target.points))
        lines += [
            "  # To compare a larger or smaller window than the recipe's, give its width and height:",
            f"  # windows: {{{_key(example)}: [25, 25]}}",
        ]
    return lines


def _correction(one: Correction) -> list[str]:
    lines = [] if one.given.box is None else [f"    box: {_list(one.given.box)}"]
    lines += [*_points("points", one.given.points), *_points("kept", one.kept)]
    if one.absent is True:
        lines.append("    absent: true")
    elif one.absent:
        lines.append(f"    absent: [{', '.join(map(_key, one.absent))}]")
    if one.learn is not None:
        lines.append(f"    learn: {'true' if one.learn else 'false'}")
    return lines


def _points(key: str, points: Mapping[str, Point]) -> list[str]:
    """Points of a correction on one line, if they fit."""
    if not points:
        return []
    each = [f"{_key(name)}: {_list(point)}" for name, point in points.items()]
    line = f"    {key}: {{{', '.join(each)}}}"
    return [line] if len(line) <= _WIDE else [f"    {key}:", *(f"      {one}" for one in each)]


def _pairs(key: str, about: str, pairs: Mapping[str, tuple[float, float]]) -> list[str]:
    if not pairs:
        return []
    rows = [(f"    {_key(name)}: {_list(pair)}", WHAT_PARTS_ARE.get(name, "")) for name, pair in pairs.items()]
    wide = max(len(row) for row, _ in rows)
    told = [f"{row:<{wide}}  # {what}" if what and key == "points" else row for row, what in rows]
    return [f"  {key}:  # {about}", *told]


def _list(values: Sequence[float]) -> str:
    return f"[{', '.join(repr(_number(value)) for value in values)}]"


def _number(value: float) -> float | int:
    return int(value) if value == int(value) else float(value)


def _key(name: str) -> str:
    return f'"{name}"' if name.lower() in ("null", "true", "false", "yes", "no", "on", "off", "y", "n") else name


def _comment(text: str) -> str:
    return "".join(char if char.isprintable() else "?" for char in text)
