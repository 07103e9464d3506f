"""A batch on workers of Dask, real ones: nothing is lost, nothing done twice, nothing half done looks finished."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import shutil
import signal
import sys
import threading
import time
from pathlib import Path

import pytest
from click.testing import CliRunner

pytest.importorskip("distributed", reason="needs the extra: pip install -e '.[cluster]'")
psutil = pytest.importorskip("psutil")

from facetrack_cli import __version__  # noqa: E402
from facetrack_cli.__main__ import main  # noqa: E402
from facetrack_cli.cli import options  # noqa: E402
from facetrack_cli.core.claims import LOCK  # noqa: E402
from facetrack_cli.runs import cluster, guard, scheduler  # noqa: E402
from facetrack_cli.trajectory.manifest import NAME, read_manifest  # noqa: E402
from tests.runs.test_run import make_clip  # noqa: E402
from tests.support.dask import Dask, until  # noqa: E402
from tests.support.terminal import refusal  # noqa: E402

FILES = ["trajectory.csv", "trajectory.json"]
SIR = ["--no-video", "--config", "sir"]
COUNT, FRAMES = 3, 500


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with clips, and in `plain` what a run without a cluster makes of them."""
    folder = tmp_path_factory.mktemp("cluster")
    first = make_clip(folder / "c0.mp4", FRAMES)
    for i in range(1, COUNT):
        for suffix in (".mp4", ".init.yaml"):
            shutil.copy(first.with_suffix(suffix), folder / f"c{i}{suffix}")
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(folder)
        assert main(["run", *names(), *SIR, "-o", "plain", "-q"]) == 0
    return folder


@pytest.fixture(scope="module")
def dask(tmp_path_factory):
    with Dask(tmp_path_factory.mktemp("dask")) as found:
        found.work(count=2)
        yield found
        found.kill()


@pytest.fixture
def clips(place):
    """What `IN` stands for in command lines."""
    return place


def names():
    return [f"c{i}.mp4" for i in range(COUNT)]


def check_equal(place, out, count=COUNT):
    """All clips are done, as without a cluster, and nothing else lies beside their files."""
    for i in range(count):
        folder = place / out / f"c{i}-sir"
        assert sorted(one.name for one in folder.iterdir()) == [NAME, *FILES]
        for name in FILES:
            assert (folder / name).read_bytes() == (place / "plain" / folder.name / name).read_bytes()


def begun(folder):
    """The process that tracks a clip, once it has rows."""

    def look():
        with contextlib.suppress(OSError, ValueError, KeyError, StopIteration, psutil.Error):
            note = json.loads((folder / LOCK).read_text())
            rows = next(folder.glob(".trajectory-*.part.csv"))
            return rows.stat().st_size > 2000 and psutil.Process(note["process"])
        return None

    return until(look)


class Killing(threading.Thread):
    """Kills whoever begins a clip, or an ancestor of it, again and again."""

    def __init__(self, folder, whom, mark):
        super().__init__(daemon=True)
        self.folder, self.whom, self.mark, self.killed, self.ended = folder, whom, mark, set(), False

    def run(self):
        while not self.ended:
            with contextlib.suppress(OSError, ValueError, psutil.Error):
                process = psutil.Process(json.loads((self.folder / LOCK).read_text())["process"])
                # the batch itself claims a folder, too, to say that its clip failed
                if process.pid not in self.killed and process.cmdline()[1:3] == ["-m", "facetrack_cli.runs.guard"]:
                    victim = self.whom(process)
                    if victim.environ().get("MARK") == self.mark:  # not who adopts orphans
                        victim.kill()
                        self.killed.add(process.pid)
            time.sleep(0.002)

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self.ended = True
        self.join()


def worker_of(process):
    """The process of the worker that a clip is tracked for: it has the guard, which has the clip."""
    return process.parent().parent()


# --- what works -------------------------------------------------------------------------------------------------------


def test_the_results_are_those_of_a_plain_run_and_are_not_made_twice(dask, place):
    (place / "bad.mp4").write_text("no clip")
    (place / "-odd, name.mp4").write_bytes((place / "c0.mp4").read_bytes())
    words = [*SIR, "--init", "c0.init.yaml", "-o", "first", "--cluster"]
    done = dask.run(*words, dask.file, "--", *names(), "bad.mp4", "-odd, name.mp4", cwd=place)
    assert done.returncode == 5, done.said
    lines = done.said.splitlines()
    assert sum(f"({', '.join(FILES)}): {FRAMES} frames" in line for line in lines) == COUNT + 1, done.said
    [error] = [line for line in lines if line.startswith("facetrack: error: ")]
    assert error.startswith("facetrack: error: bad.mp4: not a video") and lines[-1] == "1 of 5 inputs failed"
    for i in range(COUNT):
        table = f"c{i}-sir/trajectory.csv"
        assert (place / "first" / table).read_bytes() == (place / "plain" / table).read_bytes()
    before = {path: path.stat().st_ino for path in (place / "first").rglob("*.*")}
    again = dask.run(*words, json.loads(dask.file.read_text())["address"], *names(), cwd=place)
    assert again.returncode == 0 and again.said.count("done before") == COUNT, again.said
    assert {path: path.stat().st_ino for path in before} == before
    over = dask.run(*words, dask.file, "--overwrite", "--stop", 9, "c0.mp4", "c1.mp4", cwd=place)
    assert over.returncode == 0 and over.said.count(": 9 frames") == 2, over.said


