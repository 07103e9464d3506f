"""YAML 1.2 text as a tree of values, each with its place, so that an error can point at it.

The reader refuses anchors and aliases (a few lines can expand to gigabytes), tags, repeated keys, keys that are not
names, several documents, and numbers that are not finite.
Plain scalars follow the core schema of YAML 1.2.2, section 10.3.2: `1e-3` is a number, `no` a text, `010` ten.
"""

from __future__ import annotations

import codecs
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from ruamel.yaml import YAML, events
from ruamel.yaml.error import MarkedYAMLError, StringMark, YAMLError

from facetrack_cli.core.errors import RecipeError, visible

MAX_BYTES = 100_000  # the parser needs seconds for a megabyte; a recipe has a page
MAX_DEPTH = 20
MAX_DIGITS = 30  # of a whole number
_WORDS = {**dict.fromkeys(("null", "Null", "NULL", "~", "")), **dict.fromkeys(("true", "True", "TRUE"), True)}
_WORDS |= dict.fromkeys(("false", "False", "FALSE"), False)
_INT = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


class Source(NamedTuple):
    """A text and its name: the name of a file, or the option of the command line that holds the text."""

    name: str
    text: str
    folder: Path
    is_file: bool = True


class Span(NamedTuple):
    """A place in a source: line and column, counted from 0."""

    source: Source
    line: int
    column: int


class Problem(NamedTuple):
    """One error: its place and a message with the remedy."""

    span: Span
    message: str

    def __str__(self) -> str:
        source = self.span.source
        place = f":{self.span.line + 1}:{self.span.column + 1}" if source.is_file else ""
        return f"{source.name}{place}: {self.message}"


@dataclass(slots=True)
class Node:
    """A value and its place; `key` is the place of its key, or None."""

    span: Span
    value: str | int | float | bool | list[Node] | dict[str, Node] | None
    key: Span | None = None

    def plain(self) -> Any:
        """The value without its places: dicts, lists and scalars."""
        if isinstance(self.value, dict):
            return {key: node.plain() for key, node in self.value.items()}
        if isinstance(self.value, list):
            return [node.plain() for node in self.value]
        return self.value

    def at(self, path: Sequence[str | int]) -> tuple[Node, list[str]]:
        """The value at a path, or the nearest above it, and the keys that lead there.

        pydantic's paths also name the chosen member of a union (`sigma`, `for each`, `nose`), which has no place.
        """
        node, keys = self, list[str]()
        for step in path:
            value = node.value
            if isinstance(value, dict) and isinstance(step, str) and step in value:
                node = value[step]
                keys.append(step)
            elif isinstance(value, list) and isinstance(step, int) and step < len(value):
                node = value[step]
                keys.append(f"[{step + 1}]")
        return node, keys

    def walk(self) -> Iterator[tuple[tuple[str | int, ...], Node]]:
        """Every value below this one, and itself, with its path of keys and indices."""
        yield (), self
        of_list = enumerate(self.value) if isinstance(self.value, list) else ()
        for name, node in self.value.items() if isinstance(self.value, dict) else of_list:
            for path, child in node.walk():
                yield (name, *path), child


class YamlProblems(RecipeError):  # noqa: N818  (it carries several problems)
    """The text is refused: `problems` are all that is wrong, at least one; the message is that of the first."""

    def __init__(self, *problems: Problem) -> None:
        first, others = problems[0], len(problems) - 1
        more = f" (and {others} more: facetrack recipes check lists all)" if others else ""
        super().__init__(f"{first}{more}")
        self.problems = problems

    def __reduce__(self) -> Any:
        return RecipeError, (str(self),)  # in another process


def read_source(path: Path, name: str, most: int = MAX_BYTES) -> Source:
    """The text of a file. Raises YamlProblems if it is longer than `most` bytes or not UTF-8, and OSError."""
    with path.open("rb") as file:
        data = file.read(most + 1)
    start = Span(Source(name, "", path.parent), 0, 0)
    if len(data) > most:
        raise YamlProblems(Problem(start, f"larger than {most // 1000} kB: too large for such a file; name another"))
    data = data.removeprefix(codecs.BOM_UTF8)
    try:
        text = data.decode()
    except UnicodeDecodeError as error:
        message = f"byte {error.start + 1} is not UTF-8; is it a text file? Save it as UTF-8"
        raise YamlProblems(Problem(start, message)) from None
    return Source(name, text, path.parent)


def parse(source: Source, *, start: int = 0) -> Node | None:
    """The tree of the one document from the character `start` on, None without any. YamlProblems: all refused."""
    reader = _Reader(source, start)
    try:
        tree = reader.document(YAML(typ="safe", pure=True).parse(source.text[start:]))
    except (YAMLError, ValueError, OverflowError) as error:
        mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
        mark = mark or StringMark("", 0, 0, 0, "", 0)
        about = [getattr(error, "context", None), getattr(error, "problem", None)]
        why = " ".join(" ".join(filter(None, about) if any(about) else [str(error)]).split())
        message = f"not valid YAML: {why}; correct the text at or before this place"
        raise YamlProblems(Problem(reader.span(mark), message)) from None
    if reader.problems:
        raise YamlProblems(*reader.problems)
    return tree


