"""An init file's text, YAML with comments or JSON, which `read_init` reads back as it was."""

from __future__ import annotations

import json
from collections.abc import Mapping
from itertools import groupby
from typing import Any, Final

from facetrack_cli.core.types import Point, Start, TargetStart
from facetrack_cli.trajectory.header import corrected, whole

_HOW: Final = {"haar": "found by Haar cascades", "--box": "placed in the box given", "the page": "picked on the page"}
WHAT_PARTS_ARE: Final = {
    "nose": "the tip of the nose",
    "mouth_left": "the corner of the mouth on the picture's left",
    "mouth_right": "the corner on the picture's right",
    "lip_upper": "the middle of the upper lip, at its upper edge",
    "lip_lower": "the middle of the lower lip, at its lower edge",
}
_WIDE: Final = 88  # characters of a line; longer ones are split, a point on each


def as_json(start: Start) -> str:
    """As JSON: a line a part of the start, and a line a target of a correction."""
    members = [f'"frame": {start.frame}']
    for name, target in start.targets.items():
        keys = [] if target.box is None else [f'"box": {_flow(target.box)}']
        for key, pairs in (("points", target.points), ("windows", target.windows)):
            if pairs:
                rows = ",\n".join(f'      "{part}": {_flow(pair)}' for part, pair in pairs.items())
                keys.append(f'"{key}": {{\n{rows}\n    }}')
        members.append(f'"{name}": {{\n    ' + ",\n    ".join(keys) + "\n  }")
    if start.corrections:
        entries = []
        for frame, group in groupby(start.corrections, key=lambda one: one.frame):
            targets = "".join(f',\n     "{one.target}": {json.dumps(corrected(one))}' for one in group)
            entries.append(f'    {{"frame": {frame}{targets}}}')
        members.append('"corrections": [\n' + ",\n".join(entries) + "\n  ]")
    return "{\n  " + ",\n  ".join(members) + "\n}\n"


def as_yaml(start: Start, clip: str = "") -> str:
    """As YAML with comments; `clip` is named at the top."""
    how = f", {_HOW[start.origin]}" if start.origin in _HOW else ""
    of = f" of {''.join(char if char.isprintable() else '?' for char in clip)}" if clip else ""
    lines = [
        f"# Where the track{of} begins{how}.",
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
            lines.append(f"  {_key(one.target)}:")
            for key, value in corrected(one).items():
                line = f"    {key}: {_flow(value)}"
                split = isinstance(value, dict) and len(line) > _WIDE
                lines += [f"    {key}:", *_below(value, 6)] if split else [line]
    return "\n".join(lines) + "\n"


def _target(target: TargetStart) -> list[str]:
    lines = [] if target.box is None else [f"  box: {_flow(target.box)}  # left, top, width, height"]
    if target.points:
        rows = list(zip(_below(target.points, 4), map(WHAT_PARTS_ARE.get, target.points), strict=True))
        wide = max(len(row) for row, _ in rows)
        lines.append("  points:  # x, y of each part; left and right as seen in the picture")
        lines += [f"{row:<{wide}}  # {what}" if what else row for row, what in rows]
    if target.windows:
        lines += ["  windows:  # width, height of the window that is compared", *_below(target.windows, 4)]
    elif target.points:
        lines += [
            "  # To compare a larger or smaller window than the recipe's, give its width and height:",
            f"  # windows: {_flow({next(iter(target.points)): (25, 25)})}",
        ]
    return lines


def _below(pairs: Mapping[str, Point], indent: int) -> list[str]:
    return [f"{' ' * indent}{_key(name)}: {_flow(pair)}" for name, pair in pairs.items()]


def _flow(value: Any) -> str:
    """Numbers, names, lists and mappings on one line."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{_key(name)}: {_flow(one)}' for name, one in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_flow, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    return _key(value) if isinstance(value, str) else repr(whole(value))


def _key(name: str) -> str:
    return f'"{name}"' if name.lower() in ("null", "true", "false", "yes", "no", "on", "off", "y", "n") else name
