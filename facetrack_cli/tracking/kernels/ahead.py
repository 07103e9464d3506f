"""The kernels of a recipe compiled before they are called, in this process and a second one beside it.

Their one signature is declared here, and which settings call them. numba holds the interpreter's lock while it
compiles: a thread gains little. What is wrong here costs time alone: a kernel is compiled when it is called, if nobody
has compiled it before; if the second process fails, this one does its share.
"""

import contextlib
import json
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from pathlib import Path
from threading import Thread
from typing import Any

from facetrack_cli.tracking.kernels.cache import compiling

PATIENCE_S = 30.0  # for the last kernel of the second process, the dearest of which takes 3 s
_FILTERS = "filter=auxiliary filter=factorized filter=guided filter=independent filter=sir"
_CELLS, _LOOKS, _NCC = "likelihood=correlation_filter", "likelihood=appearance", "ncc"
_COLOURS = "likelihood=colour_ratio"
# a kernel, the dearest first; what it takes: f8 a number, f8x2 a tuple, f8:2 an array of two axes, f8:2r a read-only
# one; any of the settings that call it: `key=type`, or the key of a section without types
KERNELS: Mapping[str, tuple[str, str]] = {
    "patches.patch_distances": ("u1:2 i8x4 u1:2 i8x4 i8 f8:2 f8:2 f8x2 i8 i8 i8 f8 f8 f8:1", "correlation"),
    "contour.nearest_edges": ("u2:2 f8:2 i8 i8 i8 f8:2 f8:2 f8 f8", "contour"),
    "least_squares._solve": ("f8:2 f8:2 f8:1 f8:1 f8:1 f8:1 f8:1 f8:2 i4:1 i8 f8", "velocity"),
    "cells._of_scales": ("u1:2 f8 f8 f8:2 i8 f4:2 i8:2 f4:1 f4:3 f4:2 f4:2 i4:1 f4:4", _CELLS),
    "orientations._channels": ("f4:2 f4:2 f4:2 f4:2 f4:2 f4:3 f4:3 f4:2 f4:2 f4:3", "head"),
    "affine.read_patches": ("u1:2 i8 i8 i8 i8 i8 f8x4 f8:2 f8 f8 i8 i8", "target=affine"),
    "mixture.log_densities": ("f4:2r f4:2 f4:2 f4:2 f8 b1", _LOOKS),
    "windows._distances": ("u1:2 f4:1 i8:1 i8:2 i8:1 f8:3 i8 i8 i8 f8 i8 f8 f4:1 f4:1 f8:2", _COLOURS),
    "mixture.update": ("f4:1r f4:2 f4:2 f4:2 f8:2 f4:2 f4:2 f8 b1 f8 f8 f8", _LOOKS),
    "ncc.moments_direct": ("u1:2 f4:2 f8:2", _NCC),
    "shape._parzen": ("f8:3 i8:1 f8:2 i8 f8 f4:2 f4:1 f8:1 f4:1 i4:1 f4:1 f8:1 i8:1", "prior=parzen"),
    "ncc.place": ("f8:3 i8 f8x2 i8 i8 i8 i8", _NCC),
    "ncc.read_patch": ("u1:2 f8 f8 f8 i8 i8", _NCC),
    "ncc.variances": ("f8:2x5 f8:2 i8 i8 i8 i8", _NCC),
    "walk._arrive": ("f8:2 f8:2 f8:2 f8 f8:1 f8:1 f8:1 f8:1 f8:1 i8:1 f8:2 f8:2 f8:1", "motion=visible_walk"),
    "cells.multiply": ("f4:3 f4:3 f4:3", _CELLS),
    "mixture.errors": ("f4:2r f4:2 f4:2 f4:2", "velocity"),
    "histogram.match_integral": ("u2:2 i8:2 i8:2 f8:1 f4:2", "histogram"),
    "histogram.match_direct": ("u2:2 i8:2 i8:2 f8:1 f4:2", "histogram"),
    "mixture.best_matches": ("f4:2r f4:2", _LOOKS),
    "least_squares._differences": ("f4:2r i8:1 f4:1r f4:2 f8:2", "velocity"),
    "skin._map": ("u1:2 u1:1", "skin likelihood=skin"),
    "skin.differences": ("i4:2 f8:2 f8:2", "skin"),
    "ncc.means": ("f8:2 f8:2 f8:2 i8 i8", _NCC),
    "affine.diffuse": ("f8:2 f8:2 f8:2 f8:1 f8 f8 f8", "motion=affine_walk"),
    "skin.nested": ("f8:3 f8 f8 i8 i8 i8", "skin"),
    "cells.project": ("f4:2 f4:2 f4:1 f4:2", _CELLS),
    "cells.remember": ("f4:3 f4:3 f4", _CELLS),
    "cells.respond": ("f4:3 f4:3 f4:2", _CELLS),
    "cells._read_cubic": ("f4:2 f8:1 f8:1 f8:1 f8:1 f8:1", _CELLS),
    "histogram.code": ("u1:3 u2:2 u2:1 i8 i8", "histogram"),
    "histogram.edges": ("f8:2 f8 f8 i8 i8 i8 i8 i8", "histogram"),
    "histogram.crop": ("i8:2 i8:2", "histogram"),
    "resampling._invert_cdf": ("f8:2 f8:2 i8:2", _FILTERS),
    "affine.boxes_extent": ("f8:2 f8 f8 i8 i8", "target=affine correlation skin"),
    "ncc.bilinear": ("f4:2 f8:2 i8 i8", _NCC),
    "skin.at_points": ("u1:3 u1:2 f8:2", "likelihood=skin"),
    "least_squares._mapped": ("f8:2 f4:2 f4:1 f8:1", "velocity"),
    "mixture.greys": ("f4:1", _LOOKS),
    "windows.extent": ("f8:3 f8", f"{_COLOURS} likelihood=skin"),
}
_SERVE = "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from {0} import serve; serve()"


