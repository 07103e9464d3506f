"""Reading the files of a run once, from end to end: where everything stands, and whether they say the same."""

from __future__ import annotations

import json
import re
from array import array
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.editor.files.run_index import STATUS, UNKNOWN, Book, Index, Span
from facetrack_cli.trajectory.row import COLUMNS, Format

_AGAIN: Final = "make the run again"
_FRAME: Final = re.compile(r'\{(?:"type":"frame",)?"frame":(\d{1,15}),"time_s":(null|[-0-9.]+),"targets":\[')
# the digits of a row in JSON are those of the CSV
_TEXTS: Final = json.JSONDecoder(parse_float=str, parse_int=str)
_VALUES: Final = json.JSONDecoder()
_OF_TARGET: Final = ("particles", "identity", "identity_prob")


def read_index(files: Mapping[Format, Path]) -> Index:
    """Read the files of a run once, and close none of them.

    Raises InputError, in one line with file and line, for what is no whole trajectory, or if the files differ.
    """
    books = {form: Book(path, form) for form, path in files.items()}
    try:
        return _Reader(books).read()
    except BaseException:
        for book in books.values():
            book.close()
        raise


class _Target(NamedTuple):
    begin: int  # characters, or bytes, of the line
    end: int
    values: Mapping[str, Any]