def assign(root: Node, option: str, assignment: str) -> None:
    """Put a value from the command line into the tree: `option` is the option's name, `assignment` is `a.b=VALUE`.

    The value is YAML. Missing mappings on the way are made. Raises YamlProblems with the place.
    """
    source = Source(f"{option} {visible(assignment)}", assignment, Path(), is_file=False)
    path, equals, _ = assignment.partition("=")
    names = path.split(".")
    if not equals or "\n" in path or not all(map(str.strip, names)):
        message = f"no value, or no name, is given; write {option} KEY=VALUE, as in filter.particles=200"
        raise YamlProblems(Problem(Span(source, 0, 0), message))
    value = parse(source, start=len(path) + 1) or Node(Span(source, 0, len(path) + 1), None)
    node, column = root, 0
    for depth, raw in enumerate(names):
        name = raw.strip()
        key, column = Span(source, 0, column + raw.index(name)), column + len(raw) + 1
        if not isinstance(node.value, dict):
            above = ".".join(map(str.strip, names[:depth]))
            raise YamlProblems(Problem(key, f'"{above}" holds no keys; set it as a whole: {option} {above}=VALUE'))
        if depth == len(names) - 1:
            node.value[name] = Node(value.span, value.value, key)
        else:
            child = node.value.get(name)
            if child is None or child.value is None:
                child = node.value[name] = Node(key, {}, key)
            node = child


class _Reader:
    """Makes the tree of a parser's events; `problems` are all that is refused of it."""

    def __init__(self, source: Source, start: int) -> None:
        self.source, self.start, self.problems = source, start, list[Problem]()

    def document(self, parsed: Iterator[Any]) -> Node | None:
        """The tree of the one document, None without any."""
        self.events = (one for one in parsed if not isinstance(one, events.StreamStartEvent | events.DocumentEndEvent))
        if isinstance(next(self.events), events.StreamEndEvent):
            return None
        tree = self.node(next(self.events))
        if not isinstance(after := next(self.events), events.StreamEndEvent):
            raise MarkedYAMLError(problem="expected a single document", problem_mark=after.start_mark)
        return tree

    def node(self, event: Any, depth: int = 0) -> Node:
        begin = event.start_mark
        if depth > MAX_DEPTH:
            raise MarkedYAMLError(problem=f"nested more than {MAX_DEPTH} deep", problem_mark=begin)
        for why in _refused(event):
            self.problems.append(Problem(self.span(begin), why))
        value: Any = None
        if isinstance(event, events.MappingStartEvent):
            value, event = self.mapping(depth + 1)
        elif isinstance(event, events.SequenceStartEvent):
            value = []
            while not isinstance(event := next(self.events), events.SequenceEndEvent):
                value.append(self.node(event, depth + 1))
        elif isinstance(event, events.ScalarEvent):
            value = event.value if event.style else self.plain(event.value, self.span(begin))
        return Node(self.span(begin), value)

    def mapping(self, depth: int) -> tuple[dict[str, Node], Any]:
        """The values by their keys, and the event that ends them."""
        children: dict[str, Node] = {}
        while not isinstance(name := next(self.events), events.MappingEndEvent):
            key, value = self.node(name, depth), self.node(next(self.events), depth)
            if not isinstance(name, events.ScalarEvent):
                self.problems.append(Problem(key.span, "a key must be a name"))
            elif (first := children.get(name.value)) is not None and first.key is not None:
                also = f" (first on line {first.key.line + 1})" if self.source.is_file else ""
                why = f'the key "{name.value}" is repeated{also}; remove one of them'
                self.problems.append(Problem(key.span, why))
            else:
                children[name.value] = Node(value.span, value.value, key.span)
        return children, name

    def plain(self, text: str, span: Span) -> str | int | float | bool | None:
        """The value of a text without quotes."""
        if text in _WORDS:
            return _WORDS[text]
        if _INT.fullmatch(text) and len(text) < MAX_DIGITS:
            return int(text, {"0x": 16, "0o": 8}.get(text[:2], 10))
        if _NOT_FINITE.fullmatch(text) or (_FLOAT.fullmatch(text) and math.isinf(float(text))):
            self.problems.append(Problem(span, f"{text} is not a finite number; write one"))
            return None
        return float(text) if _FLOAT.fullmatch(text) else text

    def span(self, mark: Any) -> Span:
        return Span(self.source, mark.line, mark.column + (self.start if mark.line == 0 else 0))


def _refused(event: Any) -> Iterator[str]:
    if isinstance(event, events.AliasEvent):
        yield f'"*{event.anchor}" is an alias; write out what it refers to'
    elif event.anchor is not None:
        yield f'"&{event.anchor}" is an anchor; remove it, and write out what refers to it'
    if getattr(event, "tag", None) is not None:
        yield f'the tag "{str(event.tag).replace("tag:yaml.org,2002:", "!!")}" is not allowed; remove it'
    elif any("\ud800" <= char <= "\udfff" for char in getattr(event, "value", "")):
        yield "half of a surrogate pair is no character; write the character itself"
