"""Corrections in init files: what is read, what is refused and where, and that what is written is read back."""

import json
import re
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Correction, Start, TargetStart
from facetrack_cli.start.assembly import name_targets
from facetrack_cli.start.init_file import read_init, write_init

HEAD = "frame: 5\nface:\n  points: {nose: [1, 2], lip_upper: [3, 4], lip_lower: [5, 6]}\ncorrections:\n"
BOXES = "frame: 5\nhead: {box: [1, 2, 30, 40]}\nleft_hand: {box: [5, 6, 30, 40]}\ncorrections:\n"


def write(tmp_path, text, name="clip.init.yaml"):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_reads_the_documented_corrections_in_the_order_of_their_frames(tmp_path):
    text = f"""{HEAD}- frame: 60
  face: {{absent: true}}
- frame: 31
  face:
    points: {{nose: [137.2, 153.9]}}     # by hand
    kept: {{lip_lower: [160, 138.4]}}
    absent: [lip_upper]
    learn: true
"""
    assert read_init(write(tmp_path, text)).corrections == (
        Correction(31, "face", TargetStart(None, {"nose": (137.2, 153.9)}), {"lip_lower": (160, 138.4)},
                   ("lip_upper",), learn=True),
        Correction(60, "face", absent=True),
    )  # fmt: skip


def test_of_a_single_target_the_keys_may_stand_beside_the_frame(tmp_path):
    text = "frame: 0\nsomebody: {box: [1, 2, 30, 40]}\ncorrections: [{frame: 3, box: [5, 6, 7, 8], learn: false}]\n"
    found = read_init(write(tmp_path, text)).corrections
    assert found == (Correction(3, "somebody", TargetStart((5, 6, 7, 8)), learn=False),)
    text = "frame: 0\nbox: [1, 2, 30, 40]\ncorrections: [{frame: 3, face: {absent: [box]}}]\n"
    assert read_init(write(tmp_path, text)).corrections == (Correction(3, "face", absent=("box",)),)


def test_a_frame_may_have_several_targets_in_one_entry_or_in_several(tmp_path):
    one = "- {frame: 9, left_hand: {absent: true}, head: {box: [1, 2, 3, 4]}}\n"
    two = "- {frame: 9, left_hand: {absent: true}}\n- {frame: 9, head: {box: [1, 2, 3, 4]}}\n"
    wanted = (Correction(9, "left_hand", absent=True), Correction(9, "head", TargetStart((1, 2, 3, 4))))
    for text in (one, two):
        assert read_init(write(tmp_path, BOXES + text)).corrections == wanted


def test_a_start_of_a_box_alone_leaves_the_parts_to_the_recipe(tmp_path):
    text = "frame: 0\nbox: [1, 2, 30, 40]\ncorrections:\n- {frame: 3, points: {nose: [5, 6]}, absent: [lip_upper]}\n"
    assert read_init(write(tmp_path, text)).corrections[0].absent == ("lip_upper",)


def test_no_corrections_are_an_empty_list(tmp_path):
    assert read_init(write(tmp_path, "frame: 0\nbox: [1, 2, 3, 4]\ncorrections: []\n")).corrections == ()


