"""What a route of the page is asked, and what it answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, NamedTuple

MOST: Final = 10**9  # of any number in an address


class RefusedError(Exception):
    """An answer in the 400s: its code, one line, and what else the JSON has."""

    def __init__(self, code: int, message: str, more: Mapping[str, Any] | None = None) -> None:
        super().__init__(message)
        self.code = code
        self.more = more or {}


class Answer(NamedTuple):
    """What a route gives back if it is not JSON with code 200: a `body` is JSON's value, or bytes of that `kind`."""

    body: Any
    code: int = 200
    kind: str = "application/json"
    headers: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Request:
    """What a route is asked: the whole numbers in its path, the query, and the JSON of a body ({} without one)."""

    numbers: tuple[int, ...] = ()
    query: Mapping[str, str] = field(default_factory=dict)
    body: Mapping[str, Any] = field(default_factory=dict)

    def whole(self, name: str, least: int = -MOST, most: int = MOST, default: int | None = None) -> int:
        """A whole number of the query. Raises RefusedError (400) if it is none, or out of range."""
        text = self.query.get(name)
        if text is None and default is not None:
            return default
        digits = (text or "").removeprefix("-")
        if text is None or not (digits.isascii() and digits.isdigit() and len(digits) < 12):
            raise RefusedError(400, f"{name} is no whole number")
        if not least <= int(text) <= most:
            raise RefusedError(400, f"{name} is {text}, and goes from {least} to {most}")
        return int(text)


class Route(NamedTuple):
    """`path` below the token, {} for a whole number in it, as in api/frame/{}.jpg; what the handler gives back is JSON
    with code 200, or an Answer. It may raise RefusedError; a FacetrackError becomes 422."""

    method: Literal["GET", "PUT", "POST"]
    path: str
    handler: Callable[[Request], Any]
