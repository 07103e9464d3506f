# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""How kernels are compiled and cached, a decorator for each kind of arithmetic, and what several trackers share.

That is bilinear reading, where boxes lie, drawing indices by weights, mean and covariance, and calibrated rows.
"""

import contextlib
import math
from collections.abc import Callable
from functools import cache, partial
from typing import Any, ClassVar, Final, TypeAlias

import llvmlite.binding as ll
import numpy as np
from numba import njit, types
from numba.core import caching
from numba.core.codegen import CodeLibrary, JITCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from numba.core.runtime import nrt
from numba.core.typing.typeof import typeof_impl
from numba.np.numpy_support import from_dtype, map_layout
from numpy.typing import NDArray

from facetrack_cli.core.errors import warn

Extent: TypeAlias = tuple[float, float, float, float]
_KEPT: Final = "kept"


@cache
def _prepare(codegen: Any) -> None:
    """Enough to load kernels; numba makes the compiler ready too, which takes 0.3 s.

    What kernels call of numba's runtime is named. They bring what counts references, which numba would compile here.
    """
    codegen._library_class = _Library
    codegen.magic_tuple = cache(codegen.magic_tuple)  # or each kernel asks the system which processor it is
    for name, address in nrt._nrt.c_helpers.items():  # type: ignore[attr-defined, unused-ignore]
        ll.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


class _Library(JITCodeLibrary):
    """As numba's, and the code of a kernel from the cache without a module of its own, which took two thirds."""

    @classmethod
    def _unserialize(cls, codegen: Any, state: Any) -> Any:
        name, kind, data = state
        if kind != _KEPT:
            return super()._unserialize(codegen, state)
        (code, bitcode), symbol = data
        library: Any = cls.__new__(cls)
        CodeLibrary.__init__(library, codegen, name)
        library._finalized = True
        # not read before a kernel that calls this one is compiled
        library._get_module_for_linking = partial(ll.parse_bitcode, bitcode)
        codegen._engine._ee.add_object_file(ll.ObjectFileRef.from_data(code))
        codegen._engine.finalize_object()
        codegen._engine._defined_symbols.add(symbol)
        return library


class _Nothing(dict[Any, Any]):
    """In place of what numba keeps of functions that it has compiled for a kernel. It would put those of a kernel
    compiled before into this one: sums that may be reordered would be in an order by which one is compiled first.
    """

    def get(self, key: Any, default: Any = None) -> Any:
        return default


class _Kept(caching.CompileResultCacheImpl):
    """What is kept of a kernel: not the modules of its parts, which took most of the time."""

    def reduce(self, cres: Any) -> Any:
        *kept, environments = super().reduce(cres)
        return *kept, () if isinstance(environments, tuple) else environments

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        try:
            (name, _, (code, bitcode)), described, *rest = payload
            state = name, _KEPT, ((code, bitcode), described.llvm_cpython_wrapper_name)
            return super().rebuild(target_context, (state, described, *rest))
        except (AttributeError, TypeError, ValueError):  # a numba that keeps kernels otherwise: as it does
            return super().rebuild(target_context, payload)


class KernelCache(caching.FunctionCache):
    """numba's cache of one kernel, which compiles a kernel again where its files are damaged.

    numba writes a file under another name first, so that a kill or a full disk damages none. Power loss may: numba then
    raises whatever the bytes make of it, in each run.
    """

    warned = False
    internal: ClassVar[dict[Any, Any]] = {}  # what numba keeps of functions that it has compiled for exact kernels
    reorders = False  # whether the kernel's sums may be reordered

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        target_context.cached_internal_func = _Nothing() if self.reorders else self.internal
        try:
            _prepare(target_context.codegen())
            with self._guard_against_spurious_io_errors():
                return self._load_overload(sig, target_context)
        except Exception as error:
            if not KernelCache.warned:
                KernelCache.warned = True
                warn(f"compiled kernels in {self._cache_path} are damaged ({type(error).__name__}): compiled anew")
            with contextlib.suppress(OSError):
                self.flush()
        return None

    def loads(self, kernel: Any, sig: Any) -> bool:
        """Whether `kernel` need not be compiled for `sig`: it is loaded, faster than by its first call."""
        with global_compiler_lock:
            if sig not in kernel.overloads and (found := self.load_overload(sig, kernel.targetctx)) is not None:
                kernel.targetctx.insert_user_function(found.entry_point, found.fndesc, [found.library])
                kernel.add_overload(found)
            return sig in kernel.overloads


