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
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

# before NumPy and OpenCV are loaded: a process that is forked must have one thread, and memory is measured
_ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "2", "MPLBACKEND": "agg", "PYTHONHASHSEED": "0"}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument(
        "what", nargs="*", default=["500"], metavar="COUNT | CASE", help="how many cases, or their names"
    )
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="begin with this seed")
    given = parser.parse_args()
    from tests.fuzz import bench, cases, judge
    from tests.fuzz.named import NAMED

    by_name = not given.what[0].isdigit()
    every = given.what if by_name else [*NAMED, *cases.names(int(given.what[0]), given.first)]
    if every == ["named"]:
        every = list(NAMED)
    failed, codes, most_s, most_bytes, began = 0, Counter[int](), (0.0, ""), (0, ""), time.monotonic()
    with tempfile.TemporaryDirectory(prefix="facetrack-fuzz-") as place:
        (Path(place) / "bench").mkdir()
        with quiet():
            own = bench.make(Path(place) / "bench")
        ready = time.monotonic() - began
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
            codes[found.code] += 1
            most_s, most_bytes = max(most_s, (found.seconds, name)), max(most_bytes, (found.rose, name))
            if by_name or found.faults:
                print(
                    f"$ facetrack {shlex.join(case.argv)[:500]!a}"[:600],
                    f"(exit code {found.code}, {found.seconds:.1f} s)",
                )
                print(ascii_lines(found.stderr[:4000]), end="")
            if found.faults:
                failed += 1
                print(f"FAIL python -m tests.fuzz {name}: {'; '.join(found.faults)}\n", flush=True)
    if not by_name:
        print("exit codes:", ", ".join(f"{code} {codes[code]} times" for code in sorted(codes)))
    seconds = time.monotonic() - began - ready
    print(f"{len(every)} cases, {failed} FAIL, in {ready:.0f} s to prepare and {seconds:.0f} s")
    print(f"the slowest: {most_s[1]}, {most_s[0]:.1f} s; the largest: {most_bytes[1]}, {most_bytes[0] / 1e6:.0f} MB")
    return 1 if failed else 0


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        yield


def ascii_lines(text: str) -> str:
    return "".join(f"  {line!a}\n" for line in text.splitlines())


if __name__ == "__main__":
    if any(os.environ.get(key) != value for key, value in _ENVIRONMENT.items()):
        os.execve(sys.executable, [sys.executable, "-m", "tests.fuzz", *sys.argv[1:]], {**os.environ, **_ENVIRONMENT})
    sys.exit(main())
