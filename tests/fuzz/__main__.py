"""Try hostile inputs: `python -m tests.fuzz [--first SEED] [COUNT | CASE...]`; exit code 1 if any is answered badly."""

from __future__ import annotations

import argparse
import contextlib
import gc
import io
import os
import shlex
import shutil
import sys
import tempfile
import threading
from pathlib import Path

# before NumPy and OpenCV are loaded: a process that is forked must have one thread, and memory is measured
_ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "2", "MPLBACKEND": "agg", "PYTHONHASHSEED": "0"}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("what", nargs="*", default=["500"], metavar="COUNT | CASE")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="begin with this seed")
    given = parser.parse_args()
    from tests.fuzz import bench, cases, judge
    from tests.fuzz.cases import NAMED

    by_name = not given.what[0].isdigit()
    every = given.what if by_name else [*NAMED, *cases.names(int(given.what[0]), given.first)]
    failed = 0
    with tempfile.TemporaryDirectory(prefix="facetrack-fuzz-") as place:
        (Path(place) / "bench").mkdir()
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            own = bench.make(Path(place) / "bench", warm=not NAMED.keys() >= {*every})
        for thread in set(threading.enumerate()) - {threading.main_thread()}:
            thread.join(10)  # that of a claim ends soon after it
        assert [thread.name for thread in threading.enumerate()] == ["MainThread"]
        gc.freeze()  # or each process would copy all objects when it collects garbage
        for name in every:
            folder = Path(place) / "case"
            shutil.rmtree(folder, ignore_errors=True)
            (folder / "work").mkdir(parents=True)
            case = cases.build(name, own, folder / "work")
            found = judge.answer(case)
            failed += bool(found.faults)
            if by_name or found.faults:
                command = f"$ facetrack {shlex.join(case.argv)[:500]!a}"[:600]
                print(f"{command} (exit code {found.code}, {found.seconds:.1f} s)")
                print("".join(f"  {line!a}\n" for line in found.stderr[:4000].splitlines()), end="")
            if found.faults:
                print(f"FAIL python -m tests.fuzz {name}: {'; '.join(found.faults)}\n", flush=True)
    print(f"{len(every)} cases, {failed} FAIL")
    return 1 if failed else 0


if __name__ == "__main__":
    if any(os.environ.get(key) != value for key, value in _ENVIRONMENT.items()):
        os.execve(sys.executable, [sys.executable, "-m", "tests.fuzz", *sys.argv[1:]], {**os.environ, **_ENVIRONMENT})
    sys.exit(main())
