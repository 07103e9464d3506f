"""Init files: what is read and refused, what is written is read back; trajectories in which somebody corrected."""

import io
import json
import math
import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.face_points import DETECTORS
from facetrack_cli.core.types import Correction, Start, TargetStart
from facetrack_cli.evaluation.accuracy import measure_confidence, measure_coverage, measure_lost, measure_points
from facetrack_cli.evaluation.rows import match
from facetrack_cli.evaluation.summary import evaluate
from facetrack_cli.report.figures import page
from facetrack_cli.report.figures import style as plot_style
from facetrack_cli.report.make import command, history_of, key_frames, reasons, recipe_yaml
from facetrack_cli.start.assembly import name_targets
from facetrack_cli.start.init_file import as_yaml, check_start, find_init, read_init, write_init
from facetrack_cli.trajectory.formats.boxes import write_mot, write_otb, write_vot
from facetrack_cli.trajectory.formats.tables import write_coco, write_dlc
from facetrack_cli.trajectory.reader import read_header, read_trajectory
from facetrack_cli.trajectory.trajectory import one_part
from facetrack_cli.trajectory.views import Clock
from facetrack_cli.trajectory.writers import WRITERS, RunSummary
from tests.evaluation.test_match import rows, statuses
from tests.support import results
from tests.support.samples import FOLDER
from tests.support.sinks import Alone

BOX = "frame: 0\nbox: [1, 2, 3, 4]\n"
HEAD = "frame: 0\nface:\n  "
POINTS = "frame: 5\nface:\n  points: {nose: [1, 2], lip_upper: [3, 4], lip_lower: [5, 6]}\ncorrections:\n"
SIX = POINTS + "- frame: 6\n  "  # whose keys are in line 6 and below
TWO = "frame: 5\nhead: {box: [1, 2, 30, 40]}\nleft_hand: {box: [5, 6, 30, 40]}\ncorrections:\n"
NOSE = "points: {nose: [1, 2]}"


def write(tmp_path, text, name="clip.init.yaml"):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_reads_the_documented_file(tmp_path):
    text = """
frame: 3
face:
  box: [100, 60, 80, 80]          # left, top, width, height
  points: {nose: [141.0, 112.5], mouth_left: [120, 140], lip_upper: [1, 2], lip_lower: [3, 4]}
  windows: {nose: [25, 21]}
corrections:
- frame: 60
  face: {absent: true}
- frame: 31
  face:
    points: {nose: [137.2, 153.9]}     # by hand
    kept: {lip_lower: [160, 138.4]}
    absent: [lip_upper]
    learn: true
"""
    points = {"nose": (141.0, 112.5), "mouth_left": (120, 140), "lip_upper": (1, 2), "lip_lower": (3, 4)}
    moved, kept = {"nose": (137.2, 153.9)}, {"lip_lower": (160, 138.4)}
    assert read_init(write(tmp_path, text)) == Start(
        3,
        {"face": TargetStart((100, 60, 80, 80), points, {"nose": (25, 21)})},
        str(tmp_path / "clip.init.yaml"),
        (Correction(31, "face", None, moved, kept, ("lip_upper",), learn=True), Correction(60, "face", absent=True)),
    )


ALONE = ({"face": TargetStart((1, 2, 3, 4))},)
BOTH = {"head": TargetStart((1, 2, 30, 40)), "left_hand": TargetStart((5, 6, 30, 40))}
APART = Correction(9, "left_hand", absent=True), Correction(9, "head", (1, 2, 3, 4))
SHORTER = {
    BOX + "corrections: []\n": ALONE,
    "frame: 0\nleft_hand: {box: [1, 2, 3, 4]}\nhead: {points: {a: [1, 2]}}\n": (
        {"left_hand": TargetStart((1, 2, 3, 4)), "head": TargetStart(None, {"a": (1, 2)})},
    ),
    "frame: 0\nanna: {box: [1, 2, 3, 4]}\ncorrections: [{frame: 3, box: [5, 6, 7, 8], learn: false}]\n": (
        {"anna": TargetStart((1, 2, 3, 4))},
        Correction(3, "anna", (5, 6, 7, 8), learn=False),
    ),
    BOX + "corrections: [{frame: 3, face: {absent: [box]}}]\n": (*ALONE, Correction(3, "face", absent=("box",))),
    TWO + "- {frame: 9, left_hand: {absent: true}, head: {box: [1, 2, 3, 4]}}\n": (BOTH, *APART),
    TWO + "- {frame: 9, left_hand: {absent: true}}\n- {frame: 9, head: {box: [1, 2, 3, 4]}}\n": (BOTH, *APART),
    # a start of a box alone leaves the parts to the recipe
    BOX + "corrections:\n- {frame: 3, points: {nose: [5, 6]}, absent: [lip_upper]}\n": (
        *ALONE,
        Correction(3, "face", None, {"nose": (5, 6)}, absent=("lip_upper",)),
    ),
}


