"""How kernels are compiled, a decorator for each kind of arithmetic, and the bilinear reading that they share.

numba trusts the files of compiled kernels: what power loss leaves of one is run, or ends the program. So each is
brought to the disk before it gets its name, and ends with its checksum.
"""

import contextlib
import hashlib
import os
import sys
from typing import Any

import numpy as np
from numba import njit
from numba.core import caching
from numba.core.runtime.nrt import rtsys

from facetrack_cli.tracking.kernels.cache import compiling


class Checked(caching.IndexDataCacheFile):
    """The files of one kernel. Damaged ones are passed over, so that it is compiled anew, with one warning for all."""

    warned = False

    def load(self, key: Any) -> Any:
        found = None
        try:
            found = super().load(key)
        except Exception as error:  # whatever the bytes that are left make of it
            if not Checked.warned:
                Checked.warned = True
                what = f"compiled kernels in {self._cache_path} are damaged ({type(error).__name__}): compiled anew"
                with contextlib.suppress(OSError, ValueError):
                    sys.stderr.write(f"facetrack: warning: {what}\n")
            with contextlib.suppress(OSError):
                self.flush()
        if found is None:
            compiling()
        return found

    def _load_data(self, name: str) -> Any:
        with open(self._data_path(name), "rb") as file:  # noqa: PTH123
            data = file.read()
        if hashlib.sha256(data[:-32]).digest() != data[-32:]:
            raise ValueError("checksum")
        return super()._load_data(name)  # what unpickles it stops at its end

    def _dump(self, obj: Any) -> bytes:
        data: bytes = super()._dump(obj)
        return data + hashlib.sha256(data).digest()

    @contextlib.contextmanager
    def _open_for_write(self, filepath: str) -> Any:
        with super()._open_for_write(filepath) as file:
            yield file
            file.flush()
            with contextlib.suppress(OSError):
                os.fsync(file.fileno())


_SUMS: Any = {"contract", "reassoc", "nsz"}
_KERNEL: Any = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}  # nobody calls them but Python


class Kept(caching.FunctionCache):
    """The cache of one kernel. Loading needs numba's allocator alone: the compiler, half a second, is not made ready.

    A compilation makes itself ready.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)

    def holds(self, kernel: Any, sig: Any) -> bool:
        """Whether `kernel` need not be compiled for `sig`. What is damaged is seen, and said, when it is loaded."""
        try:
            known = self._cache_file._load_index()
            return sig in kernel.overloads or self._index_key(sig, kernel.targetctx.codegen()) in known
        except Exception:
            return True


def _kept(kernel: Any) -> Any:
    if isinstance(cache := getattr(kernel, "_cache", None), caching.FunctionCache):  # not with NUMBA_DISABLE_JIT
        cache.__class__ = Kept
        cache._cache_file.__class__ = Checked
    return kernel


def exact(function: Any) -> Any:
    return _kept(njit(cache=True, **_KERNEL)(function))


def fast(function: Any) -> Any:
    """As `exact`, but sums may be reordered, which lets them vectorise; NaN and infinity keep their meaning."""
    return _kept(njit(cache=True, fastmath=_SUMS, **_KERNEL)(function))


# parts of other kernels, exact and fast ones: typed once, not wherever they are called, which compiles in half the time
_PART: Any = {"forceinline": True, "no_cpython_wrapper": True, **_KERNEL}
part: Any = njit(**_PART)
fast_part: Any = njit(fastmath=_SUMS, **_PART)

# parts that as functions of their own do not vectorise, and take five times as long
inline: Any = njit(inline="always", error_model="numpy")


@inline
def join(image, kind, bits):
    """Each pixel of `image` (H, W) with those right, below and both, as `kind` (H * W,), from the lowest `bits` up.

    The last row and column are their own neighbours.
    """
    height, width = image.shape
    out, two = np.empty(height * width, kind), bits + bits
    for y in range(height):
        upper, lower, row = image[y], image[min(y + 1, height - 1)], out[y * width : (y + 1) * width]
        for x in range(width - 1):
            above = kind(upper[x]) | kind(upper[x + 1]) << bits
            row[x] = above | kind(lower[x]) << two | kind(lower[x + 1]) << (two + bits)
        above, below = kind(upper[width - 1]), kind(lower[width - 1])
        row[width - 1] = above | above << bits | below << two | below << (two + bits)
    return out


@inline
def look_up(joined, bits, mask, at, part, four, out):
    """Bilinear values `out` (L,) within the joined pixels `at` (L,), by the fractions `part` (2, L) of a pixel."""
    fx, fy = part[0], part[1]
    # a loop of its own: loads from anywhere do not vectorise, all else does
    for k in range(len(at)):
        four[k] = joined[np.uint64(at[k])]
    for k in range(len(at)):
        out[k] = between(four[k], bits, mask, fx[k], fy[k])


@inline
def between(four, bits, mask, fx, fy):
    """The bilinear value within four joined pixels."""
    two = bits + bits
    above, right = np.float32(np.int32(four & mask)), np.float32(np.int32(four >> bits & mask))
    below, both = np.float32(np.int32(four >> two & mask)), np.float32(np.int32(four >> (two + bits)))
    above += fx * (right - above)
    below += fx * (both - below)
    return above + fy * (below - above)


@part
def read_at(values, x, y):
    """`values` (H, W) at (x, y), or at the nearest place within."""
    height, width = values.shape[0] - 1, values.shape[1] - 1
    x, y = min(max(x, 0.0), 1.0 * width), min(max(y, 0.0), 1.0 * height)
    x0, y0 = min(int(x), width - 1), min(int(y), height - 1)  # of a single row or column -1, which is that one too
    fx, fy = x - x0, y - y0
    return (1.0 - fy) * ((1.0 - fx) * values[y0, x0] + fx * values[y0, x0 + 1]) + fy * (
        (1.0 - fx) * values[y0 + 1, x0] + fx * values[y0 + 1, x0 + 1]
    )


@part
def box_sum(sums, x0, y0, x1, y1):
    """The sum over a box by an integral image (H + 1, W + 1): pixel edges are whole numbers, parts count by area."""
    return read_at(sums, x1, y1) + read_at(sums, x0, y0) - read_at(sums, x1, y0) - read_at(sums, x0, y1)
