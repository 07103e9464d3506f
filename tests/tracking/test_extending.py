"""Sections from outside of the package, as docs/extending.md shows them: its code is executed here."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from importlib import metadata
from typing import ClassVar, Literal

import numpy as np
import pytest
from pydantic import Field

from facetrack_cli.core.errors import ExitCode, RecipeError
from facetrack_cli.engine.loop import track
from facetrack_cli.engine.protocols import Motion
from facetrack_cli.recipe import sections
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import completed, json_schema, register, to_dict
from facetrack_cli.recipe.sections import FilterSettings, LikelihoodSettings, Refusal, Section
from facetrack_cli.runs import clip, record
from facetrack_cli.runs.plan import Job
from facetrack_cli.runs.signals import Stop
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.start.init_file import read_init
from facetrack_cli.trackers.smoothed import lagged
from facetrack_cli.trajectory.diagnostics import EVIDENCE
from facetrack_cli.video.source import open_source
from tests.support.results import rows_of
from tests.support.samples import FOLDER, from_tools, read_rows
from tests.test_docs import ROOT, blocks

PAGE = ROOT / "docs" / "extending.md"
MODULES = ("grey_difference", "heavy_tails", "lazy_sir")
PLUGGED = "likelihood={type: grey_difference, sigma: 8}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The modules of the page as files that can be imported."""
    folder = tmp_path_factory.mktemp("outside")
    for block in blocks(PAGE, "python"):
        if named := re.match(r"# (\w+\.py)\n", block):
            (folder / named[1]).write_text(block, encoding="utf-8")
    assert sorted(path.stem for path in folder.iterdir()) == sorted(MODULES)
    sys.path.insert(0, str(folder))
    yield folder
    sys.path.remove(str(folder))
    for name in MODULES:
        sys.modules.pop(name, None)


@pytest.fixture
def registry(folder):
    """Afterwards the registry is as it was."""
    sections.registered(LikelihoodSettings)
    before = {kind: dict(types) for kind, types in sections._types.items()}
    yield
    sections._types.update(before)


@pytest.fixture
def plugged(registry):
    """The first example of the page has been executed."""
    return executed("sigma: 8}")


def executed(part, names=None):
    """The names that the first block of code of the page leaves that has `part` and no file's name."""
    names = {} if names is None else names
    exec(next(one for one in blocks(PAGE, "python") if part in one and not one.startswith(("#", " "))), names)
    return names


def followed(recipe, stop=25):
    """Mean distance in pixels of the estimates from the ground truth, and the rows of all frames, joined."""
    start = read_init(FOLDER / "occlusion.init.yaml")
    truth = {(row["frame"], row["part"]): (float(row["x"]), float(row["y"])) for row in read_rows("occlusion")}
    with open_source(FOLDER / "occlusion.mp4", stop=stop) as source:
        results = list(track(build_tracker(recipe, start), source, 3))
    parts = [part for one in results for part in rows_of(one.rows)]
    off = [np.hypot(*np.subtract(truth[str(part.frame), part.part], (part.x, part.y))) for part in parts]
    assert len(results) == stop
    return np.mean(off), rows_of(results[-1].rows)


def refused(*overrides, config="sir"):
    with pytest.raises(RecipeError) as caught:
        load_recipe(config, overrides)
    return str(caught.value)


# --- the page's examples follow a clip


def test_the_likelihood_follows_a_clip(plugged):
    recipe = plugged["recipe"]
    assert recipe.likelihood == plugged["GreyDifference"](type="grey_difference", sigma=8.0)
    off, parts = followed(recipe, stop=12)
    assert off < 1.5
    assert {part.status for part in parts} == {"tracked"} and np.mean([part.confidence for part in parts]) > 0.6


def test_what_the_likelihood_reports_is_in_the_trajectory(plugged, monkeypatch):
    monkeypatch.chdir(ROOT)
    names = executed("diagnostics[", plugged)
    found, module = names["found"], sys.modules["grey_difference"]
    assert len(found) == 25 and np.isnan(found[0]) and ((found[1:] > 0) & (found[1:] < 60)).all()
    # it is the one that was declared, and its values are those of the likelihood at the estimate
    rows, recipe = names["trajectory"], plugged["recipe"]
    assert rows.diagnostics["face"].declared == (module.DIFFERENCE, EVIDENCE)
    [target] = build_tracker(recipe, read_init(FOLDER / "occlusion.init.yaml"))
    with open_source(FOLDER / "occlusion.mp4", stop=25) as source:
        frames = list(source)
    learned = target.likelihood.init(frames[0], target.x0)
    last = rows.between(24, 25)
    x = np.stack([last.x, last.y], axis=1)[np.argsort(last.which)][None]
    distances = 255 * target.likelihood.distances(learned, frames[24], x)
    assert found[24] == pytest.approx(np.sqrt(np.square(distances).mean()))


