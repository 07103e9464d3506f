#!/usr/bin/env bash
# The run that compiles numba's functions gives other last bits than all later runs.
#
# Found: numba 0.68.1 keeps compiled functions with cache=True. A function with fastmath that calls another one with
# fastmath and cache=True gives one result in the process that compiles them, and another one in each process that finds
# them in the cache, on the same machine, from the same bytes. The callee is compiled twice, once by itself and once as a
# part of the caller, and sums that may be reordered come out differently. The process that compiles uses the one by
# itself; what is read from the cache is the caller's own. Without fastmath both are the same, and so they are where the
# callee is put into its caller by forceinline=True. Nothing is said. A filter that draws by weights goes another way from
# such a bit, so a first run in a fresh container, as in CI, need not repeat the results of a later one.
# Packages: numba 0.68.1, llvmlite 0.50.0, numpy 2.4.6.
# Data: a made-up symmetric matrix. Which digits differ depends on the processor.
# Output seen:
#   fastmath, callee by itself: compiled -0.362517550730043, cached -0.36251755073004305; same bytes: False
#   fastmath, callee inlined: compiled -0.36251755073004305, cached -0.36251755073004305; same bytes: True
#   no fastmath, callee by itself: compiled -0.3625175507300431, cached -0.3625175507300431; same bytes: True
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check numba==0.68.1 llvmlite==0.50.0 numpy==2.4.6
cat > sums.py <<'PYTHON'
import sys

import numpy as np
from numba import njit

fast, inlined = sys.argv[1] == "fastmath", sys.argv[2] == "inlined"


@njit(fastmath=fast, forceinline=True) if inlined else njit(fastmath=fast, cache=True)
def turned(a):
    """A step of Householder's reduction for each row."""
    p = np.zeros(len(a))
    for k in range(len(a) - 1, 0, -1):
        v, squares = a[k, :k], 0.0
        for i in range(k):
            squares += v[i] * v[i]
        for i in range(k):
            row, total = a[i, :i], 0.0
            for j in range(i):
                total += row[j] * v[j]
                p[j] += row[j] * v[i]
            p[i] = total + a[i, i] * v[i]
        for i in range(k):
            p[i] /= squares
        for i in range(k):
            for j in range(i + 1):
                a[i, j] -= v[i] * p[j] + p[i] * v[j]
    return p


@njit(fastmath=fast, cache=True)
def reduced(a):
    return turned(a.copy())


x = np.random.default_rng(0).standard_normal((60, 60))
found = reduced(np.round(x @ x.T, 6))
print("cached" if reduced.stats.cache_hits else "compiled", float(found[30]), found.tobytes().hex())
PYTHON
env/bin/python - <<'PYTHON'
import shutil
import subprocess
import sys

seen = []
for arithmetic, callee in (("fastmath", "by itself"), ("fastmath", "inlined"), ("no fastmath", "by itself")):
    shutil.rmtree("__pycache__", ignore_errors=True)
    runs = [
        subprocess.run(
            [sys.executable, "-B", "sums.py", arithmetic, callee], capture_output=True, text=True, check=True
        ).stdout.split()
        for _ in range(3)
    ]
    (first, value, bits), (second, later, more), (_, _, third) = runs
    print(f"{arithmetic}, callee {callee}: {first} {value}, {second} {later}; same bytes: {bits == more}")
    seen.append((first, second, bits == more, more == third))
expected = [("compiled", "cached", False, True), *[("compiled", "cached", True, True)] * 2]
sys.exit(0 if seen == expected else "the behaviour is another one")
PYTHON
