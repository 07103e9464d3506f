"""Values of an init file's YAML tree, each checked where it stands: every refusal is one line with its place."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from typing import Final, NoReturn, TypeAlias

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Box, Point
from facetrack_cli.core.yaml_tree import Node

MAX_PIXELS: Final = 1e6
MAX_FRAME: Final = 10**9
NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_-]{0,63}")
Branch: TypeAlias = "dict[str, Node]"


def mapping(node: Node, what: str, example: str) -> Branch:
    """The mapping that a node is; `what` it is said to be."""
    if not isinstance(node.value, dict):
        refuse(node, f"{what} is a mapping, not {shown(node)}; write {example}")
    return node.value


def named(node: Node, what: str, example: str) -> Branch:
    """A mapping by the names of parts, with something in it."""
    found = mapping(node, what, example)
    if not found:
        refuse(node, f"{what} is empty; write {example}, or remove the key")
    for name, child in found.items():
        if not NAME.fullmatch(name):
            refuse(child, f'"{name}" cannot name a part; use letters, digits, _ and -', at_key=True)
    return found


def frame_number(node: Node) -> int:
    """A frame, counted from 0."""
    value = node.value
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= MAX_FRAME:
        refuse(node, f"frame: {shown(node)} is no frame; give a whole number, from 0")
    return value


def numbers(node: Node, what: str, wanted: Sequence[str]) -> tuple[float, ...]:
    """A list of as many numbers of pixels as have a name in `wanted`."""
    shape = f"[{', '.join(wanted)}]"
    if not isinstance(node.value, list):
        refuse(node, f"{what} is {shape} in pixels, not {shown(node)}; write {len(wanted)} numbers in brackets")
    if len(node.value) != len(wanted):
        refuse(node, f"{what} has {len(node.value)} numbers; write {len(wanted)}: {shape}")
    found = []
    for name, child in zip(wanted, node.value, strict=True):
        value = child.value
        if isinstance(value, bool) or not isinstance(value, int | float):
            refuse(child, f"{name} of {what} is {shown(child)}; write a number of pixels")
        if not abs(value) <= MAX_PIXELS:
            refuse(child, f"{name} of {what} is {shown(child)}, beyond any picture; write a number of pixels")
        found.append(float(value))
    return tuple(found)


def area(size: tuple[float, float], node: Node, what: str) -> tuple[float, float]:
    """The size itself, if it is one: (width, height) above 0."""
    if min(size) <= 0:
        refuse(node, f"{what} has no area: width {size[0]:g}, height {size[1]:g}; both must be above 0")
    return size


def box_of(node: Node, what: str) -> Box:
    """[left, top, width, height] with an area."""
    left, top, width, height = numbers(node, what, ("left", "top", "width", "height"))
    return (left, top, *area((width, height), node, what))


def points_of(node: Node, what: str, a_point: str, of: str) -> dict[str, Point]:
    """{part: [x, y]}, at least one; `a_point` is what each is called, `of` whose they are."""
    points: dict[str, Point] = {}
    for name, child in named(node, f"{what}{of}", "nose: [x, y]").items():
        x, y = numbers(child, f"the {a_point} {name}{of}", ("x", "y"))
        points[name] = (x, y)
    return points


def nearest(name: str, known: Iterable[str], otherwise: str, cutoff: float = 0.6) -> str:
    """`did you mean "..."?` of the known name that is nearest, else what else to do."""
    near = get_close_matches(name, list(known), n=1, cutoff=cutoff)
    return f'did you mean "{near[0]}"?' if near else otherwise


def shown(node: Node) -> str:
    """A value as a message quotes it."""
    if isinstance(node.value, dict | list):
        return "a mapping" if isinstance(node.value, dict) else "a list"
    if node.value is None:
        return "nothing"
    text = str(node.value).lower() if isinstance(node.value, bool) else str(node.value)
    text = json.dumps(text, ensure_ascii=False) if isinstance(node.value, str) else text
    return text if len(text) <= 40 else f"{text[:37]}..."


def refuse(node: Node, message: str, *, at_key: bool = False) -> NoReturn:
    """InputError that says where the node, or the key that it stands under, is."""
    # what is not there has no place of its own, its key has
    span = node.key if (at_key or node.value is None) and node.key is not None else node.span
    raise InputError(f"{span.source.place(span)}: {message}")