@pytest.mark.parametrize("text", SHORTER)
def test_shorter_forms(tmp_path, text):
    start, (targets, *corrections) = read_init(write(tmp_path, text)), SHORTER[text]
    assert list(start.targets.items()) == list(targets.items()) and [*start.corrections] == corrections


MISTAKES = [
    ("frame: 0\nfarme: 0\nbox: [1, 2, 3, 4]\n", 2, 'unknown key "farme"; did you mean "frame"'),
    (HEAD + "box: [1, 2, 3, 4]\n  colour: red\n", 4, 'unknown key "colour"; the keys there are: box, points, windows'),
    ("face: {frame: 0, box: [1, 2, 3, 4]}\n", 1, '"frame" is missing'),
    (
        "frame: 99999999999\nbox: [1, 2, 3, 4]\n",
        1,
        "frame: Input should be less than or equal to 1000000000, not 99999999999",
    ),
    ("frame: 0\nplaced_by: hand\nbox: [1, 2, 3, 4]\n", 2, "placed_by names a detector, haar or yunet"),
    ("frame: 0\n", 1, "no box or points of face"),
    (HEAD + "windows: {nose: [1, 2]}\n", 3, "no box or points of face; add"),
    ("frame: 0\nface:\n", 2, "the target face is a mapping of keys; write box: or points: below its name"),
    (HEAD + "points: {nose: [1, -1e7]}\n", 3, "face.points.nose[2]: Input should be greater than or equal to -1000000"),
    (HEAD + 'points: {"the nose": [1, 2]}\n', 3, '"the nose" is no name; use letters'),
    (
        HEAD + "points: {nose: [1, 2]}\n  windows: {nase: [5, 5]}\n",
        4,
        'windows names "nase", which the start does not have; it has nose',
    ),
    ("- 1\n- 2\n", 1, "an init file is a mapping of keys; write frame: 0"),
    ("", 1, "empty"),
    (POINTS + "  frame: 31\n", 5, "corrections is a list; write - frame: 31"),
    (
        "frame: 0\nface: {box: [1, 2, 3, 4]}\ncorrection: []\n",
        3,
        'unknown key "correction"; did you mean "corrections"?',
    ),
    (POINTS + "- 31\n", 5, "a correction is a mapping of keys; write - frame: 31"),
    (POINTS + f"- face: {{{NOSE}}}\n", 5, 'the key "frame" is missing; add frame: N'),
    (POINTS + f"- {{frame: 5, {NOSE}}}\n", 5, "the track begins in frame 5"),
    (POINTS + "- frame: 6\n", 5, "nothing is corrected here; add points: or box:"),
    (SIX + "face: {}\n", 6, "nothing of face is corrected"),
    (SIX + f"fase: {{{NOSE}}}\n", 6, 'unknown key "fase"; did you mean "face"?'),
    (SIX + "point: {nose: [1, 2]}\n", 6, 'unknown key "point"; did you mean "points"?'),
    ("frame: 0\nface: {box: [1, 2, 3, 4]}\nplacd_by: haar\n", 3, 'unknown key "placd_by"; did you mean "placed_by"?'),
    # the first of several, in whatever order sets are
    ("frame: 0\nbox: [1, 2, 3, 4]\naa: 1\nbb: 1\ncc: 1\ndd: 1\nee: 1\nff: 1\n", 3, 'unknown key "aa"'),
    (SIX + "face:\n    learnt: true\n", 7, 'unknown key "learnt"; did you mean "learn"?'),
    (SIX + "face: [1, 2]\n", 6, "the correction of face is a mapping"),
    (TWO + "- {frame: 6, absent: true}\n", 5, "below its name: head, left_hand"),
    (
        POINTS + f"- {{frame: 6, {NOSE}}}\n- frame: 6\n  face: {{absent: true}}\n",
        7,
        "face is corrected in frame 6 already",
    ),
    (SIX + "absent: [lip_uper]\n", 6, "does not have; it has nose, lip_upper, lip_lower"),
    (SIX + f"{NOSE}\n  kept: {{nose: [1, 2]}}\n", 7, "nose is in points already"),
    (TWO + "- frame: 6\n  head: {box: [1, 2, 3, 4], absent: [box]}\n", 6, "box is in box already"),
    (TWO + "- frame: 6\n  head: {box: [1, 2, 3, 4], kept: {a: [1, 2]}}\n", 6, "nothing is kept beside a box"),
    (SIX + "absent: false\n", 6, "absent: Input should be a valid list, not false"),
    (SIX + "absent: [nose, nose]\n", 6, "nose is in absent already"),
    (SIX + f"{NOSE}\n  confirmed: true\n", 5, "confirmed stand alone"),
    (SIX + "confirmed: [ear]\n", 6, 'confirmed names "ear", which the start'),
    (SIX + "absent: true\n  learn: true\n", 5, "confirmed stand alone"),
]


