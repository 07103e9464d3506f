"""Tests see no model that the machine happens to have, except those that ask for `mesh_model` or `iris_model`."""

import os
from pathlib import Path

import pytest

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.models import VARIABLE, fetch_model, model_path

GIVEN = "FACETRACK_TEST_MODELS"  # what the variable was, also for the processes that share the tests


def hide_models() -> None:
    """Name a folder that is not there, for this process and those that it starts."""
    os.environ.setdefault(GIVEN, os.environ.get(VARIABLE, ""))
    os.environ[VARIABLE] = str(Path(__file__).with_name("no_models"))


def model_file(shared: Path, patch: pytest.MonkeyPatch, name: str) -> Path:
    """The file of a model: in the folder that was given, else downloaded into `shared`, by one process for all."""
    if os.environ[GIVEN]:
        patch.setenv(VARIABLE, os.environ[GIVEN])
        if path := model_path(name):
            return path
    patch.setenv(VARIABLE, str(shared))
    patch.setenv("PIP_RETRIES", "1")
    fcntl = pytest.importorskip("fcntl", reason="needs a lock between processes")
    shared.mkdir(exist_ok=True)
    failed = shared / "failed.txt"
    with (shared / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            if not failed.exists():
                return model_path(name) or fetch_model(name)
        except InputError as error:
            failed.write_text(str(error))
    pytest.skip(failed.read_text())
