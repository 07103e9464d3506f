#!/usr/bin/env bash
# Who nods without a smile has not nodded.
#
# Found: mergeLabels of praatio 6.2.2 writes into each interval of a tier what another tier says meanwhile. By its documentation
# all intervals of the tier appear in the result, and its example is an interval with nothing beside it, whose label becomes
# "bar()". In fact these are left out: of four nods, two of them with smiles, two are left, and counts and shares are wrong; the
# function with a similar aim, intersection, is the one that should leave them out. An interval may also be more than
# one: a nod with two smiles is one nod with both. Nothing is said. Look for what is missing by its begin.
# Packages: praatio 6.2.2.
# Data: a made-up tier of nods and one of smiles, made here; the first two are the example of the documentation.
# Output seen:
#   documented example: foo(bang)
#   nods: 4, with smiles merged: up(A,B), down(B); messages 0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check praatio==6.2.2
env/bin/python - <<'PYTHON'
import contextlib
import io
import sys
import warnings

from praatio import textgrid


def merged(first, second):
    tiers = [textgrid.IntervalTier(name, spans, 0, 10) for name, spans in (("nod", first), ("smile", second))]
    return [entry.label for entry in tiers[0].mergeLabels(tiers[1]).entries]


NODS = [(1, 2, "up"), (3, 4, "down"), (5, 6, "up"), (7, 8, "down")]
SMILES = [(1, 1.5, "A"), (1.8, 2.5, "B"), (3.5, 4.5, "B")]
printed = io.StringIO()
with warnings.catch_warnings(record=True) as said, contextlib.redirect_stdout(printed):
    warnings.simplefilter("always")
    example = merged([(1, 2, "foo"), (3, 4, "bar")], [(1, 2, "bang"), (2, 3, "wizz")])
    nods = merged(NODS, SMILES)
messages = len(said) + len(printed.getvalue())
promised = [entry for entry in textgrid.IntervalTier.mergeLabels.__doc__.splitlines() if "bar()" in entry]
print("documented example: " + ", ".join(example))
print(f"nods: {len(NODS)}, with smiles merged: " + ", ".join(nods) + f"; messages {messages}")
sys.exit((example, nods, messages, len(promised)) != (["foo(bang)"], ["up(A,B)", "down(B)"], 0, 1))
PYTHON