@pytest.mark.parametrize(("text", "line", "said"), MISTAKES)
def test_a_mistake_is_one_line_with_its_place(tmp_path, text, line, said):
    path = write(tmp_path, text)
    with pytest.raises(InputError) as caught:
        read_init(path)
    message = str(caught.value)
    assert "\n" not in message and said in message
    assert re.match(rf"{re.escape(str(path))}:{line}[: ]", message), message


numbers = st.floats(-1e6, 1e6, allow_nan=False)
sizes = st.floats(0.01, 1e6)
boxes = st.tuples(numbers, numbers, sizes, sizes)
PARTS = ("nose", "no", "_X", "mouth-left", "x1")


@st.composite
def corrections(draw, frame, name):
    learn = draw(st.sampled_from([None, True, False]))
    kind = draw(st.sampled_from(["gone", "confirmed", "box", "points"]))
    if kind == "gone":
        return Correction(frame, name, absent=True)
    if kind == "confirmed":
        sure = draw(st.lists(st.sampled_from(PARTS), max_size=3, unique=True))
        return Correction(frame, name, confirmed=tuple(sure) or True)
    if kind == "box":
        return Correction(frame, name, draw(boxes), learn=learn)
    about = {part: draw(st.sampled_from(["given", "kept", "absent", ""])) for part in PARTS}
    where = {part: draw(st.tuples(numbers, numbers)) for part in PARTS}
    those = {said: [part for part in PARTS if about[part] == said] for said in ("given", "kept", "absent")}
    if not those["given"] + those["absent"]:
        those["absent"] = [part for part in PARTS if part not in those["kept"]][:1] or [those["kept"].pop()]
    points, kept = ({part: where[part] for part in those[said]} for said in ("given", "kept"))
    return Correction(frame, name, None, points, kept, tuple(those["absent"]), learn)


@st.composite
def starts(draw):
    first, targets = draw(st.integers(0, 1000)), {}
    for name in draw(st.lists(st.sampled_from(["face", "no", "hand"]), min_size=1, unique=True)):
        points = {part: draw(st.tuples(numbers, numbers)) for part in PARTS}
        windows = {part: draw(st.tuples(sizes, sizes)) for part in PARTS[:1]}
        targets[name] = TargetStart(draw(st.one_of(st.none(), boxes)), points, windows)
    places = st.tuples(st.integers(first + 1, 10**9), st.sampled_from(list(targets)))
    those = sorted(draw(st.lists(places, max_size=5, unique=True)), key=lambda place: place[0])
    corrected = tuple(draw(corrections(frame, name)) for frame, name in those)
    if any(targets[one.target].box is None and one.box for one in corrected):
        targets = {name: replace(one, box=(0.0, 1.0, 2.0, 3.0)) for name, one in targets.items()}
    by = draw(st.sampled_from(["", *DETECTORS]))
    return Start(first, targets, "", corrected, detector=by, placed=by != "")


