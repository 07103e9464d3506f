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
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias

from ruamel.yaml import YAML, events
from ruamel.yaml.error import MarkedYAMLError, YAMLError

MAX_BYTES = 100_000  # the parser needs seconds for a megabyte; a recipe has a page
MAX_DEPTH = 20
EXCERPT_WIDTH = 100
Scalar: TypeAlias = "str | int | float | bool | None"
_WORDS = {**dict.fromkeys(("null", "Null", "NULL", "~", "")), **dict.fromkeys(("true", "True", "TRUE"), True)}
_WORDS |= dict.fromkeys(("false", "False", "FALSE"), False)
_INT = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


@dataclass(frozen=True, slots=True)
class Source:
    """A text and its name: the name of a file, or the option of the command line that holds the text."""

    name: str
    text: str
    folder: Path
    is_file: bool = True


@dataclass(frozen=True, slots=True)
class Span:
    """A place in a source: line and columns, counted from 0; `end` is one past its last character."""

    source: Source
    line: int
    column: int
    end: int

    def excerpt(self) -> str:
        """The line, and carets below the place; "" where there is no text."""
        from rich.cells import cell_len

        if not self.source.text:
            return ""
        lines = _lines(self.source.text)
        line = lines[self.line] if self.line < len(lines) else ""
        first = 0 if self.column < 0.8 * EXCERPT_WIDTH else self.column - EXCERPT_WIDTH // 2
        shown = line[first : first + EXCERPT_WIDTH]
        before = printable(shown[: self.column - first])
        under = printable(shown[self.column - first : max(self.end, self.column + 1) - first])
        gutter = f"{self.line + 1:>5} | " if self.source.is_file else "    "
        margin = f"{'|':>7} " if self.source.is_file else gutter
        return f"{gutter}{printable(shown)}\n{margin}{' ' * cell_len(before)}{'^' * max(1, cell_len(under))}"


@dataclass(frozen=True, slots=True)
class Problem:
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
    value: Scalar | list[Node] | dict[str, Node]
    key: Span | None = None

    def plain(self) -> Any:
        """The value without its places: dicts, lists and scalars."""
        if isinstance(self.value, dict):
            return {key: node.plain() for key, node in self.value.items()}
        if isinstance(self.value, list):
            return [node.plain() for node in self.value]
        return self.value

    def walk(self) -> Iterator[tuple[tuple[str | int, ...], Node]]:
        """Every value below this one, and itself, with its path of keys and indices."""
        yield (), self
        of_list = enumerate(self.value) if isinstance(self.value, list) else ()
        for name, node in self.value.items() if isinstance(self.value, dict) else of_list:
            for path, child in node.walk():
                yield (name, *path), child


