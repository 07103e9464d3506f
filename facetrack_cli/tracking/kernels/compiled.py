"""How kernels are compiled: one decorator for each kind of arithmetic."""

from __future__ import annotations

from typing import Any

from numba import njit

exact: Any = njit(cache=True, nogil=True, error_model="numpy")
# sums may be reordered, which is what lets them vectorise; NaN and infinity keep their meaning
fast: Any = njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")
# as functions of their own these do not vectorise, and take five times as long
inline: Any = njit(inline="always", error_model="numpy")
