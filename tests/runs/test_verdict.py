"""What a run says at its end: where it began, what bears it out, which frames to look at, and what to do next."""

import json
from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.core.face_points import HANDS
from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.clip import EVERY_FRAMES, RunMonitor
from facetrack_cli.runs.plan import Outcome
from facetrack_cli.trackers.face.detectors import Detection
from tests.support.results import part, result, target


class Sees:
    """A detector that sees a face in every n-th look."""

    name = "haar"

    def __init__(self, every):
        self.every, self.count = every, 0

    def measure(self, image, box):
        self.count += 1
        return Detection(box, {}) if self.every and self.count % self.every == 0 else None


BLACK = np.zeros((60, 80, 3), np.uint8)


def frame_of(i, pixels=BLACK):
    return Frame(i, i / 25, pixels)


def watched(statuses, confidences, *, sees=None, first=0, origin="--box", calibrated=True):
    start = Start(first, {"face": TargetStart((30.0, 20.0, 20.0, 20.0))}, origin)
    watch = RunMonitor(start, calibrated=calibrated, fitted=calibrated, detector=sees)
    for i, (status, confidence) in enumerate(zip(statuses, confidences, strict=True), first):
        box = part("box", 40, 30, 20, 20, confidence=confidence, status=status)
        watch.write(result(frame_of(i), [target("face", [box])]))
    return watch


def test_where_it_began_and_which_frames_to_look_at():
    statuses = ["init", *["tracked"] * 9, *["lost"] * 5, *["tracked"] * 5, "lost"]
    sure = [1.0, *[0.9] * 8, 0.6, *[0.1] * 5, *[0.95] * 5, 0.1]
    assert watched(statuses, sure, first=18).line() == (
        "called lost in 6 of 21 frames; begins in frame 18 (0:00.72), by --box, 18 frames of the clip are before it; "
        "look at frames 28 to 32, 38 (lost), 27 (lowest confidence, 0.60)"
    )
    many = watched(["lost", "tracked"] * 400, [0.1, 0.9] * 400)
    assert len(many.lost) <= 4 and len(many.look) == 3 and many.lost_frames == 400, "memory does not grow with the clip"


@pytest.mark.parametrize(
    ("looks", "lost_looks", "every", "doubtful", "said"),
    [
        (10, 0, 1, False, "haar sees a face there in 10 of 10 looks"),
        (10, 0, 4, True, "doubtful: haar sees a face there in 2 of 10 looks alone"),
        (5, 4, 1, False, "haar sees a face there in 5 of 5 looks"),
        (1, 0, 0, False, "never called lost"),
        (2, 0, 0, False, "never called lost"),
        (3, 0, 0, True, "doubtful: haar sees"),
    ],
)
def test_a_track_that_no_detector_confirms_is_doubtful(looks, lost_looks, every, doubtful, said):
    statuses = ["tracked"] * looks * EVERY_FRAMES + ["lost"] * lost_looks * EVERY_FRAMES
    watch = watched(statuses, [1.0] * len(statuses), sees=Sees(every), origin="haar")
    assert bool(watch.doubts()) == doubtful and said in watch.line()


def test_a_low_calibrated_confidence_is_doubtful():
    low = ["init"] + ["tracked"] * 20, [1.0] + [0.49] * 20
    assert watched(*low).line().startswith("doubtful: its confidence expects 49% of its rows to be right")
    raw = watched(*low, calibrated=False).line()
    assert raw.startswith("never called lost") and raw.endswith("(lowest confidence, 0.49, not calibrated)")
    assert not watched(["init"] + ["tracked"] * 3, [1.0] + [float("nan")] * 3).doubts()  # it says nothing


def test_of_points_alone_the_box_of_the_start_moves_with_them():
    seen = []

    class Looks(Sees):
        def measure(self, image, box):
            seen.append(image[56:104, 56:104].mean())

    picture = np.zeros((120, 160, 3), np.uint8)
    picture[50:90, 70:110] = 255  # where the box has moved to
    start = Start(0, {"face": TargetStart((20.0, 30.0, 40.0, 40.0), {"nose": (40.0, 50.0)})}, "haar")
    watch = RunMonitor(start, calibrated=False, fitted=False, detector=Looks(0))
    for i in range(EVERY_FRAMES):
        watch.write(result(frame_of(i, picture), [target("face", [part("nose", 90, 70, 5, 5, confidence=1.0)])]))
    assert seen == [255.0]