class YamlProblems(Exception):  # noqa: N818  (it carries several problems)
    """The text is refused; `problems` holds at least one."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        super().__init__("; ".join(map(str, problems)))
        self.problems = tuple(problems)


def read_source(path: Path, name: str, most: int = MAX_BYTES) -> Source:
    """The text of a file. Raises YamlProblems if it is longer than `most` bytes or not UTF-8, and OSError."""
    with path.open("rb") as file:
        data = file.read(most + 1)
    start = Span(Source(name, "", path.parent), 0, 0, 0)
    if len(data) > most:
        raise YamlProblems([Problem(start, f"larger than {most // 1000} kB: too large for such a file; name another")])
    data = data.removeprefix(codecs.BOM_UTF8)
    try:
        text = data.decode()
    except UnicodeDecodeError as error:
        before = data[: error.start].decode()
        lines = _lines(before)
        span = Span(Source(name, before, path.parent), len(lines) - 1, len(lines[-1]), 0)
        message = f"byte 0x{data[error.start]:02x} is not UTF-8; is it a text file? Save it as UTF-8"
        raise YamlProblems([Problem(span, message)]) from None
    return Source(name, text, path.parent)


def parse(source: Source, *, start: int = 0) -> Node | None:
    """The tree of the one document from the character `start` on, None without any. YamlProblems: all refused."""
    return _Reader(source, start).read()


def assign(root: Node, option: str, assignment: str) -> None:
    """Put a value from the command line into the tree: `option` is the option's name, `assignment` is `a.b=VALUE`.

    The value is YAML. Missing mappings on the way are made. Raises YamlProblems with the place.
    """
    source = Source(f"{option} {printable(assignment)}", assignment, Path(), is_file=False)
    path, equals, _ = assignment.partition("=")
    whole = Span(source, 0, 0, max(1, len(path)))
    if not equals or any(c in path for c in "\n\r"):
        raise YamlProblems([Problem(whole, f"no value is given; write {option} KEY=VALUE, as in filter.particles=200")])
    value = parse(source, start=len(path) + 1) or Node(Span(source, 0, len(path), len(path) + 1), None)
    node, column = root, 0
    names = path.split(".")
    for depth, raw in enumerate(names):
        name = raw.strip()
        begin = column + len(raw) - len(raw.lstrip())
        key = Span(source, 0, begin, begin + max(1, len(name)))
        column += len(raw) + 1
        if not name:
            raise YamlProblems([Problem(key, "a name is missing here; write keys with one dot between them")])
        if not isinstance(node.value, dict):
            above = ".".join(part.strip() for part in names[:depth])
            raise YamlProblems([Problem(key, f'"{above}" holds no keys; set it as a whole: {option} {above}=VALUE')])
        if depth == len(names) - 1:
            node.value[name] = Node(value.span, value.value, key)
        else:
            child = node.value.get(name)
            if child is None or child.value is None:
                child = node.value[name] = Node(key, {}, key)
            node = child


@dataclass
class _Reader:
    source: Source
    start: int
    problems: list[Problem] = field(default_factory=list)
    seen_alias: bool = False

    def read(self) -> Node | None:
        root: Node | None = None
        try:
            stream = iter(YAML(typ="safe", pure=True).parse(self.source.text[self.start :]))
            for event in stream:
                if not isinstance(event, events.DocumentStartEvent):
                    continue
                if root is not None:
                    self.refuse(event, "a second document begins here; keep one in a file")
                    break
                if event.version not in (None, (1, 2), [1, 2]):
                    self.refuse(event, "only YAML 1.2 is read; remove the %YAML line")
                root = self.node(stream, next(stream), 0)
        except (YAMLError, ValueError, OverflowError) as error:
            self.problems = [self.syntax(error) if isinstance(error, MarkedYAMLError) else self.unreadable(error)]
        if self.problems:
            raise YamlProblems(self.problems)
        return root

    def node(self, stream: Iterator[Any], event: Any, depth: int) -> Node:
        if depth > MAX_DEPTH:
            self.refuse(event, f"nested more than {MAX_DEPTH} deep")
            raise YamlProblems(self.problems)
        span = self.span(event)
        if isinstance(event, events.AliasEvent):
            self.refuse(event, f'"*{event.anchor}" repeats another part of the file; write it out', of_anchors=True)
            return Node(span, None)
        if event.anchor is not None:
            why = f'"&{event.anchor}" is an anchor; remove it, and write out what refers to it'
            self.refuse(event, why, of_anchors=True)
        tag = event.ctag or event.tag
        if tag is not None and str(tag) != "!":
            self.refuse(event, f'the tag "{tag}" is not allowed; remove it')
        if isinstance(event, events.MappingStartEvent):
            return self.mapping(stream, event, depth)
        if isinstance(event, events.SequenceStartEvent):
            items: list[Node] = []
            while not isinstance(child := next(stream), events.SequenceEndEvent):
                items.append(self.node(stream, child, depth + 1))
            return Node(self.span(event, child), items)
        return Node(span, self.scalar(event))

    def mapping(self, stream: Iterator[Any], start: Any, depth: int) -> Node:
        children: dict[str, Node] = {}
        while not isinstance(event := next(stream), events.MappingEndEvent):
            key = self.node(stream, event, depth + 1)
            value = self.node(stream, next(stream), depth + 1)
            if not isinstance(event, events.ScalarEvent):
                self.refuse(event, "a key must be a name")
            elif (first := children.get(event.value)) is not None and first.key is not None:
                also = f" (first on line {first.key.line + 1})" if self.source.is_file else ""
                self.refuse(event, f'the key "{event.value}" is repeated{also}; remove one of them')
            else:
                children[event.value] = Node(value.span, value.value, key.span)
        return Node(self.span(start, event), children)

    def scalar(self, event: Any) -> Scalar:
        text: str = event.value
        if any("\ud800" <= char <= "\udfff" for char in text):
            self.refuse(event, "half of a surrogate pair is no character; write the character itself")
            return None
        if event.style is not None or not event.implicit[0]:
            return text
        if text in _WORDS:
            return _WORDS[text]
        if _INT.fullmatch(text):
            if len(text) > 30:
                self.refuse(event, f"a number of {len(text)} digits; is it meant as a text? Put it in quotes")
                return None
            return int(text, {"0x": 16, "0o": 8}.get(text[:2], 10))
        if _NOT_FINITE.fullmatch(text) or (_FLOAT.fullmatch(text) and math.isinf(float(text))):
            self.refuse(event, f"{text} is not a finite number; write one")
            return None
        return float(text) if _FLOAT.fullmatch(text) else text

    def span(self, event: Any, closing: Any = None) -> Span:
        begin, end = event.start_mark, event.end_mark
        if closing is not None and event.flow_style:
            end = closing.end_mark
        last = end.column if end.line == begin.line else begin.column + 1
        return self.at(begin.line, begin.column, last)

    def at(self, line: int, column: int, end: int) -> Span:
        head = _lines(self.source.text[: self.start])
        shift = len(head[-1]) if line == 0 else 0
        return Span(self.source, line + len(head) - 1, column + shift, end + shift)

    def refuse(self, event: Any, message: str, of_anchors: bool = False) -> None:
        if not (of_anchors and self.seen_alias):  # one message is enough for hundreds of them
            self.problems.append(Problem(self.span(event), message))
        self.seen_alias |= of_anchors

    def syntax(self, error: MarkedYAMLError) -> Problem:
        mark = error.problem_mark or error.context_mark
        line, column = (mark.line, mark.column) if mark is not None else (0, 0)
        span = self.at(line, column, column + 1)
        lines = _lines(self.source.text)
        here = lines[span.line][: span.column + 1] if span.line < len(lines) else ""
        if here.endswith("\t") or (here.strip() == "" and "\t" in here):
            return Problem(span, "a tab; YAML is indented by spaces, replace it")
        if error.problem == "mapping values are not allowed here":
            return Problem(span, "a second colon; put the text in quotes if it belongs to it, or begin a new line")
        about = " ".join(filter(None, (error.context, error.problem)))
        return Problem(span, f"not valid YAML: {' '.join(about.split())}; correct the text at or before this place")

    def unreadable(self, error: Exception) -> Problem:
        position = getattr(error, "position", None)
        if not isinstance(position, int):
            return Problem(self.at(0, 0, 1), f"not valid YAML: {' '.join(str(error).split())}; correct the text")
        lines = _lines(self.source.text[self.start :][:position])
        span = self.at(len(lines) - 1, len(lines[-1]), len(lines[-1]) + 1)
        return Problem(span, "a control character, which YAML does not allow; remove it")


@lru_cache(4)  # every problem of a recipe asks for them
def _lines(text: str) -> Sequence[str]:
    """The lines as YAML counts them, as its marks do; at least one."""
    return re.split(r"\r\n|[\n\r\x85\u2028\u2029]", text)


def printable(text: str) -> str:
    """The text without what would break a line or a terminal."""
    return "".join(char if char.isprintable() else " " if char == "\t" else "?" for char in text)
