"""A run again: what its folder already holds of this very job, and the checksums by which that is known."""

from __future__ import annotations

import contextlib
import hashlib
import stat
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from facetrack_cli import __version__
from facetrack_cli.core.files import digest
from facetrack_cli.core.numbers import dumps
from facetrack_cli.core.types import Start
from facetrack_cli.core.yaml_tree import YamlProblems
from facetrack_cli.recipe.load import files_of
from facetrack_cli.recipe.model import Recipe, to_dict
from facetrack_cli.runs.signals import never
from facetrack_cli.tracking.start import find_init
from facetrack_cli.trajectory.batch_file import as_text
from facetrack_cli.trajectory.header import is_there, to_record
from facetrack_cli.trajectory.manifest import Clip, Manifest, read_manifest
from facetrack_cli.trajectory.trajectory import Trajectory
from facetrack_cli.video.images import listing

if TYPE_CHECKING:
    from facetrack_cli.runs.job import Job


def previous(job: Job) -> Manifest | None:
    """What the folder of a job holds of an earlier run of the same job and the same clip; None if nothing."""
    if job.out is None or not is_there(job.out):
        return None
    found = read_manifest(job.out)
    if found is None or found.clip is None or found.asked != asked(job):
        return None
    whole = all(_size(job.out / name) == one.bytes for name, one in found.files.items())
    return found if whole and _same(found.clip, job.clip) else None


def _size(path: Path) -> int | None:
    with contextlib.suppress(OSError):
        found = path.stat()
        return found.st_size if stat.S_ISREG(found.st_mode) else None
    return None


def swapped(rows: Trajectory, clip: Path) -> str | None:
    """A line if a clip that is there is not, byte for byte, the one that the rows of a run say they are of."""
    said, known = rows.header.get("source_sha256"), read_manifest(rows.path.parent)
    if not isinstance(said, str) or not said or not is_there(clip):
        return None
    of_run = known.clip if known is not None and known.clip is not None and known.clip.sha256 == said else None
    if _digest(clip) == said if of_run is None else _same(of_run, clip):
        return None
    return f"{clip}: is not the clip that {rows.path.name} was made from (its SHA-256 differs)"


def asked(job: Job) -> str:
    """A digest of all that a job asks for, but not of its clip: of recipe, start, frames, options, and their files."""
    init = find_init(job.clip) if job.init is None and job.box is None else job.init
    given = _digest(init) if isinstance(init, Path) else to_record(init) if isinstance(init, Start) else init
    settings = [given, job.box, job.init_frame, job.faces, job.start, job.stop]
    options = [str(job.fps), job.lag, job.posterior, job.formats, job.video, job.strict]
    pieces = [job.split, job.piece and [job.piece.correction]] if job.split or job.piece else []
    return hashlib.sha256(dumps([__version__, _of_recipe(job.recipe), settings, options, *pieces]).encode()).hexdigest()


def _of_recipe(recipe: Recipe) -> str:
    """A digest of a recipe and the files it names, computed once for all clips of a batch."""
    global _last
    if _last is None or _last[0] is not recipe or _last[1] != [_stamp(file) for file, _ in _last[1]]:
        files: list[Path] = []
        with contextlib.suppress(YamlProblems):  # the run says so
            files = files_of(recipe)
        stamps = [_stamp(file) for file in files]
        text = dumps([to_dict(recipe), *map(_digest, files)])
        _last = recipe, stamps, hashlib.sha256(text.encode()).hexdigest()
    return _last[2]


_Stamp: TypeAlias = tuple[Path, "tuple[int, int] | None"]
_last: tuple[Recipe, list[_Stamp], str] | None = None


def _stamp(path: Path) -> _Stamp:
    with contextlib.suppress(OSError):
        found = path.stat()
        return path, (found.st_size, found.st_mtime_ns)
    return path, None


class Fingerprint:
    """The SHA-256 of a clip, computed in a thread of its own while the clip is tracked; `clip` is the clip without."""

    def __init__(self, clip: Path, *, whole: bool = True) -> None:
        """`whole`: whether it is computed; the clip of a piece is the same for all."""
        self.clip, self._found, self._stopped = looked_at(clip), "", not whole

        def compute() -> None:
            self._found = _digest(clip, lambda: self._stopped)

        self._thread = threading.Thread(target=compute, name="sha256", daemon=True)
        self._thread.start()

    def end(self, *, whole: bool) -> Clip | None:
        """The clip with its checksum, for which it waits if the run is `whole`; None if the clip is gone."""
        self._stopped = not whole
        self._thread.join()
        return self.clip and self.clip.model_copy(update={"sha256": self._found})


def ends(clip: Path) -> str:
    """A checksum of a clip that is soon computed: of its size and its first and last MiB. OSError."""
    files = _files(clip)
    found = hashlib.sha256(repr([(path.name, path.stat().st_size) for path in files]).encode(errors="surrogateescape"))
    for path in [files[0], files[-1]] if files else []:
        with path.open("rb") as file:
            found.update(file.read(1 << 20))
            file.seek(max(path.stat().st_size - (1 << 20), 0))
            found.update(file.read(1 << 20))
    return found.hexdigest()


def _same(known: Clip, clip: Path) -> bool:
    now = looked_at(clip)
    if now is None or now.bytes != known.bytes:
        return False
    return now.changed_ns == known.changed_ns or (known.sha256 != "" and _digest(clip) == known.sha256)


def looked_at(clip: Path) -> Clip | None:
    """A clip without its checksum; None if it is gone."""
    try:
        stats = [file.stat() for file in _files(clip)]
    except OSError:
        return None
    changed = max((one.st_mtime_ns for one in stats), default=0)
    return Clip(path=as_text(str(clip)), bytes=sum(one.st_size for one in stats), changed_ns=changed, sha256="")


def _digest(path: Path, stopped: Callable[[], bool] = never) -> str:
    """The checksum of a file, or of the images of a folder; "" if it cannot be read."""
    try:
        return digest(_files(path), names=listing(path) is not None, stopped=stopped)
    except OSError:
        return ""


def _files(clip: Path) -> list[Path]:
    images = listing(clip)
    return [clip] if images is None else images
