"""The errors that pydantic finds in a recipe, as problems with a place in the text and a remedy."""

import re
from collections.abc import Iterator, Sequence
from typing import Any, Final, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from facetrack_cli.core.yaml_tree import Node, Problem, Span
from facetrack_cli.recipe.sections import Steps, suggest, type_of, variants

_NAMES = "a name has small letters, digits and _, begins with a letter, and is not long"
# of what pydantic says, the words that people who write recipes would use
_PLAIN: Final = {
    "(Input|String|Number|List|Tuple|Dictionary) should": "must",
    "greater than or equal to": "at least", "less than or equal to": "at most", " after validation": "",
    "a valid integer.*": "a whole number", "a valid string.*": "a text", "a valid tuple": "a list",
    "a valid boolean.*": "true or false", "a valid ": "a ",
}  # fmt: skip


def problems(error: ValidationError, model: type[BaseModel], root: Node) -> list[Problem]:
    """Everything that the error lists, in the order of the text."""
    listed = [problem for details in error.errors(include_url=False) for problem in _problems(details, model, root)]
    return sorted(listed, key=lambda p: (not p.span.source.is_file, p.span.line, p.span.column))


def locate(root: Node, path: Steps) -> tuple[Node, list[str]]:
    """The value at a path, or the nearest above it, and the keys that lead there.

    pydantic's paths also name the chosen member of a union (`filter`, `sir`, `particles`): such a step has no place.
    """
    node, keys, may_be_member = root, list[str](), False
    for step in path:
        value = node.value
        if may_be_member and isinstance(value, dict) and "type" in value and value["type"].value == step:
            may_be_member = False  # a key of the section may have the same name
        elif isinstance(value, dict) and isinstance(step, str) and step in value:
            node, may_be_member = value[step], True
            keys.append(step)
        elif isinstance(value, list) and isinstance(step, int) and step < len(value):
            node, may_be_member = value[step], True
            keys.append(f"[{step + 1}]")
    return node, keys


def _problems(details: ErrorDetails, model: type[BaseModel], root: Node) -> Iterator[Problem]:
    kind, path = details["type"], details["loc"]
    if kind == "refused":
        for refusal in details["ctx"]["refusals"]:
            node, _ = locate(root, (*path, *refusal.path))
            yield Problem(node.key if refusal.at_key and node.key else _value_span(node), refusal.message)
        return
    node, keys = locate(root, path)
    where, at = _dotted(keys), node.key or node.span
    if kind == "missing":
        what = f"item {path[-1] + 1}" if isinstance(path[-1], int) else f'the key "{path[-1]}"'
        section = f'"{where}"' if where else "the recipe"
        yield Problem(at, f"{section} lacks {what}; add it")
    elif kind == "extra_forbidden":
        above, owners = _dotted(locate(root, path[:-1])[1]), _models_at(model, path[:-1])
        names = suggest(
            str(path[-1]), [name for owner in owners[:1] for name in owner.model_fields], "the keys there are"
        )
        inside = f' in "{above}"' if above else ""
        yield Problem(at, f'unknown key "{path[-1]}"{inside}; {names}')
    elif kind.startswith("union_tag"):
        types = [type_of(member) for member in _models_at(model, tuple(keys))]
        chosen = node.value.get("type") if isinstance(node.value, dict) else None
        if chosen is None:
            yield Problem(at, f'"{where}" lacks the key "type"; it is one of: {", ".join(types)}')
        else:
            named = suggest(str(chosen.value), types, "it is one of")
            yield Problem(chosen.span, f"{where}.type cannot be {_shown(chosen.value)}; {named}")
    elif path[-1] == "[key]":  # how pydantic calls the name itself in a mapping from any name
        yield Problem(at, f'"{keys[-1]}" cannot be one of {_dotted(keys[:-1])}; {_NAMES}')
    elif kind != "too_short" or _length(node) < details["ctx"]["min_length"]:  # items that are wrong do not count there
        yield Problem(_value_span(node), f"{where or 'the recipe'} {_said(details, node)}")


def _said(details: ErrorDetails, node: Node) -> str:
    """What pydantic says, with what stands in the text."""
    said = details["msg"]
    for theirs, plain in _PLAIN.items():
        said = re.sub(theirs, plain, said)
    if details["type"] in ("model_type", "model_attributes_type", "dict_type"):
        said = "must be a mapping of keys"
    elif details["type"] == "string_pattern_mismatch":
        said = f"does not fit: {_NAMES}"
    return said if ", not " in said else f"{said}, not {_shown(node.value)}"


def _models_at(model: type[BaseModel], path: Steps) -> list[type[BaseModel]]:
    """The models that may stand at a path: one, or all members of a union whose member the path does not name."""
    here = [model]
    named_by_user = False  # the key of a mapping from any name to a model
    for step in path:
        if named_by_user:
            named_by_user = False
            continue
        if named := [kind for kind in here if len(here) > 1 and type_of(kind) == step]:
            here = named
            continue
        fields = [kind.model_fields[step] for kind in here if isinstance(step, str) and step in kind.model_fields]
        named_by_user = any(get_origin(info.annotation) is dict for info in fields)
        here = [below for info in fields for below in _models_in(info.annotation)]
    return here


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return variants(annotation)
    return [model for member in get_args(annotation) for model in _models_in(member)]


def _length(node: Node) -> int:
    return len(node.value) if isinstance(node.value, list | dict) else 0


def _value_span(node: Node) -> Span:
    """The place of a wrong value; of a section, and of an empty value, the place of its key."""
    nothing = node.span.end <= node.span.column
    return node.key if node.key is not None and (nothing or isinstance(node.value, dict)) else node.span


def _dotted(keys: Sequence[str]) -> str:
    return ".".join(keys).replace(".[", "[")


def _shown(value: Any) -> str:
    if isinstance(value, str):
        short = value if len(value) <= 40 else value[:40] + "..."
        return f'the text "{" ".join(short.split())}"'
    if value is None or isinstance(value, bool):
        return "empty (null)" if value is None else str(value).lower()
    return "a mapping" if isinstance(value, dict) else "a list" if isinstance(value, list) else str(value)
