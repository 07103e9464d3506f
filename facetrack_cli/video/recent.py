"""What was used last, as much of it as a number of bytes holds; who waits longest is not who comes first."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

_Key = TypeVar("_Key", bound=Hashable)
_Value = TypeVar("_Value")


class Recent(Generic[_Key, _Value]):
    """Values by key; those used longest ago are forgotten when all take more than `most_bytes`. Thread-safe."""

    def __init__(self, most_bytes: int):
        self.most_bytes = most_bytes
        self.bytes = 0
        self._known: OrderedDict[_Key, tuple[_Value, int]] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: _Key) -> _Value | None:
        with self._lock:
            known = self._known.get(key)
            if known is None:
                return None
            self._known.move_to_end(key)
            return known[0]

    def put(self, key: _Key, value: _Value, size: int) -> None:
        """Keep a value of so many bytes; the last one is kept however large it is."""
        with self._lock:
            if key in self._known:
                self.bytes -= self._known.pop(key)[1]
            self._known[key] = value, size
            self.bytes += size
            while self.bytes > self.most_bytes and len(self._known) > 1:
                self.bytes -= self._known.popitem(last=False)[1][1]

    def clear(self) -> None:
        with self._lock:
            self._known.clear()
            self.bytes = 0


class Turns:
    """A lock that goes to whoever asked last, since what was asked before is likely not wanted any more."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._tickets = 0
        self._waiting: list[int] = []
        self._taken = False

    def ticket(self) -> int:
        """A place in the queue, with which one may take several turns."""
        with self._condition:
            self._tickets += 1
            return self._tickets

    @contextmanager
    def turn(self, ticket: int) -> Iterator[None]:
        with self._condition:
            self._waiting.append(ticket)
            try:
                self._condition.wait_for(lambda: not self._taken and max(self._waiting) == ticket)
            finally:
                self._waiting.remove(ticket)
                self._condition.notify_all()
            self._taken = True
        try:
            yield
        finally:
            with self._condition:
                self._taken = False
                self._condition.notify_all()

    def overtaken(self, ticket: int) -> bool:
        """Whether somebody who asked later is waiting."""
        with self._condition:
            return max(self._waiting, default=0) > ticket