@given(starts(), st.sampled_from(["a.init.yaml", "a.init.json"]))
def test_what_is_written_is_read_back(tmp_path_factory, start, name):
    path = tmp_path_factory.mktemp("init") / name
    write_init(path, start, clip="a # clip\n")
    assert replace(read_init(path), origin="") == start
    if name.endswith(".json"):
        assert len(json.loads(path.read_text()).get("corrections", [])) == len({one.frame for one in start.corrections})


def test_written_files_explain_themselves_and_are_not_replaced_unasked(tmp_path):
    path = tmp_path / "clip.init.yaml"
    start = Start(12, {"face": TargetStart((1, 2, 30, 40), {"nose": (10.25, 20)})}, "haar")
    write_init(path, start, clip="clip.mp4")
    text = path.read_text()
    assert "\nplaced_by: haar  # remove this line once you have edited" in text and read_init(path).detector == "haar"
    assert "clip.mp4" in text and "left, top, width, height" in text and "the tip of the nose" in text
    with pytest.raises(OutputError, match="--overwrite"):
        write_init(path, start)
    write_init(path, Start(13, start.targets, ""), overwrite=True)
    assert read_init(path).frame == 13 and "placed_by" not in path.read_text()
    with pytest.raises(OutputError, match="cannot be written"):
        write_init(tmp_path / "none" / "a.yaml", start)
    stream = io.StringIO()
    write_init(stream, start)
    assert "frame: 12" in stream.getvalue()


def test_written_corrections_are_made_to_be_edited(tmp_path):
    points = dict.fromkeys(("nose", "lip_upper", "lip_lower", "mouth_left", "mouth_right"), (1.5, 2.0))
    kept = dict(list(points.items())[2:])
    some = Correction(7, "face", None, {"nose": (3, 4)}, kept, ("lip_upper",))
    start = Start(0, {"face": TargetStart(None, points)}, "", (some, Correction(9, "face", absent=True)))
    path = tmp_path / "clip.init.yaml"
    write_init(path, start)
    head, _, tail = path.read_text().partition("corrections:\n")
    assert "# points, box: by hand; kept: where its other points were" in head
    assert tail.splitlines() == [
        "- frame: 7",
        "  face:",
        "    points: {nose: [3, 4]}",
        "    kept: {lip_lower: [1.5, 2], mouth_left: [1.5, 2], mouth_right: [1.5, 2]}",
        "    absent: [lip_upper]",
        "- frame: 9",
        "  face:",
        "    absent: true",
    ]
    many = replace(some, kept={f"point_{n:02}": (n + 0.25, 200.5) for n in range(20)}, absent=())
    wide = Start(0, {"face": TargetStart(None, {"nose": (1, 2), **many.kept})}, "", (many,))
    write_init(path, wide, overwrite=True)
    assert max(map(len, path.read_text().splitlines())) <= 120, "more points than a line holds stand below each other"
    assert read_init(path).corrections == (many,)


def test_finds_the_file_beside_a_video_or_a_folder(tmp_path):
    frames = tmp_path / "shots.d"
    frames.mkdir()
    assert find_init(tmp_path / "clip.a.mp4") is None and find_init(frames) is None
    for suffix in ("json", "yml", "yaml"):
        beside = write(tmp_path, "", f"clip.a.init.{suffix}")
        assert find_init(tmp_path / "clip.a.mp4") == beside
    (tmp_path / "shots.d.init.yaml").touch()
    assert find_init(frames) == find_init(frames / ".") == tmp_path / "shots.d.init.yaml"


FITS = TargetStart(None, {"nose": (1, 2), "mouth_left": (1, 2)})
LARGE = (-1, 10, 321, 40), (10, -1, 40, 241)  # along either side

