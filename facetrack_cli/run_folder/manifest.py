"""`run.json`: of which clip a run's folder is, how it was made, how it ended, and the checksum of each of its files.

It is replaced last, together with those files: it alone says what is complete, and files of different runs are noticed
whenever they are read. What a killed run leaves, files half replaced and tables without an end, is ended when read.

Whether a job and a clip are the same again is told by checksums: of the clip, of the recipe with its files, and of all
that the job asks for.
"""

import contextlib
import hashlib
import json
import os
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, groupby, takewhile
from pathlib import Path
from typing import Any, ClassVar, Final, Literal

from pydantic import ConfigDict, TypeAdapter, ValidationError

from facetrack_cli.core import __version__
from facetrack_cli.core.errors import BusyError, FacetrackError, InputError, OutputError, from_system, reading
from facetrack_cli.core.files import (
    FULL,
    MAX_TABLE_BYTES,
    TABLES,
    BytesSink,
    check_plain,
    digest,
    discard,
    read_bounded,
    temporary_path,
)
from facetrack_cli.core.numbers import dumps
from facetrack_cli.core.yaml_tree import YamlProblems
from facetrack_cli.recipe.load import files_of
from facetrack_cli.recipe.model import Recipe, to_dict
from facetrack_cli.run_folder import lease
from facetrack_cli.trajectory import reader
from facetrack_cli.trajectory.trajectory import Trajectory
from facetrack_cli.trajectory.writers import FOOTER, FORMATS, WRITERS, Format, RunSummary, summary_of, tail
from facetrack_cli.video.images import listing

NAME: Final = "run.json"
VIDEO: Final = "annotated.mp4"
POSTERIOR: Final = "posterior.npz"
FILTERED: Final = "trajectory.filtered.csv"
OWNED: Final = (VIDEO, POSTERIOR, FILTERED, reader.PEOPLE, *TABLES, NAME)  # the files that a run writes, or replaces
REPORT: Final = "report.html"
PLOT: Final = "plot.png"
KILLED: Final = "killed"


@dataclass(frozen=True)
class File:
    """A file's size in bytes and SHA-256."""

    bytes: int
    sha256: str


@dataclass(frozen=True)
class Clip(File):
    """The clip of a run, its size that of all its images; `changed_ns` is when it was last changed.

    `sha256` is "" if the run ended before all of it was read.
    """

    path: str
    changed_ns: int


@dataclass
class Manifest(RunSummary):
    """The contents of run.json. `asked`: a digest of all that was asked for.

    `networks` are those that placed points. `doubts` is what speaks against the track, `look` the first and last frames
    to look at, the longest span first. `began` and `ended` are UTC; `seconds` is the time between them, in which all
    but `resumed` frames were tracked. In a batch a clip that failed has its `error`.
    """

    # another version may say more
    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="ignore", defer_build=True)
    format: Literal["facetrack-run"] = "facetrack-run"
    version: Literal[1] = 1
    facetrack: str = __version__
    asked: str = ""
    networks: tuple[str, ...] = ()
    doubts: str = ""
    look: tuple[tuple[int, int], ...] = ()
    resumed: int = 0
    clip: Clip | None = None
    smoothed: bool = False
    host: str = ""
    began: str = ""
    ended: str = ""
    seconds: float | None = None
    error: str | None = None
    exit_code: int | None = None
    files: dict[str, File] = field(default_factory=dict)

    @property
    def network(self) -> str:
        """Which networks placed points; "" without one."""
        return f"with the network {' and '.join(map(os.path.basename, self.networks))}" if self.networks else ""

    def record(self) -> dict[str, Any]:
        """The contents as JSON has them. What the tables say of the ending and the clip is not repeated."""
        return dict(_ADAPTER.dump_python(self, mode="json", exclude={"variable_fps", "evidence", "source_sha256"}))

    @property
    def is_failure(self) -> bool:
        """Whether the folder holds nothing but the line that its clip failed."""
        return self.error is not None and not self.files


_ADAPTER: Final = TypeAdapter(Manifest)


def read_manifest(folder: Path) -> Manifest | None:
    """The run.json of a folder; None if there is none. InputError for a file that is not as we write it."""
    path = folder / NAME
    try:
        with reading(path), contextlib.suppress(FileNotFoundError, NotADirectoryError):
            return _ADAPTER.validate_json(read_bounded(path))
    except ValidationError as e:
        raise InputError(f"{path}: is not as facetrack run writes it; remove it, or make the run again") from e
    return None