def test_workers_of_this_machine(place):
    done = Dask(place / "here").run(*SIR, "-o", "here", "--cluster", "local:2", *names(), cwd=place)
    assert done.returncode == 0, done.said
    check_equal(place, "here")
    words = ["c0.mp4", *SIR, "--smooth", "--stop", 20, "-o"]
    smoothed = Dask(place / "here").run(*words, "smoothed", "--cluster", "local:1", cwd=place)
    assert smoothed.returncode == 0, smoothed.said
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(place)
        assert main(["run", *map(str, words), "smooth", "-q"]) == 0
    table = "trajectory.csv"
    assert (place / "smoothed" / table).read_bytes() == (place / "smooth" / table).read_bytes()


# --- what is refused --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("where", "said"),
    [
        ("local", "--cluster local: names no scheduler; give local:N, tcp://HOST:PORT, or the scheduler file of"),
        ("local:0", "names no scheduler"),
        ("http://here:80", "names no scheduler"),
        ("head:8786", "names no scheduler"),
        ("none.json", "--cluster none.json: cannot be read: No such file or directory; give local:N"),
        ("odd.json", "--cluster odd.json: is no scheduler file: it has no address; give"),
        ("tcp://127.0.0.1:9", "no scheduler of Dask answers at tcp://127.0.0.1:9 within 1 s"),
    ],
)
def test_what_names_no_scheduler(facetrack, monkeypatch, where, said):
    monkeypatch.setattr(scheduler, "ANSWER_S", 1.0)
    monkeypatch.setattr(cluster, "ANSWER_S", 1.0)
    Path("odd.json").write_text("[1]")
    assert said in refusal(facetrack("run", "IN/c0.mp4", *SIR, "-o", "o", "--cluster", where), 2)


def test_options_that_have_no_meaning_on_a_cluster(facetrack, monkeypatch):
    run = ["run", "IN/c0.mp4", *SIR, "--cluster", "local:1"]
    assert "streams one clip from this machine" in refusal(facetrack(*run, "-o", "-"), 2)
    assert "give one of them" in refusal(facetrack(*run, "-j", 2), 2)
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert refusal(facetrack(*run), 2).endswith("is not installed: pip install 'facetrack[cluster]'")


def test_another_version_is_not_run(tmp_path):
    one = guard._Guard()
    one.ask("0.0.0", str(tmp_path), ["--help"])
    code, [line] = until(one.answer)
    one.close()
    assert code == 2 and "and 0.0.0 where the batch is; install the same version" in line


def test_a_worker_that_sees_other_folders(tmp_path):
    one = guard._Guard()
    one.ask(__version__, str(tmp_path / "none"), ["--help"])
    code, [line] = until(one.answer)
    one.close()
    assert code == 1 and line.endswith("all machines must see the same folders")


def test_words_are_passed_on_as_they_were_given():
    seen = []

    class Some:
        many: tuple[str, ...] = options.OVERRIDES
        box: object = options.box_option("A box.")
        out: str | None = options.option("-o --out DIR", "Where.")
        fast: bool = options.flag("--fast -f", "Fast.")
        number: int = options.option("-n --number N", "A number.", type=int, default=3)
        rest: tuple[Path, ...] = options.argument("REST", nargs=-1)

        def run(self):
            seen.extend(options.words_without("out"))

    words = ["--set", "a=-1", "x", "--box=-1,2,3,4", "-oo", "-f", "--set", "b= c", "--", "-y"]
    assert CliRunner().invoke(options.verb(Some), words).exit_code == 0
    assert seen == ["--set=a=-1", "--set=b= c", "--box=-1,2,3,4", "--fast"]


# --- what dies --------------------------------------------------------------------------------------------------------