_numba_type = typeof_impl.dispatch(np.ndarray)


@typeof_impl.register(np.ndarray)
def _type_of(array: Any, purpose: Any) -> Any:
    """As numba's, which asks whether each array is one of `numpy.ma`: to import that takes as long as ten kernels."""
    if type(array) is not np.ndarray or array.dtype.kind not in "biufc":
        return _numba_type(array, purpose)
    return types.Array(from_dtype(array.dtype), array.ndim, map_layout(array), readonly=not array.flags.writeable)


_SUMS: Any = {"contract", "reassoc", "nsz"}
_KERNEL: Any = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}  # only Python calls them


def exact(function: Any, **more: Any) -> Any:
    """The kernel of a function, or a decorator that makes it, if given a signature: what a recipe's kernel `takes`.

    A signature has a word for each argument: f8 a number, f8x2 a tuple, f8:2 an array of two axes, f8:2r a read-only
    one.
    """
    if isinstance(function, str):
        return partial(_declared, function, more)
    kernel = njit(cache=True, **_KERNEL, **more)(function)
    if isinstance(cache := getattr(kernel, "_cache", None), caching.FunctionCache):  # not with NUMBA_DISABLE_JIT
        cache.__class__, cache._impl.__class__ = KernelCache, _Kept
        kernel._cache.reorders = "fastmath" in more
    return kernel


def _declared(words: str, more: Any, function: Any) -> Any:
    kernel = exact(function, **more)
    kernel.takes = tuple(map(_named, words.split()))
    return kernel


@cache
def _named(word: str) -> Any:
    word, _, many = word.partition("x")
    word, _, axes = word.partition(":")
    kind = getattr(types, word)
    kind = types.Array(kind, int(axes[0]), "C", readonly=axes.endswith("r")) if axes else kind
    return types.UniTuple(kind, int(many)) if many else kind


def fast(function: Any) -> Any:
    """As `exact`, but sums may be reordered, which lets them vectorise; NaN and infinity keep their meaning.

    No kernel calls such a one: what numba compiles first and what it later finds in the cache would reorder otherwise.
    """
    return exact(function, fastmath=_SUMS)


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


@exact("f8:2 f8:2 i8:2")
def invert_cdf(weights, points, out):
    """Indices `out` (M, K) by weights (N, K) and points (M, K), as `engine.resampling` says."""
    (n, columns), m = weights.shape, points.shape[0]
    for k in range(columns):
        total, last = 0.0, 0
        for i in range(n):
            total += weights[i, k]
            if weights[i, k] > 0.0:
                last = i
        i, cumulated = 0, weights[0, k]
        for j in range(m):
            while i < last and cumulated <= points[j, k] * total:
                i += 1
                cumulated += weights[i, k]
            out[j, k] = i


@exact("f8:3 f8:1 f8:1 f8:2 f8:3")
def moments(x, w, more, mean, cov):
    """Of x (N, K, D) with weights w (N,) the `mean` (K, D), and the covariance of the first two `cov` (K, 2, 2).

    The covariance is multiplied by `more` (K,), as `engine.spaces.estimate` says.
    """
    mean[:], cov[:] = 0.0, 0.0
    for n in range(len(x)):
        for k in range(x.shape[1]):
            for d in range(x.shape[2]):
                mean[k, d] += w[n] * x[n, k, d]
    for n in range(len(x)):
        for k in range(x.shape[1]):
            u, v = x[n, k, 0] - mean[k, 0], x[n, k, 1] - mean[k, 1]
            cov[k, 0, 0] += w[n] * u * u
            cov[k, 0, 1] += w[n] * u * v
            cov[k, 1, 1] += w[n] * v * v
    for k in range(len(more)):
        cov[k, 1, 0] = cov[k, 0, 1] = more[k] * cov[k, 0, 1]
        cov[k, 0, 0], cov[k, 1, 1] = more[k] * cov[k, 0, 0], more[k] * cov[k, 1, 1]


# --- the loop over the rows of a calibration, as `engine/confidence.py` says what it computes; nan stays nan

AS_IT_IS, HIDDEN, LOST, INIT, ABSENT = range(5)  # how a row is seen


@part
def _within(x, low, high):
    return low if x < low else high if x > high else x


@part
def _between(knots, count, x):
    """Linear between the first `count` of the knots (2, M), level beyond them."""
    i = 0
    while i < count - 2 and x > knots[0, i + 1]:
        i += 1
    if count == 1 or x <= knots[0, 0]:
        return knots[1, 0]
    share = (x - knots[0, i]) / (knots[0, i + 1] - knots[0, i])
    return knots[1, i] + (1.0 if share > 1.0 else share) * (knots[1, i + 1] - knots[1, i])


