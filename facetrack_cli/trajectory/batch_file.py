"""`batch-<8 hex>.json` among the results of a batch: its clips, and the folder of each. The same batch has the same."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.files import MOST, cannot_write, check_readable, make_folder, replacing


class BatchFile(BaseModel):
    """The contents: clip and name of its folder, as often as there are clips."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    format: Literal["facetrack-batch"] = "facetrack-batch"
    version: Literal[1] = 1
    recipe: str
    clips: tuple[tuple[str, str], ...]


def write_batch(out: Path, recipe: str, clips: Sequence[Path], names: Sequence[str]) -> Path:
    """Write the file of a batch into its folder, which is made. Raises OutputError."""
    pairs = [(as_text(str(clip)), as_text(name)) for clip, name in zip(clips, names, strict=True)]
    data = BatchFile(recipe=recipe, clips=tuple(pairs)).model_dump_json(indent=1).encode() + b"\n"
    path = out / f"batch-{hashlib.sha256(data).hexdigest()[:8]}.json"
    make_folder(out)
    try:
        if not path.exists():
            with replacing(path) as file:
                file.write(data)
    except OSError as e:
        raise cannot_write(path, e) from e
    return path


def batches(folder: Path) -> Iterator[BatchFile]:
    """Those of a folder. Raises InputError for one that is not as we write it, and OSError."""
    for path in sorted(folder.glob("batch-????????.json")):
        check_readable(path, MOST)
        try:
            yield BatchFile.model_validate_json(path.read_bytes())
        except ValidationError as e:
            raise InputError(f"{path}: is not as facetrack run writes it; remove it, and run again") from e


def as_text(name: str) -> str:
    """A name as JSON holds it: bytes that are no text are escaped."""
    return name.encode(errors="backslashreplace").decode()