def test_all_three_together_follow_a_clip(registry):
    recipe = executed("LazySir")["recipe"]
    assert [one.type for one in (recipe.likelihood, recipe.motion, recipe.filter)] == [
        "grey_difference", "student_walk", "lazy_sir",
    ]  # fmt: skip
    off, parts = followed(recipe)
    assert off < 5  # a target that stands still is off by 7.8
    ess = [part.ess for part in parts]
    assert all(1 <= one <= recipe.particles == 500 for one in ess)


def test_rows_by_the_motion_are_smoothed(registry):
    recipe, start = executed("LazySir")["recipe"], read_init(FOLDER / "occlusion.init.yaml")
    with open_source(FOLDER / "occlusion.mp4", stop=12) as source:
        results = list(track(build_tracker(recipe, start), source, 3))
    after = list(lagged(results, 4))
    jitter, less = (np.abs(np.diff([one.rows.x for one in each], n=2, axis=0)).mean() for each in (results, after))
    assert less < 0.7 * jitter
    module = sys.modules["heavy_tails"]
    without = type("Rough", (Motion,), {"propagate": module.Steps.propagate, "expect": module.Steps.expect})()
    with pytest.raises(TypeError, match="Rough has no linear form, which --smooth and --lag take"):
        without.linear(np.zeros((5, 2)))


def test_a_state_that_cannot_be_stored_costs_the_checkpoint_alone(plugged, tmp_path, monkeypatch):
    monkeypatch.setattr(record, "EVERY_FRAMES", 2)
    job, stop = Job(FOLDER / "occlusion.mp4", plugged["recipe"], tmp_path / "whole", stop=9, video=False), Stop()
    done = clip.run(job, Stop())
    assert done.failure is None and done.frames == 9 and done.warnings == ()

    def report(frames, total):
        stop.code = ExitCode.INTERRUPTED if frames == 6 else stop.code

    done = clip.run(replace(job, out=tmp_path / "part"), stop, report)
    assert done.failure is None and done.frames == 6 and done.warnings == (
        "no checkpoint: grey_difference.Learned cannot be stored; the same command begins at the first frame",
    )  # fmt: skip


# --- messages, schema and tables know of it


def test_messages_recipes_that_are_read_back_the_schema_and_the_tables_know_of_it(plugged):
    assert refused("likelihood.type=grey_diference").endswith("""'grey_difference', not "grey_diference\"""")
    wrong = 'likelihood type "grey_difference" does not go with target type "region"; write product or skin_ncc'
    assert wrong in refused(PLUGGED, config="histogram")
    assert "write colour_ratio or window_ncc or grey_difference" in refused("likelihood={type: skin}")
    assert "sigma: Input should be less than or equal to 255, not 300" in refused(
        "likelihood={type: grey_difference, sigma: 300}"
    )
    settings = to_dict(plugged["recipe"])
    assert settings["likelihood"] == {"type": "grey_difference", "sigma": 8.0} and completed(settings) == settings
    assert completed({**settings, "likelihood": {"type": "grey_difference"}})["likelihood"]["sigma"] == 20.0
    schema = json_schema()
    assert schema["$defs"]["GreyDifference"]["properties"]["sigma"]["maximum"] == 255
    mapping = schema["$defs"]["ParticleRecipe"]["properties"]["likelihood"]["discriminator"]["mapping"]
    assert mapping["grey_difference"] == "#/$defs/GreyDifference"
    tables = from_tools("commands_doc").keys_tables()
    assert "`grey_difference`: Mean squared difference of grey levels" in tables
    assert "| `likelihood.sigma` | number > 0, ≤ 255 | `20.0` | For `grey_difference` only. Standard" in tables


def test_every_engine_that_a_section_names_is_there():
    for kind in sections.KINDS:
        for section in sections.registered(kind).values():
            assert callable(sections.pkgutil.resolve_name(section.engine)), section
            assert section.goes_with or kind is sections.TargetSettings
    engines = re.findall(r"engine = \"(.*)\"", PAGE.read_text(encoding="utf-8"))
    assert engines and all(one.startswith("facetrack_cli.trackers.points.") for one in engines)