class _Reader:
    def __init__(self, books: Mapping[Format, Book]) -> None:
        self._books = books
        self._main = books["json"] if "json" in books else books["jsonl"]
        self._others = [book for book in books.values() if book is not self._main]
        self._lines = {book: book.lines() for book in books.values()}
        self._at = dict.fromkeys(books.values(), 0)
        self._number = dict.fromkeys(books.values(), 0)
        self._edges = {book: array("q") for book in books.values()}
        self._confidence = array("H")
        self._status = bytearray()
        self._parts: dict[str, tuple[str, ...]] = {}

    def read(self) -> Index:
        header = self._head()
        first, frames = 0, 0
        footer: Mapping[str, Any]
        while True:
            at = self._at[self._main]
            line = self._next(self._main)
            if self._main.form == "json" and line == b"],\n":
                footer = self._json_foot(at)
                break
            text = self._text(line)
            if self._main.form == "jsonl" and text.startswith('{"type":"footer"'):
                self._main.foot = {key: (at + b, at + e) for key, (b, e) in self._members(text, 0).items()}
                footer = self._loaded(text)
                break
            number, time_s, targets = self._frame(text, line)
            if frames == 0:
                first = number
                self._parts = self._first_parts(targets)
            elif number != first + frames:
                raise self._wrong(f"frame {number} follows frame {first + frames - 1}")
            self._check_targets(number, targets)
            self._note(at, targets)
            for book in self._others:
                self._compare(book, number, time_s, line, targets)
            frames += 1
        self._end(frames)
        shape = (frames, sum(map(len, self._parts.values())))
        for book in self._books.values():
            book.edges = np.frombuffer(self._edges[book], np.int64).reshape(frames, -1)
        return Index(
            self._main,
            tuple(self._books.values()),
            first,
            self._parts,
            header,
            footer,
            np.frombuffer(self._confidence, np.uint16).reshape(shape),
            np.frombuffer(bytes(self._status), np.uint8).reshape(shape),
        )

    # lines

    def _next(self, book: Book) -> bytes:
        """One more line; InputError at the end of the file."""
        line = next(self._lines[book], b"")
        self._number[book] += 1
        if not line.endswith(b"\n"):
            raise self._wrong("ends before the run does, was it cut short?", book)
        self._at[book] += len(line)
        return line

    def _wrong(self, why: str, book: Book | None = None, remedy: str = "") -> InputError:
        book = self._main if book is None else book
        if not remedy and book is not self._main:
            remedy = f"remove it, {self._main.path.name} tells the same, or {_AGAIN}"
        mark = " " if why.endswith("?") else "; "
        return InputError(f"{book.path}:{self._number[book]}: {why}{mark}{remedy or _AGAIN}")

    def _not_ours(self, book: Book | None = None) -> InputError:
        return self._wrong("is not as facetrack run writes it, was it edited?", book)

    def _text(self, line: bytes) -> str:
        try:
            return line.decode()
        except UnicodeDecodeError:
            raise self._not_ours() from None

    def _loaded(self, text: str) -> Mapping[str, Any]:
        try:
            found = json.loads(text)
        except (ValueError, RecursionError):
            found = None
        if not isinstance(found, dict):
            raise self._not_ours()
        return found

    # what stands around the frames

    def _head(self) -> Mapping[str, Any]:
        for book in self._others:
            if book.form == "csv":
                if self._next(book) != (",".join(COLUMNS) + "\n").encode():
                    raise self._wrong("has other columns or line ends than facetrack run writes, was it edited?", book)
            else:
                text = self._next(book).decode(errors="replace")
                book.head = self._members(text, 0, book)
        if self._main.form == "jsonl":
            text = self._text(self._next(self._main))
        else:
            lines = [self._text(self._next(self._main))]
            while lines[-1] != '"frames": [\n':
                if len(lines) > 100 or sum(map(len, lines)) > 10_000_000:
                    raise self._not_ours()
                lines.append(self._text(self._next(self._main)))
            text = "".join(lines)[: -len(',\n"frames": [\n')] + "}"
        self._main.head = self._members(text, 0)
        return self._loaded(text)

    def _json_foot(self, at: int) -> Mapping[str, Any]:
        lines: list[str] = []
        while (line := next(self._lines[self._main], b"")) and len(lines) < 100:
            lines.append(self._text(line))
        text = "{" + "".join(lines)
        # a brace stands where "],\n" did
        moved = at + len("],\n") - 1
        self._main.foot = {key: (b + moved, e + moved) for key, (b, e) in self._members(text, 0).items()}
        return self._loaded(text)

    def _members(self, text: str, at: int, book: Book | None = None) -> dict[str, Span]:
        """Where the value of each key of an object stands, in bytes of UTF-8."""
        found: dict[str, Span] = {}
        try:
            at = _blank(text, at + 1)
            while text[at] != "}":
                key, at = _VALUES.raw_decode(text, at)
                at = _blank(text, _blank(text, at) + 1)
                _, end = _VALUES.raw_decode(text, at)
                begin = len(text[:at].encode())
                found[str(key)] = begin, begin + len(text[at:end].encode())
                at = _blank(text, end)
                if text[at] == ",":
                    at = _blank(text, at + 1)
        except (ValueError, IndexError, RecursionError):
            raise self._not_ours(book) from None
        return found

    def _end(self, frames: int) -> None:
        if not frames:
            raise InputError(f"{self._main.path}: has no frames")
        if "lost_frames" not in self._main.foot or "init" not in self._main.head:
            raise self._not_ours()
        for book in self._others:
            if book.form == "csv":
                if next(self._lines[book], b""):
                    raise self._wrong(f"goes on after the last frame of {self._main.path.name}", book)
                continue
            at = self._at[book]
            text = self._next(book).decode(errors="replace")
            if not text.startswith('{"type":"footer"'):
                raise self._wrong(f"goes on after the last frame of {self._main.path.name}", book)
            book.foot = {key: (at + b, at + e) for key, (b, e) in self._members(text, 0, book).items()}

    # frames

    def _frame(self, text: str, line: bytes) -> tuple[int, str, list[_Target]]:
        """The frame's number, its time as it is written, and its targets with the bytes of the line they stand in."""
        head = _FRAME.match(text)
        if head is None:
            raise self._not_ours()
        at, targets = head.end(), []
        try:
            while text[at] == "{":
                values, end = _TEXTS.raw_decode(text, at)
                targets.append(_Target(at, end, values))
                at = end + (text[end] == ",")
            if not text.startswith("]}", at) or text[at + 2 :] not in ("\n", ",\n"):
                raise self._not_ours()
        except (ValueError, IndexError, RecursionError):
            raise self._not_ours() from None
        if len(line) != len(text):
            targets = [
                _Target(len(text[: one.begin].encode()), len(text[: one.end].encode()), one.values) for one in targets
            ]
        return int(head[1]), "" if head[2] == "null" else head[2], targets

    def _first_parts(self, targets: list[_Target]) -> dict[str, tuple[str, ...]]:
        try:
            found = {one.values["target"]: tuple(part["part"] for part in one.values["parts"]) for one in targets}
        except (KeyError, TypeError):
            raise self._not_ours() from None
        if not found or len(found) != len(targets) or not all(found.values()):
            raise self._not_ours()
        return found

    def _check_targets(self, number: int, targets: list[_Target]) -> None:
        try:
            same = len(targets) == len(self._parts) and all(
                one.values["target"] == name and tuple(part["part"] for part in one.values["parts"]) == parts
                for one, (name, parts) in zip(targets, self._parts.items(), strict=True)
            )
        except (KeyError, TypeError):
            same = False
        if not same:
            raise self._wrong(f"frame {number} has not the same targets and parts as the first")

    def _note(self, at: int, targets: list[_Target]) -> None:
        edges = self._edges[self._main]
        edges.extend(at + one.begin for one in targets)
        edges.append(at + targets[-1].end + 1)
        for one in targets:
            for part in one.values["parts"]:
                try:
                    self._status.append(_NUMBER[part["status"]])
                    sure = part.get("confidence")
                    self._confidence.append(UNKNOWN if sure is None else round(float(sure) * 10000))
                except (KeyError, TypeError, ValueError, OverflowError):
                    raise self._not_ours() from None

    def _compare(self, book: Book, number: int, time_s: str, line: bytes, targets: list[_Target]) -> None:
        """The next lines of another file, which must say the same."""
        at, edges = self._at[book], self._edges[book]
        edges.append(at)
        if book.form == "jsonl":
            own = b'{"type":"frame",'
            edges.pop()
            edges.extend(at + one.begin + len(own) - 1 for one in targets)
            edges.append(at + targets[-1].end + len(own))
            if self._next(book) != own + line[1:].removesuffix(b"\n").removesuffix(b",") + b"\n":
                raise self._differs(book, number)
            return
        for one in targets:
            # a name may hold a line break, and stands in quotes then
            for wanted in _csv(number, time_s, one.values).split(b"\n")[:-1]:
                if self._next(book) != wanted + b"\n":
                    raise self._differs(book, number)
            edges.append(self._at[book])

    def _differs(self, book: Book, number: int) -> InputError:
        why = f"differs from {self._main.path.name} in frame {number}"
        return self._wrong(why, book, f"remove the one that is wrong, or {_AGAIN}")


_NUMBER = {name: number for number, name in enumerate(STATUS)}


def _csv(number: int, time_s: str, target: Mapping[str, Any]) -> bytes:
    """The lines that the CSV has of a target whose numbers are texts."""
    shared = {"frame": str(number), "time_s": time_s, "target": _cell(target["target"])}
    shared |= {key: _cell(target[key]) for key in _OF_TARGET if key in target}
    lines = []
    for part in target["parts"]:
        row = {**part, **shared, "part": _cell(part["part"])}
        lines.append(",".join([row.get(column, "") for column in COLUMNS]) + "\n")
    return "".join(lines).encode(errors="backslashreplace")


def _cell(text: str) -> str:
    return '"' + text.replace('"', '""') + '"' if any(c in text for c in ',"\r\n') else text


def _blank(text: str, at: int) -> int:
    while text[at] in " \n\r\t":
        at += 1
    return at
