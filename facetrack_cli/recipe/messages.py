"""The errors that pydantic finds in a recipe, as problems with a place in the text and a remedy."""

import types
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from facetrack_cli.core.yaml_tree import Node, Problem, Span
from facetrack_cli.recipe.sections import Steps, suggest, type_of, variants

_WANTED = {
    **dict.fromkeys(("int_type", "int_from_float"), "a whole number"),
    **dict.fromkeys(("model_type", "model_attributes_type", "dict_type"), "a mapping of keys"),
    **dict.fromkeys(("list_type", "tuple_type"), "a list"),
    "float_type": "a number",
    "string_type": "a text",
    "bool_type": "true or false",
}
_BOUNDS = {
    "greater_than": ("gt", "greater than {}"),
    "greater_than_equal": ("ge", "at least {}"),
    "less_than": ("lt", "less than {}"),
    "less_than_equal": ("le", "at most {}"),
    "string_too_short": ("min_length", "at least {} characters long"),
    "string_too_long": ("max_length", "at most {} characters long"),
}
_NAMES = "a name has small letters, digits and _, and begins with a letter"


def problems(error: ValidationError, model: type[BaseModel], root: Node) -> list[Problem]:
    """Everything that the error lists, in the order of the text."""
    errors = error.errors(include_url=False)
    listed = [problem for details in errors for problem in _problems(details, model, root)]
    listed += _short_lists([details["loc"] for details in errors if details["type"] == "missing"], root)
    return sorted(listed, key=lambda p: (not p.span.source.is_file, p.span.line, p.span.column))


def _short_lists(missing: Sequence[Steps], root: Node) -> Iterator[Problem]:
    """pydantic reports each missing item of a list of fixed length: this reports each list once."""
    wanted: dict[Steps, int] = {}
    for *path, last in missing:
        if isinstance(last, int):
            wanted[tuple(path)] = max(last + 1, wanted.get(tuple(path), 0))
    for steps, length in wanted.items():
        node, keys, _ = locate(root, steps)
        yield Problem(_value_span(node), f"{_dotted(keys)} must have {length} items, not {_length(node)}")


def locate(root: Node, path: Steps) -> tuple[Node, list[str], bool]:
    """The value at a path, or the nearest above it; the keys that lead there; and whether it is the value itself.

    pydantic's paths also name the chosen member of a union (`filter`, `sir`, `particles`): such a step has no place.
    """
    node, keys, exact = root, [], True
    union_open = False
    for step in path:
        value = node.value
        if isinstance(value, dict):
            kind = value.get("type")
            if union_open and kind is not None and kind.value == step:
                union_open = False
                continue
            if isinstance(step, str) and step in value:
                node, union_open, exact = value[step], True, True
                keys.append(step)
                continue
        elif isinstance(value, list) and isinstance(step, int) and step < len(value):
            node, union_open, exact = value[step], True, True
            keys.append(f"[{step + 1}]")
            continue
        exact = False
    return node, keys, exact


def _problems(details: ErrorDetails, model: type[BaseModel], root: Node) -> Iterator[Problem]:
    kind, path, context = details["type"], details["loc"], details.get("ctx", {})
    if kind == "refused":
        for refusal in context["refusals"]:
            node, _, _ = locate(root, (*path, *refusal.path))
            yield Problem(node.key if refusal.at_key and node.key else _value_span(node), refusal.message)
        return
    node, keys, _ = locate(root, path)
    where, at = _dotted(keys), node.key or node.span
    types = [type_of(member) for member in _models_at(model, tuple(keys))] if kind.startswith("union") else []
    if kind == "too_short" and _length(node) >= context["min_length"]:
        return  # pydantic does not count items that are wrong themselves
    if kind == "missing" and isinstance(path[-1], int):
        return  # the list as a whole has a message
    if kind == "missing":
        section = f'"{where}"' if where else "the recipe"
        yield Problem(at, f'{section} lacks the key "{path[-1]}"; add it')
    elif kind == "extra_forbidden":
        yield Problem(at, _unknown_key(str(path[-1]), path, model, root))
    elif kind == "union_tag_not_found":
        yield Problem(at, f'"{where}" lacks the key "type"; it is one of: {", ".join(types)}')
    elif kind == "union_tag_invalid":
        chosen = node.value["type"] if isinstance(node.value, dict) else Node(node.span, None)
        message = f"{where}.type cannot be {_shown(chosen.value)}; it is one of: {', '.join(types)}"
        if isinstance(chosen.value, str):
            message = f'unknown {where} type "{chosen.value}"; {suggest(chosen.value, types, "it is one of")}'
        yield Problem(chosen.span, message)
    elif path[-1] == "[key]":  # how pydantic calls the name itself in a mapping from any name
        rule = _NAMES if kind == "string_pattern_mismatch" else f"give {context['max_length']} characters at most"
        yield Problem(at, f'"{keys[-1]}" cannot be one of {_dotted(keys[:-1])}; {rule}')
    else:
        yield Problem(_value_span(node), f"{where or 'the recipe'} {_must(details, node)}")