def kernel(name: str) -> Any:
    module, function = name.split(".")
    return getattr(import_module(f"{__package__}.{module}"), function)


def signature(name: str) -> tuple[Any, ...]:
    """numba's types of what a kernel takes."""
    from numba import types

    def of(word: str) -> Any:
        word, _, many = word.partition("x")
        word, _, axes = word.partition(":")
        one = getattr(types, word)
        if axes:
            one = types.Array(one, int(axes[0]), "C", readonly=axes.endswith("r"))
        return types.UniTuple(one, int(many)) if many else one

    return tuple(map(of, KERNELS[name][0].split()))


def of_recipe(settings: Mapping[str, Any]) -> list[str]:
    """The names of the kernels that a recipe calls, given as `to_dict` does; the dearest first."""
    said = set(_said("", settings))
    return [name for name, (_, by) in KERNELS.items() if not said.isdisjoint(by.split())]


def _said(key: str, settings: Any) -> Iterator[str]:
    if isinstance(settings, Mapping):
        yield f"{key}={settings['type']}" if "type" in settings else key
        for below, more in settings.items():
            yield from _said(below, more)


class Ahead:
    """What an earlier run has not left of a recipe's kernels, being compiled while the `with` block lasts.

    `processes`: how many there may be, this one too; the second one begins at once, this one with `finish`.
    """

    def __init__(self, settings: Mapping[str, Any], processes: int) -> None:
        self._left = deque(name for name in of_recipe(settings) if not _is_kept(name))
        self._process: subprocess.Popen[str] | None = None
        self._feeder = Thread(target=self._feed, name="compile", daemon=True)
        if self._left:
            compiling()
        # what embeds Python, or is frozen, is no interpreter that could be started
        if len(self._left) > 1 and processes > 1 and Path(sys.executable or "").stem.startswith("python"):
            command = [sys.executable, "-c", _SERVE.format(__name__), json.dumps(sys.path)]
            with contextlib.suppress(OSError):
                pipe = subprocess.PIPE
                self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True)
                self._feeder.start()

    def __enter__(self) -> "Ahead":
        return self

    def finish(self, stopped: Callable[[], bool] = lambda: False) -> None:
        """Compile what is left, until all is there or `stopped`."""
        waited = 0.0
        while not stopped():
            if self._left:
                with contextlib.suppress(IndexError):  # it is taken meanwhile
                    _compile(self._left.popleft())
            elif self._feeder.is_alive() and waited < PATIENCE_S:
                self._feeder.join(0.05)
                waited += 0.05
            else:
                return

    def __exit__(self, *_: object) -> None:
        self._left.clear()
        if self._process is not None:
            self._process.kill()
            self._feeder.join()
            with self._process:  # closes its pipes, waits for it
                pass

    def _feed(self) -> None:
        """Hand one kernel after the other to the second process; one that it dies of is left to this one."""
        assert self._process is not None and self._process.stdin and self._process.stdout
        while self._left:
            try:
                name = self._left.popleft()
            except IndexError:
                return
            answer = ""
            with contextlib.suppress(OSError, ValueError):
                self._process.stdin.write(f"{name}\n")
                self._process.stdin.flush()
                answer = self._process.stdout.readline()
            if not answer:
                self._left.append(name)
                return


def serve() -> None:
    """The second process: compile what standard input names, answer each, and end with the first process."""
    for line in sys.stdin:
        _compile(line.strip())
        sys.stdout.write("\n")
        sys.stdout.flush()


def _compile(name: str) -> None:
    with contextlib.suppress(Exception):  # where it is called it is said
        kernel(name).compile(signature(name))


def _is_kept(name: str) -> bool:
    """Whether a kernel was compiled before; also of what is no kernel, as where numba is switched off."""
    cache: Any = getattr(kernel(name), "_cache", None)
    return not hasattr(cache, "holds") or bool(cache.holds(kernel(name), signature(name)))