# --- what the clip and the recipe say of it ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("target", "said", "corrected"),
    [
        (TargetStart(None, {"nose": (320, 10), "mouth_left": (1, 2)}), r"nose of face at \[320, 10\] is outside", ()),
        (TargetStart(None, {"nose": (1, 2), "mouth_left": (1, -0.6)}), "mouth_left of face", ()),
        (TargetStart((310, 10, 40, 40), {"nose": (1, 2), "mouth_left": (1, 2)}), "the box .* is outside", ()),
        (TargetStart((10, 10, 40, 40)), "no point for nose, mouth_left of face", ()),
        (TargetStart(None, {"nose": (1, 2)}), "no point for mouth_left of face", ()),
        (TargetStart(None, {"nose": (1, 2), "mouth_left": (1, 2)}, {"nose": (5, 241)}), "5x241, is larger than", ()),
        *((FITS, "the box of face at frame 3, .* is larger than the frame", box) for box in LARGE),
    ],
)
def test_what_the_clip_and_the_recipe_refuse(target, said, corrected):
    corrections = (Correction(3, "face", corrected),) if corrected else ()
    with pytest.raises(InputError, match=rf"^here\.yaml: .*{said}"):
        check_start(Start(0, {"face": target}, "here.yaml", corrections), (320, 240), ("nose", "mouth_left"))


def test_what_they_accept():
    target = TargetStart((-10, -10, 40, 40), {"nose": (-0.5, 239.5), "chin": (319.5, 0)}, {"nose": (320, 240)})
    check_start(Start(4, {"face": target}, ""), (320, 240), ["nose"], frames=5)
    with pytest.raises(InputError, match="ends with frame 3"):
        check_start(Start(4, {"face": target}, ""), (320, 240), ["nose"], frames=4)


def test_corrections_go_with_their_targets_to_the_names_of_the_recipe():
    hand, boxes = Correction(3, "hand", absent=True), ((1, 2, 30, 40), (5, 6, 30, 40))

    def named(names, targets, *those, **more):
        start = Start(0, {name: TargetStart(box) for name, box in zip(targets, boxes, strict=False)}, "x", those)
        return name_targets(start, names, None, **more).corrections

    for name in ("face", "somebody"):
        assert named(("head",), (name,), replace(hand, target=name)) == (replace(hand, target="head"),)
    face = Correction(4, "face", absent=True)
    assert named(("head", "hand"), ("face", "hand"), hand, face) == (hand, replace(face, target="head"))
    assert named(("head",), ("head", "hand"), hand, left_out=("hand",)) == ()
    assert named((), ("head", "hand"), hand) == (hand,)


# --- what reads a trajectory that was corrected: tables, measures, exports, plots, reports

SAMPLE = FOLDER / "occlusion.mp4"
NAN = math.nan
# frame 3: lip is lost; 5: it is absent, said by hand; 8: it is given again, and nose is kept; 10: both are absent
CORRECTIONS = [
    {"frame": 5, "target": "face", "absent": ["lip"]},
    {"frame": 8, "target": "face", "points": {"lip": [30, 20]}, "kept": {"nose": [10, 20]}, "learn": True},
    {"frame": 10, "target": "face", "absent": True},
]
HEADER = {
    "source": {"path": "clip.mp4", "size": [64, 48], "fps": 25.0},
    "recipe": {"name": "mine", "description": "x"},
    "seed": 0,
    "init": {
        "from": "haar",
        "frame": 0,
        "targets": {"face": {"points": {"nose": [10, 20], "lip": [30, 20]}}},
        "corrections": CORRECTIONS,
    },
}


def result(index):
    lip = "absent" if index in (5, 6, 7) or index >= 10 else "lost" if index in (3, 4) else "tracked"
    said = {"nose": "absent" if index >= 10 else "tracked", "lip": lip}
    by_hand = {"nose": index == 10, "lip": index in (5, 8, 10)}
    if index in (0, 8):
        said = {"nose": "init" if index == 0 else "tracked", "lip": "init"}
    parts = []
    for name, x in (("nose", 10.0), ("lip", 30.0)):
        place = (None,) * 4 if said[name] == "absent" else (x + 0.5 * index, 20.0, 8.0, 6.0)
        known = {} if said[name] == "absent" else {"confidence": 0.8, "cov": (1.0, 0.0, 1.0), "ess": 9.0}
        parts.append(results.part(name, *place, said[name], **known, by_hand=by_hand[name]))
    gone = all(status == "absent" for status in said.values())
    return results.result(index, [results.target("face", parts, None if gone else 10)]).rows


