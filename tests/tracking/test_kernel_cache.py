"""Where compiled kernels go on an installation that its user cannot write."""

import os
import stat
import tempfile
from pathlib import Path

import pytest

from facetrack_cli.tracking.kernels import cache as kernel_cache

posix = pytest.mark.skipif(os.name != "posix", reason="owners and modes of POSIX")


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A user without NUMBA_CACHE_DIR, whose home and temporary folder are in `tmp_path`."""
    # set first, so that what provide_cache sets is taken back
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def unwritable(monkeypatch, *parts):
    monkeypatch.setattr(kernel_cache, "_writable", lambda folder: not any(part in folder for part in parts))


def test_nothing_is_set_where_numba_finds_a_place(place, monkeypatch):
    kernel_cache.provide_cache()
    assert "NUMBA_CACHE_DIR" not in os.environ
    unwritable(monkeypatch, "__pycache__")
    kernel_cache.provide_cache()
    assert "NUMBA_CACHE_DIR" not in os.environ


@posix
def test_else_a_folder_of_the_users_own(place, monkeypatch):
    unwritable(monkeypatch, "__pycache__", "home")
    kernel_cache.provide_cache()
    folder = Path(os.environ.pop("NUMBA_CACHE_DIR"))
    assert folder == place / f"facetrack-kernels-{os.getuid()}"
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    kernel_cache.provide_cache()
    assert os.environ["NUMBA_CACHE_DIR"] == str(folder), "it is found again"


@posix
@pytest.mark.parametrize("how", ["open to all", "link", "file"])
def test_a_folder_that_others_may_have_filled_is_not_used(place, monkeypatch, how):
    unwritable(monkeypatch, "__pycache__", "home")
    planted = place / f"facetrack-kernels-{os.getuid()}"
    if how == "open to all":
        planted.mkdir()
        planted.chmod(0o777)
    elif how == "link":
        (place / "elsewhere").mkdir(mode=0o700)
        planted.symlink_to(place / "elsewhere")
    else:
        planted.write_text("")
    kernel_cache.provide_cache()
    used = Path(os.environ["NUMBA_CACHE_DIR"])
    assert used != planted and used.is_dir() and stat.S_IMODE(used.stat().st_mode) == 0o700


def test_whether_a_folder_can_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    assert kernel_cache._writable(str(tmp_path))
    assert kernel_cache._writable(str(tmp_path / "not" / "yet"))
    assert not kernel_cache._writable(str(tmp_path / "file" / "below"))
