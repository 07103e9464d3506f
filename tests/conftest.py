"""What holds for every test."""

import base64
import gc
import os
import signal
import sys
import threading
from collections import Counter
from copy import copy
from functools import wraps
from hashlib import sha1
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.models import VARIABLE, fetch_model, model_path
from facetrack_cli.report import make
from facetrack_cli.report.make import Image
from facetrack_cli.trackers.face import detectors
from facetrack_cli.trackers.people import descriptor
from tests.support.samples import FOLDER

PIXEL = "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAQAAAC1HAwCAAAAC0lEQVR42mNkYAAAAAYAAjCB0C8AAAAASUVORK5CYII="
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


# a shell starts what it puts into the background with Ctrl-C ignored, and every process that the tests start inherits
# that: the tests of Ctrl-C would wait for a signal that never comes
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# images of containers often set this: each process, also of the next session, would compile all modules anew
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

hide_models()

# property tests try the same examples each time; HYPOTHESIS_PROFILE=nightly tries ten times as many, new ones each time
for profile, examples in {"default": 20, "nightly": 200}.items():
    unhealthy = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
    settings.register_profile(
        profile, max_examples=examples, deadline=None, suppress_health_check=unhealthy, derandomize=profile == "default"
    )
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "default"))


_ASKED = []  # whether the test that runs has asked for Haar cascades in vain, beside an OpenCV without them, as 5 is
_IN_VAIN = set()  # files of tests in which a fixture did
_check = detectors.check_cascades


def _checked():
    if not detectors.has_cascades():
        _ASKED.append(True)
    _check()


detectors.check_cascades = _checked


def _skips_without_cascades(item):
    _ASKED.clear()
    try:
        return (yield)
    except Exception:
        # a fixture of the module fails with its first test, and is not asked again
        if _ASKED:
            _IN_VAIN.add(item.path)
        if _ASKED or item.path in _IN_VAIN:
            pytest.skip("needs the Haar cascades of OpenCV 4")
        raise


pytest_runtest_setup = pytest.hookimpl(wrapper=True)(_skips_without_cascades)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    _IN_VAIN.discard(item.path)  # its fixtures were made
    return (yield from _skips_without_cascades(item))


def pytest_xdist_auto_num_workers():
    """A process more than there are cores: many tests wait for others that they started."""
    return (os.cpu_count() or 1) + 1


def pytest_collection_modifyitems(items):
    """Of a test that is marked `one_in(n)`, every n-th case runs by day, and all with `nightly`."""
    seen = Counter()
    for item in items:
        if marked := item.get_closest_marker("one_in"):
            of = item.nodeid.partition("[")[0]
            if seen[of] % marked.args[0]:
                item.add_marker(pytest.mark.nightly)
            seen[of] += 1


def pytest_collection_finish():
    """What the collection made lives to the end: the collector of garbage need not go through it again and again."""
    gc.collect()
    gc.freeze()


def once(function):
    """The function, which computes what it gives for each image once in a thread."""
    known = {}

    @wraps(function)
    def remembered(*given):
        own = threading.get_ident(), cv2.getNumThreads(), descriptor.embedding_model()
        key = *own, *(hashed(one) if isinstance(one, np.ndarray) else getattr(one, "_model", one) for one in given)
        if key not in known:
            known[key] = function(*given)
        return copy(known[key])

    return remembered


def hashed(image):
    return image.shape, image.dtype.str, sha1(np.ascontiguousarray(image)).digest()


@pytest.fixture(scope="session", autouse=True)
def seen_once():
    """Detectors and dlib's network see an image once: many runs are of the same frames, little else takes longer."""
    with pytest.MonkeyPatch.context() as patch:
        for place, name in ((descriptor, "embedded"), (detectors, "_detect"), (detectors.YuNet, "_detect")):
            patch.setattr(place, name, once(getattr(place, name)))
        yield


@pytest.fixture(scope="module")
def clips():
    """What `IN` stands for in command lines, where a module has no clips of its own."""
    return FOLDER


@pytest.fixture
def facetrack(clips, tmp_path, monkeypatch, capfd):
    """Run a command line in an empty folder, `IN` standing for the module's `clips`: exit code, stdout, stderr."""
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    monkeypatch.delenv("FACETRACK_DEBUG", raising=False)
    threads = cv2.getNumThreads()

    def call(*args):
        code = main([str(arg).replace("IN/", f"{clips}/") for arg in args])
        return code, *capfd.readouterr()

    yield call
    cv2.setNumThreads(threads)


@pytest.fixture
def no_plot(monkeypatch):
    """Reports have a pixel in the place of their plot. Plots have their own tests, and take most of the time."""
    pixel = Image(base64.b64decode(PIXEL), (1, 1), "image/png")
    monkeypatch.setattr(make, "_plot", lambda *_: pixel)


@pytest.fixture(scope="session")
def mesh_model(tmp_path_factory):
    """The real file of the model `mesh`; the test skips where it cannot be had.

    A test that is to use the network sets FACETRACK_MODELS to the folder of this file: no other test sees it.
    """
    with pytest.MonkeyPatch.context() as patch:
        return model_file(models_of(tmp_path_factory, "mesh"), patch, "mesh")


@pytest.fixture(scope="session")
def iris_model(tmp_path_factory):
    """As `mesh_model`, of the model `iris`."""
    with pytest.MonkeyPatch.context() as patch:
        return model_file(models_of(tmp_path_factory, "iris"), patch, "iris")


def models_of(tmp_path_factory, name):
    own = tmp_path_factory.getbasetemp()  # with xdist a folder of each worker, in a folder of the session
    return (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / f"models_{name}"
