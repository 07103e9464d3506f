"""What a tracker that adapts tells: written only where known, read back as arrays, refused with its place."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.files import FileSink
from facetrack_cli.core.types import Frame, PartResult, Result, TargetResult, Told
from facetrack_cli.trajectory import table as module
from facetrack_cli.trajectory.reader import read_trajectory
from facetrack_cli.trajectory.select import choose
from facetrack_cli.trajectory.writers import SCHEMA, WRITERS, Footer, members

TOLD = Told(
    affine=(1.0, 0.123456, -0.0, 1.0, 10.0, 20.12345),
    scale=1.25,
    error=0.5,
    noise=2.0,
    posterior={"ben": 0.0625, "anna": 0.93754, "none": -0.0},
    entropy=0.23,
)


def result(index: int, *targets: TargetResult) -> Result:
    return Result(Frame(index, index / 25, np.zeros((4, 6, 3), np.uint8)), targets)


def target(told: Told | None, name: str = "face", who: str | None = None, sure: float | None = None) -> TargetResult:
    part = PartResult("box", 3.0, 2.0, 4.0, 4.0, "tracked", 0.5)
    return TargetResult(name, (part,), 77, np.zeros((1, 1, 2)), who, sure, told=told)


def write(path: Path, results: list[Result]) -> Path:
    writer = WRITERS[path.suffix[1:]](FileSink(path), {"seed": 3})  # type: ignore[index]
    for each in results:
        writer.write(each)
    writer.close(Footer())
    return path


# --- writing ---


def test_the_members_of_a_target_stand_after_its_identity(tmp_path: Path) -> None:
    path = write(tmp_path / "t.json", [result(0, target(TOLD, who="anna", sure=0.93754))])
    assert (
        '{"target":"face","particles":77,"identity":"anna","identity_prob":0.9375,'
        '"posterior":{"ben":0.0625,"anna":0.9375,"none":0.0000},"entropy":0.2300,"scale":1.2500,"noise":2.0000,'
        '"error":0.5000,"affine":[1.00000,0.12346,0.00000,1.00000,10.000,20.123],"parts":[{"part":"box",'
    ) in path.read_text()


def test_what_is_not_known_is_left_out(tmp_path: Path) -> None:
    assert members(Told()) == []
    assert members(Told(scale=math.nan, noise=math.inf, affine=(1, 0, 0, math.nan, 1, 1))) == []
    assert members(Told(posterior={"a": math.nan, 'say "b"': 1.0})) == ['"posterior":{"say \\"b\\"":1.0000}']
    plain = write(tmp_path / "plain.json", [result(0, target(None))]).read_text()
    assert plain == write(tmp_path / "told.json", [result(0, target(Told()))]).read_text()


def test_the_csv_stays_as_it_is(tmp_path: Path) -> None:
    without = write(tmp_path / "a.csv", [result(0, target(None, who="anna", sure=0.9))]).read_text()
    assert write(tmp_path / "b.csv", [result(0, target(TOLD, who="anna", sure=0.9))]).read_text() == without


# --- a round trip ---

SHARE = st.integers(0, 10_000).map(lambda n: n / 10_000)
NUMBER = st.none() | st.integers(0, 10**6).map(lambda n: n / 10_000)
NAMES = ["anna", "ben", "Zoë", 'q"', "none"]
TOLDS = st.builds(
    Told,
    affine=st.none() | st.tuples(*[st.integers(-1000, 1000).map(lambda n: n / 1000)] * 6),
    scale=NUMBER,
    error=NUMBER,
    noise=NUMBER,
    entropy=NUMBER,
    posterior=st.none() | st.dictionaries(st.sampled_from(NAMES), SHARE),
)


def same(a: object, b: float) -> bool:
    return math.isnan(b) if a is None else a == b


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(tolds=st.lists(st.none() | TOLDS, min_size=1, max_size=6), form=st.sampled_from(["json", "jsonl"]))
def test_what_is_written_is_read(tmp_path: Path, tolds: list[Told | None], form: str) -> None:
    table = read_trajectory(write(tmp_path / f"t.{form}", [result(i, target(t)) for i, t in enumerate(tolds)]))
    known = [i for i, told in enumerate(tolds) if told is not None and members(told)]
    if not known:
        assert table.told == ()
        return
    (told,) = table.told
    assert told.target == "face" and told.frame.tolist() == known
    order = dict.fromkeys(name for i in known for name in (tolds[i] or Told()).posterior or {})
    assert told.names == tuple(order)
    for at, i in enumerate(known):
        given_ = tolds[i]
        assert given_ is not None
        for key in ("scale", "error", "noise", "entropy"):
            assert same(getattr(given_, key), getattr(told, key)[at])
        assert given_.affine is None or tuple(told.affine[at]) == given_.affine
        assert given_.affine is not None or np.isnan(told.affine[at]).all()
        for k, name in enumerate(told.names):
            assert same((given_.posterior or {}).get(name), told.posterior[at, k])


def clip(path: Path, frames: int = 30) -> Table:
    """Anna, of whom it is sure from frame 10 on; and a second target of which nothing is told."""
    results = []
    for i in range(frames):
        p = 0.3 if i < 3 else 0.6 if i < 10 else 0.95
        who = "ben" if i < 3 else "anna"
        posterior = {"anna": p, "ben": 1 - p}
        results.append(
            result(i, target(replace(TOLD, posterior=posterior), who=who, sure=max(p, 1 - p)), target(None, "other"))
        )
    return read_trajectory(write(path, results))


def test_who_it_is_from_either_file(tmp_path: Path) -> None:
    for form in ("json", "csv"):
        (told,) = clip(tmp_path / f"t.{form}").told
        assert told.target == "face" and told.identity[[0, 2, 3, 29]].tolist() == ["ben", "ben", "anna", "anna"]
        assert told.passed("anna") == 10 and told.passed("ben") is None and told.passed("carl") is None
        names, p = told.beliefs()
        assert p[:, names.index("anna")][-1] == 0.95
    assert told.names == () and np.isnan(told.scale).all()
    assert np.isnan(p[0, names.index("anna")]), "the CSV knows the probability of the most likely alone"


def test_a_choice_of_targets_keeps_what_is_told_of_them(tmp_path: Path) -> None:
    table = clip(tmp_path / "t.json")
    assert len(choose(table, "face/box").told) == 1
    assert choose(table, "other").told == ()


# --- what is refused ---


def file(folder: Path, *targets: Any) -> Path:
    frames = [
        {"frame": i, "time_s": i / 25, "targets": [{"parts": [{"part": "box", "x": 1, "y": 2}], **one}]}
        for i, one in enumerate(targets)
    ]
    path = folder / "one.json"
    path.write_text(json.dumps({"schema": SCHEMA, "frames": frames}))
    return path


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ({"scale": "1"}, "scale '1' is no number from 0 up"),
        ({"scale": -1}, "scale -1 is no number"),
        ({"noise": True}, "noise True is no number"),
        ({"error": float("inf")}, "error inf is no number"),
        ({"error": 10**400}, "is no number"),
        ({"entropy": [1]}, r"entropy \[1\] is no number"),
        ({"identity": 5}, "identity 5 is no name"),
        ({"identity_prob": 1.5}, "identity_prob 1.5 is no probability"),
        ({"posterior": [0.5]}, "posterior is no object of names"),
        ({"posterior": {"anna": 1.2}}, "posterior of 'anna' 1.2 is no probability"),
        ({"posterior": {"anna": None}}, "posterior of 'anna' None is no probability"),
        ({"posterior": {"": 0.2}}, "posterior of '' 0.2 is no probability"),
        ({"affine": [1, 0, 0, 1, 5]}, "affine is no list of six numbers"),
        ({"affine": [1, 0, 0, 1, 5, "x"]}, "affine is no list of six numbers"),
        ({"affine": {"a1": 1}}, "affine is no list of six numbers"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, wrong: dict[str, Any], why: str) -> None:
    with pytest.raises(
        InputError, match=rf"one\.json: frame 1, face: .*{why}.*; correct it, or leave it out"
    ) as caught:
        read_trajectory(file(tmp_path, {"target": "face"}, {"target": "face", **wrong}))
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 1000


@pytest.mark.parametrize("name", [None, ["a"], 3, ""])
def test_records_that_are_none_are_refused_as_before(tmp_path: Path, name: object) -> None:
    with pytest.raises(InputError, match=r"record 0 of frames is not as facetrack writes it"):
        read_trajectory(file(tmp_path, {"target": name, "scale": 1.0}))


def test_a_csv_with_no_probability_says_where(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("frame,target,part,x,y,identity,identity_prob\n0,face,box,1,2,anna,0.5\n1,face,box,1,2,anna,1.5\n")
    with pytest.raises(InputError, match=r"t\.csv: frame 1, face: identity_prob 1\.5 is no probability; correct it"):
        read_trajectory(path)


CELL = st.sampled_from(["", " anna", "ben ", "a, b"]), st.sampled_from(["", "0.5", " 1 ", "2", "-0.1", "nan", "x"])


@settings(max_examples=80, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(cells=st.lists(st.tuples(st.integers(0, 9), *CELL), min_size=1, max_size=6, unique_by=lambda c: c[0]))
def test_columns_and_rows_of_a_csv_tell_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cells: list[tuple[int, str, str]]
) -> None:
    path = tmp_path / "t.csv"
    lines = [f'{frame},face,box,1,2,"{who}",{sure}' for frame, who, sure in cells]
    path.write_text("\n".join(["frame,target,part,x,y,identity,identity_prob", *lines]))

    def read() -> list[Any] | str:
        try:
            return [[t.frame.tolist(), t.identity.tolist(), str(t.identity_prob)] for t in read_trajectory(path).told]
        except InputError as e:
            return str(e)

    monkeypatch.setattr(module, "_BLOCK", 2)
    quick = read()
    with monkeypatch.context() as patch:
        patch.setattr(module, "_csv_columns", lambda _: None)
        assert read() == quick


# --- what else reads trajectories ---


@pytest.mark.parametrize("form", ["mot", "otb", "got10k", "vot", "coco", "dlc", "eaf"])
def test_exports_are_those_of_a_tracker_that_tells_nothing(tmp_path: Path, form: str) -> None:
    header = {"source": {"path": "clip.mp4", "size": [6, 4], "fps": 25.0}}
    found = []
    for name, told in (("plain", None), ("told", TOLD)):
        folder = tmp_path / name
        folder.mkdir()
        writer = WRITERS["json"](FileSink(folder / "trajectory.json"), header)
        for index in range(5):
            writer.write(result(index, target(told)))
        writer.close(Footer())
        out = tmp_path / f"{name}.out"
        assert main(["export", str(folder), "--to", form, "-o", str(out)]) == 0
        text = out.read_text()
        found.append(re.sub(r'DATE="[^"]*"|urn:nl-mpi-tools-elan-eaf:[^<"]*', "", text.replace(name, "")))
    assert found[0] == found[1] and found[0]


def test_it_is_measured_against_a_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "t.json", [result(i, target(TOLD, who="anna", sure=0.9)) for i in range(5)])
    truth = tmp_path / "truth.csv"
    truth.write_text("frame,target,part,x,y,w,h\n" + "".join(f"{i},face,box,3,2,4,4\n" for i in range(5)))
    assert main(["eval", str(path), "--truth", str(truth)]) == 0
    assert "1.000" in capsys.readouterr().out
