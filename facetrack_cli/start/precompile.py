"""The dear kernels of a recipe, compiled before they are called, in this process and in a second process beside it.

This file declares the one signature of each of them, and the setting that calls it. numba holds the interpreter's lock
while it compiles, so threads gain little. The first call compiles a kernel that is missing.
"""

import contextlib
import json
import pkgutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from facetrack_cli.engine.kernels.cache import compiling

# a kernel that takes a second or more to compile, the dearest first; what it takes: f8 a number, f8x2 a tuple, f8:2 an
# array of two axes, f8:2r a read-only one; the setting that calls it: `key=type`, or the key of a section without types
KERNELS: Mapping[str, tuple[str, str]] = {
    "trackers.regions.region_kernels.patch_distances": (
        "u1:2 i8x4 u1:2 i8x4 i8 f8:2 f8:2 f8x2 i8 i8 f8 b1 f8 f8:1",
        "correlation",
    ),
    "trackers.regions.region_kernels.nearest_edges": ("u2:2 f8:2 i8 i8 i8 f8:2 f8:2 f8 f8", "contour"),
    "trackers.appearance.appearance_kernels.gain": ("f8:2 f8:2 i8 f8", "velocity"),
    "trackers.box.box_kernels.gradients_of_scales": ("u1:2 f8 f8 f8:2 i8 f4:4", "likelihood=correlation_filter"),
    "trackers.face.image_kernels._channels": ("f4:3", "head"),
    "trackers.face.image_kernels.run_stages": ("f4:3 f8:2 f8:2 f8:1 f4:3", "head"),
    "trackers.face.window_kernels.greatest": ("f4:3 f4:4 i8:1 i8:2 f8:2 f4:3", "likelihood=window_ncc"),
    "trackers.face.landmark_kernels.jump": (
        "f8:3 f8:2 f8:3 f8:2 f8:2 f8 f8:1 f8:1 f8 f8:2 f8 f8 f4:3 f8:2 f8:1 f8 f8 f8:3 f8:2",
        "motion=jumping_walk",
    ),
    "trackers.face.landmark_kernels.learn": (
        "f8:3 f8:2 f8:3 f8:1 f8:2 f8:2 f8:1 f8 f8 f8:3 f8:2 f8:2 f8:2 f8:2",
        "head",
    ),
    "trackers.face.landmark_kernels.judge": (
        "f8:2 i8:1 i8:2 f4:3 f8:2 f8:1 f8:1 f8:2 f8:3 f8:1 f8 f8:1 f8:1 f8:1 f8:2 b1:1 b1:1",
        "likelihood=window_ncc",
    ),
    "trackers.appearance.appearance_kernels.read_patches": (
        "u1:2 i8 i8 i8 i8 i8 f8x4 f8:2 f8 f8 i8 i8",
        "target=affine",
    ),
    "trackers.appearance.appearance_kernels.log_densities": ("f4:2r f4:2 f4:2 f4:2 f8 b1", "likelihood=appearance"),
    "trackers.points.point_kernels.colour_ratio_distances": (
        "u1:2 f4:1 i8:1 i8:2 i8:1 f8:3 i8 i8 i8 f8 i8 f8 f8:2",
        "likelihood=colour_ratio",
    ),
    "trackers.appearance.appearance_kernels.update": (
        "f4:1r f4:2 f4:2 f4:2 f8:2 f4:2 f4:2 f8 b1 f8 f8 f8",
        "likelihood=appearance",
    ),
    "trackers.points.point_kernels.parzen": ("f8:3 i8:1 f8:2 i8 f8 f4:2 f4:1 f8:1", "prior=parzen"),
    "trackers.hands.hand_kernels.move": (
        "f8:3 b1:2 b1:1 f8:3 f8:3 f8:2 f8:1 f8:1 f8:1 f8:1 f8 f4:2 f4:2 f8:1 f8 f8 f8:1",
        "hands",
    ),
    "trackers.hands.hand_kernels.gather": ("f8:3 b1:2 f8:1 f4:2 f8 f4:2 f8 f8:1 f8:2 f8:3 f8:1 f8:1 f8:2", "hands"),
    "trackers.hands.hand_kernels.fit_skin": ("f4:2 f8 f8 f8:1 f8 f8 f8 f4:2 f8:2 f8:1", "hands"),
    "trackers.hands.hand_kernels.learn_head": ("f4:3 f4:3 f4:1 f8 f8:2 f8 f4:2 f4:2 f4:1", "hands"),
    "trackers.regions.region_kernels.match_boxes": ("u2:2 i8:2 i8:2 f8:1 f4:2", "histogram"),
}
_SECOND = "import json, sys; sys.path[:], names = json.loads(sys.argv[1]); from {0} import *; compile_kernels(names)"