def _must(details: ErrorDetails, node: Node) -> str:
    kind, context = details["type"], details.get("ctx", {})
    shown = _shown(node.value)
    if kind in _WANTED:
        quoted = isinstance(node.value, str) and kind in ("int_type", "float_type") and _is_number(node.value)
        return f"must be {_WANTED[kind]}, not {shown}{'; remove the quotes' if quoted else ''}"
    if kind in _BOUNDS:
        name, phrase = _BOUNDS[kind]
        bound = context[name]  # written as people do: 1000000, not 1e+06
        number = bound if isinstance(bound, int) else format(bound, ".0f" if bound.is_integer() else "g")
        if isinstance(node.value, str):  # a time
            shown = f"{details['input']:g}, which is {node.value} at the clip's frame rate"
        return f"must be {phrase.format(number)}, not {shown}"
    if kind in ("too_short", "too_long"):
        bound = f"at least {context['min_length']}" if kind == "too_short" else f"at most {context['max_length']}"
        return f"must have {bound} items, not {_length(node)}"
    if kind == "literal_error":
        choices = [word.strip(" '") for word in str(context["expected"]).replace(" or ", ",").split(",")]
        return f"cannot be {shown}; {suggest(str(node.value), choices, 'it is one of')}"
    if kind == "string_pattern_mismatch":
        return f"cannot be {shown}; {_NAMES}"
    return f"{details['msg']}, not {shown}"


def _unknown_key(key: str, path: Steps, model: type[BaseModel], root: Node) -> str:
    node, keys, _ = locate(root, path[:-1])
    section = _dotted(keys)
    owners = _models_at(model, path[:-1])
    names = [name for owner in owners[:1] for name in owner.model_fields]
    homes = [type_of(kind) for kind in _models_at(model, tuple(keys)) if key in kind.model_fields]
    if homes and section:
        mine = type_of(owners[0])
        chosen = node.value.get("type") if isinstance(node.value, dict) else None
        typed = chosen is not None and not chosen.span.source.is_file
        remedy = f"give all of it at once: --set '{section}={{type: {mine}, ...}}'" if typed else "remove it"
        return f'"{key}" does not belong to {section} type "{mine}" but to {" and ".join(homes)}; {remedy}'
    inside = f' in "{section}"' if section else ""
    return f'unknown key "{key}"{inside}; {suggest(key, names, "the keys there are")}'


def _models_at(model: type[BaseModel], path: Steps) -> list[type[BaseModel]]:
    """The models that may stand at a path: one, or all members of a union whose member the path does not name."""
    here = [model]
    named_by_user = False  # the key of a mapping from any name to a model
    for step in path:
        if named_by_user:
            named_by_user = False
            continue
        named = [kind for kind in here if len(here) > 1 and type_of(kind) == step]
        if named:
            here = named
            continue
        fields = [kind.model_fields[step] for kind in here if isinstance(step, str) and step in kind.model_fields]
        named_by_user = any(get_origin(info.annotation) is dict for info in fields)
        here = [below for info in fields for below in _models_in(info.annotation)]
    return here


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return variants(annotation)
    if get_origin(annotation) in (Union, types.UnionType):
        return [model for member in get_args(annotation) for model in _models_in(member)]
    if get_origin(annotation) is dict:
        return _models_in(get_args(annotation)[1])
    return _models_in(get_args(annotation)[0]) if get_origin(annotation) is Annotated else []


def _length(node: Node) -> int:
    return len(node.value) if isinstance(node.value, list | dict) else 0


def _value_span(node: Node) -> Span:
    """The place of a wrong value; of a section, and of an empty value, the place of its key."""
    nothing = node.span.end <= node.span.column
    return node.key if node.key is not None and (nothing or isinstance(node.value, dict)) else node.span


def _dotted(keys: Sequence[str]) -> str:
    return ".".join(keys).replace(".[", "[")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _shown(value: Any) -> str:
    if isinstance(value, str):
        short = value if len(value) <= 40 else value[:40] + "..."
        return f'the text "{" ".join(short.split())}"'
    if value is None or isinstance(value, bool):
        return "empty (null)" if value is None else str(value).lower()
    return "a mapping" if isinstance(value, dict) else "a list" if isinstance(value, list) else str(value)
