"""What is committed beside the package: sample clips, notebook, pinned versions, workflows and the container."""

import json
import re
import sys
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version
from ruamel.yaml import YAML

from facetrack_cli.start.init_file import read_init
from tests.fuzz import guided
from tests.support.samples import FOLDER, read_pictures, read_rows

CLIPS = sorted(path.stem for path in FOLDER.glob("*.mp4") if path.stem != "film")  # which is joined from the others


def test_clips_are_small_and_the_film_has_two_people():
    assert max(path.stat().st_size for path in FOLDER.glob("*.mp4")) < 1_000_000
    assert {row["target"] for row in read_rows("film")} == {"collins", "hopper"}


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", CLIPS)
def test_the_truth_of_a_clip_has_a_row_for_each_frame_and_part(name):
    pictures, rows = read_pictures(name), read_rows(name)
    assert pictures.shape[1:] == (240, 320, 3) and 150 <= len(pictures) <= 300
    parts = [(r["target"], r["part"]) for r in rows if r["frame"] == "0"]
    expected = [(str(t), f"{t / 25:.2f}", *part) for t in range(len(pictures)) for part in parts]
    assert [(r["frame"], r["time_s"], r["target"], r["part"]) for r in rows] == expected
    assert {r["status"] for r in rows} <= {"visible", "hidden"}


@pytest.mark.parametrize("name", CLIPS)
def test_the_init_file_is_the_truth_of_the_first_frame(name):
    start = read_init(FOLDER / f"{name}.init.yaml")
    assert start.frame == 0
    for row in read_rows(name):
        if row["frame"] != "0":
            continue
        target = start.targets[row["target"]]
        if row["part"] in target.points:
            assert target.points[row["part"]] == pytest.approx((float(row["x"]), float(row["y"])))
            continue
        left, top, width, height = target.box
        # pixel centres are at whole numbers, so a box has its middle half a pixel before left + width / 2
        box = left + (width - 1) / 2, top + (height - 1) / 2, width, height
        assert box == pytest.approx([float(row[key]) for key in "xywh"], abs=0.011)


NOTEBOOK = Path(__file__).parent.parent / "docs" / "notebook.ipynb"
CODE = [cell for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]


def test_it_holds_no_outputs():
    assert CODE and all(cell["outputs"] == [] and cell["execution_count"] is None for cell in CODE)


def test_its_cells_run(monkeypatch, tmp_path, capsys):
    """In one namespace, without a kernel: that would be one more package for the same statements."""
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("agg")
    monkeypatch.chdir(NOTEBOOK.parent)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    names = {}
    for i, cell in enumerate(CODE):
        exec(compile("".join(cell["source"]), f"{NOTEBOOK.name}, code cell {i + 1}", "exec"), names)
    said = capsys.readouterr().out
    assert "['absent'] ['init']" in said and "mouth_left" in said
    assert names["after"] < names["before"], said
    assert len(names["wide"].read_text(encoding="utf-8").splitlines()) == 121
    names["plt"].close("all")


if sys.version_info >= (3, 11):
    import tomllib
else:
    tomllib = pytest.importorskip("tomli")

ROOT = Path(__file__).parents[1]

needs_ci = pytest.mark.skipif(not (ROOT / ".ci").is_dir(), reason="a source distribution has no .ci")


