"""A real scheduler and real workers of Dask on this machine, and what is left of their processes."""

from __future__ import annotations

import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil

ROOT = Path(__file__).parents[2]


def until(true: Callable[[], object], seconds: float = 60.0) -> object:
    """Wait until something is true, and return it."""
    deadline = time.monotonic() + seconds
    while not (found := true()):
        assert time.monotonic() < deadline, "it never came"
        time.sleep(0.01)
    return found


class Dask:
    """Processes that are ended, and searched for, together, in a `with`."""

    def __init__(self, folder: Path, **config: object) -> None:
        folder.mkdir(exist_ok=True)
        self.folder, self.file, self.mark = folder, folder / "scheduler.json", secrets.token_hex(8)
        self.environment = os.environ | {
            "PYTHONPATH": str(ROOT),
            "MARK": self.mark,
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
            "DASK_DISTRIBUTED__WORKER__LIFETIME__RESTART": "true",
            "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "false",
        }
        self.environment |= {key: str(value) for key, value in config.items()}
        self.workers: list[psutil.Popen] = []

    def __enter__(self) -> Dask:
        self.schedule()
        return self

    def schedule(self, port: int = 0) -> None:
        self.file.unlink(missing_ok=True)
        where = ["--host", "127.0.0.1", "--port", str(port), "--no-dashboard", "--no-show"]
        self.scheduler = self.start("dask_scheduler", *where, "--scheduler-file", str(self.file))
        until(self.file.exists)

    def work(self, *options: str, count: int = 1, before: Callable[[], None] | None = None) -> None:
        for _ in range(count):
            words = ["--scheduler-file", str(self.file), "--nthreads", "1", "--no-dashboard", *options]
            self.workers.append(self.start("dask_worker", *words, before=before))

    def start(self, module: str, *words: str, before: Callable[[], None] | None = None) -> psutil.Popen:
        with (self.folder / "log.txt").open("ab") as log:
            command = [sys.executable, "-m", f"distributed.cli.{module}", *words]
            return psutil.Popen(
                command, env=self.environment, stderr=log, stdout=log, cwd=self.folder, preexec_fn=before
            )

    def run(self, *words: object, cwd: Path, wait: bool = True) -> subprocess.Popen[str]:
        """`facetrack run`; it has ended unless not waited for."""
        command = [sys.executable, "-m", "facetrack_cli", "run", *map(str, words)]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        process = subprocess.Popen(command, env=self.environment, cwd=cwd, **pipes)
        if wait:
            process.said = "".join(process.communicate(timeout=120))
        return process

    def left(self) -> list[psutil.Process]:
        """All processes that belong here, and what they have started, and so on."""
        return [one for one in psutil.process_iter() if self._is_ours(one)]

    def _is_ours(self, one: psutil.Process) -> bool:
        try:
            return one.status() != psutil.STATUS_ZOMBIE and one.environ().get("MARK") == self.mark
        except psutil.Error:
            return False

    def __exit__(self, *_: object) -> None:
        for one in self.left():
            try:
                one.send_signal(signal.SIGCONT)
                one.kill()
            except psutil.Error:
                pass
        for one in (self.scheduler, *self.workers):
            one.wait()
