"""A finished run: its folder read and checked, rows, recipe, start and clip, and its files written again.

They are written all or none, with the video drawn again from rows. A run given the whole clip is smoothed so, by what
its filters knew in every frame, which is kept meanwhile in `posterior.npz`.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from copy import deepcopy
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
from pydantic import ValidationError

from facetrack_cli.core.errors import InputError, reading
from facetrack_cli.core.files import cannot_write, check_plain, discard, publish, temporary_path, writing
from facetrack_cli.core.models import shipped_folder, shipped_recipes
from facetrack_cli.core.npz import Kind, Stored, flatten, restore, write_arrays
from facetrack_cli.core.numbers import dumps
from facetrack_cli.core.types import Start
from facetrack_cli.engine.protocols import Belief, Linear
from facetrack_cli.recipe.model import KINDS, ParticleRecipe, Recipe
from facetrack_cli.run_folder import manifest
from facetrack_cli.run_folder.lease import FolderLease, sweep
from facetrack_cli.run_folder.manifest import FILTERED, POSTERIOR, VIDEO, check_belongs, read_run, write_rows
from facetrack_cli.runs.plan import Job, Report
from facetrack_cli.runs.record import FOLDER, ClipFacts, Sink
from facetrack_cli.runs.signals import Stopped, StoppedError
from facetrack_cli.trackers.smoothed import Beliefs, renamed_hands, smoothed_rows
from facetrack_cli.trajectory.reader import PEOPLE, Header, is_there, read_header
from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory, header_value, recorded, successive
from facetrack_cli.trajectory.views import choose
from facetrack_cli.trajectory.writers import FORMATS, Format, summary_of
from facetrack_cli.trajectory.writers import Header as RunHeader
from facetrack_cli.video.images import listing
from facetrack_cli.video.overlay import Overlay
from facetrack_cli.video.source import given_rate, open_source
from facetrack_cli.video.writer import VideoWriter

KIND: Final = Kind("facetrack-posterior", 2, "posterior of a run", "facetrack run --smooth")
_BLOCK_FRAMES: Final = 500  # of a posterior, that are written together
Write: TypeAlias = Callable[[Callable[[bytes], object]], object]  # writes one file by calls of `write(data)`


@dataclass(frozen=True)
class Run:
    """A finished run: the `rows` of its JSON, and the `start` with its corrections.

    `files` are its trajectories, each with its `stamp` when it was opened. `fps` is None for a video. Of a `film` it is
    one track of one person.
    """

    folder: Path
    rows: Trajectory
    header: Header
    recipe: Recipe
    start: Start
    clip: Path
    fps: Fraction | None
    files: Mapping[Format, tuple[Path, object]]
    film: bool = False

    @cached_property
    def first(self) -> int:
        return int(self.rows.frame[0])

    @cached_property
    def last(self) -> int:
        return int(self.rows.frame[-1])

    @cached_property
    def parts(self) -> Mapping[str, tuple[str, ...]]:
        """The parts of each target."""
        return {name: tuple(part for target, part in self.rows.names if target == name) for name in self.rows.targets}

    @property
    def fixed_by(self) -> str:
        """The command that corrects it."""
        of = f" --person {self.rows.targets[0]}@{self.first}f" if self.film else ""
        return f"facetrack fix {self.folder}{of}"

    @property
    def video(self) -> Path | None:
        """The video that the run wrote, if it did."""
        path = self.folder / VIDEO
        return path if path.is_file() else None


def open_run(folder: Path, clip: Path | None = None) -> Run:
    """The run that `facetrack run` wrote into a folder; `clip` is where its clip is now, if not where it was.

    Raises InputError for a folder without JSON, files that are not as the run wrote them, a recipe of another version,
    and a clip or a file of the recipe that is missing.
    """
    main = manifest.trajectory_of(folder)
    if (folder / PEOPLE).is_file():
        who = f"facetrack people {folder} --page corrects who is who"
        raise InputError(f"{folder}: is of a film; {who}, and --person NAME@TIME of facetrack fix one's points")
    files = run_files(folder)
    stamped = {form: (path, stamp(path)) for form, path in files.items()}
    rows = read_files(files)
    header = read_header(rows)
    path = Path(header.source.path) if clip is None else clip
    if clip is None and not is_there(path) and not listing(path):
        raise InputError(f"{path}: is not there, and the run in {folder} is of it; name the clip with --clip")
    if (other := manifest.other_clip(rows, path)) is not None:
        raise InputError(f"{other}; name its clip with --clip")
    recipe = recipe_of(main, rows.header["recipe"], [Path(), folder, folder.parent, path.parent])
    return Run(folder, rows, header, recipe, header.init.start, path, given_rate(path, header.source.fps), stamped)


def run_files(folder: Path) -> dict[Format, Path]:
    """The trajectories in the folder of a run."""
    return {form: folder / f"trajectory.{form}" for form in FORMATS if (folder / f"trajectory.{form}").is_file()}


def read_files(files: Mapping[Format, Path]) -> Trajectory:
    """The rows of a run's JSON, or else its JSON lines. InputError for a file that is not as its run wrote it."""
    for path in files.values():
        with reading(path):
            check_belongs(path)
    return read_run(files["json"] if "json" in files else files["jsonl"])