def check_belongs(path: Path) -> None:
    """InputError if a file of a run, as trajectory.csv, is not the one that run.json beside it says."""
    run = read_manifest(path.parent) if path.name in OWNED else None
    if run is None:
        return
    if path.name not in run.files or run.files[path.name].sha256 != digest([path]):
        what = f"is not as its run wrote it, as {NAME} beside it says: it was edited, or is of another run"
        raise InputError(f"{path}: {what}; copy it elsewhere to read it as it is")


def outdated(folder: Path, init: Path | None) -> Iterator[str]:
    """A line on the files that report, plot and export made of the track that is replaced now, and on corrections that
    are not those of its `init` file.
    """
    there = sorted(path.name for path in folder.iterdir() if path.name not in OWNED)
    if made := [name for name in there if name in (REPORT, PLOT) or name.startswith("trajectory.")]:
        yield f"{folder}: older than the track: {', '.join(made)}; make them anew with --overwrite"
    for path in (folder / reader.CORRECTED, folder / reader.UNSAVED):
        if path.is_file() and (init is None or os.path.realpath(path) != os.path.realpath(init)):
            yield f"{path}: holds corrections that this track does not have; take them with --init {path}"


def commit(
    lock: lease.FolderLease, folder: Path, files: Sequence[Path], run: Manifest | None, gone: Sequence[Path] = ()
) -> None:
    """Let the temporary files of these paths replace them, and then run.json: `run`, and their checksums.

    Of the files that a run writes, those that `run` does not keep are removed. Without `run` (that of an older
    version) there is no run.json, and only `gone` is removed. On a full disk the files are kept without a run.json.
    Raises OSError; OutputError if the lock was taken over, and nothing is replaced then.
    """
    files, gone, path = list(files), list(gone), folder / NAME
    check_plain(path, *files)
    try:
        if run is not None:
            parts = {path.name: temporary_path(path) for path in files if path.name in OWNED}
            new = {name: File(part.stat().st_size, digest([part])) for name, part in parts.items()}
            run = replace(run, files={**run.files, **new})
            gone += [folder / name for name in OWNED if name not in run.files and folder / name not in files]
            try:
                text = json.dumps(run.record(), indent=1, ensure_ascii=False) + "\n"
                temporary_path(path).write_bytes(text.encode(errors="backslashreplace"))
                files.append(path)
                gone.remove(path)
            except OSError as e:
                if e.errno not in FULL:
                    raise
        lock.prepare(files, gone)
    except BaseException:
        discard(path)
        raise
    lock.commit()


def as_line(error: Exception) -> FacetrackError:
    """The error as its line alone: an exception need not survive the way between processes."""
    if os.environ.get("FACETRACK_DEBUG", "") not in ("", "0"):
        traceback.print_exception(error)
    if isinstance(error, FacetrackError):
        kinds = (BusyError, OutputError, InputError)
        return next((kind for kind in kinds if isinstance(error, kind)), FacetrackError)(str(error))
    if (of_system := from_system(error)) is not None:
        return of_system
    return FacetrackError(f"internal error, please report it: {type(error).__name__}: {error}")


def failed(run: Manifest, error: Exception) -> Manifest:
    """The run with the error that ended it."""
    line = as_line(error)
    return replace(run, complete=False, error=as_text(str(line)), exit_code=int(line.exit_code), ended=lease.utc_now())


def note_failure(lock: lease.FolderLease, folder: Path, run: Manifest, clip: Path, error: Exception) -> None:
    """Write into run.json that a clip failed, with what is known of its `run`; what was tracked of it stays.

    Nothing is written where the error is one of writing, and over results that are whole or of something else.
    """
    if isinstance(error, OutputError):
        return
    with contextlib.suppress(FacetrackError, OSError):  # the error itself is worth more
        same, present = previous_run(folder, run.asked, clip)
        if same is not None and same.files:
            if same.stopped is None:
                return
            run = same
        elif same is None and not (present and present.is_failure) and any((folder / name).exists() for name in OWNED):
            return
        else:
            run = replace(run, clip=clip_stat(clip))
        commit(lock, folder, [], failed(run, error))