def test_a_worker_that_is_killed(dask, place):
    head = dask.run(*SIR, "-o", "killed", "--cluster", dask.file, *names(), cwd=place, wait=False)
    process = begun(place / "killed" / "c1-sir")
    guard_of = process.parent()
    worker_of(process).kill()
    said = head.communicate(timeout=100)[1]
    assert head.returncode == 0, said
    check_equal(place, "killed")
    until(lambda: not any(one.is_running() and one.status() != psutil.STATUS_ZOMBIE for one in (process, guard_of)))


def test_a_clip_that_ends_its_process(dask, place):
    with Killing(place / "poison" / "c1-sir", lambda process: process, dask.mark) as killing:
        done = dask.run(*SIR, "-o", "poison", "--cluster", dask.file, *names(), cwd=place)
    assert done.returncode == 5 and len(killing.killed) == 3, done.said
    assert "facetrack: error: c1.mp4: its process was killed by signal 9; tried 3 times, at last on " in done.said
    known = read_manifest(place / "poison" / "c1-sir")
    assert known.error.startswith("its process was killed by signal 9") and not known.complete
    words = [*SIR, "-o", "poison", "--retry-failed", "--cluster", dask.file, *names()]
    assert dask.run(*words, cwd=place).returncode == 0
    check_equal(place, "poison")


@pytest.mark.nightly
def test_a_clip_that_ends_its_worker_is_alone_at_fault(dask, place):
    with Killing(place / "worse" / "c1-sir", worker_of, dask.mark) as killing:
        done = dask.run(*SIR, "-o", "worse", "--cluster", dask.file, *names(), cwd=place)
    assert done.returncode == 5 and len(killing.killed) <= 6, done.said
    assert "facetrack: error: c1.mp4: it ended worker after worker" in done.said
    assert "ended worker after worker" in read_manifest(place / "worse" / "c1-sir").error
    shutil.rmtree(place / "worse" / "c1-sir")
    shutil.copytree(place / "plain" / "c1-sir", place / "worse" / "c1-sir")
    check_equal(place, "worse")


@pytest.mark.nightly
def test_a_clip_that_hangs_and_a_worker_that_does(dask, place):
    head = dask.run(*SIR, "-o", "hung", "--cluster", dask.file, *names(), cwd=place, wait=False)
    first = begun(place / "hung" / "c0-sir")
    first.suspend()
    second = begun(place / "hung" / "c1-sir")
    worker_of(second).suspend()
    second.suspend()
    said = head.communicate(timeout=100)[1]
    assert head.returncode == 0, said
    check_equal(place, "hung")
    until(lambda: not first.is_running() and not second.is_running())


@pytest.mark.nightly
def test_a_worker_without_space(dask, place):
    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

    dask.work(before=limit)
    bad = dask.workers.pop()
    done = dask.run(*SIR, "-o", "full", "--cluster", dask.file, *names(), cwd=place)
    bad.terminate()
    bad.wait()
    assert done.returncode == 0, done.said
    assert "and is tried again" in done.said and "File too large" in done.said
    check_equal(place, "full")


# --- what is stopped --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), pytest.param(signal.SIGKILL, -9, marks=pytest.mark.nightly)]
)
def test_a_batch_that_is_stopped_leaves_nothing_at_work(dask, place, number, code):
    out = f"stopped{number:d}"
    head = dask.run(*SIR, "-o", out, "--cluster", dask.file, *names(), cwd=place, wait=False)
    processes = [begun(place / out / f"c{i}-sir") for i in (0, 1)]
    os.kill(head.pid, number)
    said = head.communicate(timeout=60)[1]
    assert head.returncode == code, said
    if number == signal.SIGINT:
        ended = [read_manifest(place / out / f"c{i}-sir").stopped for i in (0, 1)]  # one may be done by then
        assert said.count("; terminated") == ended.count("terminated") > 0
    until(lambda: not any(one.is_running() for one in processes))
    assert not list(place.glob(f"{out}/*/{LOCK}")) and not list(place.glob(f"{out}/*/.*.part*"))
    assert dask.run(*SIR, "-o", out, "--cluster", dask.file, *names(), cwd=place).returncode == 0
    check_equal(place, out)


@pytest.mark.nightly
def test_a_scheduler_that_is_gone_and_comes_back(place, tmp_path):
    with Dask(tmp_path) as dask:
        dask.work(count=2)
        head = dask.run(*SIR, "-o", "again", "--cluster", dask.file, *names(), cwd=place, wait=False)
        begun(place / "again" / "c2-sir")
        done = {path: path.stat().st_ino for path in place.glob("again/*/run.json")}
        dask.scheduler.kill()
        dask.scheduler.wait()
        dask.schedule()
        dask.work(count=2)
        said = head.communicate(timeout=100)[1]
        assert head.returncode == 0, said
        assert "is gone; waiting for it" in said and "is back" in said
        check_equal(place, "again")
        assert {path: path.stat().st_ino for path in done} == done != {}