@exact("f8:2 i8:1 b1:1 f8 f8:2 f8:2 f8:3 i8:1 f8:1 f8 f8")
def calibrate(rows, how, boxes, size, slopes, ends, knots, counts, spread, cap, likely):
    """Overwrites confidence and spread of `rows` (10, R), and `how` (R,) they are seen; returns whether that changes.

    `rows` are confidence, w, h, ess, particles, std_x, std_y, cov_xy, std_w and std_h; `boxes` (R,) says which are of
    boxes. Of points and of boxes are `slopes` (2, 6) of the features, `ends` (2, 2), the intercept and
    the least p, which is nan without a logistic regression, `knots` (2, 2, M), and their `counts` (2,), 0 without any
    and -1 without a map.
    """
    f, gone, changes = np.empty(6), False, False
    for i in range(len(boxes)):
        gone |= how[i] == LOST and boxes[i]
    for i in range(len(boxes)):
        kind, side, c, ess, p = 1 if boxes[i] else 0, size, rows[0, i], rows[3, i], np.nan
        was, lost = how[i], how[i] == LOST
        if counts[kind] >= 0 and not math.isnan(c):
            if boxes[i] or size == 0.0:
                side = math.sqrt(rows[1, i] * rows[2, i])
            f[0], f[1], f[4] = c, math.log((c + 0.01) / (1.01 - c)), 1.0 if lost else 0.0
            f[2] = math.log(_within(math.hypot(rows[5, i], rows[6, i]) / side, 1e-3, 10.0))
            f[3] = math.log10(_within(ess / rows[4, i], 1e-3, 1.0))
            # what is small in the picture is placed less exactly, in terms of its size
            f[5], p = math.log(_within(side, 3.0, 1000.0)), ends[kind, 0]
            for j in range(6):
                p += slopes[kind, j] * f[j] if slopes[kind, j] != 0.0 else 0.0
            if not math.isnan(ends[kind, 1]):
                p = _within(1.0 / (1.0 + math.exp(-_within(p, -700.0, 700.0))), ends[kind, 1], 1.0 - ends[kind, 1])
            if counts[kind] > 0 and not math.isnan(p):
                p = _between(knots[kind], counts[kind], p)
        if gone and lost and p > cap:
            p = cap
        factor = 1.0 if math.isnan(ess) or counts[kind] < 0 else spread[kind]
        for j in range(5, 10):
            rows[j, i] *= factor**2 if j == 7 else factor
        if not (was == INIT or math.isnan(c) or math.isnan(ess)):
            rows[0, i] = p
            if p < likely:
                how[i] = LOST
            elif lost and not math.isnan(p):
                how[i] = HIDDEN
        changes |= how[i] != was
    return changes


# --- which part of a frame boxes cover


def boxes_extent(x: NDArray[np.float64], w: float, h: float, width: int, height: int) -> Extent:
    """(x from, y from, x to, y to) of boxes (w, h), centred, at x, within the image.

    x (N, 3) = (cx, cy, s), or (N, 6) = (cx, cy, a1, a2, a3, a4), deformed by [[a1, a2], [a3, a4]].
    """
    of = np.abs(x[:, 2:] if x.shape[1] == 6 else x[:, 2:3] * (1.0, 0.0, 0.0, 1.0))
    half = 0.5 * (of[:, ::2] * w + of[:, 1::2] * h)
    # these leave out nan, also where all are
    (x0, y0), (x1, y1) = np.fmin.reduce(x[:, :2] - half).tolist(), np.fmax.reduce(x[:, :2] + half).tolist()
    right, bottom = width - 1.0, height - 1.0
    return max(0.0, min(right, x0)), max(0.0, min(bottom, y0)), min(right, max(0.0, x1)), min(bottom, max(0.0, y1))


def cropped(
    read: Callable[[int, Extent], tuple[NDArray[np.uint8], int, int]], factor: int, x0: int, y0: int, x1: int, y1: int
) -> NDArray[np.uint8]:
    """Pixels [x0, x1) x [y0, y1), and no more, of a frame reduced by `factor`, as its `grey` or its `reduced` reads."""
    image, left, top = read(factor, (x0 * factor, y0 * factor, x1 * factor - 1, y1 * factor - 1))
    dx, dy = left // factor, top // factor
    return image[y0 - dy : y1 - dy, x0 - dx : x1 - dx]
