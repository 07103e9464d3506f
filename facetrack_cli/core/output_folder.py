"""The folder of a command's results: refused before anything runs if it cannot be used, and not left behind empty."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from pathlib import Path

from facetrack_cli.core.errors import OutputError
from facetrack_cli.core.files import refused, write_new


class Folder:
    """The folder `path`, in which files named `names` may be written, in a `with`.

    Raises OutputError where one of them exists and `overwrite` is not set, where the folder is one of `inputs`, where
    it cannot be made or written to. Folders made for it are removed if nothing is written.
    """

    def __init__(self, path: Path, names: Sequence[str], *, overwrite: bool, inputs: Sequence[Path] = ()) -> None:
        self.path = path
        self._names = names
        self._overwrite = overwrite
        self._inputs = inputs
        self._made: list[Path] = []
        self.written: list[Path] = []

    @classmethod
    def of(
        cls, out: str | None, default: str, names: Sequence[str], *, overwrite: bool, inputs: Sequence[Path] = ()
    ) -> Folder:
        """The folder of --out, or `default` in the working directory."""
        if out in ("", "-"):
            raise OutputError(f"--out {out!r} names no folder; the table goes to standard output in any case")
        return cls(Path(default if out is None else out), names, overwrite=overwrite, inputs=inputs)

    def __enter__(self) -> Folder:
        path = self.path
        try:
            if path.exists() and not path.is_dir():
                raise OutputError(
                    f"{path}: is a file, where a folder for the results is to be; name another with --out"
                )
            for given in self._inputs:
                if path.is_dir() and given.is_dir() and path.samefile(given):
                    raise OutputError(f"{path}: the results would go among the input's frames; name another with --out")
            for name in self._names:
                if (path / name).is_dir():
                    raise OutputError(
                        f"{path / name}: is a folder, where a file of results is to be; name another folder with --out"
                    )
                if os.path.lexists(path / name) and not self._overwrite:
                    raise OutputError(
                        f"{path / name}: is there already; --overwrite replaces it, --out names another folder"
                    )
            self._made = [folder for folder in (path, *path.parents) if not folder.exists()]
            path.mkdir(parents=True, exist_ok=True)
        except OSError as e:
            raise refused(path, e) from e
        if not os.access(path, os.W_OK):
            raise OutputError(f"{path}: cannot be written: no permission; choose another place with --out")
        return self

    def write(self, name: str, data: str | bytes) -> None:
        """A whole file or none."""
        content = data.encode(errors="backslashreplace") if isinstance(data, str) else data
        write_new(self.path / name, content, overwrite=self._overwrite)
        self.written.append(self.path / name)

    def __exit__(self, *_: object) -> None:
        for folder in self._made if not self.written else ():
            with contextlib.suppress(OSError):
                folder.rmdir()

    def summary(self) -> str:
        """One line: what was written."""
        return f"{self.path}{os.sep} ({', '.join(path.name for path in self.written)})" if self.written else "nothing"
