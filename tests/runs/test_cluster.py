"""A batch on workers of Dask: nothing is lost, nothing is done twice, nothing half done looks finished."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
from concurrent.futures import CancelledError
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import pytest

if find_spec("distributed") is None:
    pytest.skip("needs the extra: pip install -e '.[cluster]'", allow_module_level=True)
psutil = pytest.importorskip("psutil")

from facetrack_cli.__main__ import main  # noqa: E402
from facetrack_cli.core import __version__  # noqa: E402
from facetrack_cli.core.errors import ExitCode, FacetrackError, InputError  # noqa: E402
from facetrack_cli.recipe.load import load_recipe  # noqa: E402
from facetrack_cli.run_folder.lease import LOCK, NOTE  # noqa: E402
from facetrack_cli.run_folder.manifest import NAME, read_manifest  # noqa: E402
from facetrack_cli.runs import batch as cluster  # noqa: E402
from facetrack_cli.runs.plan import Job, Outcome  # noqa: E402
from facetrack_cli.runs.progress import Progress  # noqa: E402
from facetrack_cli.runs.signals import Stop  # noqa: E402
from tests.support.samples import FOLDER  # noqa: E402
from tests.support.sway import TABLES, make_clip, until  # noqa: E402
from tests.support.terminal import refusal  # noqa: E402


class Dask:
    """Processes that are ended together, in a `with`, with all that they start."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.file = folder, folder / "scheduler.json"
        self.environment = os.environ | {
            "PYTHONPATH": str(FOLDER.parent),
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
            "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "false",
        }
        self.processes: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> Dask:
        self.start("dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-show")
        until(self.file.exists)
        for _ in range(2):
            self.start("dask_worker", "--nthreads", "1")
        return self

    def start(self, module: str, *words: str) -> None:
        command = [sys.executable, "-m", f"distributed.cli.{module}", "--no-dashboard"]
        command += ["--scheduler-file", str(self.file), *words]
        with (self.folder / "log.txt").open("ab") as log:
            more = {"env": self.environment, "cwd": self.folder, "start_new_session": True}
            self.processes.append(subprocess.Popen(command, stderr=log, stdout=log, **more))

    def run(self, *words: object, cwd: Path, wait: bool = True) -> subprocess.Popen[str]:
        """`facetrack run`; it has ended unless not waited for."""
        command = [sys.executable, "-m", "facetrack_cli", "run", *map(str, words)]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        process = subprocess.Popen(command, env=self.environment, cwd=cwd, **pipes)
        if wait:
            process.said = "".join(process.communicate(timeout=120))
        return process

    def __exit__(self, *_: object) -> None:
        for one in self.processes:
            os.killpg(one.pid, signal.SIGKILL)
            one.wait()


