"""The kernels of a recipe, compiled before they are called, in this process and in a second process beside it.

This file declares which settings call each kernel; its one signature stands at its decorator. numba holds the
interpreter's lock while it compiles, so threads gain little. An error here costs time alone: the first call compiles a
kernel that is missing.
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

_CELLS = "likelihood=correlation_filter"
_FILTERS = "filter=auxiliary filter=factorized filter=guided filter=independent filter=sir"
# modules, their kernels, the dearest first, and any of the settings that call them: `key=type`, or the key of a section
# without types
KERNELS: Mapping[str, str] = {
    f"{module}.{name}": by
    for module, names, by in (
        ("trackers.regions.region_kernels", "patch_distances", "correlation"),
        ("trackers.regions.region_kernels", "nearest_edges", "contour"),
        ("trackers.appearance.appearance_kernels", "gain errors differences mapped", "velocity"),
        ("trackers.box.box_kernels", "gradients_of_scales gradients descend chroma colours project", _CELLS),
        ("trackers.face.image_kernels", "_channels place_eyes place find_corners looks shrink", "head"),
        ("trackers.face.image_kernels", "see", f"head {_CELLS}"),
        ("trackers.face.window_kernels", "greatest matched", "likelihood=window_ncc"),
        ("trackers.face.landmark_kernels", "step learn follow relay read show median_shift", "head"),
        ("trackers.face.landmark_kernels", "judge", "likelihood=window_ncc"),
        ("trackers.appearance.appearance_kernels", "read_patches", "target=affine"),
        ("trackers.appearance.appearance_kernels", "log_densities update best_matches", "likelihood=appearance"),
        ("trackers.points.point_kernels", "colour_ratio_distances read_window", "likelihood=colour_ratio"),
        ("trackers.points.point_kernels", "parzen", "prior=parzen"),
        ("trackers.skin.skin_kernels", "moments_direct bilinear", "ncc"),
        ("trackers.box.box_kernels", "arrive sum_up carry log_mixture", "motion=visible_walk"),
        ("trackers.hands.hand_kernels", "move weigh gather fit_skin learn_head edges same_light", "hands"),
        ("trackers.box.box_kernels", "remember turn respond highest tally read_cubic", _CELLS),
        ("trackers.regions.region_kernels", "match_boxes", "histogram"),
        ("engine.kernels.compiled", "invert_cdf moments calibrate", _FILTERS),
        ("trackers.skin.skin_kernels", "box_sums", "ncc skin"),
    )
    for name in names.split()
}
_SECOND = "import json, sys; sys.path[:], names = json.loads(sys.argv[1]); from {0} import *; compile_kernels(names)"


def kernel(name: str) -> Any:
    return pkgutil.resolve_name(f"facetrack_cli.{name}")


def _settings(key: str, settings: Any) -> Iterator[str]:
    if isinstance(settings, Mapping):
        yield f"{key}={settings['type']}" if "type" in settings else key
        for below, more in settings.items():
            yield from _settings(below, more)


@contextlib.contextmanager
def precompiling(settings: Mapping[str, Any], processes: int) -> Iterator[Callable[..., None]]:
    """Compile the kernels of a recipe, given as `to_dict` does, that the cache lacks, while the `with` block lasts.

    `processes`: how many there may be, this one included. The second process begins at once. This one compiles or loads
    all kernels when what the block is given is called, with the last two arguments of `compile_kernels`.
    """
    types = set(_settings("", settings))
    called = [name for name, by in KERNELS.items() if not types.isdisjoint(by.split())]  # the dearest first
    missing = [name for name in called if not _load(name)]
    # one begins with the dear ones, the other with the cheap ones; each finds in the cache what the other has compiled
    second: subprocess.Popen[bytes] | None = None
    # a program that embeds Python, or is frozen, has no interpreter to start
    if len(missing) > 1 and processes > 1 and Path(sys.executable or "").stem.startswith("python"):
        order = json.dumps([sys.path, missing[::-1]])
        command, nowhere = [sys.executable, "-c", _SECOND.format(__name__), order], subprocess.DEVNULL
        with contextlib.suppress(OSError):
            second = subprocess.Popen(command, stdin=nowhere, stdout=nowhere, stderr=nowhere)
    try:
        yield partial(compile_kernels, missing)
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
            kernel(name).compile(kernel(name).takes)


def _load(name: str) -> bool:
    """Whether an earlier run has compiled a kernel, which is loaded; also True where numba is switched off."""
    cache: Any = getattr(kernel(name), "_cache", None)
    return not hasattr(cache, "loads") or bool(cache.loads(kernel(name), kernel(name).takes))
