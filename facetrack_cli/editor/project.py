"""A project of `facetrack app`: clips, what is tracked in each, and their runs, one child process at a time.

Each run is the ordinary `facetrack run` in a folder of its own, so the folders say how far everything is, also after
a kill. project.json holds what folders do not say: the list, what is chosen, and what is still to be run.
"""

import contextlib
import json
import os
import re
import subprocess
import sys
import threading
from collections.abc import Iterable, Sequence
from itertools import count
from pathlib import Path
from typing import IO, Annotated, Any, Final, Literal, TypeAlias

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from facetrack_cli.core.errors import (
    LOG_FORMAT,
    BusyError,
    ExitCode,
    FacetrackError,
    InputError,
    UsageError,
    flat,
    reading,
)
from facetrack_cli.core.files import absolute, make_folder, read_bounded, write_new, writing
from facetrack_cli.core.types import checked_name
from facetrack_cli.run_folder.lease import FolderLease
from facetrack_cli.run_folder.status import ClipStatus, clip_status

NAME: Final = "project.json"
MAX_CLIPS: Final = 2000
RECIPES: Final = {"face": "face", "everybody": "face", "signer": "signer", "box": "correlation_filter"}
STOPPED: Final = (ExitCode.INTERRUPTED, ExitCode.TERMINATED)
What: TypeAlias = Literal["face", "everybody", "signer", "box"]


class Clip(BaseModel):
    """A clip of the list. `name` is that of its folders; `likely` what a detector sees there, once it has looked."""

    model_config = ConfigDict(extra="forbid")
    id: int
    path: str
    name: Annotated[str, AfterValidator(lambda name: checked_name(name, "clip"))]
    what: What = "face"
    likely: What | None = None
    size: tuple[int, int] | None = None
    seconds: float = 0.0
    frames: int = 0
    wanted: bool = False  # to be run
    again: bool = False  # from the start, over what is there
    error: str | None = None


class Listed(BaseModel):
    """project.json."""

    model_config = ConfigDict(extra="forbid")
    format: Literal["facetrack-project"] = "facetrack-project"
    version: Literal[1] = 1
    clips: list[Clip] = []