def stamp(path: Path) -> object:
    """What changes when a file is written again."""
    try:
        stats = path.stat()
    except OSError:
        return None
    return stats.st_ino, stats.st_size, stats.st_mtime_ns


def recipe_of(main: Path, settings: Mapping[str, Any], folders: Sequence[Path]) -> Recipe:
    """The run's recipe; the files that it names are looked for in `folders` and among the shipped ones."""
    name = str(settings.get("name", "recipe"))
    values: dict[str, Any] = {key: deepcopy(value) for key, value in settings.items() if key != "name"}
    if any(file.stem == name for file in shipped_recipes()):
        folders = [shipped_folder(), *folders]
    _place(main, values, [*folders, shipped_folder()])
    kind = KINDS.get(str(values.get("type", "particle_filter")), ParticleRecipe)
    try:
        return kind.model_validate(values, context={"path": main.parent / f"{name}.yaml", "root": None})
    except ValidationError as e:
        first = e.errors()[0]
        wrong = f"{'.'.join(map(str, first['loc']))}: {first['msg'].lower()}"
        unknown = f"this version of facetrack does not know its recipe ({wrong})"
        raise InputError(f"{main}: {unknown}; make the run again") from None


def _place(main: Path, values: dict[str, Any], folders: Sequence[Path]) -> None:
    """Put the place where each file of a recipe's sections is now."""
    for key, value in values.items():
        if isinstance(value, dict):
            _place(main, value, folders)
        elif key in ("file", "gallery", "calibration") and isinstance(value, str):
            there = [path for folder in folders if is_there(path := folder / value) and path.is_file()]
            if not there:
                places = ", ".join(dict.fromkeys(str(folder.resolve()) for folder in folders))
                named = f'its recipe names the file "{value}", which is in none of {places}'
                raise InputError(f"{main}: {named}; put it into one")
            values[key] = str(there[0].resolve())


def finish_run(job: Job, out: Path, report: Report, stop: Stopped) -> list[str]:
    """Smooth a run that was tracked, draw its video, or both; warnings. StoppedError once `stop`: nothing is written.

    The rows of a filter that is smoothed are kept in trajectory.filtered.csv, and the posterior is removed.
    """
    others, gone = dict[Path, Write](), list[Path]()
    rows = read_files(run_files(out)) if job.smooth else read_run(out)
    if job.smooth:
        others[out / FILTERED] = partial(write_rows, "csv", rows=rows)
        gone.append(out / POSTERIOR)
        rows = given_all(rows, read_posterior(out / POSTERIOR, rows))
    # what a CSV does not say
    about = {"source": {"fps": job.fps and float(job.fps), "stream": job.stream}, "recipe": {"name": job.recipe.name}}
    rows, clip = replace(rows, header=rows.header or about), job.clip if job.video else None
    return rewrite(out, rows, others, gone, clip, tables=job.smooth, report=report, stop=stop)[1]


def given_all(rows: Trajectory, beliefs: Mapping[str, Beliefs]) -> Trajectory:
    """The rows of a filter, given the whole clip, by the `beliefs` of each target in each frame."""
    rows, beliefs = renamed_hands(rows, beliefs)
    after = successive([smoothed_rows(choose(rows, name), beliefs[name]) for name in rows.targets], rows)
    return replace(after, header={**rows.header, "smoothed": {"lag": None}})