def test_a_hand_that_is_taken_for_a_face_is_said_to_be_doubtful(facetrack):
    few = ["--set", "filter.particles=30", "--no-video", "--start", "40", "--stop", "110", "-o", "a b"]
    code, _, err = facetrack("run", "IN/hands.mp4", "--init", "haar", "--config", "ncc", *few)  # which shows no face
    said = err.splitlines()
    assert code == 0 and "doubtful: haar sees a face there in" in said[-2]
    assert "43 frames of the clip are before it" in said[-2]
    assert said[-1] == "look: facetrack report 'a b'; correct: facetrack fix 'a b'"
    [warning] = json.loads(Path("a b/trajectory.json").read_text())["warnings"]  # for the report
    assert f"doubtful: {warning};" in said[-2] and not any("warning" in line for line in said)
    start = ["run", "IN/hands.mp4", "--box", "10,20,60,60", "--stop", "3", "--no-video", "-o"]
    assert facetrack(*start, "c", "-q") == (0, "", "")
    assert "facetrack fix" not in facetrack(*start, "d", "--format", "csv")[2], "which needs the JSON"


@pytest.mark.parametrize("recipe", ["face", "head_hands", "adaptive"])
def test_the_face_of_a_recipe_is_looked_at(recipe):
    start = Start(0, {"face": TargetStart((30.0, 20.0, 20.0, 20.0))}, "haar")
    watch = RunMonitor.of(load_recipe(recipe), start)
    assert watch.detector is not None and RunMonitor.of(load_recipe(recipe), Start(0, {}, "--box")).detector is None


def signing(named, statuses):
    start = Start(0, {"head": TargetStart((30.0, 20.0, 20.0, 20.0))}, "--box")
    watch = RunMonitor(start, calibrated=False, fitted=False, detector=None)
    for i, (p, status) in enumerate(zip(named, statuses, strict=True)):
        head = target("head", [part("box", 40, 30, 20, 20, confidence=1.0, status="tracked")])
        place = (None, None) if status == "absent" else (20, 50)
        hand = part("box", *place, 9, 9, confidence=0.95, status=status)
        hands = [target(name, [hand], reported={"named": p, "present": 0.9}) for name in HANDS]
        watch.write(result(frame_of(i), [head, *hands]))
    return watch


def test_a_run_in_which_no_hand_appears_is_doubtful():
    never = signing([0.5] * 20, ["absent"] * 20)
    assert never.line().startswith("doubtful: no hand appears in its 20 frames; if another face signs, begin with its")
    assert not signing([1.0] * 20, ["absent"] * 19 + ["tracked"]).doubts()
    assert not watched(["tracked"] * 5, [1.0] * 5).doubts(), "nobody follows hands there"


def test_frames_in_which_names_of_hands_are_in_doubt_are_told():
    p = np.full(60, 0.99)
    p[10:15], p[20], p[30:33], p[40:50] = 0.6, 0.7, 0.55, 0.5
    watch = signing(p.tolist(), ["tracked"] * 60)
    assert "which hand is which is in doubt in frames 10 to 14, 30 to 32, 40 to 49" in watch.line()
    assert "which hand is which" not in signing([0.99] * 30, ["tracked"] * 30).line()
    assert "which hand is which" not in signing([0.5] * 30, ["lost"] * 30).line(), "there is no row to doubt"


def test_the_line_of_a_run_names_the_parts_that_are_lost_most():
    lost = {f"face/{name}": n for n, name in enumerate(("nose", "chin", "jaw", "brow", "lip"), 1)}
    named = "face lip in 5, face brow in 4, face jaw in 3, face chin in 2 frames"
    assert Outcome(frames=9, lost_frames=lost).summary().endswith(f"lost: {named}, and other parts")
    del lost["face/nose"]
    assert Outcome(frames=9, lost_frames=lost).summary().endswith(f"lost: {named}")
