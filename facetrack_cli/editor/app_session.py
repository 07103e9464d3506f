"""The page of `facetrack app`: clips are added, tracked, looked at, corrected and exported.

A project is a folder. Each run is the ordinary `facetrack run` in a folder of its own, one child process at a time, so
the folders say how far everything is, also after a kill. project.json holds what folders do not say: the list, what is
chosen, and what is still to be run.
"""

import json
import os
import re
import subprocess
import sys
import threading
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, nullcontext, suppress
from itertools import count
from pathlib import Path
from typing import IO, Annotated, Any, ClassVar, Final, Literal, TypeAlias

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from facetrack_cli.core.errors import LOG_FORMAT, BusyError, ExitCode, FacetrackError, InputError, UsageError, flat
from facetrack_cli.core.files import TABLES, absolute, make_folder, read_bounded, write_new, writing
from facetrack_cli.core.types import Array, checked_name
from facetrack_cli.editor.fix_session import CastSession, FixSession
from facetrack_cli.editor.fixer import open_track
from facetrack_cli.editor.session import NOTHING, Answer, Json, Page, PickSession, Proposer, jpeg
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.run_folder import manifest
from facetrack_cli.run_folder.lease import FolderLease
from facetrack_cli.run_folder.manifest import VIDEO, read_run
from facetrack_cli.run_folder.status import ClipStatus, clip_status
from facetrack_cli.runs.batch import expand
from facetrack_cli.runs.export import content, encoded, named
from facetrack_cli.runs.finished import open_run, stamp
from facetrack_cli.start.init_file import read_init
from facetrack_cli.trajectory.formats import EXPORTS
from facetrack_cli.trajectory.trajectory import Trajectory
from facetrack_cli.video.source import Frames

NAME: Final = "project.json"
MAX_CLIPS: Final = 2000
LOOKS: Final = 5  # frames of a clip in which faces are sought, in its first seconds
LOOKS_WITHIN: Final = 250  # frames
THUMB_PIXELS: Final = 240  # about, along the longer side
BINS: Final = 400  # of a curve
RECIPES: Final = {"face": "face", "everybody": "face", "signer": "signer", "box": "correlation_filter"}
STOPPED: Final = (ExitCode.INTERRUPTED, ExitCode.TERMINATED)
PROGRAMS: Final = {
    "csv-wide": "Excel: a row for each frame",
    "measures": "Excel: measures of faces and hands",
    "events": "Excel: events",
    "eaf": "ELAN",
    "cvat": "CVAT",
    "labelstudio": "Label Studio",
    "boris": "BORIS",
    "srt": "Subtitles",
    "dlc": "DeepLabCut",
    "openface": "OpenFace",
    "coco": "COCO",
}
"""What a file is for, by its format."""
OF_MANY: Final = tuple(form for form in PROGRAMS if "clips" in EXPORTS[form].takes)  # files of many clips
BOM: Final = b"\xef\xbb\xbf"  # by which Excel knows that a CSV is UTF-8
What: TypeAlias = Literal["face", "everybody", "signer", "box"]
Ids = Annotated[list[int], Field(max_length=MAX_CLIPS)]


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