def rewrite(
    folder: Path,
    rows: Trajectory,
    others: Mapping[Path, Write],
    gone: Sequence[Path],
    clip: Path | None,
    span: tuple[int, int] | None = None,
    *,
    tables: bool = True,
    report: Report,
    stop: Stopped,
    order: Sequence[str] = (),
    check: Callable[[], None] = lambda: None,
    lock: FolderLease | None = None,
) -> tuple[list[Path], list[str]]:
    """Write a run's `tables` again with these rows, and `others`; all replace the old files of the `folder` together.

    Returns the files, and warnings. Each value of `others` writes one file by calls of `write(data)`, `gone` are files
    to remove. The video is drawn again on the `clip`, if there is one, as `repaint` does.
    `check` raises, at the beginning and before anything is replaced, if the folder has changed; `lock` is
    the folder's, if it is held. OutputError for a file that cannot be written; the folder is then as it was.
    """
    of_video = f"{VIDEO}: "  # what is said of the video of before goes with it
    if clip is not None and any(of_video in line for line in rows.header.get("warnings", ())):
        left = [line for line in rows.header["warnings"] if of_video not in line]
        rows, tables = replace(rows, header={**rows.header, "warnings": left}), True
    tabled = run_files(folder) if tables else {}
    files: dict[Path, Write] = {path: partial(write_rows, form, rows=rows) for form, path in tabled.items()}
    files |= dict(others)
    written, notes = list[Path](), list[str]()
    check_plain(folder / VIDEO, *files)
    if (run := manifest.read_manifest(folder)) is not None:
        kept = {name: file for name, file in run.files.items() if folder / name not in gone}
        counted, smoothed = summary_of(rows), run.smoothed or rows.header.get("smoothed") == {"lag": None}
        lost = counted.lost_frames, counted.lost_at_end
        run = replace(run, files=kept, smoothed=smoothed, lost_frames=lost[0], lost_at_end=lost[1])
    try:
        with nullcontext(lock) if lock else FolderLease(folder) as lock:
            check()
            sweep(folder)
            if clip is not None:
                written.append(folder / VIDEO)
                notes += repaint(rows, clip, span, path=written[0], report=report, stop=stop, order=order)
                said = (line for line in run.warnings if of_video not in line) if run else ()
                run = run and replace(run, warnings=(*said, *notes))
            for path, write in files.items():
                written.append(path)
                with temporary_path(path).open("wb") as file:
                    write(file.write)
            check()
            manifest.commit(lock, folder, written, run, gone)
    except OSError as e:
        raise cannot_write(written[-1] if written else folder, e, "make it writable, and save again") from e
    finally:
        for path in written:
            discard(path)
    return written, notes


def repaint(
    rows: Trajectory,
    clip: Path,
    span: tuple[int, int] | None = None,
    *,
    path: Path,
    report: Report,
    stop: Stopped,
    order: Sequence[str] = (),
) -> tuple[str, ...]:
    """Write the annotated video into its temporary file; its warnings.

    It shows the first and last frames of `span`, else all that have rows. Targets have the colours of their places in
    `order`.

    Raises StoppedError once `stop` says so, InputError if the clip lacks frames of the run; nothing is written then.
    """
    first, last = span or (int(rows.frames[0]), int(rows.frames[-1]))
    fps, stream = header_value(rows, "source", "fps"), header_value(rows, "source", "stream")
    rate, total, done = given_rate(clip, fps) if isinstance(fps, int | float) else None, last - first + 1, 0
    with open_source(clip, fps=rate, start=first, stop=last + 1, stream=stream) as source:
        title = str(header_value(rows, "recipe", "name") or "")
        overlay = Overlay(source.size, fps=float(source.fps), title=title, order=order)
        sound = source.path if source.is_video else None
        video = VideoWriter(path, source.size, source.fps, source.aspect, audio_from=sound, replace=False)
        try:
            for done, frame in enumerate(source, 1):
                if stop():
                    raise StoppedError
                video.write(overlay.draw(FrameResult(frame, recorded(frame.index, rows.at(frame.index)))), frame.time_s)
                report(done, total)
            if done < total:
                raise InputError(f"{clip}: has no frame {first + done}, which the run has; name its clip with --clip")
        except BaseException:
            video.discard()
            raise
        video.close()
        return tuple(video.warnings)


