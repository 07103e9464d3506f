"""Corrections in an init file: what was put right by hand after its first frame.

    corrections:
    - frame: 31
      face:
        points: {mouth_left: [137.2, 153.9]}     # by hand
        kept: {nose: [160, 138.4]}               # where the others were; may be left out
        absent: [lip_upper]                      # not to be seen from there on; or true: all of it
        learn: true                              # what it looks like is learned anew; may be left out
    - frame: 60
      face: {absent: true}

An entry may name several targets. With a single target its keys may stand beside `frame`. The frames may stand in any
order, and no target may have two corrections in one frame.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Final, Literal

from facetrack_cli.core.types import BOX, Box, Correction, Point, TargetStart
from facetrack_cli.core.yaml_tree import Node
from facetrack_cli.tracking.start.init_values import (
    Branch,
    box_of,
    frame_number,
    mapping,
    nearest,
    points_of,
    refuse,
    shown,
)

KEYS: Final = ("box", "points", "kept", "absent", "learn")
_EXAMPLE: Final = "- frame: 31 and, below it, what was put right"
_NOTHING: Final = "add points: or box: by hand, or absent: true"


def read_corrections(node: Node, first: int, targets: Mapping[str, TargetStart]) -> tuple[Correction, ...]:
    """The corrections of a start at frame `first` with these targets, by their frames.

    Raises InputError, one line with file, line and column, for whatever cannot be meant.
    """
    if not isinstance(node.value, list):
        refuse(node, f"corrections is a list, not {shown(node)}; write {_EXAMPLE}, or remove the key")
    found: list[Correction] = []
    places: dict[tuple[int, str], int] = {}
    for entry in node.value:
        keys = dict(mapping(entry, "a correction", _EXAMPLE))
        if "frame" not in keys:
            refuse(entry, 'the key "frame" of this correction is missing; add frame: N, counted from 0')
        at = keys.pop("frame")
        frame = frame_number(at)
        if frame <= first:
            refuse(at, f"corrects frame {frame}, but the track begins in frame {first}; corrections come after it")
        for name, where, below in _by_target(keys, entry, at, frame, targets):
            if (frame, name) in places:
                line = places[frame, name]
                refuse(
                    where, f"{name} has a correction of frame {frame} in line {line} already; join them", at_key=True
                )
            places[frame, name] = (where.key or where.span).line + 1
            found.append(_correction(frame, name, below, where, targets[name]))
    return tuple(sorted(found, key=lambda one: one.frame))


def _by_target(
    keys: Branch, entry: Node, at: Node, frame: int, targets: Mapping[str, TargetStart]
) -> list[tuple[str, Node, Branch]]:
    """Of one entry the targets, where each stands, and what is said of it."""
    if not keys:
        refuse(at, f"nothing is put right in frame {frame}; {_NOTHING}, or remove the entry")
    if any(key in (*KEYS, "windows") for key in keys):
        if len(targets) > 1:
            refuse(entry, f"which target is put right? Indent the keys below its name: {', '.join(targets)}")
        return [(next(iter(targets)), entry, keys)]
    found = []
    for key, node in keys.items():
        if key not in targets:
            if not isinstance(node.value, dict) and len(targets) == 1:
                refuse(
                    node, f'unknown key "{key}"; {nearest(key, (*KEYS, *targets, "frame"), _keys_are())}', at_key=True
                )
            meant = nearest(key, (*targets, *KEYS), f"it begins with {', '.join(targets)}; give its start at the top")
            refuse(node, f'puts right "{key}", which the file does not begin with; {meant}', at_key=True)
        found.append((key, node, mapping(node, f"the correction of {key}", "points: or absent: below the name")))
    return found


def _keys_are() -> str:
    return f"keys of a correction are {', '.join(KEYS)}"


def _correction(frame: int, name: str, keys: Branch, where: Node, start: TargetStart) -> Correction:
    of = f" of {name}"
    for key, node in keys.items():
        if key == "windows":
            refuse(node, "windows stay as the start has them; remove them from the correction", at_key=True)
        if key not in KEYS:
            refuse(node, f'unknown key "{key}"{of}; {nearest(key, (*KEYS, "frame"), _keys_are())}', at_key=True)
    if not keys or not keys.keys() & {"box", "points", "absent"}:
        refuse(where, f"nothing{of} is put right in frame {frame}; {_NOTHING}, or remove it")
    absent = _absent(keys["absent"], of) if "absent" in keys else ()
    if absent is True and len(keys) > 1:
        other = next(key for key in keys if key != "absent")
        refuse(keys[other], f"{other}: all{of} is absent; remove {other}, or list the absent parts", at_key=True)
    if "box" in keys and "kept" in keys:
        refuse(keys["kept"], f"kept{of} beside its box: a box has no other parts; remove kept", at_key=True)
    box: Box | None = box_of(keys["box"], f"the box{of}") if "box" in keys else None
    points: dict[str, Point] = points_of(keys["points"], "points", "point", of) if "points" in keys else {}
    kept: dict[str, Point] = points_of(keys["kept"], "kept", "kept point", of) if "kept" in keys else {}
    parts = (*start.points, *((BOX,) if start.box is not None else ())) if start.points else ()
    _check_parts(keys, points, "points", parts, ())
    _check_parts(keys, kept, "kept", parts, (("points", points),))
    if absent is not True:
        given = {**points, **({BOX: ()} if box is not None else {})}
        _check_parts(keys, absent, "absent", parts, (("points" if points else "box", given), ("kept", kept)))
    return Correction(frame, name, TargetStart(box, points), kept, absent, _learn(keys))


def _absent(node: Node, of: str) -> tuple[str, ...] | Literal[True]:
    if node.value is True:
        return True
    if node.value is False:
        refuse(node, f"absent: false says nothing; remove it: what is given{of} is there again")
    if not isinstance(node.value, list):
        refuse(node, f"absent{of} is true or a list of parts, not {shown(node)}; write [nose] or true")
    if not node.value:
        refuse(node, f"absent{of} is empty; name parts, as [nose], or remove the key")
    names: list[str] = []
    for child in node.value:
        if not isinstance(child.value, str):
            refuse(child, f"absent{of} names {shown(child)}, which is no part; write names, as [nose]")
        if child.value in names:
            refuse(child, f"absent{of} names {child.value} twice; once will do")
        names.append(child.value)
    return tuple(names)


def _check_parts(
    keys: Branch,
    names: Collection[str],
    key: str,
    parts: Collection[str],
    others: tuple[tuple[str, Collection[str]], ...],
) -> None:
    """Refuse parts that the start does not have, where it names any, and those which `others` say something else of."""
    if key not in keys:
        return
    value = keys[key].value
    for at, name in enumerate(names):
        node = value[at] if isinstance(value, list) else value[name] if isinstance(value, dict) else keys[key]
        for other, given in others:
            if name in given:
                refuse(node, f"{name} is in {other} and in {key}; leave it in one of them", at_key=True)
        if parts and name not in parts:
            meant = nearest(name, parts, f"it has {', '.join(parts)}")
            refuse(node, f'{key} names "{name}", which the start does not have; {meant}', at_key=True)


def _learn(keys: Branch) -> bool | None:
    if "learn" not in keys:
        return None
    value = keys["learn"].value
    if not isinstance(value, bool):
        refuse(keys["learn"], f"learn is true or false, not {shown(keys['learn'])}; or remove it")
    return value
