"""The clips that a command line names: files, folders, globs, and lists of them.

A folder of images is one clip. In a folder that holds videos, animations or archives of images each of them is a clip;
in one that holds none of these, those of its sub-folders are.
"""

from __future__ import annotations

import glob
import os
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from facetrack_cli.core.errors import InputError, UsageError, from_system, reason
from facetrack_cli.core.files import MAX_FILE_BYTES, absolute, read_bounded
from facetrack_cli.run_folder.manifest import NAME
from facetrack_cli.trajectory.header import is_there
from facetrack_cli.video import images
from facetrack_cli.video.files import chapters, check_local, is_clip, is_image


class Found(NamedTuple):
    """The clips, each once, and whether they are `several`: more than one, or whatever a folder, glob or list holds."""

    clips: list[Path]
    several: bool


def expand(inputs: Sequence[Path], note: Callable[[str], None] = lambda line: None) -> Found:
    """The clips of the inputs of a command line, in their order; `note` hears what is left out.

    InputError for a list that cannot be read, and a folder, glob or list without clips; UsageError for several images.
    """
    listed = [clip for given in inputs for clip in _listed(given)]
    groups = [_clips(given, note) for given in listed]
    found = {absolute(clip): clip for group in groups for clip in group}
    clips = list(found.values())
    alone = [one for one in clips if is_image(one) and images.listing(one) is None and images.pages(one) == 1]
    if len(alone) > 1:
        folder = alone[0].parent
        raise UsageError(f"{alone[0]} and {len(alone) - 1} more are single images; give their folder, {folder}{os.sep}")
    if parts := chapters(clips):
        names = f"{parts[0].name} to {parts[-1].name}"
        how = "list them as lines file 'NAME' and join them first: ffmpeg -f concat -safe 0 -i LIST -c copy joined.mp4"
        note(f"facetrack: {names}: each is a clip of its own; if they are chapters of one recording, {how}")
    plain = len(inputs) == len(listed) and groups == [[given] for given in inputs]
    return Found(clips, len(clips) > 1 or not plain)


def _listed(given: Path) -> list[Path]:
    """What a list names, `@list.txt` or `@-`; anything else is itself, also a file whose name begins so."""
    if not str(given).startswith("@") or is_there(given):
        return [given]
    name = str(given)[1:]
    path = Path(name)
    try:
        data = sys.stdin.buffer.read(MAX_FILE_BYTES) if name == "-" else read_bounded(path, what="list")
    except OSError as e:
        raise InputError(f"{path}: cannot be read as a list of clips: {reason(e)}; check the name") from e
    lines = [line.rstrip("\r") for line in os.fsdecode(data.removeprefix(b"\xef\xbb\xbf")).split("\n")]
    if b"\0" in data:
        raise InputError(f"{'standard input' if name == '-' else path}: is not a list of clips; it has a path a line")
    found = [Path(line) for line in lines if line.strip() and not line.startswith("#")]
    if not found:
        raise InputError(f"{'standard input' if name == '-' else path}: names no clip; it has a path a line")
    return found


def _clips(given: Path, note: Callable[[str], None]) -> list[Path]:
    """The clips that one input is."""
    check_local(given)
    try:
        if given.is_dir():
            return _of_folder(given, note) or _below(given, note) or [given]
        if re.search(r"[*?\[]", str(given)) and not is_there(given):
            return _of_glob(given, note)
    except OSError as e:
        raise from_system(e) or InputError(f"{e.filename or given}: {reason(e)}; check the permissions") from e
    return [given]


def _of_glob(given: Path, note: Callable[[str], None]) -> list[Path]:
    matches = _sorted(Path(name) for name in glob.glob(str(given), recursive=True))  # noqa: PTH207 -- any of its parts
    if not matches:
        raise InputError(f"{given}: matches no file; check the name")
    folders = [one for one in matches if one.is_dir()]
    files = [one for one in matches if not one.is_dir()]
    pictures = {one for one in files if is_image(one)}
    videos = [one for one in files if one not in pictures]
    if pictures and not videos and not folders:
        return [given]
    _left_out(given, len(pictures), note)
    return videos + [clip for folder in folders for clip in _of_folder(folder, note)]


def _of_folder(folder: Path, note: Callable[[str], None]) -> list[Path]:
    """The clips right in a folder: it itself, its videos, or none. A run's folder has none."""
    if (folder / NAME).exists():
        return []
    names = [name for name in os.listdir(folder) if not name.startswith(".")]  # noqa: PTH208 -- of many, fast
    paths = [folder / name for name in names]
    videos = sorted(filter(is_clip, paths), key=lambda path: images.natural_key(path.name))
    pictures = [path for path in {*paths}.difference(videos) if path.suffix.lower() in images.SUFFIXES]
    if not videos:
        return [folder] if any(path.is_file() for path in pictures) else []
    _left_out(folder, len(pictures), note)
    return videos


def _below(folder: Path, note: Callable[[str], None]) -> list[Path]:
    inside = _sorted(one for one in folder.iterdir() if not one.name.startswith(".") and one.is_dir())
    return [clip for one in inside for clip in _of_folder(one, note)]


def _left_out(given: Path, pictures: int, note: Callable[[str], None]) -> None:
    if pictures:
        what = "1 image beside the videos is" if pictures == 1 else f"{pictures} images beside the videos are"
        note(f"facetrack: warning: {given}: {what} left out; give images a folder of their own")


def _sorted(paths: Iterable[Path]) -> list[Path]:
    return sorted(paths, key=lambda path: images.natural_key(str(path)))
