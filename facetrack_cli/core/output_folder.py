"""The folder of a command's results: checked before anything runs, and removed again if nothing is written into it."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Sequence
from pathlib import Path

from facetrack_cli.core.errors import OutputError
from facetrack_cli.core.files import cannot_write, check_file, same_file, write_new


def check_folder(path: Path, names: Sequence[str], *, overwrite: bool, inputs: Sequence[Path | None]) -> None:
    """OutputError if files of these names cannot go into the folder `path`, or would replace or mix with `inputs`."""
    try:
        if path.exists() and not path.is_dir():
            raise OutputError(f"{path}: is a file, where a folder for the results is to be; name another with --out")
        if any(same_file(path, given) for given in inputs if given is not None):
            raise OutputError(f"{path}: the results would go among the frames of the input; name another with --out")
    except OSError as e:
        raise cannot_write(path, e) from e
    for name in names:
        check_file(path / name, overwrite=overwrite, inputs=inputs, remedy="name another folder with --out")


def make_folder(path: Path) -> list[Path]:
    """Make a folder and return those that were made, the innermost first. OutputError if it cannot be written to."""
    try:
        made = [folder for folder in (path, *path.parents) if not folder.exists()]
        path.mkdir(parents=True, exist_ok=True)
        if not os.access(path, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as e:
        raise cannot_write(path, e) from e
    return made


def remove_folders(made: Sequence[Path]) -> None:
    """Remove folders that `make_folder` made, unless they hold something."""
    for folder in made:
        with contextlib.suppress(OSError):
            folder.rmdir()


class Folder:
    """The folder `path` of the results of a command, into which `write` writes files named `names`, in a `with`.

    Raises OutputError as `check_folder` and `make_folder` do. Folders made for it are removed if nothing is written.
    """

    def __init__(self, out: str | None, default: str, names: Sequence[str], *, overwrite: bool, clip: Path) -> None:
        """`out` is the value of --out; without it the folder `default` in the working directory is taken."""
        if out in ("", "-"):
            raise OutputError(f"--out {out!r} names no folder; the table goes to standard output in any case")
        self.path = Path(default if out is None else out)
        self.written: list[Path] = []
        self._names, self._overwrite, self._clip = names, overwrite, clip

    def __enter__(self) -> Folder:
        check_folder(self.path, self._names, overwrite=self._overwrite, inputs=[self._clip])
        self._made = make_folder(self.path)
        return self

    def write(self, name: str, data: str | bytes) -> None:
        """Write one file, whole or not at all."""
        content = data.encode(errors="backslashreplace") if isinstance(data, str) else data
        write_new(self.path / name, content, overwrite=self._overwrite)
        self.written.append(self.path / name)

    def __exit__(self, *_: object) -> None:
        if not self.written:
            remove_folders(self._made)

    def summary(self) -> str:
        """One line: what was written."""
        return f"{self.path}{os.sep} ({', '.join(path.name for path in self.written)})" if self.written else "nothing"
