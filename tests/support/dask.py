"""A real scheduler and real workers of Dask on this machine, and what is left of their processes."""

from __future__ import annotations

import contextlib
import os
import secrets
import subprocess
import sys
from pathlib import Path

import psutil

from tests.support.sway import until

ROOT = Path(__file__).parents[2]


class Dask:
    """Processes that are ended together, in a `with`; all that they start has the same MARK."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.file, self.mark = folder, folder / "scheduler.json", secrets.token_hex(8)
        self.environment = os.environ | {
            "PYTHONPATH": str(ROOT),
            "MARK": self.mark,
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
            "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "false",
        }
        self.processes: list[psutil.Popen] = []

    def __enter__(self) -> Dask:
        self.schedule()
        return self

    def schedule(self) -> None:
        self.file.unlink(missing_ok=True)
        self.scheduler = self.start("dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-show")
        until(self.file.exists)

    def work(self, count: int) -> None:
        for _ in range(count):
            self.start("dask_worker", "--nthreads", "1")

    def start(self, module: str, *words: str) -> psutil.Popen:
        command = [sys.executable, "-m", f"distributed.cli.{module}", "--no-dashboard"]
        command += ["--scheduler-file", str(self.file), *words]
        with (self.folder / "log.txt").open("ab") as log:
            self.processes.append(psutil.Popen(command, env=self.environment, stderr=log, stdout=log, cwd=self.folder))
        return self.processes[-1]

    def run(self, *words: object, cwd: Path, wait: bool = True) -> subprocess.Popen[str]:
        """`facetrack run`; it has ended unless not waited for."""
        command = [sys.executable, "-m", "facetrack_cli", "run", *map(str, words)]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        process = subprocess.Popen(command, env=self.environment, cwd=cwd, **pipes)
        if wait:
            process.said = "".join(process.communicate(timeout=120))
        return process

    def __exit__(self, *_: object) -> None:
        for one in psutil.process_iter():
            with contextlib.suppress(psutil.Error):
                if one.environ().get("MARK") == self.mark:
                    one.kill()
        for one in self.processes:
            one.wait()
