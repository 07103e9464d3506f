"""Write the reference of commands and of recipe keys, from the help of the commands and the settings of recipes.

python tools/commands_doc.py            # writes docs/commands.md
python tools/commands_doc.py --check    # writes nothing; exit code 1 if it is stale

The page of keys is no file: tools/site_links.py makes it when the site is built.
"""

from __future__ import annotations

import argparse
import inspect
import itertools
import re
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import click

from facetrack_cli.cli.app import COMMANDS, cli
from facetrack_cli.recipe.schema import json_schema

DOCS = Path(__file__).resolve().parent.parent / "docs"
WIDTH = 100
Schema: TypeAlias = "dict[str, Any]"


# --- commands ------------------------------------------------------------------------------------------------------


def commands() -> Iterator[tuple[str, click.Command]]:
    """Every command with its full name, in the order of the help: `facetrack`, `facetrack run`, ..."""
    context = click.Context(cli, info_name="facetrack")
    yield "facetrack", cli
    for name in COMMANDS:
        command = cli.get_command(context, name)
        assert command is not None
        yield f"facetrack {name}", command
        if isinstance(command, click.Group):
            yield from ((f"facetrack {name} {below}", sub) for below, sub in command.commands.items())


def commands_page() -> str:
    """docs/commands.md."""
    parts = [
        "# Commands",
        wrapped("`tools/commands_doc.py` writes this page. `facetrack COMMAND --help` prints the same text."),
    ]
    everything = list(commands())
    rows = [f"| [`{name}`](#{name.replace(' ', '-')}) | {escape(short(command))} |" for name, command in everything[1:]]
    parts.append("\n".join(["| command | |", "|---|---|", *rows]))
    for name, command in everything:
        parts += [f"## {name}", f"```\n{usage(name, command)}\n```", *help_of(command), *options(command)]
    return "\n\n".join(parts) + "\n"


def short(command: click.Command) -> str:
    """The first sentence of a command's help."""
    return " ".join(inspect.cleandoc(command.help or "").split("\n\n")[0].split())


def usage(name: str, command: click.Command) -> str:
    arguments = [argument_name(one) for one in command.params if isinstance(one, click.Argument)]
    words = [name, "[OPTIONS]" if any(isinstance(one, click.Option) for one in command.params) else "", *arguments]
    return " ".join(filter(None, [*words, "COMMAND ..." if isinstance(command, click.Group) else ""]))


def argument_name(argument: click.Argument) -> str:
    name = argument.metavar or (argument.name or "").upper()
    return name if argument.required else f"[{name}]"


def help_of(command: click.Command) -> Iterator[str]:
    r"""The paragraphs of a help text; indented lines below a \b become a block of code."""
    for paragraph in inspect.cleandoc(command.help or "").split("\n\n"):
        kept = paragraph.startswith("\b\n")
        lines = [line if kept else line.strip() for line in paragraph.splitlines() if line != "\b"]
        for indented, group in itertools.groupby(lines, lambda line: line.startswith(" ")):
            if indented:
                yield "```sh\n" + textwrap.dedent("\n".join(group)) + "\n```"
            else:
                yield wrapped(escape(" ".join(" ".join(group).split())))


def options(command: click.Command) -> list[str]:
    """A table of the options, if there are any."""
    rows = []
    for option in command.params:
        if not isinstance(option, click.Option):
            continue
        value = "" if option.is_flag else " " + (option.metavar or "N")
        names = ", ".join(sorted(option.opts, key=len))
        rows.append(f"| `{names}{value}` | {escape(' '.join((option.help or '').split()))}{extra(option)} |")
    return ["\n".join(["| option | |", "|---|---|", *rows])] if rows else []


def extra(option: click.Option) -> str:
    """The default and the range, where click adds them to the help text."""
    said = [f"default: {option.default}"] if option.show_default else []
    if isinstance(option.type, click.IntRange) and not option.is_flag:
        low, high = option.type.min, option.type.max
        said += [f"{low} to {high}" if high is not None else f"from {low} up"]
    return f" [{', '.join(said)}]" if said else ""


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
    if field.get("title") == "Time":
        return "time"
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


def pages() -> dict[Path, str]:
    """The text of each page."""
    return {DOCS / "commands.md": commands_page()}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; exit code 1 if a page is stale")
    check = parser.parse_args(arguments).check
    stale = 0
    for path, text in pages().items():
        if path.exists() and path.read_text(encoding="utf-8") == text:
            continue
        stale += 1
        print(f"docs/{path.name} is stale; run: python tools/commands_doc.py" if check else f"docs/{path.name} written")
        if not check:
            path.write_text(text, encoding="utf-8")
    return 1 if check and stale else 0


if __name__ == "__main__":
    raise SystemExit(main())