def as_text(name: str) -> str:
    """A name as JSON holds it: bytes that are no text are escaped."""
    return name.encode(errors="backslashreplace").decode()


def read_run(path: Path | str) -> Trajectory:
    """A trajectory as `read_trajectory` reads it; if it is in the folder of a run, what a kill left there is recovered
    first. InputError also for a file of another run than run.json beside it.
    """
    check_run(Path(path))
    return reader.read_trajectory(path)


def check_run(path: Path) -> None:
    """Recover the folder of a run, or of one of its files. InputError for a file of another run than run.json there,
    and for a folder whose first run is not at its end.
    """
    with reading(path, "name a trajectory or ground-truth file"):
        recover_interrupted(path if path.is_dir() else path.parent)
        ended = (path / NAME).is_file() or any(path.glob("trajectory.*"))
        if path.is_dir() and not ended and lease.holder(path) is not None:
            how_far = "facetrack status tells how far it is"
            raise InputError(f"{path}: a run is being written here; wait until it ends ({how_far})")
        check_belongs(reader.table_in(path))


def trajectory_of(run: Path) -> Path:
    """The trajectory of a run's folder that has a header. InputError if there is none."""
    check_run(run)
    if not run.is_dir() or (path := reader.table_in(run)).suffix not in (".json", ".jsonl"):
        again = "name the folder of a run, which facetrack run wrote with --format csv,json"
        lacks = "has no trajectory.json, with recipe and clip" if run.is_dir() else "is no folder"
        raise InputError(f"{run}: {lacks}; {again}")
    return path


def recover_interrupted(folder: Path, stopped: Callable[[], bool] = lambda: False) -> None:
    """End what a killed process left in a folder, if nobody writes there.

    Files half replaced are replaced; tables that were being written become the tables of a run that was stopped.
    """
    if lease.is_held(folder):
        lease.finish_replacing(folder, lease.left_in(folder))
        if lease.holder(folder) is None:  # else it is at work
            with contextlib.suppress(OutputError, OSError), lease.FolderLease(folder, stopped) as lock:
                recover(folder, lock)


def recover(folder: Path, lock: lease.FolderLease) -> None:
    """As `recover_interrupted`, of a folder that is locked."""
    note = lock.stale_note
    lease.finish_replacing(folder, note)
    with contextlib.suppress(ValueError, InputError):  # a note need not be ours
        run, mark = _ADAPTER.validate_python(note.get("run")), lease.mark_of(note)
        if mark is not None:
            _end_tables(folder, lock, mark, run)
    lock.note({"before": None})
    lease.sweep(folder)


def _end_tables(folder: Path, lock: lease.FolderLease, mark: str, run: Manifest) -> None:
    """Write the whole frames of a killed process's tables again, and run.json."""
    check_plain(*(folder / name for name in TABLES))
    parts = {form: temporary_path(folder / f"trajectory.{form}", mark) for form in FORMATS}
    forms = [form for form, part in parts.items() if part.is_file()]
    if not forms:
        return
    first = forms[-1]  # JSON also has the header, and its lines are the last of the three to be written
    text, frames = _whole_frames(first, read_bounded(parts[first], MAX_TABLE_BYTES))
    before = read_manifest(folder)
    if not frames or (before is not None and before.asked == run.asked and before.frames >= frames):
        return
    torn = temporary_path(folder / f"torn.{first}")
    try:
        torn.write_bytes(text)
        rows = reader.read_table(torn)
        ending = summary_of(rows, complete=False, stopped=KILLED)
        rows = replace(rows, header={**rows.header, **{name: getattr(ending, name) for name in FOOTER}})
        files = [folder / f"trajectory.{form}" for form in forms]
        for form, path in zip(forms, files, strict=True):
            with temporary_path(path).open("wb") as file:
                write_rows(form, file.write, rows)
        members = ("frames", "complete", "stopped", "lost_frames", "lost_at_end")
        commit(lock, folder, files, replace(run, **{name: getattr(ending, name) for name in members}, files={}))
    finally:
        torn.unlink(missing_ok=True)