class AppSession(Page):
    """The page of the project in a folder. Pages that correct a run, or choose a start, are opened below it.

    `lock` is held while a clip is changed. What was to be run when it was closed, or killed, is `paused`.
    """

    index: ClassVar[str] = "home.html"

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder = absolute(folder)
        make_folder(self.folder, "name another folder")
        with ExitStack() as held:
            try:
                held.enter_context(FolderLease(self.folder))
                path = self.folder / NAME
                listed = Listed.model_validate_json(read_bounded(path) if path.exists() else b"{}")
            except BusyError:
                raise UsageError(f"{self.folder}: is open already; go to its page, or name another folder") from None
            except ValidationError as e:
                raise InputError(f"{path}: is not as facetrack app writes it; move it away, and add the clips") from e
            self.resources = held.pop_all()
        self.clips = {clip.id: clip for clip in listed.clips}
        self.paused = any(clip.wanted for clip in listed.clips)
        self.running: Clip | None = None
        self._progress: dict[str, Any] = {}  # of what runs, as its lines say
        self._child: subprocess.Popen[str] | None = None
        self._last_look: tuple[object, Json] = None, {}  # of `get_look`, and what it was made of
        self._looks = ThreadPoolExecutor(1, "looks")  # at clips, as they come
        self._look_at([clip for clip in listed.clips if not clip.frames])
        self._work = threading.Condition(self.lock)
        self._worker = threading.Thread(target=self._go, name="runs", daemon=True)
        self._worker.start()

    def close(self) -> None:
        """End what runs, which keeps what it has tracked, and wait for it."""
        with self.lock:
            self.stopping.set()
            self._terminate()
            self._work.notify_all()
        self._looks.shutdown(cancel_futures=True)
        for page in [*self.opened.values()]:
            page.close()  # what was corrected and not saved is kept beside the run
        super().close()

    def get_state(self) -> Json:
        self._shut_of()
        with self.lock:
            return {
                "folder": str(self.folder),
                "clips": [self._shown(clip) for clip in self.clips.values()],
                "paused": self.paused,
                "programs": {form: {"name": name, "many": form in OF_MANY} for form, name in PROGRAMS.items()},
                "ended": self.ended,
            }

    def _shown(self, clip: Clip) -> Json:
        """A clip as the page shows it."""
        rate = None
        try:
            status = self._status(clip)
        except FacetrackError as e:
            status = ClipStatus(clip.name, clip.name, "failed", error=str(e))
        state, done, error = str(status.state), status.frames, clip.error or status.error
        start = self.start_of(clip).is_file()
        if clip is self.running:
            state, done = "running", 0
            if self._progress.get("doing") == "":  # else it does something before or after
                done, rate = int(self._progress.get("done") or 0), self._progress.get("frames_per_s")
        elif clip.wanted and state != "running":
            state = "paused" if self.paused else "queued"
        elif error:
            state = "failed"
        elif state == "not begun":
            state = "needs box" if clip.what == "box" and not start else "ready"
        movie = stamp(self.run_of(clip) / VIDEO)  # changes when it is drawn again
        return {
            **clip.model_dump(include={"id", "what", "likely", "size", "seconds", "frames"}),
            "name": self.place(clip).name, "path": str(self.place(clip)), "start": start, "look": status.look,
            "movie": movie and str(movie), "doing": self._progress.get("doing", "starting"), "rate": rate,
            "state": state, "done": done, "error": error,
        }  # fmt: skip

    def post_quit(self) -> Json:
        return self.end([], None)

    # where things are

    def find(self, clip: int) -> Clip:
        """InputError for a clip that is not there any more."""
        if (known := self.clips.get(clip)) is None:
            raise InputError("this clip is not in the list any more")
        return known

    def place(self, clip: Clip) -> Path:
        return self.folder / clip.path

    def run_of(self, clip: Clip) -> Path:
        """The folder of a run: each choice of what is tracked has its own, so that none replaces another."""
        return self.folder / "runs" / f"{clip.name}-{clip.what}"

    def start_of(self, clip: Clip) -> Path:
        """The init file of what is chosen on the page of a start."""
        return self.folder / "starts" / f"{clip.name}-{clip.what}.init.yaml"

    def _thumb(self, clip: int) -> Path:
        return self.folder / "thumbs" / f"{clip}.jpg"

    def _save(self) -> None:
        with self.lock:
            data = Listed(clips=list(self.clips.values())).model_dump_json(indent=1).encode() + b"\n"
            write_new(self.folder / NAME, data, overwrite=True)

    # adding, and removing

    def put_upload(self, data: bytes, name: str, offset: int, total: int) -> Json:
        """A piece of a file that is dropped; the last one adds it."""
        try:
            name = re.sub(r'[<>:"|?*]', "_", checked_name(name.strip(" ."), "file"))
        except ValueError as e:
            raise UsageError(str(e)) from None
        folder = self.folder / "clips"
        make_folder(folder, "name another folder")
        part = folder / f".{name}.part"
        with writing(part, "free some space"), part.open("r+b" if offset and part.exists() else "wb") as file:
            if file.seek(0, 2) < offset:
                raise UsageError(f"{name}: a piece is missing; drop the file again")
            file.seek(offset)
            file.write(data)
            file.truncate()
            if file.tell() < total:
                return {"offset": file.tell()}
        with self.lock, writing(part, "choose another folder"):
            name = free(Path(name).stem, (file.name for file in folder.iterdir()), Path(name).suffix)
            part.rename(path := folder / name)
        return self._add([path])

    def post_add(self, path: str) -> Json:
        """The clips that a path names: a file, or a folder of clips or images."""
        place = Path(path.strip().strip("\"'")).expanduser()
        if not place.is_absolute():
            raise UsageError(f"{place}: give the whole path, as {Path.home() / 'clips'}")
        if not place.exists():
            raise UsageError(f"{place}: there is nothing of this name")
        return self._add(expand([place])[0])

    def _add(self, paths: Sequence[Path]) -> Json:
        """Add clips that are not in the list yet. Raises UsageError for too many."""
        added = []
        with self.lock:
            there = {self.place(clip) for clip in self.clips.values()}
            new = [path for path in map(absolute, paths) if path not in there]
            if (total := len(self.clips) + len(new)) > MAX_CLIPS:
                raise UsageError(f"{total} clips are too many for a list; at most {MAX_CLIPS}")
            # also of clips that were removed
            made = (path.name for kind in ("runs", "starts") for path in self.folder.glob(f"{kind}/*"))
            taken = {*(clip.name for clip in self.clips.values()), *(name.rpartition("-")[0] for name in made)}
            for path in new:
                stem = re.sub(r"[^\w .()-]", "_", path.stem)[:80].strip(" .") or "clip"
                taken.add(name := free(stem, taken))
                kept = path.relative_to(self.folder).as_posix() if path.is_relative_to(self.folder) else str(path)
                added.append(Clip(id=max(self.clips, default=0) + 1, path=kept, name=name))
                self.clips[added[-1].id] = added[-1]
            self._save()
        self._look_at(added)
        return {"added": [clip.id for clip in added]}

    def _look_at(self, clips: Iterable[Clip]) -> None:
        """Look at clips in a thread: a picture, how long they are, and what is likely to be tracked."""

        def look(clip: Clip) -> None:
            try:
                with Frames(self.place(clip)) as frames:
                    thumb = self._thumb(clip.id)
                    make_folder(thumb.parent)
                    write_new(thumb, jpeg(frames, 0, max(round(max(frames.size) / THUMB_PIXELS), 1)), overwrite=True)
                    likely, size, total = likely_in(frames), frames.size, frames.count
                with self.lock:
                    clip.size, clip.frames, clip.likely, clip.what = size, max(total, 1), likely, likely
                    clip.seconds = round(total / float(frames.fps), 2)
                    self._save()
            except FacetrackError as e:
                clip.error = flat(str(e))
            except Exception as e:
                clip.error = self.record(e)

        for clip in clips:
            self._looks.submit(look, clip)

    def post_remove(self, clip: int) -> Json:
        """Take a clip from the list; what was made of it stays in its folders."""
        self._shut_of(clip)
        with self.lock:
            gone = self.find(clip)
            self._want([gone], False)
            while self.running is gone:
                self._work.wait()
            self.clips.pop(clip, None)
            self._save()
        return self.get_state()

    # running

    def post_choose(self, clips: Ids, what: What) -> Json:
        with self.lock:
            for clip in map(self._idle, clips):
                clip.what, clip.error = what, None
            self._save()
        return self.get_state()

    def _idle(self, clip: int) -> Clip:
        """UsageError for a clip that is being tracked."""
        if (chosen := self.find(clip)).wanted:
            raise UsageError(f"{chosen.name} is being tracked; stop it first")
        return chosen

    def post_want(self, clips: Ids, wanted: bool, again: bool = False) -> Json:
        """Have clips tracked, `again` from the start, or stop them."""
        for clip in clips if wanted else ():
            self._shut_of(clip)
        self._want([*map(self.find, clips)], wanted, again)
        return self.get_state()

    def _want(self, clips: Sequence[Clip], wanted: bool, again: bool = False) -> None:
        """Those that lack their box are left out; UsageError if there is no other."""
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
            self._save()
            self._work.notify_all()

    def post_pause(self, paused: bool) -> Json:
        """Let the queue wait; what runs is ended, and goes on later from where it was."""
        with self.lock:
            self.paused = paused
            if paused:
                self._terminate()
            self._work.notify_all()
        return self.get_state()

    def _status(self, clip: Clip) -> ClipStatus:
        """How far the run of a clip is, by its folder."""
        folder = self.run_of(clip)
        return clip_status(folder, folder.name, clip.name)

    def _terminate(self) -> None:
        if self._child is not None:
            self._child.terminate()

    def _go(self) -> None:
        """Run what is wanted, one after another, until it is closed."""
        with self.lock:
            while not self.stopping.is_set():
                waiting = [] if self.paused else [clip for clip in self.clips.values() if clip.wanted]
                for clip in waiting:
                    try:
                        if clip.again or (state := self._status(clip).state) not in ("done", "running"):
                            self._track(clip)
                            break
                        clip.wanted = state != "done"  # by a process that was left by a kill
                    except (FacetrackError, OSError) as e:  # as of a full disk
                        clip.error, clip.wanted = flat(str(e)), False
                else:
                    self._work.wait(1.0 if waiting else None)

    def _track(self, clip: Clip) -> None:
        """Run one clip; the lock is given back meanwhile."""
        again, clip.again = clip.again, False  # what it has tracked stays if it is stopped
        how = ["--faces", "all"] if clip.what == "everybody" else ["--config", RECIPES[clip.what]]
        how += ["--init", str(start)] if (start := self.start_of(clip)).is_file() else []
        how += ["--out", str(self.run_of(clip)), *["--overwrite"] * again]
        self._save()
        self._child = subprocess.Popen(
            [sys.executable, "-m", "facetrack_cli", "run", str(self.place(clip)), *how],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
            encoding="utf-8", errors="replace", env={**os.environ, LOG_FORMAT: "json"},
        )  # fmt: skip
        self.running, self._progress = clip, {}
        self._work.release()
        try:
            with self._child:
                message = self._listen(self._child.stderr)
        finally:
            self._work.acquire()
        code, self.running, self._child = self._child.returncode, None, None
        self.paused = self.paused or (clip.wanted and code in STOPPED)  # as by Ctrl-C in the terminal
        stopped = self.stopping.is_set() or self.paused or not clip.wanted
        clip.error = None if stopped or code in (ExitCode.DONE, ExitCode.LOST) else message or f"exit code {code}"
        clip.wanted = clip.wanted and stopped
        self._save()
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
                    self._progress = {**record, "doing": text.removeprefix("progress").strip(", ")}
            else:
                message, error = text, text if record.get("level") == "error" else error
        return error or message

    # looking

    def get_thumb(self, clip: int) -> Answer:
        return Answer(self._thumb(clip), kind="image/jpeg")

    def get_video(self, clip: int, v: str = "") -> Answer:
        return Answer(self.run_of(self.find(clip)) / VIDEO, kind="video/mp4")

    def get_look(self, clip: int) -> Json:
        folder = self.run_of(self.find(clip))
        key = folder, *(stamp(folder / name) for name in (manifest.NAME, *TABLES))
        if self._last_look[0] != key:
            self._last_look = key, looked(read_run(folder))
        return self._last_look[1]

    # correcting

    def post_open(
        self, clip: int, page: Literal["fix", "people", "start"], person: str | None = None, frame: int = 0
    ) -> Json:
        """Open the page that corrects a run, or a `person` of a film, or who is who in it, or that chooses a start."""
        name = f"{page}-{clip}" + ("" if person is None else f"-{frame}")
        with self.lock:
            self._shut_of()
            chosen = self._idle(clip)
            if name not in self.opened:
                self.opened[name] = self._page(chosen, page, person, frame)
        return {"url": f"{name}/"}

    def _page(self, clip: Clip, page: str, person: str | None, frame: int) -> Page:
        folder, out = self.run_of(clip), self.start_of(clip)
        if page == "people":
            return CastSession(folder)
        if page == "fix":
            return FixSession(open_run(folder) if person is None else open_track(folder, person, frame))
        make_folder(out.parent)
        previous, recipe = read_init(out) if out.is_file() else NOTHING, load_recipe(RECIPES[clip.what])
        return PickSession(self.place(clip), recipe, out=out, overwrite=True, previous=previous)

    def _shut_of(self, clip: int | None = None) -> None:
        """Close the pages of a clip, or those that have ended."""
        for name, page in [*self.opened.items()]:
            if (name.split("-")[1] == str(clip) or page.over()) and self.opened.pop(name, None) is not None:
                page.close()

    # exporting

    def get_export(self, program: str, clip: int | None = None) -> Answer:
        """A file for a program, of one clip or of all; it stays in exports/."""
        known = OF_MANY if clip is None else (*PROGRAMS,)
        if program not in known:
            raise UsageError(f"{program}: choose among {', '.join(known)}")
        chosen = [*self.clips.values()] if clip is None else [self.find(clip)]
        name = self.folder.name if clip is None else chosen[0].name
        path = self.folder / "exports" / f"{name}.{EXPORTS[program].ending}"
        make_folder(path.parent, "free some space")
        clips = []
        for each in chosen:
            with suppress(InputError) if clip is None else nullcontext():  # of many, those that can be read
                clips.append(named(read_run(self.run_of(each)), drop_lost=False))
        if not clips:
            raise InputError("no run can be read yet")
        data = encoded(content(clips, program, path, box="points", many=clip is None))
        write_new(path, BOM * PROGRAMS[program].startswith("Excel") + data, overwrite=True)
        saved_as = re.sub(r'[^ -~]|["\\]', "_", path.name)
        headers = {"Content-Disposition": f'attachment; filename="{saved_as}"'}
        return Answer(path, kind="application/octet-stream", headers=headers)


