"""Confidence and status from distances alone; a calibration's file, and what it does to the rows of a recipe."""

import json
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from facetrack_cli.core.errors import InputError, RecipeError
from facetrack_cli.core.types import Frame
from facetrack_cli.engine import confidence as judging
from facetrack_cli.engine.confidence import Calibration, Isotonic, Logistic, boxes_of, load_calibration
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import ConfidenceSettings
from facetrack_cli.runs.api import track_video
from facetrack_cli.trajectory.trajectory import SPREAD, build
from tests.support.samples import FOLDER, from_tools

fitting = from_tools("calibration_fit")

X0 = np.array([[50.0, 50.0], [80.0, 50.0]])
WINDOWS = np.array([[10.0, 10.0], [20.0, 12.0]])


class Ring:
    """A likelihood whose windows near the parts are off by 0.1, those beside by 0.4 and 0.2, and a blank by 0.3."""

    def distances(self, learned, frame, x):
        if np.all(frame.bgr == frame.bgr[0, 0]):
            return np.full(x.shape[:2], 0.3)
        # how far off, in windows: the same in every direction
        off = np.sqrt(np.sum(((x - X0) / WINDOWS) ** 2, axis=2))
        assert np.allclose(off, 1.0) or np.allclose(off, 1 / 13)
        return np.full(x.shape[:2], [0.4, 0.2]) if off[0, 0] > 0.5 else np.full(x.shape[:2], 0.1)


def begin(**options):
    """The functions of confidence.py with these settings, and what they say of the first frame."""
    settings = ConfidenceSettings(**options)
    confidence = SimpleNamespace(begin=partial(judging.begin, settings), judge=partial(judging.judge, settings))
    frame = Frame(0, 0.0, np.arange(300, dtype=np.uint8).reshape(10, 10, 3))
    return confidence, confidence.begin(partial(Ring().distances, None), frame, X0, WINDOWS)


def test_the_first_frame_is_sure_and_sets_the_levels_between_which_confidence_falls():
    confidence, judgement = begin()
    assert judgement.status == ("init", "init")
    np.testing.assert_array_equal(judgement.confidence, 1.0)
    np.testing.assert_allclose(judgement.good, 0.1)
    # the first by the blank window, the second by the ring
    np.testing.assert_allclose(judgement.bad, [0.3, 0.2])
    for distances, expected in (((0.1, 0.05), 1.0), ((0.2, 0.15), 0.5), ((0.3, 0.3), 0.0)):
        np.testing.assert_allclose(confidence.judge(judgement, np.array(distances)).confidence, expected)


def test_lost_after_patience_and_tracked_at_once():
    confidence, judgement = begin(lost_below=0.3, patience=3)
    judgement = confidence.judge(judgement, np.array([0.1, 0.1]))
    seen = []
    for distance in (0.5, 0.5, 0.5, 0.5, 0.1):
        judgement = confidence.judge(judgement, np.array([distance, 0.1]))
        seen.append(judgement.status)
    assert seen == [("tracked",) * 2] * 2 + [("lost", "tracked")] * 2 + [("tracked", "tracked")]


def test_what_is_good_is_not_learned_from_what_is_bad():
    confidence, judgement = begin()
    judgement = confidence.judge(judgement, np.array([0.1, 0.1]))
    for _ in range(500):
        judgement = confidence.judge(judgement, np.array([0.5, 0.12]))
    np.testing.assert_allclose(judgement.good, [0.1, 0.12], atol=1e-3)


def test_without_a_memory_what_is_good_stays_what_the_first_frame_said():
    def after(**options):
        confidence, judgement = begin(**options)
        for _ in range(40):
            judgement = confidence.judge(judgement, np.array([0.15, 0.12]))
        return judgement

    np.testing.assert_allclose(after(memory=None).good, 0.1)
    np.testing.assert_allclose(after(memory=5).good, [0.15, 0.12], rtol=1e-3)
    assert np.all(after(memory=None).confidence < after(memory=5).confidence)


# --- calibration: the file


POINTS = Logistic(
    intercept=-1.0, coefficients={"confidence": 2.0, "spread": -0.5, "ess": 0.1, "lost": -1.0}, least=0.01
)
BOX = Isotonic(score="confidence", knots=[[0.0, 0.1], [0.5, 0.2], [1.0, 0.75]])
BY = {"points": 2.0, "box": 0.5}