@pytest.fixture
def table(tmp_path):
    writer = WRITERS["json"](Alone(tmp_path / "trajectory.json"), HEADER)
    for index in range(13):
        writer.write(result(index))
    writer.close(RunSummary())
    return read_trajectory(tmp_path / "trajectory.json")


# --- measures ----------------------------------------------------------------------------------------------------


def corrected(letters):
    """Statuses of ours: i init, t tracked, l lost, a absent."""
    return ["absent" if one == "a" else statuses(one)[0] for one in letters]


def test_an_absent_row_is_a_miss_where_the_truth_is_visible_and_no_error_elsewhere():
    part = rows([0, NAN, NAN, NAN, 1], "vvhav", ours=corrected("iaaat"))
    found = measure_points([part])
    assert (found.rows, found.missing, found.hidden_rows) == (2, 1, 0)
    assert found.failure_rate == pytest.approx(1 / 3)
    found = measure_lost([rows([0, 0, NAN, NAN, 0, 0], "vvhhvv", ours=corrected("ittaat"))])
    assert (found.rows, found.covered, found.called) == (3, 1, 0), "neither called lost nor missed"


def test_a_place_given_by_hand_is_no_merit_but_in_the_first_frame():
    part = rows([0, 6, 0, 6], "vvvv", ours=corrected("itit"))
    assert part.later.tolist() == [False, False, True, False]
    found = measure_points([part])
    assert found.rows == 3 and found.mean_px == 4
    part = replace(part, confidence=np.array([1.0, 0.2, 1.0, 0.2]), std=np.ones((4, 2)))
    assert [measure([part]).rows for measure in (measure_lost, measure_confidence, measure_coverage)] == [2, 2, 2]


def boxed(status, x, frames=6, **more):
    """A target of 20 by 20 pixels."""
    full = np.full(frames, 20.0)
    return one_part("hand", "box", range(frames), x=x, y=np.full(frames, 50.0), w=full, h=full, status=status, **more)


def test_boxes_given_later_are_left_out_and_absent_ones_miss_where_there_is_something_to_see():
    x = np.full(6, 50.0)
    seen = ["visible", "visible", "hidden", "hidden", "visible", "visible"]
    theirs = replace(boxed(seen, x), path=Path("truth.csv"))
    gone = [NAN if letter == "a" else 50.0 for letter in "iaatit"]
    ours = boxed(corrected("iaatit"), gone)
    ours = replace(ours, w=np.where(np.isnan(ours.x), NAN, 20.0), h=np.where(np.isnan(ours.x), NAN, 20.0))
    found = evaluate(match(replace(ours, path=Path("t.json")), theirs, partial=False, select=None))
    measured = found.parts[0]
    assert (measured.boxes.rows, measured.boxes.missing) == (3, 1), "frame 4 was given by hand"
    assert measured.boxes.ao == pytest.approx(0.5), "one of two after the first"
    assert (measured.boxes.hidden_rows, measured.boxes.hidden_overlap) == (1, 1.0), "to call it absent is no miss"


def test_a_trajectory_with_absent_rows_may_be_measured_and_be_truth(table):
    other = replace(table, x=table.x + 1, header={}, path=Path("checked.csv"))
    found = evaluate(match(table, other, partial=False, select=None))
    assert found.counts["absent"] == 9 and found.all.points.mean_px == pytest.approx(1.0)


# --- exports -----------------------------------------------------------------------------------------------------


def test_what_is_absent_has_no_row_or_no_place_in_other_formats(table):
    lip = table.parts[1]
    assert [int(line.split(",")[0]) - 1 for line in write_mot([lip]).splitlines()] == [0, 1, 2, 3, 4, 8, 9]
    assert write_vot(lip).splitlines()[5] == "2"
    assert write_otb(lip).splitlines()[5] == "nan,nan,nan,nan"
    assert write_dlc(table).splitlines()[3 + 5] == "5,12.500,20.000,0.8000,,,"
    annotations = json.loads(write_coco(table, (64, 48), "{}.png".format, "windows"))["annotations"]
    frames = {one["image_id"] - 1: one for one in annotations}
    assert sorted(frames) == list(range(10)), "nothing where all is absent"
    assert frames[5]["keypoints"][3:6] == [0, 0, 0] and frames[5]["num_keypoints"] == 1


