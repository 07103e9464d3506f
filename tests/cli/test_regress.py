"""facetrack regress as its users meet it: what passes, what fails and how it is told, what is recorded."""

import json
import os
import shutil
import signal
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import ExitCode
from facetrack_cli.evaluation import goldens
from facetrack_cli.evaluation.goldens import Checked, as_junit, find_goldens, read_golden
from facetrack_cli.trackers.points.colour_ratio import ColourRatio
from tests.support.samples import FOLDER

# elements, their attributes and what they may hold, as in the xunit plugin of Jenkins, junit-10.xsd
SCHEMA = {
    "testsuites": (set(), {"testsuite"}),
    "testsuite": ({"name", "tests", "failures", "errors", "skipped"}, {"testcase"}),
    "testcase": ({"name", "time", "classname"}, {"skipped", "failure"}),
    "failure": ({"message"}, set()),
    "skipped": ({"message"}, set()),
}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A folder with the start of a clip and a golden of it."""
    folder = tmp_path_factory.mktemp("clips")
    for name in ("occlusion.mp4", "occlusion.init.yaml", "occlusion.truth.csv"):
        shutil.copy(FOLDER / name, folder)
    assert main(["regress", str(folder), "--config", "factorized", "--update", "--stop", "26", "-q"]) == 0
    return folder


@pytest.fixture
def clips(recorded, tmp_path):
    return Path(shutil.copytree(recorded, tmp_path / "clips"))


def golden_of(folder):
    (path,) = find_goldens(folder)
    return path


def edit(path, **changes):
    data = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps({**data, **changes}), encoding="utf-8")


def elsewhere(path):
    """As if the golden had been recorded with another numpy."""
    edit(path, versions={**read_golden(path).versions, "numpy": "1.0"})


def check_junit(path):
    root = ElementTree.parse(path).getroot()
    assert root.tag == "testsuites"
    for element in root.iter():
        attributes, children = SCHEMA[element.tag]
        assert set(element.attrib) <= attributes and {child.tag for child in element} <= children
    for suite in root.iter("testsuite"):
        cases = suite.findall("testcase")
        assert suite.get("tests") == str(len(cases)) and all(case.get("name") for case in cases)
        for kind, tag in (("failures", "failure"), ("skipped", "skipped")):
            assert suite.get(kind) == str(len(suite.findall(f"testcase/{tag}")))
    return root


@pytest.fixture
def shifted(monkeypatch):
    """A likelihood that looks a pixel and a half beside the particle."""
    asked = ColourRatio.distances
    monkeypatch.setattr(ColourRatio, "distances", lambda s, a, f, x: asked(s, a, f, x + np.array([1.5, 0.0])))


def test_an_unchanged_tracker_passes_and_the_reports_say_so(facetrack, clips, tmp_path):
    xml, data = tmp_path / "r.xml", tmp_path / "r.json"
    code, out, err = facetrack("regress", clips, "--junit", xml, "--json", data)
    assert code == ExitCode.DONE and err == ""
    assert out.splitlines()[0].startswith("occlusion.mp4 factorized: ok (the same rows; ")
    assert out.splitlines()[1].startswith("1 golden in ") and out.endswith(": 1 ok, 0 FAIL\n")
    case = check_junit(xml).find("testsuite/testcase")
    assert case is not None and (case.get("classname"), case.get("name")) == ("occlusion.mp4", "factorized")
    assert float(case.get("time", "0")) > 0 and len(case) == 0
    found = json.loads(data.read_text())
    assert (found["ok"], found["fails"], found["skipped"]) == (1, 0, 0)
    assert found["results"][0]["farthest"] < 1 and found["results"][0]["seeds"] == 1
    again, out, err = facetrack("regress", clips, "--junit", xml)
    assert again == ExitCode.USAGE and "--overwrite" in err and out == "", "refused before anything runs"
    assert facetrack("regress", clips, "--junit", xml, "--overwrite")[0] == ExitCode.DONE


@pytest.mark.parametrize("other_versions", [False, True])
def test_a_likelihood_that_is_off_fails_and_is_told(other_versions, facetrack, clips, tmp_path, shifted):
    if other_versions:
        elsewhere(golden_of(clips))
    xml, data = tmp_path / "r.xml", tmp_path / "r.json"
    code, out, _ = facetrack("regress", clips, "--junit", xml, "--json", data)
    assert code == ExitCode.REGRESSION
    first, *more = out.splitlines()
    assert first.startswith("occlusion.mp4 factorized: FAILS: ") and more[-1].endswith("0 ok, 1 FAILS")
    assert ("FAILS: other rows than recorded from frame 1 on" in first) is not other_versions
    assert ": mean x " in out and ", of recorded seeds " in out and ("numpy 1.0" in out) is other_versions
    failure = check_junit(xml).find(".//failure")
    assert failure is not None and failure.get("message") == first.split("FAILS: ")[1]
    assert "mean x" in (failure.text or "")
    result = json.loads(data.read_text())["results"][0]
    assert result["status"] == "fails" and result["farthest"] > 1


def test_a_row_that_was_changed_fails(facetrack, clips):
    path = golden_of(clips)
    (frame, part, x, y, reach), *rows = read_golden(path).rows
    edit(path, rows=[[frame, part, x + 2 * reach + 2, y, reach], *rows])
    said = f" px from its golden row of frame {frame}, recorded seeds up to {reach:.4g} px"
    for change in (lambda path: None, elsewhere):
        change(path)
        code, out, _ = facetrack("regress", clips)
        assert code == ExitCode.REGRESSION and f"{part}: " in out and said in out


def test_a_change_within_the_spread_fails_with_the_same_versions(facetrack, clips, monkeypatch):
    asked, rng = ColourRatio.distances, np.random.default_rng()
    monkeypatch.setattr(ColourRatio, "distances", lambda s, a, f, x: asked(s, a, f, x) + rng.normal(0, 1e-6))
    code, out, _ = facetrack("regress", clips)
    assert code == ExitCode.REGRESSION and "other rows than recorded from frame " in out
    assert "    they are within the spread of seeds" in out
    elsewhere(golden_of(clips))
    code, out, _ = facetrack("regress", clips)
    assert code == ExitCode.DONE and " % of the spread of 10 seeds; " in out
    assert "    not as recorded: numpy 1.0 -> " in out


def test_a_changed_recipe_is_told_and_compared_all_the_same(facetrack, clips):
    code, out, _ = facetrack("regress", clips, "--set", "motion.sigma=0.25")
    assert code == ExitCode.REGRESSION
    assert "not as recorded: motion.sigma 0.1 -> 0.25; record again with --update" in out
    code, _, err = facetrack("regress", clips, "--set", "motion.sigm=0.25")
    assert code == ExitCode.USAGE and 'unknown key "sigm"' in err  # a mistake in the option is no regression
    code, out, _ = facetrack("regress", clips, "--set", "confidence.patience=4")
    assert code == ExitCode.DONE and "confidence.patience 3 -> 4" in out and ": ok (" in out


def longer(clips):
    with (clips / "occlusion.mp4").open("ab") as file:
        file.write(b"\0")


def renamed(clips):
    path = golden_of(clips)
    path.write_text(path.read_text(encoding="utf-8").replace("face/nose", "face/chin"), encoding="utf-8")


@pytest.mark.parametrize(
    ("damage", "code", "said"),
    [
        (longer, ExitCode.REGRESSION, "is not the one recorded; restore it, or record again"),
        (lambda clips: (clips / "occlusion.mp4").unlink(), ExitCode.REGRESSION, "is not there; put it back, or remove"),
        (renamed, ExitCode.REGRESSION, "tracks face/nose, face/mouth_left"),
        (renamed, ExitCode.REGRESSION, "recorded were face/chin, "),
        (lambda clips: golden_of(clips).write_text("{"), ExitCode.INPUT, "is no golden"),
        (lambda clips: edit(golden_of(clips), recipe="no_such_recipe"), ExitCode.REGRESSION,
         'FAILS: "no_such_recipe" is neither a file nor a shipped recipe'),
    ],
)  # fmt: skip
def test_what_cannot_be_compared_fails(damage, code, said, facetrack, clips):
    damage(clips)
    found, out, err = facetrack("regress", clips)
    assert found == code and said in out + err


def test_what_cannot_run_here_is_skipped(facetrack, clips, tmp_path, monkeypatch):
    edit(golden_of(clips), recipe="kcf")
    monkeypatch.setattr(goldens, "find_opencv", lambda tracker: None)
    xml = tmp_path / "r.xml"
    code, out, _ = facetrack("regress", clips, "--junit", xml)
    assert code == ExitCode.DONE and "skipped: the installed OpenCV has no KCF tracker" in out
    assert "0 ok, 0 FAIL, 1 skipped" in out
    skipped = check_junit(xml).find(".//skipped")
    assert skipped is not None and "KCF" in skipped.get("message", "")


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        ((), ExitCode.INPUT, "has no goldens; record some with facetrack regress"),
        (("--update",), ExitCode.INPUT, "has no goldens; record some with facetrack regress"),
        (("--update", "--config", "sir"), ExitCode.INPUT, "has no clip with an init file beside it"),
        (("--update", "--config", "nonsense"), ExitCode.USAGE, '"nonsense" is neither a file nor a shipped recipe'),
        (("--update", "--set", "seed=1"), ExitCode.USAGE, "--update records recipes as they are"),
        (("--seeds", "30"), ExitCode.USAGE, "go with --update"),
        (("--junit", "a", "--json", "a"), ExitCode.USAGE, "name the same file"),
    ],
)
def test_what_there_is_nothing_to_do_with_is_told_in_a_line(arguments, code, said, facetrack, tmp_path):
    (tmp_path / "few").mkdir()
    (tmp_path / "few" / "clip.csv").write_text("")
    found, out, err = facetrack("regress", tmp_path / "few", *arguments)
    assert found == code and said in err and out == "" and err.count("\n") <= 2
    assert [p.name for p in (tmp_path / "few").iterdir()] == ["clip.csv"]


def test_a_recipe_of_the_user_is_found_from_the_folder_of_clips(facetrack, clips):
    shutil.rmtree(clips / "goldens")
    assert main(["recipes", "show", "factorized"]) == 0
    facetrack("recipes")  # drops what was printed
    text = (FOLDER.parent / "configs" / "factorized.yaml").read_text(encoding="utf-8")
    (clips / "mine.yaml").write_text(text.replace("particles: 100", "particles: 30"), encoding="utf-8")
    code, out, _ = facetrack("regress", clips, "--config", clips / "mine.yaml", "--update", "--stop", 12)
    assert code == 0 and out == f"occlusion.mp4 mine: wrote {golden_of(clips)} (10 seeds)\n"
    assert read_golden(golden_of(clips)).recipe == "mine.yaml"
    assert facetrack("regress", clips)[0] == ExitCode.DONE
    before = golden_of(clips).read_bytes()
    assert facetrack("regress", clips, "--update")[0] == ExitCode.DONE
    assert golden_of(clips).read_bytes() == before, "the same seeds and frames, the same golden"
    code, _, err = facetrack("regress", clips, "--config", "sir")
    assert code == ExitCode.INPUT and "has no golden of sir, only of mine" in err


def test_what_cannot_be_recorded_does_not_stop_the_others(facetrack, clips):
    (clips / "broken.mp4").write_bytes(b"nothing")
    shutil.copy(clips / "occlusion.init.yaml", clips / "broken.init.yaml")
    code, out, _ = facetrack("regress", clips, "--config", "factorized", "--update", "--stop", 6)
    assert code == ExitCode.BATCH
    assert "broken.mp4 factorized: not recorded: " in out and "occlusion.mp4 factorized: wrote " in out


@pytest.mark.parametrize("update", [True, False])
def test_an_interrupt_leaves_the_goldens_as_they_were(update, facetrack, clips, tmp_path, monkeypatch):
    run = goldens.run_plans
    elsewhere(golden_of(clips))
    before = golden_of(clips).read_bytes()

    def interrupted(plans, stopped, workers, report):
        def tell(done, total):
            if done > 40:
                os.kill(os.getpid(), signal.SIGINT)
            report(done, total)

        yield from run(plans, workers, stopped, tell)

    monkeypatch.setattr(goldens, "run_plans", interrupted)
    arguments = ["--update"] if update else ["--junit", tmp_path / "r.xml"]
    code, out, err = facetrack("regress", clips, *arguments)
    assert code == ExitCode.INTERRUPTED and out == "" and "interrupted" in err
    assert golden_of(clips).read_bytes() == before and not (tmp_path / "r.xml").exists()
    assert [p.name for p in (clips / "goldens").iterdir()] == ["occlusion.factorized.json"]


def test_junit_escapes_what_xml_cannot_hold(tmp_path):
    nasty = 'a <b> & "c" \x00\x1b[31m ]]> \ud800'
    path = tmp_path / "r.xml"
    fails = Checked(Path("golden"), nasty, nasty, "fails", nasty, (nasty,))
    path.write_text(as_junit([fails, replace(fails, status="skipped")]), encoding="utf-8")
    failure, clean = check_junit(path).find(".//failure"), 'a <b> & "c" \ufffd\ufffd[31m ]]> \ufffd'
    assert failure is not None and failure.text == f"{clean}\n{clean}"


# --- the shipped goldens -------------------------------------------------------------------------------------------

FEW = ["occlusion.factorized", "expressions.sir"]


def verdict(stem, monkeypatch, *overrides):
    """Of a shipped golden, as if its versions were others."""
    monkeypatch.setattr(goldens, "versions", lambda: {"numpy": "1.0"})
    asked = [one for one in goldens.recorded(FOLDER, {}) if one.path.stem == stem]
    (found,) = goldens.regress(FOLDER, asked, overrides=overrides)
    return found


@pytest.mark.nightly
@pytest.mark.parametrize("stem", FEW)
@pytest.mark.parametrize(
    "change", ["motion.sigma=0.07", "motion.sigma=0.13", "likelihood.sigma=1.95", "likelihood.sigma=1.05"]
)
def test_a_sigma_that_is_off_by_30_percent_fails(stem, change, monkeypatch):
    found = verdict(stem, monkeypatch, change)
    assert found.status == "fails" and (found.farthest or 0) > 1


@pytest.mark.nightly
@pytest.mark.parametrize("stem", [*FEW, "map.skin_ncc_robust"])
@pytest.mark.parametrize("first_seed", [300, 400, 500])
def test_unseen_seeds_pass(stem, first_seed, monkeypatch):
    monkeypatch.setattr(goldens, "UNSEEN", first_seed)
    found = verdict(stem, monkeypatch)
    assert found.status == "ok" and found.seeds == 4