def calibration(**maps):
    checked = {kind: {"rows": 10, "ece": 0.1} for kind in maps}
    spread = {kind: BY[kind] for kind in maps}
    return Calibration(
        recipe="sir", maps=maps, lost=0.3, spread=spread, checked=checked, clips=["a.mp4", "b.mp4"], seeds=2
    )


BOTH = calibration(points=POINTS, box=BOX)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "both.json"
    path.write_text(BOTH.model_dump_json(), encoding="utf-8")
    return path


def rows(**columns):
    """A point in three frames and a box in one."""
    known = {"confidence": [1.0, 0.6, np.nan, 0.75], "status": ["init", "lost", "absent", "tracked"]}
    known |= {"w": [8.0, 8.0, np.nan, 40.0], "h": [8.0, 8.0, np.nan, 10.0]}
    known |= {"std_x": [0.0, 3.0, np.nan, 3.0], "std_y": [0.0, 4.0, np.nan, 4.0], "ess": [100.0, 10.0, np.nan, 1.0]}
    known |= {"particles": [100.0] * 4, "cov_xy": [0.0, -2.0, np.nan, 1.0]} | columns
    return build([("face", "nose"), ("face", "box")], [0, 0, 0, 1], [0, 1, 2, 1], **known)


def test_a_file_is_read_as_it_was_written(file):
    assert load_calibration(file) == BOTH


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"format": "facetrack-gallery"}, "format: Input should be"),
        ({"maps": {"points": {"method": "logistic", "intercept": "1", "coefficients": {}}}}, "points.logistic.int"),
        ({"maps": {"box": {"method": "isotonic", "score": "confidence", "knots": []}}}, "knots"),
        ({"colour": 1}, "colour"),
    ],
)
def test_a_damaged_file_is_refused_in_a_line_that_names_it(file, change, said):
    stored = {**json.loads(file.read_text(encoding="utf-8")), **change}
    file.write_text(json.dumps(stored), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        load_calibration(file)
    line = str(refused.value)
    assert line.startswith(f"{file}: ") and said in line and "\n" not in line and "tools/calibrations.py" in line


# --- rows -----------------------------------------------------------------------------------------------------------


def test_features_by_hand():
    given = rows()
    known = fitting.features(vars(given), np.array([False, False, False, True]), 50.0)
    assert known["spread"][[0, 1, 3]].tolist() == pytest.approx([np.log(1e-3), np.log(5 / 50), np.log(5 / 20)])
    assert known["ess"][[0, 1, 3]].tolist() == pytest.approx([0, -1, -2])
    assert known["log_odds"][1] == pytest.approx(np.log(0.61 / 0.41)) and known["lost"].tolist() == [0, 1, 0, 0]
    assert known["size"][[0, 1, 3]].tolist() == pytest.approx([np.log(50), np.log(50), np.log(20)])
    # a single point has no distance to others, but a window
    assert fitting.features(vars(given), np.zeros(4, np.bool_), 0.0)["spread"][1] == pytest.approx(np.log(5 / 8))


def test_points_and_boxes_have_maps_of_their_own():
    given = rows()
    found = BOTH.applied(given, 50.0)
    point = 1 / (1 + np.exp(-(-1 + 2 * 0.6 - 0.5 * np.log(0.1) - 0.1 - 1)))
    # what was given is certain; of what is absent nothing is known
    np.testing.assert_allclose(found.confidence, [1.0, point, np.nan, 0.475])
    assert replace(found, confidence=given.confidence).columns().keys() == given.columns().keys()
    for name, values in given.columns().items():
        if name not in ("confidence", "status", *SPREAD):
            np.testing.assert_array_equal(found.columns()[name], values)
    # of the point that is lost p is above 1/2, of the tracked box below
    assert given.status.tolist() == ["init", "lost", "absent", "tracked"] and point > 0.5
    assert found.status.tolist() == ["init", "hidden", "absent", "lost"]
    np.testing.assert_allclose(found.std_x, given.std_x * [2, 2, 2, 0.5])
    np.testing.assert_allclose(found.cov_xy, given.cov_xy * [4, 4, 4, 0.25])


@pytest.mark.parametrize("size", [0.0, 50.0])
@pytest.mark.parametrize("score", ["confidence", "spread", POINTS])
def test_the_kernel_maps_rows_as_what_fitted_the_map_does(score, size):
    rng = np.random.default_rng(6)
    names = [("face", part) for part in ("nose", "box")]
    columns = {name: rng.uniform(0.001, 60, 40) for name in ("w", "h", "std_x", "std_y", "ess")}
    columns |= {
        "particles": np.full(40, 50.0),
        "confidence": rng.random(40),
        "status": rng.choice(["lost", "tracked"], 40),
    }
    columns["confidence"][3], columns["ess"][4], columns["std_x"][5] = np.nan, np.nan, np.nan
    given = build(names, np.arange(40) % 2, np.arange(40) // 2, **columns)
    knots = [[0.1, 0.9], [0.3, 0.4], [0.4, 0.1]] if score == "spread" else [[0.1, 0.1], [0.3, 0.4], [0.4, 0.9]]
    maps = {"points": Isotonic(score=score, knots=knots), "box": POINTS}
    found = calibration(**maps).applied(given, size)
    known, boxes = fitting.features(vars(given), boxes_of(given), size), boxes_of(given)
    p = np.where(boxes, *(fitting.probability(maps[kind], known) for kind in ("box", "points")))
    p = np.where(given.status == "lost", np.minimum(p, 0.3), p)
    kept = np.isnan(given.confidence) | np.isnan(given.ess)
    np.testing.assert_allclose(found.confidence, np.where(kept, given.confidence, p))
    lost, sure = given.status == "lost", np.where(kept, np.nan, p)
    expected = np.where(sure < 0.5, "lost", np.where(lost & ~np.isnan(sure), "hidden", given.status))
    np.testing.assert_array_equal(found.status, expected)


def test_of_a_lost_box_and_its_points_nothing_is_likely():
    """Three points and a box, all in one frame: as long as the box is seen a point is hidden, and after that lost."""
    names = [("face", part) for part in ("nose", "mouth_left", "box")]
    columns = {"w": [8.0, 8.0, 40.0], "h": [8.0, 8.0, 10.0], "std_x": [0.1] * 3, "std_y": [0.1] * 3, "ess": [90.0] * 3}
    columns |= {"particles": [100.0] * 3, "cov_xy": [0.0] * 3, "confidence": [0.9] * 3}
    both = calibration(points=Logistic(intercept=2.0, coefficients={}, least=0.01), box=BOX)
    for box, point, sure in (("tracked", "hidden", 1 / (1 + np.exp(-2))), ("lost", "lost", 0.3)):
        given = build(names, [0, 1, 2], [4, 4, 4], status=["tracked", "lost", box], **columns)
        found = both.applied(given, 50.0)
        assert found.status.tolist() == ["tracked", point, box]
        np.testing.assert_allclose(found.confidence[1], sure)
        assert found.confidence[0] > 0.8 and (found.confidence[2] > 0.5) == (box == "tracked")


def test_without_a_map_for_a_part_its_confidence_is_not_known():
    found = calibration(points=POINTS).applied(rows(), 50.0)
    assert np.isnan(found.confidence[3]) and np.isfinite(found.confidence[1])
    assert calibration(box=BOX).applied(rows(), 50.0).confidence[0] == 1.0  # in the first frame


# --- recipes --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("recipe", "clip"),
    [
        ("factorized_robust", "occlusion"),
        ("adaptive_robust", "lamp"),
        ("face", "occlusion"),
    ],
)
def test_a_calibration_changes_confidence_and_spread_alone(file, recipe, clip):
    raw, found = (
        track_video(FOLDER / f"{clip}.mp4", load_recipe(recipe, {"confidence.calibration": name}), stop=9)
        for name in (None, str(file))
    )
    for name in ("x", "y", "w", "h", "angle", "ess", "particles"):
        assert getattr(found, name).tobytes() == getattr(raw, name).tobytes(), name
    assert found.header["recipe"]["confidence"]["calibration"] == str(file)
    later = raw.status != "init"
    own = np.isnan(raw.ess)  # of points without particles
    assert np.array_equal(found.confidence == raw.confidence, own | ~later) and np.all(found.confidence[~later] == 1.0)
    of_box = np.array([part == "box" for _, part in raw.names])[raw.which]
    np.testing.assert_allclose(found.std_y, raw.std_y * np.where(own, 1.0, np.where(of_box, 0.5, 2.0)))
    boxes = of_box & later
    np.testing.assert_allclose(found.confidence[boxes], fitting.probability(BOX, {"confidence": raw.confidence[boxes]}))


def test_what_gives_no_confidence_has_none_to_calibrate():
    with pytest.raises(RecipeError, match="gives no confidence; remove the calibration"):
        load_recipe("contour_correlation", {"likelihood.contour": None, "confidence.calibration": "x.json"})
