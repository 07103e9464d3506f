"""The kernels of a recipe, compiled before they are called, in this process and in a second process beside it.

This file declares the one signature of each kernel, and the settings that call it. numba holds the interpreter's lock
while it compiles, so threads gain little. An error here costs time alone: the first call compiles a kernel that is
missing.
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

_FILTERS = "filter=auxiliary filter=factorized filter=guided filter=independent filter=sir"
_CELLS, _LOOKS, _NCC = "likelihood=correlation_filter", "likelihood=appearance", "ncc"
_COLOURS = "likelihood=colour_ratio"
# a kernel, the dearest first; what it takes: f8 a number, f8x2 a tuple, f8:2 an array of two axes, f8:2r a read-only
# one; any of the settings that call it: `key=type`, or the key of a section without types
KERNELS: Mapping[str, tuple[str, str]] = {
    "trackers.regions.region_kernels.patch_distances": (
        "u1:2 i8x4 u1:2 i8x4 i8 f8:2 f8:2 f8x2 i8 i8 f8 b1 f8 f8:1",
        "correlation",
    ),
    "trackers.regions.region_kernels.nearest_edges": ("u2:2 f8:2 i8 i8 i8 f8:2 f8:2 f8 f8", "contour"),
    "trackers.appearance.appearance_kernels.gain": ("f8:2 f8:2 i8 f8", "velocity"),
    "trackers.box.box_kernels.gradients_of_scales": ("u1:2 f8 f8 f8:2 i8 f4:4", _CELLS),
    "trackers.face.image_kernels._channels": ("f4:3", "head"),
    "trackers.face.image_kernels.read_eyes": ("u1:3 f8:2 f4:2", "head"),
    "trackers.face.image_kernels.run_stages": ("f4:3 f8:2 f8:2 f8:1 f4:3", "head"),
    "trackers.face.window_kernels.greatest": ("f4:3 f4:4 i8:1 i8:2 f8:2 f4:3", "likelihood=window_ncc"),
    "trackers.face.window_kernels.matched": ("f4:3 f4:4 i8:1 i8:2 f8:3 f4:3 f8:3", "likelihood=window_ncc"),
    "trackers.face.landmark_kernels.jump": (
        "f8:3 f8:2 f8:3 f8:2 f8:2 f8 f8:1 f8:1 f8 f8:2 f8 f8 f4:3 f8:2 f8:1 f8 f8 f8:3 f8:2",
        "motion=jumping_walk",
    ),
    "trackers.face.landmark_kernels.learn": (
        "f8:3 f8:2 f8:3 f8:1 f8:2 f8:2 f8:1 f8 f8 f8:3 f8:2 f8:2 f8:2 f8:2",
        "head",
    ),
    "trackers.face.landmark_kernels.compare": ("f8:3 f8:2 f8:2 f8:2 f8:3 f8:1 f8:3 f8:2 f8:2 b1:1 f8:2", "head"),
    "trackers.face.landmark_kernels.judge": (
        "f8:2 i8:1 i8:2 f4:3 f8:2 f8:1 f8:1 f8:2 f8:3 f8:1 f8 f8:1 f8:1 f8:1 f8:2 b1:1 b1:1",
        "likelihood=window_ncc",
    ),
    "trackers.face.landmark_kernels.follow": ("b1 f8:2 f8:1 f8 f8:2 f8:2 f8:1 f8:1 f8:1 f8:1 f8:2 f8:3 f8:1", "head"),
    "trackers.face.landmark_kernels.fuse": ("f8:3 f8:2 f8:2 f8:2 f8 f8:2 f8:1", "head"),
    "trackers.face.landmark_kernels.read": ("f8:3 f8:1 f8:3 f8:2 f8:2 f8:2 f8:2 f8 f8 f8:3 f8:2 f8:2", "head"),
    "trackers.face.landmark_kernels.show": ("f8:2 f8:3 f8:1 i8 f8 f8:2 f8:2 f8:1 f8 f8 f8 f8:2 i8:1", "head"),
    "trackers.face.landmark_kernels.median_shift": ("f8:2 b1:1 f8:1", "head"),
    "trackers.face.image_kernels.read": ("f4:3 f8:2 f8:2", "head"),
    "trackers.face.image_kernels.warp": ("u1:2 f8:2 u1:3", f"head {_CELLS}"),
    "trackers.face.image_kernels.looks": ("u1:3", "head"),
    "trackers.appearance.appearance_kernels.read_patches": (
        "u1:2 i8 i8 i8 i8 i8 f8x4 f8:2 f8 f8 i8 i8",
        "target=affine",
    ),
    "trackers.appearance.appearance_kernels.log_densities": ("f4:2r f4:2 f4:2 f4:2 f8 b1", _LOOKS),
    "trackers.points.point_kernels.colour_ratio_distances": (
        "u1:2 f4:1 i8:1 i8:2 i8:1 f8:3 i8 i8 i8 f8 i8 f8 f8:2",
        _COLOURS,
    ),
    "trackers.appearance.appearance_kernels.update": ("f4:1r f4:2 f4:2 f4:2 f8:2 f4:2 f4:2 f8 b1 f8 f8 f8", _LOOKS),
    "trackers.skin.skin_kernels.moments_direct": ("u1:2 f4:2 f8:2", _NCC),
    "trackers.points.point_kernels.parzen": ("f8:3 i8:1 f8:2 i8 f8 f4:2 f4:1 f8:1", "prior=parzen"),
    "trackers.box.box_kernels.arrive": ("f8:2 f8:2 f8:2 f8 f8:1 f8:1 f8:1 f8:1 f8:1 i8:1", "motion=visible_walk"),
    "trackers.hands.hand_kernels.move": (
        "f8:3 b1:2 b1:1 f8:3 f8:3 f8:2 f8:1 f8:1 f8:1 f8:1 f8 f4:2 f4:2 f8:1 f8 f8 f8:1",
        "hands",
    ),
    "trackers.hands.hand_kernels.weigh": ("f8:3 b1:2 b1:1 f4:2 f4:2 f4:2 f8:1 f8 f8 f8 f8 f8 f8:1", "hands"),
    "trackers.hands.hand_kernels.gather": ("f8:3 b1:2 f8:1 f4:2 f8 f4:2 f8 f8:1 f8:2 f8:3 f8:1 f8:1 f8:2", "hands"),
    "trackers.hands.hand_kernels.fit_skin": ("f4:2 f8 f8 f8:1 f8 f8 f8 f4:2 f8:2 f8:1", "hands"),
    "trackers.hands.hand_kernels.resample": ("f8:3 b1:2 b1:1 f8:1 f8 f8:2 f8:3 b1:2 b1:1", "hands"),
    "trackers.hands.hand_kernels.is_lit_alike": ("u1:3 u1:3 i8", "hands"),
    "trackers.hands.hand_kernels.learn_head": ("f4:3 f4:3 f4:1 f8 f8:2 f8 f4:2 f4:2 f4:1", "hands"),
    "trackers.box.box_kernels.multiply": ("f4:3 f4:3 f4:3", _CELLS),
    "trackers.appearance.appearance_kernels.errors": ("f4:2r f4:2 f4:2 f4:2", "velocity"),
    "trackers.regions.region_kernels.match_boxes": ("u2:2 i8:2 i8:2 f8:1 f4:2", "histogram"),
    "trackers.appearance.appearance_kernels.best_matches": ("f4:2r f4:2", _LOOKS),
    "trackers.appearance.appearance_kernels.differences": ("f4:2r i8:1 f4:1r", "velocity"),
    "trackers.box.box_kernels.chroma": ("u1:3 f4:3", _CELLS),
    "trackers.box.box_kernels.colours": ("u1:3 f4:1 f4:1 i8:1 f4:1", _CELLS),
    "trackers.box.box_kernels.project": ("f4:2 f4:2 f4:1 f4:2", _CELLS),
    "trackers.box.box_kernels.remember": ("f4:3 f4:3 f4", _CELLS),
    "trackers.box.box_kernels.respond": ("f4:3 f4:3 f4:2", _CELLS),
    "trackers.box.box_kernels.read_cubic": ("f4:2 f8:1 f8:1 f8:1", _CELLS),
    "engine.kernels.compiled.invert_cdf": ("f8:2 f8:2 i8:2", _FILTERS),
    "trackers.skin.skin_kernels.box_sums": ("f8:2 f8:2", f"{_NCC} skin"),
    "engine.kernels.compiled.calibrate": ("f8:2 b1:1 b1:1 b1:1 f8 f8:2 f8:2 f8:3 i8:1 f8:1 f8 f8 i8:1", "calibration"),
    "engine.kernels.compiled.moments": ("f8:3 f8:1 f8:1 f8:2 f8:3", _FILTERS),
    "trackers.skin.skin_kernels.bilinear": ("f4:2 f8:2 i8 i8", _NCC),
    "trackers.appearance.appearance_kernels.mapped": ("f8:2 f4:2 f4:1", "velocity"),
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
    called = [name for name, (_, by) in KERNELS.items() if not types.isdisjoint(by.split())]  # the dearest first
    missing = [name for name in called if not _is_cached(name)]
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