SIR = ["--no-video", "--config", "sir"]
COUNT, FRAMES = 3, 200


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with clips that show the same, and in `plain` what a run without a cluster makes of them."""
    folder = tmp_path_factory.mktemp("cluster")
    first = make_clip(folder / "c0.mp4", FRAMES)
    for i in range(1, COUNT):
        for suffix in (".mp4", ".init.yaml"):
            shutil.copy(first.with_suffix(suffix), folder / f"c{i}{suffix}")
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(folder)
        assert main(["run", "c0.mp4", *SIR, "-o", "plain", "-q"]) == 0
    return folder


@pytest.fixture(scope="module")
def dask(tmp_path_factory):
    with Dask(tmp_path_factory.mktemp("dask")) as found:
        yield found


def names():
    return [f"c{i}.mp4" for i in range(COUNT)]


def check_equal(place, out):
    """All clips are done, as without a cluster, and nothing else lies beside their files."""
    for i in range(COUNT):
        folder = place / out / f"c{i}-sir"
        assert sorted(one.name for one in folder.iterdir()) == [NAME, *TABLES]
        for name in TABLES:
            assert (folder / name).read_bytes() == (place / "plain" / name).read_bytes().replace(b"c0.", b"c%d." % i)


def holder(folder):
    """The process that tracks a clip, which is its worker; None if there is none."""
    try:
        process = psutil.Process(json.loads((folder / NOTE).read_text())["process"])
        return process if "spawn_main" in " ".join(process.cmdline()) else None
    except (OSError, ValueError, KeyError, psutil.Error):
        return None


def begun(folder):
    """The worker that tracks a clip, once there are rows."""
    until(lambda: any(part.stat().st_size > 2000 for part in folder.glob(".trajectory-*.part.csv")))
    return until(lambda: holder(folder))


def test_the_results_are_those_of_a_plain_run_and_are_not_made_twice(dask, place, capfd, monkeypatch):
    monkeypatch.chdir(place)
    Path("bad.mp4").write_text("no clip")
    shutil.copy("c0.mp4", "-odd, name.mp4")
    words = ["run", *SIR, "--init", "c0.init.yaml", "-o", "first", "--cluster"]
    assert main([*words, str(dask.file), "--", *names(), "bad.mp4", "-odd, name.mp4"]) == 5
    lines = capfd.readouterr().err.splitlines()
    assert sum(f"({', '.join(TABLES)}): {FRAMES} frames" in line for line in lines) == COUNT + 1, lines
    [error] = [line for line in lines if line.startswith("facetrack: error: ")]
    assert error.startswith("facetrack: error: bad.mp4: not a video") and lines[-1] == "1 of 5 inputs failed"
    for i in range(COUNT):
        assert Path(f"first/c{i}-sir/trajectory.csv").read_bytes() == Path("plain/trajectory.csv").read_bytes()
    before = {path: path.stat().st_ino for path in Path("first").rglob("*.*")}
    assert main([*words, json.loads(dask.file.read_text())["address"], *names()]) == 0
    assert capfd.readouterr().err.count("done before") == COUNT
    assert {path: path.stat().st_ino for path in before} == before
    assert main([*words, str(dask.file), "--overwrite", "--smooth", "--stop", "9", "c0.mp4", "c1.mp4"]) == 0
    assert capfd.readouterr().err.count(": 9 frames") == 2
    assert read_manifest(Path("first/c1-sir")).smoothed


def test_a_worker_that_is_killed(dask, place):
    head = dask.run(*SIR, "-o", "killed", "--cluster", dask.file, *names(), cwd=place, wait=False)
    begun(place / "killed" / "c1-sir").kill()
    said = head.communicate(timeout=100)[1]
    assert head.returncode == 0, said
    check_equal(place, "killed")


@pytest.mark.nightly
def test_ctrl_c_closes_the_files_on_the_workers(dask, place):
    words = [*SIR, "-o", "stopped", "--cluster", dask.file, *names()]
    head = dask.run(*words, cwd=place, wait=False)
    for i in (0, 1):
        begun(place / "stopped" / f"c{i}-sir")
    head.send_signal(signal.SIGINT)
    said = head.communicate(timeout=60)[1]
    assert head.returncode == ExitCode.INTERRUPTED, said
    ended = [read_manifest(place / "stopped" / f"c{i}-sir").stopped for i in (0, 1)]  # one may be done by then
    assert said.count("; terminated") == ended.count("terminated") > 0
    assert not list(place.glob(f"stopped/*/{LOCK}")) and not list(place.glob("stopped/*/.*.part*"))
    assert dask.run(*words, cwd=place).returncode == 0
    check_equal(place, "stopped")


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """What `IN` stands for in command lines."""
    return make_clip(tmp_path_factory.mktemp("refused") / "c0.mp4", 6).parent


@pytest.mark.parametrize(
    ("where", "said"),
    [
        ("local", "--cluster local: names no scheduler; give tcp://HOST:PORT, or the scheduler file of"),
        ("head:8786", "names no scheduler"),
        ("odd.json", "--cluster odd.json: names no scheduler"),
        ("tcp://127.0.0.1:9", "no scheduler of Dask answers at tcp://127.0.0.1:9 within 0 s"),
    ],
)
def test_what_names_no_scheduler(facetrack, monkeypatch, where, said):
    monkeypatch.setattr(cluster, "ANSWER_S", 0.3)
    Path("odd.json").write_text("[1]")
    assert said in refusal(facetrack("run", "IN/c0.mp4", *SIR, "-o", "o", "--cluster", where), 2)


def test_options_that_have_no_meaning_on_a_cluster(facetrack, monkeypatch):
    run = ["run", "IN/c0.mp4", *SIR, "--cluster"]
    assert "streams one clip from this machine" in refusal(facetrack(*run, "tcp://a:1", "-o", "-"), 2)
    assert "give one of them" in refusal(facetrack(*run, "tcp://a:1", "-j", 2), 2)
    monkeypatch.setitem(sys.modules, "distributed", None)
    said = refusal(facetrack(*run, "tcp://127.0.0.1:9"), 2)
    assert said.endswith("is not installed: pip install 'facetrack[cluster]'")


@pytest.fixture
def worker(monkeypatch):
    found = SimpleNamespace(status=SimpleNamespace(name="running"), address="tcp://here:1")
    monkeypatch.setattr("distributed.get_worker", lambda: found)
    return found


def test_what_a_worker_refuses(worker, tmp_path, monkeypatch):
    sent = pickle.dumps(None)
    with pytest.raises(FacetrackError, match=r"and 0\.0\.0 where the batch is; install the same version"):
        cluster._on_worker("0.0.0", str(tmp_path), "batch", sent)
    with pytest.raises(FacetrackError, match=r"No such file .* all machines must see the same folders"):
        cluster._on_worker(__version__, str(tmp_path / "none"), "batch", sent)
    monkeypatch.setattr(cluster, "_ended_batches", {"told"})
    assert cluster._on_worker(__version__, str(tmp_path), "told", sent) is None
    worker.status.name = "closing"
    assert cluster._on_worker(__version__, str(tmp_path), "batch", sent) is None


def test_dask_tries_again_what_is_not_the_clip_s_fault(worker, tmp_path, monkeypatch):
    sent = pickle.dumps(Job(tmp_path / "a.mp4", load_recipe("sir"), tmp_path / "a"))
    monkeypatch.chdir(tmp_path)
    for error in (InputError("no video"), FacetrackError("no space left")):
        monkeypatch.setattr(cluster, "attempt", lambda job, stop, error=error: Outcome(failure=error))
        if isinstance(error, InputError):
            assert cluster._on_worker(__version__, str(tmp_path), "batch", sent).failure is error
            continue
        with pytest.raises(FacetrackError, match="no space left"):
            cluster._on_worker(__version__, str(tmp_path), "batch", sent)


class Answer(SimpleNamespace):
    __hash__ = object.__hash__


class Scheduler:
    """In place of a client: each try of a clip gives the next answer of its script."""

    status = "running"

    def __init__(self, **scripts):
        self.scripts, self.sent = {f"{name}.mp4": [*answers] for name, answers in scripts.items()}, []

    def nthreads(self):
        return {"tcp://one:1": 1}

    def submit(self, function, version, folder, batch, sent, pure, retries):
        job = pickle.loads(sent)
        self.sent.append(job)
        answer = self.scripts[job.clip.name].pop(0)

        def result(timeout):
            if isinstance(answer, BaseException):
                raise answer
            return answer

        status = "cancelled" if isinstance(answer, CancelledError) else "finished"
        return Answer(done=lambda: True, result=result, status=status)

    def close(self, timeout):
        pass


def outcomes(monkeypatch, scheduler, tmp_path):
    """The outcomes of a batch by clip."""
    monkeypatch.setattr("distributed.Client", lambda address, **_: scheduler)
    monkeypatch.setattr(cluster, "ANSWER_LOOK_S", 0.0)
    recipe = load_recipe("sir")
    jobs = [Job(Path(name), recipe, tmp_path / name, batch=True, overwrite=True) for name in scheduler.scripts]
    return {one.source.stem: one for one in cluster.run_cluster(jobs, "tcp://one:9", Stop(), Progress(quiet=True))}


def answer(name, error=None, **more):
    return Outcome(source=Path(f"{name}.mp4"), frames=9, failure=error, **more)


def test_what_becomes_of_each_answer(tmp_path, monkeypatch):
    from distributed import KilledWorker

    killed = KilledWorker("key", SimpleNamespace(address="tcp://one:1"), 3)
    scheduler = Scheduler(
        a=[FacetrackError("no space left")],
        b=[answer("b", InputError("not a video"))],
        c=[CancelledError(), None, answer("c", stopped="terminated", paths=[tmp_path / "c.csv"]), answer("c")],
        d=[killed, killed],
        e=[killed, answer("e")],
    )
    found = outcomes(monkeypatch, scheduler, tmp_path)
    assert not any(scheduler.scripts.values()), "each answer was asked for"
    assert str(found["a"].failure).startswith("a.mp4: no space left; tried 3 times")
    assert str(found["b"].failure) == "not a video"
    assert found["c"].failure is None and found["c"].stopped is None and found["e"].failure is None
    assert [job.overwrite for job in scheduler.sent if job.clip.stem == "c"] == [True, True, True, False]
    assert "it ended worker after worker" in str(found["d"].failure)
    assert "ended worker after worker" in read_manifest(tmp_path / "d.mp4").error


def test_a_scheduler_that_is_gone(tmp_path, monkeypatch):
    scheduler = Scheduler(a=[answer("a")])
    monkeypatch.setattr(scheduler, "status", "closed", raising=False)
    found = outcomes(monkeypatch, scheduler, tmp_path)
    assert "not tracked, as the scheduler is gone; the same command again goes on" in str(found["a"].failure)
