"""Init files: what is read, what is refused and where, and that what is written is read back."""

import io
import json
import re
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.face_points import DETECTORS
from facetrack_cli.core.types import Correction, Start, TargetStart
from facetrack_cli.start.assembly import name_targets
from facetrack_cli.start.init_file import check_start, find_init, read_init, write_init

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