def write_rows(form: Format, write: Callable[[bytes], object], rows: Trajectory) -> None:
    """Write these rows as a run does, by calls of `write`."""
    head = {key: value for key, value in rows.header.items() if key not in (*FOOTER, "frames_tracked", "type")}
    foot = {key: value for key, value in rows.header.items() if key in FOOTER}
    writer = WRITERS[form](BytesSink(write), head)
    writer.write(rows)
    writer.close(RunSummary(**{**foot, "warnings": tuple(foot.get("warnings", ()))}))


def _whole_frames(form: Format, text: bytes) -> tuple[bytes, int]:
    """A table up to its last whole frame, ended, and the number of its frames. A frame may be torn anywhere.

    Raises ValueError for a header that is torn.
    """
    lines = text.split(b"\n")
    first = lines.index(b'"frames": [') + 1 if form == "json" else 1
    begins = {"csv": b"", "json": b'{"frame":', "jsonl": b'{"type":"frame"'}[form]  # what follows may be the end
    head, body = lines[:first], [*takewhile(lambda line: line.startswith(begins), lines[first:-1])]
    if form == "csv":
        groups = [list(rows) for _, rows in groupby(body, lambda line: line.partition(b",")[0])][:-1]
        return b"\n".join([*head, *chain.from_iterable(groups), b""]), len(groups)
    end = tail(form, RunSummary(), len(body)).encode()
    if form == "json":  # the comma of the last frame goes
        return b"\n".join([*head, *body]).removesuffix(b",") + end, len(body)
    return b"\n".join([*head, *body, end]), len(body)


def previous_run(folder: Path, asked: str, clip: Path) -> tuple[Manifest | None, Manifest | None]:
    """The run.json of a folder if it is of the same job (`asked`) and clip, and its files are whole; and the one there.

    Raises InputError for a run.json that is not as we write it.
    """
    present = read_manifest(folder) if reader.is_there(folder) else None
    if present is None or present.clip is None or present.asked != asked:
        return None, present
    whole = all(_is_as_written(folder, name, present) for name in present.files)
    return present if whole and _is_same(present.clip, clip) else None, present


def other_clip(rows: Trajectory, clip: Path) -> str | None:
    """A line if a clip that is there is not, byte for byte, the clip that the rows of a run are of."""
    digest_then, run = rows.header.get("source_sha256"), read_manifest(rows.path.parent)
    if not isinstance(digest_then, str) or not digest_then or not reader.is_there(clip):
        return None
    of_run = run.clip if run is not None and run.clip is not None and run.clip.sha256 == digest_then else None
    if clip_digest(clip) == digest_then if of_run is None else _is_same(of_run, clip):
        return None
    return f"{clip}: is not the clip that {rows.path.name} was made from (its SHA-256 differs)"


def recipe_digest(recipe: Recipe) -> str:
    """A digest of a recipe and of the files that it names."""
    files: list[Path] = []
    with contextlib.suppress(YamlProblems):  # the run says so
        files = files_of(recipe)
    return hashlib.sha256(dumps([to_dict(recipe), *map(clip_digest, files)]).encode()).hexdigest()


def clip_stat(clip: Path) -> Clip | None:
    """A clip without its checksum; None if it is gone."""
    try:
        images = listing(clip)
        stats = [file.stat() for file in ([clip] if images is None else images)]
    except OSError:
        return None
    changed = max((file.st_mtime_ns for file in stats), default=0)
    return Clip(sum(file.st_size for file in stats), "", as_text(str(clip)), changed)


def clip_digest(path: Path, heard: Callable[[int], None] = lambda _: None) -> str:
    """SHA-256 of a file, or of the images of a folder; "" if it cannot be read. `heard` is as of `digest`."""
    try:
        images = listing(path)
        return digest([path] if images is None else images, names=images is not None, heard=heard)
    except OSError:
        return ""


def _is_same(clip_then: Clip, clip: Path) -> bool:
    now = clip_stat(clip)
    if now is None or now.bytes != clip_then.bytes:
        return False
    return now.changed_ns == clip_then.changed_ns or (clip_then.sha256 != "" and clip_digest(clip) == clip_then.sha256)


def _is_as_written(folder: Path, name: str, run: Manifest) -> bool:
    """Whether a file is what its run wrote; of a run that did not end, whose tables are replaced, if its size is."""
    path, of = folder / name, run.files[name]
    with contextlib.suppress(OSError, ValueError):
        return path.stat().st_size == of.bytes and (run.stopped is not None or digest([path]) == of.sha256)
    return False