def _declared(*extras) -> list[Requirement]:
    """The packages of the program and of these extras, and those of extras that they name."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lists = [project["dependencies"], *(project["optional-dependencies"][name] for name in extras)]
    found = [Requirement(line) for lines in lists for line in lines]
    more = {extra for one in found if one.name == project["name"] for extra in one.extras}
    own = [one for one in found if one.name != project["name"]]
    return own if more <= set(extras) else _declared(*sorted({*extras, *more}))


def _pinned(name) -> list[tuple[str, Version, bool]]:
    """The lines of a file of pins: package, version, and whether it is for this Python."""
    text = (ROOT / ".ci" / name).read_text(encoding="utf-8")
    lines = [Requirement(line) for line in re.findall(r"^[^#\s][^\\\n#]*", text, re.MULTILINE)]
    return [
        (canonicalize_name(one.name), Version(str(one.specifier)[2:]), one.marker is None or one.marker.evaluate())
        for one in lines
    ]


@needs_ci
def test_the_lowest_versions_are_those_that_are_declared():
    pins = {name: version for name, version, _ in _pinned("lowest.txt")}
    for one in _declared("test", "samples"):
        lowest = next(Version(s.version) for s in one.specifier if s.operator == ">=")
        pin = pins[canonicalize_name(one.name)]
        # the first file of a version: 4.13 is 4.13.0.90 of opencv-python-headless
        assert pin.release[: len(lowest.release)] == lowest.release and pin in one.specifier, one


@needs_ci
@pytest.mark.parametrize(
    ("name", "extras"),
    [
        ("requirements.txt", ("dev", "browser", "samples")),
        ("bare.txt", ()),
        ("container.txt", ("plot", "detect", "people")),
    ],
)
def test_the_locked_versions_are_allowed(name, extras):
    pins = {package: version for package, version, here in _pinned(name) if here}
    for one in _declared(*extras):
        own = [version for package, version, _ in _pinned(name) if package == canonicalize_name(one.name)]
        assert canonicalize_name(one.name) in pins and all(version in one.specifier for version in own), one


LOCKS = {"requirements.txt": 50, "bare.txt": 15, "container.txt": 25, "tools.txt": 20, "fuzz.txt": 0}


@needs_ci
@pytest.mark.parametrize("name", LOCKS)
def test_the_lock_has_a_hash_of_each_package_and_names_no_index(name):
    text = (ROOT / ".ci" / name).read_text(encoding="utf-8")
    blocks = re.split(r"^(?=[^#\s])", text, flags=re.MULTILINE)[1:]
    assert len(blocks) > LOCKS[name] and all("--hash=sha256:" in block for block in blocks)
    assert "://" not in text and "index-url" not in text


WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))

needs_workflows = pytest.mark.skipif(not WORKFLOWS, reason="a source distribution has no workflows")


def read(path):
    return YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))


@needs_workflows
@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_a_workflow_takes_what_is_pinned(path):
    text = path.read_text(encoding="utf-8")
    uses = re.findall(r"uses: (.+)", text)
    assert uses and all(re.fullmatch(r"[\w.-]+(/[\w.-]+)+@[0-9a-f]{40} # v\d+\.\d+\.\d+", one) for one in uses)
    for words in re.findall(r"pip install ([^\n&]+)", text):
        assert words.startswith(("--require-hashes ", "--no-deps ")), words


@needs_workflows
@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_a_workflow_has_few_rights_and_an_end(path):
    whole = read(path)
    assert whole["permissions"] == {"contents": "read"}
    for name, job in whole["jobs"].items():
        assert job["timeout-minutes"] <= 350, name
        for step in job["steps"]:
            if "checkout" in step.get("uses", ""):
                assert step["with"]["persist-credentials"] is False, name


@needs_workflows
def test_the_nightly_workflow_runs_each_fuzzer_every_night():
    whole = read(ROOT / ".github" / "workflows" / "nightly.yml")
    jobs = whole["jobs"]
    assert whole["on"]["schedule"] and jobs["fuzz"]["strategy"]["matrix"]["parser"] == [*guided.parsers()]
    assert any("-m ''" in step.get("run", "") for step in jobs["tests"]["steps"])


@needs_workflows
def test_the_container_is_of_one_image_and_has_a_user():
    lines = (ROOT / "Dockerfile").read_text(encoding="utf-8").splitlines()
    assert all(re.search(r"@sha256:[0-9a-f]{64}$", line) for line in lines if line.startswith("FROM "))
    [user] = [line for line in lines if line.startswith("USER ")]
    assert int(user.split()[1]) > 0