NOSE = "points: {nose: [1, 2]}"
MISTAKES = {
    "no list": (HEAD + "  frame: 31\n", 5, "corrections is a list; write - frame: 31"),
    "nothing": (HEAD, 4, "corrections is a list; write - frame: 31"),
    "misspelt": ("frame: 0\nface: {box: [1, 2, 3, 4]}\ncorrection: []\n", 3, 'did you mean "corrections"?'),
    "entry without keys": (HEAD + "- 31\n", 5, "a correction is a mapping of keys; write - frame: 31"),
    "no frame": (HEAD + f"- face: {{{NOSE}}}\n", 5, 'the key "frame" is missing; add frame: N'),
    "frame of the start": (HEAD + f"- {{frame: 5, {NOSE}}}\n", 5, "the track begins in frame 5"),
    "nothing in an entry": (HEAD + "- frame: 6\n", 5, "nothing is corrected here; add points: or box:"),
    "nothing of a target": (HEAD + "- frame: 6\n  face: {}\n", 6, "nothing of face is corrected"),
    "only kept": (HEAD + "- frame: 6\n  face: {kept: {nose: [1, 2]}}\n", 6, "nothing of face is corrected"),
    "a target that is none": (HEAD + f"- frame: 6\n  fase: {{{NOSE}}}\n", 6, 'did you mean "face"?'),
    "misspelt key": (HEAD + "- frame: 6\n  pionts: {nose: [1, 2]}\n", 6, 'did you mean "points"?'),
    "misspelt key of a target": (HEAD + "- frame: 6\n  face:\n    learnt: true\n", 7, 'did you mean "learn"?'),
    "unknown key of a target": (
        HEAD + "- frame: 6\n  face: {colour: red}\n",
        6,
        'face in frame 6: unknown key "colour"; the keys there are: box, points, kept',
    ),
    "target as a list": (HEAD + "- frame: 6\n  face: [1, 2]\n", 6, "the correction of face is a mapping"),
    "which of two": (BOXES + "- {frame: 6, absent: true}\n", 5, "below its name: head, left_hand"),
    "twice": (HEAD + f"- {{frame: 6, {NOSE}}}\n- frame: 6\n  face: {{absent: true}}\n", 7, "in line 5 already"),
    "windows": (HEAD + f"- frame: 6\n  {NOSE}\n  windows: {{nose: [5, 5]}}\n", 7, "windows stay as the start has them"),
    "beyond any image": (
        HEAD + "- frame: 6\n  points: {nose: [1, 1e7]}\n", 6, "face in frame 6: points.nose[2] must be at most 1000000",
    ),
    "no points": (HEAD + "- frame: 6\n  points: {}\n", 6, "nothing is given here"),
    "unknown part": (HEAD + "- frame: 6\n  points: {noes: [1, 2]}\n", 6, 'did you mean "nose"?'),
    "unknown absent part": (HEAD + "- frame: 6\n  absent: [lip_uper]\n", 6, 'did you mean "lip_upper"?'),
    "given and kept": (HEAD + f"- frame: 6\n  {NOSE}\n  kept: {{nose: [1, 2]}}\n", 7, "nose is in points already"),
    "given and absent": (HEAD + f"- frame: 6\n  {NOSE}\n  absent: [nose]\n", 7, "nose is in points already"),
    "kept and absent": (
        HEAD + f"- frame: 6\n  {NOSE}\n  kept: {{lip_upper: [1, 2]}}\n  absent: [lip_upper]\n",
        8,
        "lip_upper is in kept already",
    ),
    "box given and absent": (
        BOXES + "- frame: 6\n  head: {box: [1, 2, 3, 4], absent: [box]}\n", 6, "box is in box already",
    ),
    "kept with a box": (BOXES + "- frame: 6\n  head: {box: [1, 2, 3, 4], kept: {a: [1, 2]}}\n", 6, "no other parts"),
    "absent: false": (
        HEAD + "- frame: 6\n  absent: false\n",
        6,
        "absent must be a list, not false; write absent: [nose], or absent: true",
    ),
    "absent as a name": (
        HEAD + "- frame: 6\n  absent: nose\n", 6, 'absent must be a list, not the text "nose"; write absent: [nose]',
    ),
    "absent of none": (HEAD + "- frame: 6\n  absent: []\n", 6, "nothing is given here"),
    "absent number": (HEAD + "- frame: 6\n  absent: [1]\n", 6, "absent[1] must be a text, not 1; write absent: [nose]"),
    "absent twice": (HEAD + "- frame: 6\n  absent: [nose, nose]\n", 6, "nose is in absent already"),
    "confirmed and given": (
        HEAD + f"- frame: 6\n  {NOSE}\n  confirmed: true\n", 6, "is confirmed where the tracker has it; remove points"
    ),
    "confirmed of nobody": (HEAD + "- frame: 6\n  confirmed: [ear]\n", 6, 'confirmed names "ear", which the start'),
    "all absent and given": (HEAD + f"- frame: 6\n  {NOSE}\n  absent: true\n", 6, "all of face is absent; remove"),
    "all absent and learnt": (HEAD + "- frame: 6\n  absent: true\n  learn: true\n", 7, "remove learn"),
    "learn as text": (
        HEAD + f"- frame: 6\n  {NOSE}\n  learn: maybe\n", 7, 'learn must be true or false, not the text "maybe"',
    ),
    "absent at the start": (
        "frame: 0\nbox: [1, 2, 3, 4]\nabsent: true\n", 3, '"absent" is a key of corrections; move it',
    ),
}  # fmt: skip


