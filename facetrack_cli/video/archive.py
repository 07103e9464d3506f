"""Images in a .zip archive, in the natural order of their names, read without unpacking the archive to disk."""

from __future__ import annotations

import zlib
from pathlib import Path, PurePosixPath
from typing import Final
from zipfile import BadZipFile, ZipFile, ZipInfo, is_zipfile

from facetrack_cli.core.errors import InputError, reason
from facetrack_cli.core.npz import check_directory
from facetrack_cli.video import images

MOST: Final = 256 << 20  # bytes of an image, unpacked
_DAMAGED: Final = (BadZipFile, EOFError, OSError, RuntimeError, NotImplementedError, ValueError, zlib.error)


def is_archive(path: Path) -> bool:
    """Whether a file is a .zip archive by its name and its end. Raises OSError."""
    return path.suffix.lower() == ".zip" and path.is_file() and is_zipfile(path)


def holds_images(path: Path) -> bool:
    """Whether an archive has an image, or cannot be read, of which more is said once it is opened."""
    try:
        with path.open("rb") as raw:
            check_directory(path, raw)
            return any(_is_frame(PurePosixPath(name)) for name in ZipFile(raw).namelist())
    except (*_DAMAGED, InputError):
        return True


class Archive:
    """The images of one folder of an archive; `files` are their paths, as if the archive were a folder.

    Raises InputError for an archive that is damaged, locked, has no images, or has them in several folders.
    """

    def __init__(self, path: Path) -> None:
        try:
            with path.open("rb") as raw:
                check_directory(path, raw)
            self._zip = ZipFile(path)
        except _DAMAGED as e:
            raise InputError(f"{path}: cannot be read as an archive ({reason(e)}); copy or download it again") from e
        names = {PurePosixPath(one.filename): one for one in self._zip.infolist() if not one.is_dir()}
        shown = {name: one for name, one in names.items() if _is_frame(name)}
        if not shown:
            raise InputError(f"{path}: no images in this archive; {', '.join(sorted(images.SUFFIXES))} are read")
        if len(folders := {name.parent for name in shown}) > 1:
            two = " and ".join(sorted(map(str, folders))[:2])
            raise InputError(f"{path}: has images in several folders, as {two}; one clip has them in one")
        ordered = images.ordered(shown, lambda name: name.name)
        self._entries: dict[Path, ZipInfo] = {path / name: shown[name] for name in ordered}
        self.files = list(self._entries)

    def read(self, file: Path) -> bytes:
        """The bytes of one image. Raises images.UnreadableError; no more is unpacked than an image may have."""
        entry = self._entries[file]
        if entry.file_size > MOST:
            raise images.UnreadableError(file, f"is too large for a frame: {entry.file_size / 1e6:.0f} MB unpacked")
        try:
            with self._zip.open(entry) as opened:
                data = opened.read(entry.file_size + 1)
        except _DAMAGED as e:
            raise images.UnreadableError(file, f"cannot be unpacked ({reason(e)})", "make the archive again") from e
        return data


def _is_frame(name: PurePosixPath) -> bool:
    hidden = any(part.startswith((".", "__MACOSX")) for part in name.parts)
    return name.suffix.lower() in images.SUFFIXES and not hidden