# --- what cannot be registered


class Known(LikelihoodSettings):
    """A likelihood that is fine."""

    goes_with = ("points",)
    type: Literal["known"]

    def build(self, context):
        raise AssertionError


def likelihood(**changes):
    """A class like `Known` in another place, with other attributes."""
    name = changes.pop("name", "another")
    annotations = {"type": Literal[name]} if name else {}
    body = {"goes_with": ("points",), "build": Known.build, "__annotations__": annotations, **changes}
    return type("Another", (LikelihoodSettings,), body)


def nothing_built(base):
    return type("Another", (base,), {"goes_with": ("points",), "__annotations__": {"type": Literal["x"]}})


def test_what_is_no_section_is_refused(registry):
    for section, error, why in (
        *(
            (nothing, TypeError, "is no section: derive it from one of")
            for nothing in (int, Section, likelihood(name=""))
        ),
        (likelihood(goes_with=()), TypeError, r'Another goes with no type of target: add goes_with = \("points",\)'),
        (nothing_built(LikelihoodSettings), TypeError, "Another builds nothing: give it a method build"),
        (nothing_built(FilterSettings), TypeError, "Another builds nothing"),
        (likelihood(name="colour_ratio"), ValueError, 'type "colour_ratio" is taken by .*; choose another'),
    ):
        with pytest.raises(error, match=why):
            register(section)
    register(Known)
    with pytest.raises(ValueError, match='the likelihood type "known" is taken by'):
        register(likelihood(name="known"))
    assert refused("likelihood.type=another").endswith('not "another"')


def test_a_section_may_have_rules_of_its_own(registry):
    class Strict(FilterSettings):
        """A filter that wants a prior."""

        goes_with: ClassVar[tuple[str, ...]] = ("points",)
        type: Literal["strict"]
        particles: int = Field(ge=1)

        def build(self, context):
            raise context.error("filter.particles", "too few")

        def mismatches(self, whole):
            if whole.prior is None:
                yield Refusal(("filter", "type"), "filter type strict needs a prior")

    register(Strict)
    strict = "filter={type: strict, particles: 3}"
    assert refused(strict) == f"--set {strict}: filter type strict needs a prior"
    recipe = load_recipe("factorized", [strict])
    with pytest.raises(RecipeError) as caught:
        build_tracker(recipe, read_init(FOLDER / "occlusion.init.yaml"))
    assert str(caught.value) == f"--set {strict}: too few"


# --- packages that bring sections


def test_an_installed_package_brings_its_sections(folder, tmp_path):
    info = tmp_path / "site" / "grey-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: grey\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[facetrack.sections]\ngrey_difference = grey_difference:GreyDifference\n")
    path = os.pathsep.join(map(str, (tmp_path / "site", folder, ROOT)))
    options = ["--config", "sir", "--stop", "3", "--no-video", "-q", "-o", "out", "--format", "csv,json"]
    done = subprocess.run(
        [sys.executable, "-m", "facetrack_cli", "run", FOLDER / "occlusion.mp4", *options, "--set", PLUGGED],
        capture_output=True, text=True, env={**os.environ, "PYTHONPATH": path}, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "trajectory.csv").read_text().count("tracked") == 10
    whole = json.loads((tmp_path / "out" / "trajectory.json").read_text())
    assert [one["name"] for one in whole["diagnostics"]] == ["difference"]
    assert ["difference" in frame["targets"][0] for frame in whole["frames"]] == [False, True, True]


@pytest.mark.parametrize(
    ("value", "why"),
    [
        ("grey_difference:Nothing", "has no attribute 'Nothing'"),
        ("grey_difference:GreyWindows", "is no section: derive it from one of"),
    ],
)
def test_a_package_whose_section_fails_is_named(folder, monkeypatch, value, why):
    monkeypatch.setattr(sections, "_types", {})
    point = metadata.EntryPoint("grey_difference", value, sections.GROUP)
    monkeypatch.setattr(sections, "_brought", lambda: [point])
    with pytest.raises(RecipeError) as refused:
        sections.registered(LikelihoodSettings)
    said = str(refused.value)
    assert f"the entry point grey_difference = {value} of ? brings no section: " in said and why in said
    assert "correct or uninstall that package" in said and "\n" not in said