@pytest.mark.parametrize("text, line, said", MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_one_line_with_its_place(tmp_path, text, line, said):
    path = write(tmp_path, text)
    with pytest.raises(InputError) as caught:
        read_init(path)
    message = str(caught.value)
    assert "\n" not in message
    assert re.match(rf"{re.escape(str(path))}:{line}:\d+: ", message), message
    assert said in message


numbers = st.floats(-1e6, 1e6, allow_nan=False)
sizes = st.floats(0.01, 1e6)
PARTS = ("nose", "no", "lip_upper", "mouth-left", "x1")


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
        return Correction(frame, name, TargetStart(draw(st.tuples(numbers, numbers, sizes, sizes))), learn=learn)
    about = {part: draw(st.sampled_from(["given", "kept", "absent", ""])) for part in PARTS}
    where = {part: draw(st.tuples(numbers, numbers)) for part in PARTS}
    those = {said: [part for part in PARTS if about[part] == said] for said in ("given", "kept", "absent")}
    if not those["given"] + those["absent"]:
        those["absent"] = [part for part in PARTS if part not in those["kept"]][:1] or [those["kept"].pop()]
    points = {part: where[part] for part in those["given"]}
    kept = {part: where[part] for part in those["kept"]}
    return Correction(frame, name, TargetStart(None, points), kept, tuple(those["absent"]), learn)


@st.composite
def starts(draw):
    first = draw(st.integers(0, 1000))
    points = {part: draw(st.tuples(numbers, numbers)) for part in PARTS}
    targets = {
        name: TargetStart(draw(st.tuples(numbers, numbers, sizes, sizes)), points)
        for name in draw(st.lists(st.sampled_from(["face", "no", "hand"]), min_size=1, unique=True))
    }
    places = st.tuples(st.integers(first + 1, 10**9), st.sampled_from(list(targets)))
    those = sorted(draw(st.lists(places, max_size=5, unique=True)), key=lambda place: place[0])
    return Start(first, targets, "", tuple(draw(corrections(frame, name)) for frame, name in those))


@given(starts(), st.sampled_from(["a.init.yaml", "a.init.json"]))
def test_what_is_written_is_read_back(tmp_path_factory, start, name):
    path = tmp_path_factory.mktemp("init") / name
    write_init(path, start)
    again = read_init(path)
    assert replace(again, origin="") == start
    if name.endswith(".json"):
        assert len(json.loads(path.read_text()).get("corrections", [])) == len({one.frame for one in start.corrections})


def test_the_file_is_made_to_be_edited(tmp_path):
    points = dict.fromkeys(("nose", "lip_upper", "lip_lower", "mouth_left", "mouth_right"), (1.5, 2.0))
    some = dict(list(points.items())[2:])
    start = Start(0, {"face": TargetStart(None, points)}, "", (
        Correction(7, "face", TargetStart(None, {"nose": (3, 4)}), some, ("lip_upper",)),
        Correction(9, "face", absent=True),
    ))  # fmt: skip
    path = tmp_path / "clip.init.yaml"
    write_init(path, start)
    text = path.read_text()
    tail = text[text.index("corrections:") :]
    assert (
        tail
        == """corrections:
- frame: 7
  face:
    points: {nose: [3, 4]}
    kept: {lip_lower: [1.5, 2], mouth_left: [1.5, 2], mouth_right: [1.5, 2]}
    absent: [lip_upper]
- frame: 9
  face:
    absent: true
"""
    )
    assert "# points, box: by hand; kept: where its other points were" in text
    many = replace(start.corrections[0], kept={f"point_{n:02}": (n + 0.25, 200.5) for n in range(20)}, absent=())
    wide = replace(start, targets={"face": TargetStart(None, {"nose": (1, 2), **many.kept})}, corrections=(many,))
    write_init(path, wide, overwrite=True)
    assert max(map(len, path.read_text().splitlines())) <= 120, "more points than a line holds stand below each other"
    assert read_init(path).corrections == (many,)


def test_as_many_corrections_as_a_long_clip_wants(tmp_path):
    start = Start(0, {"face": TargetStart((1, 2, 3, 4))}, "", tuple(
        Correction(n, "face", TargetStart((100.25, 200.5, 30.75, 40.5))) for n in range(1, 2001)
    ))  # fmt: skip
    path = tmp_path / "clip.init.yaml"
    write_init(path, start)
    assert path.stat().st_size > 100_000
    assert len(read_init(path).corrections) == 2000


# --- the targets that a recipe names -----------------------------------------------------------------------------


def start_of(*corrections, **boxes):
    return Start(0, {name: TargetStart(box=one) for name, one in boxes.items()}, "x.yaml", corrections)


@pytest.mark.parametrize("name", ["face", "somebody"])
def test_corrections_of_a_single_target_go_with_it_to_its_new_name(name):
    start = start_of(Correction(3, name, absent=True), **{name: (1, 2, 30, 40)})
    assert name_targets(start, ("head",), None).corrections == (Correction(3, "head", absent=True),)


def test_of_several_targets_the_face_is_the_head_and_others_keep_their_corrections():
    start = start_of(
        Correction(3, "hand", absent=True), Correction(4, "face", absent=True),
        face=(1, 2, 30, 40), hand=(5, 6, 30, 40),
    )  # fmt: skip
    found = name_targets(start, ("head", "hand"), None).corrections
    assert found == (Correction(3, "hand", absent=True), Correction(4, "head", absent=True))


def test_corrections_of_a_target_that_is_left_out_are_left_out():
    start = start_of(Correction(3, "hand", absent=True), head=(1, 2, 30, 40), hand=(5, 6, 30, 40))
    assert name_targets(start, ("head",), None, left_out=("hand",)).corrections == ()
    assert name_targets(start, (), None) is start