class PosteriorWriter(Sink):
    """Writes the beliefs of every frame, in blocks beside the checkpoint of a run, and at the end into one file.

    They take less than 1 kB a frame and part. Raises OutputError.
    """

    path: Path

    def __init__(self, out: Path) -> None:
        self.path, self._folder = out / POSTERIOR, out / FOLDER
        self._kept: list[list[tuple[int, tuple[Belief, ...]]]] = []  # of each target, of so many frames
        self._frames = 0

    def begin(self, clip: ClipFacts, header: RunHeader, mark: int | None) -> None:
        corrections, self._blocks = header["init"].get("corrections", []), mark or 0
        self._head = {"targets": np.empty(0), "corrections": np.array(dumps(corrections))}

    def write(self, result: FrameResult) -> None:
        if not self._kept:
            self._head["targets"], self._kept = np.array(result.rows.targets), [[] for _ in result.targets]
        for kept, target in zip(self._kept, result.targets, strict=True):
            if target.beliefs is not None and (beliefs := target.beliefs()):
                kept.append((result.frame.index, beliefs))
        self._frames += 1
        if self._frames == _BLOCK_FRAMES:
            self._flush()

    def mark(self) -> int:
        self._flush()
        return self._blocks

    def _flush(self) -> None:
        if not self._frames:
            return
        held = []
        for kept in self._kept:
            groups = zip(*(beliefs for _, beliefs in kept), strict=True)
            held.append(([frame for frame, _ in kept], [_stacked(group) for group in groups]))
            kept.clear()
        with writing(self.path):
            self._folder.mkdir(exist_ok=True)
            write_arrays(self._block(self._blocks), flatten(str(self._blocks), held))
            publish(self._block(self._blocks))
        self._blocks, self._frames = self._blocks + 1, 0

    def close(self, done: object) -> None:
        self._flush()
        write_arrays(self.path, {**KIND.head, **self._head}, [*map(self._block, range(self._blocks))])

    def _block(self, number: int) -> Path:
        return self._folder / f"posterior-{number:05}.npz"


def _stacked(group: Sequence[Belief]) -> Belief:
    """The beliefs in T frames as one, whose arrays have T as their first axis."""
    mean, cov, motion, doubt, named = zip(*group, strict=True)
    linear = Linear(*(np.array(values, np.float64) for values in zip(*motion, strict=True)))
    names = None if named[0] is None else np.array(named, np.float64)
    return Belief(np.array(mean, np.float64), np.array(cov, np.float64), linear, np.array(doubt), names)


def _each(group: Belief) -> list[Belief]:
    """The belief in each of the frames of stacked ones."""
    named = [None] * len(group.mean) if group.named is None else group.named
    columns = group.mean, group.cov, map(Linear, *group.motion), group.doubt, named
    return [Belief(*values) for values in zip(*columns, strict=True)]


def read_posterior(path: Path, rows: Trajectory) -> dict[str, Beliefs]:
    """The beliefs of each target in every frame of its run's `rows`.

    Raises InputError for a file that is not as its run wrote it, and for one of before the run was corrected.
    """

    def make(stored: Stored) -> dict[str, Beliefs]:
        if stored.text("corrections") != dumps(rows.header["init"].get("corrections", [])):
            raise InputError(f"{path}: was kept before the run was corrected; run again with --init and --smooth")
        beliefs: dict[str, dict[int, tuple[Belief, ...]]] = {name: {} for name in stored.texts("targets")}
        block = 0
        while str(block) in stored:
            for by_frame, (at, groups) in zip(beliefs.values(), restore(str(block), stored.file), strict=True):
                by_frame |= zip(at, zip(*map(_each, groups), strict=True), strict=True)
            block += 1
        frames = rows.frames.tolist()
        return {name: [by_frame.get(frame, ()) for frame in frames] for name, by_frame in beliefs.items()}

    check_belongs(path)
    return KIND.read(path, make)
