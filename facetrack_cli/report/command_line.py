"""A run's recipe and start as YAML, and the command that repeats the run."""

import contextlib
import json
import re
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from facetrack_cli.core.errors import FacetrackError
from facetrack_cli.core.face_points import DETECTORS
from facetrack_cli.core.models import shipped_recipes
from facetrack_cli.core.types import Correction, Start
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import completed, to_dict
from facetrack_cli.start.init_file import as_yaml, read_init
from facetrack_cli.trajectory.header import CORRECTED, ClipHeader, Header, InitHeader
from facetrack_cli.video.files import brings_rate
from facetrack_cli.video.source import FOLDER_FPS

# texts that YAML reads as such without quotes, also within brackets; but for words that it reads as something else
_PLAIN = re.compile("(?!(?:null|true|false|yes|no|on|off|y|n)$)[a-z_][a-z0-9_./-]*", re.IGNORECASE)


def recipe_yaml(recipe: Mapping[str, Any]) -> str:
    """A recipe file of these settings; lists and inner mappings stand on one line each."""
    lines = []
    for key, value in recipe.items():
        if isinstance(value, Mapping) and value:
            lines += [f"{key}:", *(f"  {_flow(inner)}: {_flow(each)}" for inner, each in value.items())]
        elif key != "name":
            lines.append(f"{key}: {_flow(value)}")
    return "\n".join(lines) + "\n"


def _flow(value: Any) -> str:
    """A value as YAML on one line."""
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{_flow(key)}: {_flow(inner)}' for key, inner in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_flow, value))}]"
    return value if isinstance(value, str) and _PLAIN.fullmatch(value) else json.dumps(value, ensure_ascii=False)


def init_yaml(header: Header) -> str:
    """The start and the corrections of a run, as an init file."""
    return as_yaml(header.init.start, header.clip_name)


def command(header: Header, last: int, folder: Path | None = None) -> str:
    """The command that makes the run again, up to the frame `last`. A recipe that differs from the shipped ones is a
    file NAME.yaml. Corrections are in the run's init file or `folder`; else in `CORRECTED`, an init file to be made.
    """
    words = ["facetrack", "run", header.source.path, *_recipe_words(header), "--seed", str(header.seed)]
    words += [*_init_words(header.init, folder), "--stop", str(last + 1), *_rate_words(header.source)]
    if header.split is not None:
        words += ["--split", header.split.length]
    words += ["-o", "again"]
    return shlex.join(words)


def _recipe_words(header: Header) -> list[str]:
    name = header.recipe_name
    shipped = next((str(file) for file in shipped_recipes() if file.stem == name), None)
    try:
        if shipped is not None:
            recipe = {key: value for key, value in header.recipe.items() if key != "name"}
            ours, wanted = to_dict(load_recipe(shipped)), completed(recipe) | {"seed": 0}
            overrides = [f"{key}={value}" for key, value in _differences(ours | {"seed": 0}, wanted)]
            if to_dict(load_recipe(shipped, overrides)) | {"seed": 0} == wanted:
                return ["--config", name, *(word for override in overrides for word in ("--set", override))]
    except (FacetrackError, TypeError, ValueError):  # of another version, or beyond what --set can say
        pass
    return ["--config", f"{name}.yaml"]


def _differences(ours: Mapping[str, Any], wanted: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, str]]:
    """(key, value as YAML) of each difference; a mapping with other keys as a whole."""
    for key, value in wanted.items():
        own = ours.get(key)
        if isinstance(value, Mapping) and isinstance(own, Mapping) and value.keys() == own.keys():
            yield from _differences(own, value, f"{above}{key}.")
        elif value != own:
            yield f"{above}{key}", _flow(value)


def _init_words(init: InitHeader, folder: Path | None) -> list[str]:
    at = ["--init-frame", str(init.frame)]
    if init.corrections:
        beside = [] if folder is None else [str(folder / CORRECTED)]
        for name in (init.origin, *beside):
            with contextlib.suppress(FacetrackError):
                found = read_init(Path(name))
                if _corrections(found) == _corrections(init.start):
                    return ["--init", name, *([] if found.frame == init.frame else at)]
        return ["--init", CORRECTED]
    first = next(iter(init.targets.values()), None)
    if init.origin in DETECTORS:
        return ["--init", init.origin, *(at if init.frame else [])]
    if init.origin == "--box" and first is not None and first.box is not None:
        return ["--box", ",".join(f"{side:.12g}" for side in first.box), *(at if init.frame else [])]
    same = False
    with contextlib.suppress(FacetrackError):
        same = read_init(Path(init.origin)).frame == init.frame
    return ["--init", init.origin, *([] if same else at)]


def _corrections(start: Start) -> list[Correction]:
    """Without the names of targets, since a recipe may call a face the head."""
    return [replace(one, target="") for one in start.corrections]


def _rate_words(source: ClipHeader) -> list[str]:
    path, folder, rate = Path(source.path), False, Fraction(source.fps).limit_denominator(1001)
    with contextlib.suppress(FacetrackError, OSError, ValueError):
        folder = not brings_rate(path) or (not path.exists() and not path.suffix)
    stream = [] if source.stream is None else ["--stream", str(source.stream)]
    return [*stream, *(["--fps", str(rate)] if folder and rate != FOLDER_FPS else [])]
