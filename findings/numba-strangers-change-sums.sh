#!/usr/bin/env bash
# What a numba function sums depends on which other function was called before it in the process.
#
# Found: numba 0.68.1 compiles a power as x**2 by a helper of its own, once in a process, and keeps it for all functions.
# The function that is compiled first has the helper in its own code, later ones are linked with it, and a sum with
# fastmath, which may be reordered, then comes out in another order. So the variance of a window has one last bit where
# it is computed alone, and another one where any function that squares, and that it neither calls nor is called by, was
# called before. Both functions are the same text, the data are the same bytes, nothing is cached, no thread is
# involved. A particle filter that draws by such weights goes another way, with the same seed, once an unrelated step is
# switched on before it. Without fastmath the bits are the same.
# Packages: numba 0.68.1, llvmlite 0.50.0, numpy 2.4.6.
# Data: made-up windows and a template. Code is made for one kind of processor, Haswell, whichever runs it.
# Output seen:
#   fastmath: alone 5652.5655446039, again alone 5652.5655446039, after a square 5652.565544603902
#   no fastmath: alone 5652.567055804608, again alone 5652.567055804608, after a square 5652.567055804608
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check numba==0.68.1 llvmlite==0.50.0 numpy==2.4.6
cat > variance.py <<'PYTHON'
import sys

import numpy as np
from numba import njit

fast = {"contract", "reassoc", "nsz"} if sys.argv[1] == "fastmath" else False


@njit(error_model="numpy")
def square(x):
    return x**2


@njit(fastmath=fast, error_model="numpy")
def moments(images, template):
    out = np.zeros((2, len(images)))
    for p in range(len(images)):
        cross, first, second = 0.0, 0.0, 0.0
        for i in range(template.shape[0]):
            total, off, squares = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for j in range(template.shape[1]):
                value = images[p, i, j]
                total += template[i, j] * value
                off += value
                squares += value * value
            cross += total
            first += off
            second += squares
        n = template.size
        out[0, p], out[1, p] = cross / n, second / n - (first / n) ** 2
    return out


if sys.argv[2] == "after":
    square(3.0)
rng = np.random.default_rng(0)
images, template = rng.uniform(0, 255, (50, 20, 20)).astype(np.float32), rng.normal(size=(20, 20)).astype(np.float32)
print(float(moments(images, template)[1, 0]))
PYTHON
export NUMBA_CPU_NAME=haswell NUMBA_CPU_FEATURES=+avx2,+fma
as_described=0
for kind in fastmath plain; do
  alone=$(env/bin/python variance.py "$kind" alone)
  again=$(env/bin/python variance.py "$kind" alone)
  after=$(env/bin/python variance.py "$kind" after)
  echo "${kind/plain/no fastmath}: alone $alone, again alone $again, after a square $after"
  [ "$alone" = "$again" ] || as_described=1
  if [ "$kind" = fastmath ]; then [ "$alone" != "$after" ] || as_described=1; else [ "$alone" = "$after" ] || as_described=1; fi
done
exit "$as_described"