def likely_in(frames: Frames) -> What:
    """What is likely to be tracked, by the faces and hands that a detector sees in some frames."""
    faces = hands = several = 0
    proposer = Proposer(frames, recipe := load_recipe("head_hands"), recipe.points)
    last = min(max(frames.count - 1, 0), LOOKS_WITHIN)
    for at in sorted({last * k // (LOOKS - 1) for k in range(LOOKS)}):
        with suppress(InputError):
            starts, _ = proposer(at)
            faces, several = faces + bool(starts), several + (len(starts) > 1)
            hands += len(starts) == 1 and len(starts[0].targets) > 1
    return "box" if not faces else "everybody" if several else "signer" if 2 * hands > LOOKS else "face"


def looked(rows: Trajectory) -> Json:
    """Curves of a run, by target, as means of equal spans of time, and its events; times in s."""
    begins = np.linspace(float(rows.times[0]), float(rows.times[-1]), max(min(BINS, len(rows.times)), 1))
    targets = []
    for name in rows.targets:
        parts, measures = rows.of_target(name), rows.measures[name].values()
        least = np.fmin.reduce([part.confidence for part in parts if len(part) == len(parts[0])])
        curves = [_curve(measure.name, measure.unit, measure.value, measure.time_s, begins) for measure in measures]
        sure = _curve("confidence", "", least, parts[0].time_s, begins)
        targets.append({"name": name, "curves": [sure, *curves]})
    keys = ("target", "tier", "value", "begin_s", "end_s")
    events = [{key: getattr(event, key) for key in keys} for event in rows.events]
    return {"begin": begins[0], "end": begins[-1], "targets": targets, "events": events}


def _curve(name: str, unit: str, values: Array, at: Array, begins: Array) -> Json:
    """The mean of the values from each time to the next, None where there are none."""
    finite = np.isfinite(values)
    bins = np.clip(np.searchsorted(begins, at[finite] + 1e-6, "right") - 1, 0, None)
    count, sums = (np.bincount(bins, weights, len(begins)) for weights in (None, values[finite]))
    means = [round(s / n, 4) if n else None for s, n in zip(sums.tolist(), count.tolist(), strict=True)]
    return {"name": name, "unit": unit, "values": means}


def free(stem: str, taken: Iterable[str], suffix: str = "") -> str:
    """The name, or the first one with a number, that is not taken, in whatever letters."""
    used = {name.casefold() for name in taken}
    names = (f"{stem}-{k}{suffix}" if k > 1 else f"{stem}{suffix}" for k in count(1))
    return next(name for name in names if name.casefold() not in used)
