#!/usr/bin/env bash
# A blink .3 s after the film began is at 1,235 s, while the fixation before it is at .1 s.
#
# Found: eyelinkparser 0.17.5 reads EyeLink's .asc files by phases of a trial. Times of a phase count from its begin: those of
# samples (ttrace_) and of fixations (fixstlist_, fixetlist_). Those of blinks (blinkstlist_, blinketlist_) should, too, since
# they are on the same list in the source, and a slip in their names there leaves them as the tracker's clock says, in the same
# table. No blink is so among samples and fixations, and none is ever found "in the first second". Besides, of files with two
# eyes, whose samples have both, the left is taken alone, while fixations and blinks of both eyes are in one list, with nothing
# that says whose: a blink with both eyes is two. Nothing is said. Take the column t_onset_ off blinks.
# Packages: eyelinkparser 0.17.5, datamatrix 1.0.20, fastnumbers 5.2.0, numpy 2.4.6.
# Data: two made-up .asc files of a second at 1,000 Hz, with a fixation from 100 to 299 ms and a blink from 300 to 399 ms, made here.
# Output seen:
#   one eye: samples 0 to 999, fixations [[100, 299]], blinks [[1234867, 1234966]], onset 1234567, x 500
#   two eyes: samples 0 to 999, fixations [[100, 299], [100, 299]], blinks [[1234867, 1234966], [1234867, 1234966]], onset 1234567, x 500
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check eyelinkparser==0.17.5 datamatrix==1.0.20 fastnumbers==5.2.0 numpy==2.4.6
env/bin/python -W ignore - <<'PYTHON'
import pathlib
import sys

import eyelinkparser
import numpy as np

START = 1234567


def written(folder, eyes):
    """A second of gaze at x = 500 for the left eye, or the only one, and 600 for the right one."""
    lines = [f"MSG\t{START} start_trial 1", f"MSG\t{START} start_phase film"]
    for time in range(START, START + 1000):
        closed = 300 <= time - START < 400
        gaze = "\t   .\t   .\t    0.0" * len(eyes) if closed else "".join(f"\t  {500 + 100 * k}.0\t  300.0\t 1000.0" for k in range(len(eyes)))
        lines.append(f"{time}{gaze}" + ("\t..." if len(eyes) == 1 else "\t.....") + ("\t    0.0" if len(eyes) == 1 else ""))
        for eye in eyes:
            if time == START + 299:
                lines.append(f"EFIX {eye}   {time - 199}\t{time}\t200\t  500.0\t  300.0\t   1000")
            if time == START + 399:
                lines.append(f"EBLINK {eye} {time - 99}\t{time}\t100")
    lines += [f"MSG\t{START + 1000} end_phase film", f"MSG\t{START + 1000} end_trial"]
    pathlib.Path(folder).mkdir()
    pathlib.Path(folder, "film.asc").write_text("\n".join(lines) + "\n")
    return eyelinkparser.parse(folder=folder)


def told(table, name):
    pairs = zip(np.array(table[f"{name}stlist_film"][0]), np.array(table[f"{name}etlist_film"][0]))
    return [[int(first), int(last)] for first, last in pairs]


seen = []
for folder, eyes in (("one eye", "R"), ("two eyes", "LR")):
    table = written(folder, eyes)
    samples = np.array(table.ttrace_film[0])
    onset = int(table.t_onset_film[0])
    fixations, blinks = told(table, "fix"), told(table, "blink")
    seen.append((int(samples[0]), int(samples[-1]), fixations, blinks, onset, int(np.array(table.xtrace_film[0])[0])))
    print("\n{}: samples {} to {}, fixations {}, blinks {}, onset {}, x {}".format(folder, *seen[-1]))
fixation, blink = [100, 299], [START + 300, START + 399]
sys.exit(seen != [(0, 999, [fixation] * len(eyes), [blink] * len(eyes), START, 500) for eyes in ("R", "LR")])
PYTHON