def kernel(name: str) -> Any:
    return pkgutil.resolve_name(f"facetrack_cli.{name}")


def signature(name: str) -> tuple[Any, ...]:
    """numba's types of the arguments of a kernel."""
    from numba import types

    def of(word: str) -> Any:
        word, _, many = word.partition("x")
        word, _, axes = word.partition(":")
        kind = getattr(types, word)
        if axes:
            kind = types.Array(kind, int(axes[0]), "C", readonly=axes.endswith("r"))
        return types.UniTuple(kind, int(many)) if many else kind  # type: ignore[no-untyped-call]

    return tuple(map(of, KERNELS[name][0].split()))


def _settings(key: str, settings: Any) -> Iterator[str]:
    if isinstance(settings, Mapping):
        yield f"{key}={settings['type']}" if "type" in settings else key
        for below, more in settings.items():
            yield from _settings(below, more)
    elif key == "calibration" and settings is not None:
        yield key


@contextlib.contextmanager
def precompiling(settings: Mapping[str, Any], processes: int) -> Iterator[Callable[..., None]]:
    """Compile the kernels of a recipe, given as `to_dict` does, that the cache lacks, while the `with` block lasts.

    `processes`: how many there may be, this one included. The second process begins at once. This one compiles or loads
    all kernels when what the block is given is called, with the last two arguments of `compile_kernels`.
    """
    types = set(_settings("", settings))
    missing = [name for name, (_, by) in KERNELS.items() if by in types and not _is_cached(name)]  # the dearest first
    # each process begins with the dear half of its own, then helps the other one from the cheap end: they meet in
    # the middle, and find in the cache what the other one has compiled
    mine, others = missing[::2], missing[1::2]
    second: subprocess.Popen[bytes] | None = None
    if missing:
        compiling()
    # a program that embeds Python, or is frozen, has no interpreter to start
    if others and processes > 1 and Path(sys.executable or "").stem.startswith("python"):
        order = json.dumps([sys.path, [*others, *reversed(mine)]])
        command, nowhere = [sys.executable, "-c", _SECOND.format(__name__), order], subprocess.DEVNULL
        with contextlib.suppress(OSError):
            second = subprocess.Popen(command, stdin=nowhere, stdout=nowhere, stderr=nowhere)
    try:
        yield partial(compile_kernels, [*mine, *reversed(others)])
    finally:
        if second is not None:
            second.kill()
            second.wait()


def compile_kernels(
    names: list[str], stopped: Callable[[], bool] = lambda: False, report: Callable[..., None] | None = None
) -> None:
    """Compile or load kernels, until all are there or `stopped`; `report` takes how many, of how many."""
    for done, name in enumerate(names):
        if stopped():
            return
        if report is not None:
            report(done, len(names), "compiling", "kernels")
        with contextlib.suppress(Exception):  # the call of the kernel raises it again
            kernel(name).compile(signature(name))


def _is_cached(name: str) -> bool:
    """Whether an earlier run has compiled a kernel; also True where numba is switched off."""
    cache: Any = getattr(kernel(name), "_cache", None)
    return not hasattr(cache, "holds") or bool(cache.holds(kernel(name), signature(name)))
