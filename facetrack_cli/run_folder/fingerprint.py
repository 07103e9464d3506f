"""Whether it is the same again: checksums of clips, of recipes with their files, and of all that a job asks for."""

from __future__ import annotations

import contextlib
import hashlib
import stat
import threading
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TypeAlias

from facetrack_cli.core.files import digest, sampled
from facetrack_cli.core.numbers import dumps
from facetrack_cli.core.types import Start
from facetrack_cli.core.version import __version__
from facetrack_cli.core.yaml_tree import YamlProblems
from facetrack_cli.recipe.load import files_of
from facetrack_cli.recipe.model import Recipe, to_dict
from facetrack_cli.run_folder.manifest import Clip, Manifest, as_text, read_manifest
from facetrack_cli.trajectory.header import is_there, to_record
from facetrack_cli.trajectory.trajectory import Trajectory
from facetrack_cli.video.images import listing


def previous_run(folder: Path, asked: Callable[[], str], clip: Path) -> Manifest | None:
    """The run.json of a folder, if it is of the same job (`asked`) and clip, and its files are whole; else None."""
    known = read_manifest(folder) if is_there(folder) else None
    if known is None or known.clip is None or known.asked != asked():
        return None
    whole = all(_is_as_written(folder, name, known) for name in known.files)
    return known if whole and _is_same(known.clip, clip) else None


def other_clip(rows: Trajectory, clip: Path) -> str | None:
    """A line if a clip that is there is not, byte for byte, the clip that the rows of a run are of."""
    said, known = rows.header.get("source_sha256"), read_manifest(rows.path.parent)
    if not isinstance(said, str) or not said or not is_there(clip):
        return None
    of_run = known.clip if known is not None and known.clip is not None and known.clip.sha256 == said else None
    if clip_digest(clip) == said if of_run is None else _is_same(of_run, clip):
        return None
    return f"{clip}: is not the clip that {rows.path.name} was made from (its SHA-256 differs)"


def job_digest(recipe: Recipe, init: object, settings: Sequence[object], *more: object) -> str:
    """A digest of a recipe and its files, of a start or an init file, and of settings, as JSON takes them."""
    given = clip_digest(init) if isinstance(init, Path) else to_record(init) if isinstance(init, Start) else init
    return hashlib.sha256(dumps([__version__, _recipe_digest(recipe), [given, *settings], *more]).encode()).hexdigest()


def _recipe_digest(recipe: Recipe) -> str:
    """A digest of a recipe and the files it names, computed once for all clips of a batch."""
    global _last
    if _last is None or _last[0] is not recipe or _last[1] != [_stamp(file) for file, _ in _last[1]]:
        files: list[Path] = []
        with contextlib.suppress(YamlProblems):  # the run says so
            files = files_of(recipe)
        text = dumps([to_dict(recipe), *map(clip_digest, files)])
        _last = recipe, [_stamp(file) for file in files], hashlib.sha256(text.encode()).hexdigest()
    return _last[2]


_Stamp: TypeAlias = tuple[Path, "tuple[int, int] | None"]
_last: tuple[Recipe, list[_Stamp], str] | None = None


def _stamp(path: Path) -> _Stamp:
    with contextlib.suppress(OSError):
        found = path.stat()
        return path, (found.st_size, found.st_mtime_ns)
    return path, None


class ClipDigest:
    """The SHA-256 of a clip, computed in a thread of its own while the clip is tracked; `clip` is the clip without."""

    def __init__(self, clip: Path, *, whole: bool = True) -> None:
        """Without `whole` it is not computed: the clip of a chunk is the same for all."""
        self.clip, self._found, self._stopped = clip_stat(clip), "", not whole

        def compute() -> None:
            self._found = clip_digest(clip, lambda: self._stopped)

        self._thread = threading.Thread(target=compute, name="sha256", daemon=True)
        self._thread.start()

    def end(self, *, whole: bool) -> Clip | None:
        """The clip with its checksum, for which it waits if the run is `whole`; None if the clip is gone."""
        self._stopped = not whole
        self._thread.join()
        return self.clip and Clip(self.clip.bytes, self._found, self.clip.path, self.clip.changed_ns)


def quick_digest(clip: Path) -> str:
    """A checksum of a clip that is soon computed, of samples of its files; "" if it cannot be read."""
    with contextlib.suppress(OSError):
        files = _files(clip)
        told = repr([(path.name, path.stat().st_size) for path in files])
        found = hashlib.sha256(told.encode(errors="surrogateescape"))
        for path in [files[0], files[-1]] if files else []:
            found.update(sampled(path).encode())
        return found.hexdigest()
    return ""


def clip_stat(clip: Path) -> Clip | None:
    """A clip without its checksum; None if it is gone."""
    try:
        stats = [file.stat() for file in _files(clip)]
    except OSError:
        return None
    changed = max((one.st_mtime_ns for one in stats), default=0)
    return Clip(sum(one.st_size for one in stats), "", as_text(str(clip)), changed)


def clip_digest(path: Path, stopped: Callable[[], bool] = lambda: False) -> str:
    """The checksum of a file, or of the images of a folder; "" if it cannot be read."""
    try:
        return digest(_files(path), names=listing(path) is not None, stopped=stopped)
    except OSError:
        return ""


def _is_same(known: Clip, clip: Path) -> bool:
    now = clip_stat(clip)
    if now is None or now.bytes != known.bytes:
        return False
    return now.changed_ns == known.changed_ns or (known.sha256 != "" and clip_digest(clip) == known.sha256)


def _is_as_written(folder: Path, name: str, known: Manifest) -> bool:
    """Whether a file is what its run wrote; of a run that did not end, whose tables are replaced, if its size is."""
    path, of, sample = folder / name, known.files[name], known.samples.get(name)
    with contextlib.suppress(OSError, ValueError):
        found = path.lstat()
        if stat.S_ISREG(found.st_mode) and found.st_size == of.bytes:
            stamp = found.st_size, found.st_mtime_ns
            return known.stopped is not None or _digest(path, sample is None, *stamp) == (sample or of.sha256)
    return False


@lru_cache(1024)  # a job asks several times
def _digest(path: Path, whole: bool, *stamp: int) -> str:
    return digest([path]) if whole else sampled(path)


def _files(clip: Path) -> list[Path]:
    images = listing(clip)
    return [clip] if images is None else images