# --- plots and reports -------------------------------------------------------------------------------------------


def test_the_plots_shade_what_is_absent_and_mark_what_was_corrected(table):
    pytest.importorskip("matplotlib", reason="needs the extra: pip install -e '.[plot]'")
    figure = page.page_figure(table)
    labels = [text.get_text() for text in figure.axes[0].get_legend().texts]
    assert {"absent", "corrected by hand"} <= set(labels)
    marks = [line for axes in figure.axes for line in axes.lines if line.get_marker() == "^"]
    assert [line.get_xdata().tolist() for line in marks] == [[5, 8, 10]]
    plain = table.between(0, 5)
    assert not {"absent", "corrected by hand"} & {
        t.get_text() for t in page.page_figure(plain).axes[0].get_legend().texts
    }
    assert plot_style.render(figure).startswith(b"\x89PNG")


def test_a_report_says_what_was_corrected(table):
    history = history_of(table, Clock(table, 25.0))
    assert history.corrections == (5, 8, 10)
    nose, lip = history.parts
    assert [(span.first, span.last) for span in lip.absent] == [(5, 7), (10, 12)]
    assert sum(span.frames for span in nose.absent) == 3
    assert [(span.first, span.last, span.back, span.by_hand) for span in lip.lost] == [(3, 4, None, True)]
    assert (history.ending("lost"), history.ending("absent")) == ([], ["nose", "lip"])
    events = reasons(table, history, "x", 0, 12)
    kinds = {frame: [kind for kind, *_ in events[frame]] for frame in key_frames(history, events, 0, 12)}
    assert kinds == {
        0: ["start"], 1: ["worst"], 3: ["lost"], 5: ["corrected"], 8: ["corrected"], 10: ["corrected"], 12: ["end"]
    }  # fmt: skip


START = """frame: 0
face:
  points:
    {nose: [171.32, 128.93], mouth_left: [149.43, 153.19], mouth_right: [194.57, 152.28],
     lip_upper: [170.86, 149.45], lip_lower: [171.32, 160.40]}
corrections:
- {frame: 3, face: {absent: [mouth_left]}}
- {frame: 6, face: {points: {mouth_left: [149.4, 153.2]}}}
- {frame: 8, face: {absent: true}}
"""


def test_a_run_with_corrections_is_reported_and_repeated(tmp_path, monkeypatch, no_plot):
    monkeypatch.chdir(tmp_path)
    Path("start.yaml").write_text(START)
    options = ["--config", "factorized", "--set", "filter.particles=15", "--no-video", "-q"]
    assert main(["run", str(SAMPLE), "--init", "start.yaml", *options, "--stop", "10", "-o", "run"]) == 0
    assert main(["report", "run"]) == 0
    page = Path("run/report.html").read_text()
    for said in (
        "<dd>3 frames<small>5 marked as absent", "by hand in frames 3, 6 and 8",
        "<strong>Corrected by hand</strong> mouth_left absent", "absent: [mouth_left]", 'class="absent"',
    ):  # fmt: skip
        assert said in page, said
    table = read_trajectory(Path("run"))
    header = read_header(table)
    words = shlex.split(command(header, int(table.frames[-1])))
    Path(words[words.index("--init") + 1]).write_text(as_yaml(header.init.start, header.clip_name))
    Path(words[words.index("--config") + 1]).write_text(recipe_yaml(header.recipe))
    assert main([*words[1:], "--no-video", "-q"]) == 0
    assert Path("again/trajectory.csv").read_bytes() == Path("run/trajectory.csv").read_bytes()
    for form in ("mot", "coco", "dlc", "eaf"):
        assert main(["export", "run", "--to", form, "-o", f"x.{form}"]) == 0
    assert 'TIER_ID="absent@face"' in Path("x.eaf").read_text()
    assert main(["eval", "run", "--truth", str(SAMPLE.with_suffix(".truth.csv")), "--partial"]) == 0