class Project:
    """The list in a folder, and the queue. Thread-safe; `lock` is held while a clip is changed.

    What was to be run when it was closed, or killed, is `paused`.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.lock = absolute(folder), threading.RLock()
        make_folder(self.folder, "name another folder")
        self._held = contextlib.ExitStack()
        try:
            self._held.enter_context(FolderLease(self.folder))
        except BusyError:
            raise UsageError(f"{self.folder}: is open already; go to its page, or name another folder") from None
        self._path = self.folder / NAME
        try:
            data = read_bounded(self._path) if self._path.exists() else b"{}"
            self.clips = {clip.id: clip for clip in Listed.model_validate_json(data).clips}
        except ValidationError as e:
            self._held.close()
            raise InputError(f"{self._path}: is not as facetrack app writes it; move it away, and add the clips") from e
        self.paused = any(clip.wanted for clip in self.clips.values())
        self.running: Clip | None = None
        self.progress: dict[str, Any] = {}  # of what runs, as its lines say
        self._child: subprocess.Popen[str] | None = None
        self._closed, self._work = False, threading.Condition(self.lock)
        self._worker = threading.Thread(target=self._go, name="runs", daemon=True)
        self._worker.start()

    def close(self) -> None:
        """End what runs, which keeps what it has tracked, and wait for it."""
        with self.lock:
            self._closed = True
            self._terminate()
            self._work.notify_all()
        self._worker.join()
        self._held.close()

    # the list

    def find(self, clip: int) -> Clip:
        """InputError for a clip that is not there any more."""
        with self.lock:
            if clip not in self.clips:
                raise InputError("this clip is not in the list any more")
            return self.clips[clip]

    def add(self, paths: Sequence[Path]) -> list[Clip]:
        """Add clips that are not in the list yet. Raises UsageError for too many."""
        with self.lock:
            there = {self.place(clip) for clip in self.clips.values()}
            new = [path for path in map(absolute, paths) if path not in there]
            if (count := len(self.clips) + len(new)) > MAX_CLIPS:
                raise UsageError(f"{count} clips are too many for a list; at most {MAX_CLIPS}")
            added = []
            for path in new:
                stem = re.sub(r"[^\w .()-]", "_", path.stem)[:80].strip(" .") or "clip"
                name = free(stem, [clip.name for clip in self.clips.values()])
                kept = path.relative_to(self.folder).as_posix() if path.is_relative_to(self.folder) else str(path)
                clip = Clip(id=max(self.clips, default=0) + 1, path=kept, name=name)
                self.clips[clip.id] = clip
                added.append(clip)
            self.save()
            return added

    def remove(self, clip: Clip) -> None:
        """Take a clip from the list; what was made of it goes into the folder removed/."""
        with self.lock:
            self.want([clip], False)
            while self.running is clip:
                self._work.wait()
            del self.clips[clip.id]
            removed = self.folder / "removed"
            for path in (place(clip, what) for what in RECIPES for place in (self.run_of, self.start_of)):
                if path.exists():
                    make_folder(removed)
                    with writing(path, "close what uses it"):
                        path.rename(removed / free(path.name, (other.name for other in removed.iterdir())))
            self.save()

    def place(self, clip: Clip) -> Path:
        return self.folder / clip.path

    def run_of(self, clip: Clip, what: str | None = None) -> Path:
        """The folder of a run: each choice of what is tracked has its own, so that none replaces another."""
        return self.folder / "runs" / f"{clip.name}-{what or clip.what}"

    def start_of(self, clip: Clip, what: str | None = None) -> Path:
        """The init file of what is chosen on the page of a start."""
        return self.folder / "starts" / f"{clip.name}-{what or clip.what}.init.yaml"

    def save(self) -> None:
        with self.lock:
            data = Listed(clips=list(self.clips.values())).model_dump_json(indent=1).encode() + b"\n"
            write_new(self._path, data, overwrite=True)

    # the queue

    def want(self, clips: Sequence[Clip], wanted: bool, *, again: bool = False) -> None:
        """Queue clips, or stop them. Those that lack their box are left out; UsageError if no other is given."""
        with self.lock:
            able = [clip for clip in clips if not wanted or clip.what != "box" or self.start_of(clip).is_file()]
            if clips and not able:
                raise UsageError(f"{clips[0].name}: draw the box first")
            for clip in able:
                clip.wanted, clip.again = wanted, wanted and again
                clip.error = None if wanted else clip.error
                if not wanted and clip is self.running:
                    self._terminate()
            self.paused = self.paused and not wanted
            self.save()
            self._work.notify_all()

    def pause(self, paused: bool) -> None:
        """Let the queue wait; what runs is ended, and goes on later from where it was."""
        with self.lock:
            self.paused = paused
            if paused:
                self._terminate()
            self._work.notify_all()

    def status(self, clip: Clip) -> ClipStatus:
        """How far the run of a clip is, by its folder."""
        folder = self.run_of(clip)
        with reading(folder):
            return clip_status(folder, folder.name, clip.name)

    def command(self, clip: Clip) -> list[str]:
        """What tracks a clip: the arguments of facetrack."""
        start = self.start_of(clip)
        how = ["--faces", "all"] if clip.what == "everybody" else ["--config", RECIPES[clip.what]]
        how += ["--init", str(start)] if start.is_file() else []
        return ["run", str(self.place(clip)), *how, "--out", str(self.run_of(clip))]

    def _terminate(self) -> None:
        if self._child is not None:
            self._child.terminate()

    def _go(self) -> None:
        """Run what is wanted, one after another, until it is closed."""
        with self.lock:
            while not self._closed:
                waiting = [] if self.paused else [clip for clip in self.clips.values() if clip.wanted]
                for clip in waiting:
                    try:
                        if clip.again or (state := self.status(clip).state) not in ("done", "running"):
                            self._run(clip)
                            break
                        clip.wanted = state != "done"  # by a process that was left by a kill
                    except (FacetrackError, OSError) as e:  # as of a full disk
                        clip.error, clip.wanted = flat(str(e)), False
                else:
                    self._work.wait(1.0 if waiting else None)

    def _run(self, clip: Clip) -> None:
        """Run one clip; the lock is given back meanwhile."""
        again, clip.again = clip.again, False  # what it has tracked stays if it is stopped
        command = [sys.executable, "-m", "facetrack_cli", *self.command(clip)] + ["--overwrite"] * again
        self.save()
        self._child = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
            encoding="utf-8", errors="replace", env={**os.environ, LOG_FORMAT: "json"},
        )  # fmt: skip
        self.running, self.progress = clip, {}
        self._work.release()
        try:
            with self._child:
                message = self._listen(self._child.stderr)
        finally:
            self._work.acquire()
        code, self.running, self._child = self._child.returncode, None, None
        self.paused = self.paused or (clip.wanted and code in STOPPED)  # as by Ctrl-C in the terminal
        stopped = self._closed or self.paused or not clip.wanted
        clip.error = None if stopped or code in (ExitCode.DONE, ExitCode.LOST) else message or f"exit code {code}"
        clip.wanted = clip.wanted and stopped
        self.save()
        self._work.notify_all()

    def _listen(self, lines: IO[str] | None) -> str:
        """Follow what a run says, each line an object of JSON; the last error, or the last line."""
        message = error = ""
        for line in lines or ():
            try:
                record = dict(json.loads(line))
            except (TypeError, ValueError):
                message = line.strip() or message
                continue
            text = str(record.get("message", ""))
            if text.startswith("progress"):
                with self.lock:  # "" while it tracks
                    self.progress = {**record, "doing": text.removeprefix("progress").strip(", ")}
            else:
                message, error = text, text if record.get("level") == "error" else error
        return error or message


def free(stem: str, taken: Iterable[str], suffix: str = "") -> str:
    """The name, or the first one with a number, that is not taken, in whatever letters."""
    used = {name.casefold() for name in taken}
    names = (f"{stem}-{k}{suffix}" if k > 1 else f"{stem}{suffix}" for k in count(1))
    return next(name for name in names if name.casefold() not in used)
