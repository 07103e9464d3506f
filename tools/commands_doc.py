"""Two pages of the site that are made when it is built: the help of all commands, and the keys of recipes.

`site_links.py` takes `commands_page` and `keys_page`. Nothing but Click is imported for the help.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Sequence
from typing import Any, TypeAlias

import click

from facetrack_cli.cli.app import cli
from facetrack_cli.cli.options import EVERY

WIDTH = 100
Schema: TypeAlias = "dict[str, Any]"


# --- commands ------------------------------------------------------------------------------------------------------


def commands() -> Iterator[click.Context]:
    """A context of every command, in the order of the help: `facetrack`, `facetrack run`, ..."""

    def below(context: click.Context) -> Iterator[click.Context]:
        yield context
        if isinstance(group := context.command, click.Group):
            for name in group.list_commands(context):
                command = group.get_command(context, name)
                assert command is not None
                yield from below(click.Context(command, context, name, max_content_width=WIDTH, terminal_width=WIDTH))

    whole = click.Context(cli, None, "facetrack", max_content_width=WIDTH, terminal_width=WIDTH, **cli.context_settings)
    whole.meta[EVERY] = True
    yield from below(whole)


def commands_page() -> str:
    """The page in Markdown: of each command all of its help."""
    everything = list(commands())
    rows = [
        f"| [`{one.command_path}`](#{one.command_path.replace(' ', '-')}) | {one.command.get_short_help_str(200)} |"
        for one in everything[1:]
    ]
    parts = ["# Commands", "What `facetrack COMMAND --help-all` prints."]
    parts.append("\n".join(["| command | |", "|---|---|", *rows]))
    parts += [f"## {one.command_path}\n\n```text\n{one.get_help()}\n```" for one in everything]
    return "\n\n".join(parts) + "\n"


# --- keys of recipes -----------------------------------------------------------------------------------------------


def escape(text: str) -> str:
    """Plain text for Markdown: `<` begins no HTML, `|` ends no cell, `*` is no emphasis; `code` stays as it is."""
    pieces = text.split("`")
    return "`".join(re.sub(r"([<|*])", r"\\\1", piece) if i % 2 == 0 else piece for i, piece in enumerate(pieces))


def wrapped(text: str) -> str:
    """A paragraph in lines of at most WIDTH characters; `code` with spaces stays on one line."""
    kept = re.sub(r"`[^`]*`", lambda code: code[0].replace(" ", "\0"), text)
    return textwrap.fill(kept, WIDTH, break_long_words=False, break_on_hyphens=False).replace("\0", " ")


# --- keys of recipes -----------------------------------------------------------------------------------------------


def keys_page() -> str:
    """The page recipe_keys.md of the site."""
    intro = wrapped("From the settings in the code; `facetrack recipes schema` prints them as JSON schema.")
    return f"# Keys of recipes\n\n{intro}\n\n{keys_tables()}\n"


def keys_tables() -> str:
    """A table of keys for each kind of recipe."""
    from facetrack_cli.recipe.model import json_schema

    schema = json_schema()
    kinds = [resolve(schema, one) for one in schema["anyOf"]]
    return "\n\n".join(f"{wrapped(one['description'])}\n\n{keys_table({**schema, **one})}" for one in kinds)


def keys_table(schema: Schema) -> str:
    """Every key of a recipe: its values, default and meaning."""
    rows = ["| key | value | default | meaning |", "|---|---|---|---|"]
    for key, field in schema["properties"].items():
        sections = members(schema, field)
        if not sections:
            rows.append(row(schema, key, field, key in schema["required"]))
            continue
        default = "required" if key in schema["required"] else "none" if allows_null(field) else "as below"
        rows.append(f"| **`{key}`** | section | {default} | {escape(field.get('description', ''))} |")
        rows += section_rows(schema, key, sections)
    return "\n".join(rows)


def section_rows(schema: Schema, key: str, sections: Sequence[Schema]) -> Iterator[str]:
    """The keys of a section; a key that only some types have names them."""
    types = [one["properties"].get("type") for one in sections]
    if types[0] is not None:
        meanings = "; ".join(f"`{one['const']}`: {one['description'].rstrip('.')}" for one in types if one is not None)
        names = ", ".join(f"`{one['const']}`" for one in types if one is not None)
        yield f"| `{key}.type` | {names} | required | {escape(meanings)}. |"
    seen: list[tuple[str, Any]] = []
    for one in sections:
        for name, field in one["properties"].items():
            # a key with another meaning in another type has a row for each
            if name == "type" or (name, field) in seen:
                continue
            seen.append((name, field))
            having = [other for other in sections if other["properties"].get(name) == field]
            note = ""
            if len(having) < len(sections):
                only = ", ".join(f"`{other['properties']['type']['const']}`" for other in having)
                note = f"For {only} only. "
            required = name in one.get("required", [])
            below = members(schema, field)
            if below:
                default = "required" if required else "none"
                meaning = escape(field.get("description", ""))
                yield f"| **`{key}.{name}`** | section | {default} | {note}{meaning} |"
                yield from section_rows(schema, f"{key}.{name}", below)
            else:
                yield row(schema, f"{key}.{name}", field, required, note)


def row(schema: Schema, key: str, field: Schema, required: bool, note: str = "") -> str:
    default = field.get("default")
    words = {None: "null", True: "true", False: "false"}
    named = default is None or isinstance(default, bool)
    shown = "required" if required else f"`{words[default] if named else default}`"
    return f"| `{key}` | {value(schema, field)} | {shown} | {note}{escape(field.get('description', ''))} |"


def members(schema: Schema, field: Schema) -> list[Schema]:
    """The sections that a field accepts: one, several that differ by `type`, or none if it is a value."""
    if below := field.get("oneOf") or field.get("anyOf"):
        return [one for each in below for one in members(schema, each)]
    one = resolve(schema, field)
    return [one] if "properties" in one else []


def resolve(schema: Schema, field: Schema) -> Schema:
    name = field.get("$ref", "").removeprefix("#/$defs/")
    return {**schema["$defs"][name], "name": name} if name else field


def allows_null(field: Schema) -> bool:
    return {"type": "null"} in field.get("anyOf", [])


def value(schema: Schema, field: Schema) -> str:
    """The values of a key, in a few words."""
    name = field.get("$ref", "").removeprefix("#/$defs/")
    if name:
        named = {
            "LengthPerPart": "length, or `{part: length}`",
            "ShiftPerPart": "`[across, down]`, or `{part: [across, down]}`",
            "WindowPerPart": "length or `[width, height]`, or `{part: ...}`",
        }
        return named[name] if name in named else value(schema, schema["$defs"][name])
    if field.get("title") in ("Length", "LengthOrNone"):
        return "length"
    if field.get("type") == "object":
        return "`{name: section}`"
    if "anyOf" in field:
        return " or ".join(value(schema, one) for one in field["anyOf"])
    if "const" in field:
        return f"`{field['const']}`"
    if field.get("prefixItems"):
        return f"[{', '.join(value(schema, one) for one in field['prefixItems'])}]"
    if field.get("type") == "array" and field.get("maxItems", 100) < 100:
        return f"[1 to {field['maxItems']} of {value(schema, field['items'])}]"
    if "enum" in field:
        return ", ".join(f"`{one}`" for one in field["enum"])
    words = {
        "null": "`null`",
        "boolean": "`true` or `false`",
        "string": "text",
        "array": "list of names",
        "integer": "whole number",
        "number": "number",
    }
    bounds = (("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"), ("exclusiveMaximum", "<"))
    limits = {f"{sign} {field[bound]:,}": field[bound] for bound, sign in bounds if bound in field}
    # without the largest integer, and without bounds that only prevent overflow
    shown = [
        text
        for text, limit in limits.items()
        if len(text) < 15 and not (isinstance(limit, float) and abs(limit) >= 1e6)
    ]
    return " ".join([words[field["type"]], ", ".join(shown)]).strip()
