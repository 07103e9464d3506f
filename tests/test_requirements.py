"""The versions that CI installs are those that pyproject.toml allows."""

import re
import sys
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

if sys.version_info >= (3, 11):
    import tomllib
else:
    tomllib = pytest.importorskip("tomli")

ROOT = Path(__file__).parents[1]

pytestmark = pytest.mark.skipif(not (ROOT / ".ci").is_dir(), reason="a source distribution has no .ci")


def _declared(*extras: str) -> list[Requirement]:
    """The packages of the program and of these extras, and those of extras that they name."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lists = [project["dependencies"], *(project["optional-dependencies"][name] for name in extras)]
    found = [Requirement(line) for lines in lists for line in lines]
    more = {extra for one in found if one.name == project["name"] for extra in one.extras}
    own = [one for one in found if one.name != project["name"]]
    return own if more <= set(extras) else _declared(*sorted({*extras, *more}))


def _pinned(name: str) -> list[tuple[str, Version, bool]]:
    """The lines of a file of pins: package, version, and whether it is for this Python."""
    text = (ROOT / ".ci" / name).read_text(encoding="utf-8")
    lines = [Requirement(line) for line in re.findall(r"^[^#\s][^\\\n#]*", text, re.MULTILINE)]
    return [
        (canonicalize_name(one.name), Version(str(one.specifier)[2:]), one.marker is None or one.marker.evaluate())
        for one in lines
    ]


def test_the_lowest_versions_are_those_that_are_declared():
    pins = {name: version for name, version, _ in _pinned("lowest.txt")}
    for one in _declared("test", "samples"):
        lowest = next(Version(s.version) for s in one.specifier if s.operator == ">=")
        pin = pins[canonicalize_name(one.name)]
        # the first file of a version: 4.13 is 4.13.0.90 of opencv-python-headless
        assert pin.release[: len(lowest.release)] == lowest.release and pin in one.specifier, one


def test_the_locked_versions_are_allowed():
    pins = _pinned("requirements.txt")
    for one in _declared("dev", "browser", "samples"):
        own = [(version, here) for name, version, here in pins if name == canonicalize_name(one.name)]
        assert sum(here for _, here in own) == 1 and all(version in one.specifier for version, _ in own), one


@pytest.mark.parametrize(("name", "extras"), [("bare.txt", ()), ("container.txt", ("plot", "detect", "people"))])
def test_the_locked_versions_of_a_user_are_allowed(name, extras):
    pins = {package: version for package, version, here in _pinned(name) if here}
    assert all(pins[canonicalize_name(one.name)] in one.specifier for one in _declared(*extras))


LOCKS = {"requirements.txt": 50, "bare.txt": 15, "container.txt": 25, "tools.txt": 20, "fuzz.txt": 0}


@pytest.mark.parametrize("name", LOCKS)
def test_the_lock_has_a_hash_of_each_package_and_names_no_index(name):
    text = (ROOT / ".ci" / name).read_text(encoding="utf-8")
    blocks = re.split(r"^(?=[^#\s])", text, flags=re.MULTILINE)[1:]
    assert len(blocks) > LOCKS[name] and all("--hash=sha256:" in block for block in blocks)
    assert "://" not in text and "index-url" not in text
