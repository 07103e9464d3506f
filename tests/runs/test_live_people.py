"""Everybody in a film that is still shown: a line a frame, names when looks allow them, and the cast at the end."""

import json
from collections import Counter

import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.live import follow
from facetrack_cli.runs.live_people import LiveCast
from facetrack_cli.trajectory.formats.read import read_truth
from facetrack_cli.trajectory.people import read_people
from facetrack_cli.video.shots import find_cuts, passing_shots
from facetrack_cli.video.source import open_source
from tests.support.film_run import FILM, film_run
from tests.support.samples import FOLDER


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """The lines of the sample film."""
    lines = []
    with open_source(FILM) as source:
        count = follow(iter(source), load_recipe("face"), None, lines.append, cast=LiveCast(None, 25.0, {}))
    *frames, last = map(json.loads, lines)
    assert count == len(frames) and all(len(line) > 1 for line in frames)
    return frames, last["people"]


def seen(frames):
    """Of each track that is seen on a face of the truth: its frame, its name, its name then, who it truly is."""
    truth = read_truth(FOLDER / "film.truth.csv")
    for line in frames:
        there = truth.at(line["frame"])
        for one in line["targets"]:
            [box] = [part for part in one["parts"] if part["part"] == "box"]
            near = [
                there.names[which][0]
                for x, y, w, which in zip(there.x, there.y, there.w, there.which, strict=True)
                if box["status"] != "lost" and abs(x - box["x"]) + abs(y - box["y"]) < 0.6 * w
            ]
            if near:
                yield line["frame"], one["target"], line["people"][one["target"]], near[0]


def test_each_frame_has_its_line_and_each_face_of_it_its_track(told):
    frames, _ = told
    assert [line["frame"] for line in frames] == list(range(len(frames)))
    truth = read_truth(FOLDER / "film.truth.csv")
    assert len([*seen(frames)]) > 0.95 * (truth.status == "visible").sum()


def test_a_name_that_was_told_is_right_and_comes_soon(told):
    frames, cast = told
    rows = [*seen(frames)]
    who = Counter((name, true) for _, _, name, true in rows if name)
    assert len({name for name, _ in who}) == len({true for _, true in who}) == len(who) == 2, who
    assert sum(who.values()) > 0.7 * len(rows)
    begun = {track: frame for frame, track, _, _ in reversed(rows)}
    named = {track: frame for frame, track, name, _ in reversed(rows) if name}
    assert all(named[track] - begun[track] <= 20 for track in named)
    assert {(cast[track], true) for _, track, _, true in rows} == set(who), "the cast at the end is of the same people"


def test_the_cast_at_the_end_is_that_of_the_run_of_a_file(told, tmp_path_factory):
    people = read_people(film_run(tmp_path_factory))
    assert set(told[1].values()) == set(people.names)


def test_a_cut_is_known_when_its_first_frame_comes_out():
    with open_source(FILM) as source:
        shots = [(shot, frame.index) for shot, frame in passing_shots(iter(source))]
    with open_source(FILM) as source:
        cuts = [cut.frame for cut in find_cuts(iter(source)) if not cut.dissolve]
    begins = dict(reversed(shots))
    assert [frame for _, frame in shots] == list(range(len(shots))) and cuts and {*cuts} <= {*begins.values()}


def test_a_film_that_is_stopped_tells_its_cast():
    lines = []
    with open_source(FILM, stop=60) as source:
        cast = LiveCast(None, 25.0, {})
        follow(iter(source), load_recipe("face"), None, lines.append, lambda: len(lines) > 20, cast)
    assert 20 < len(lines) < 40 and json.loads(lines[-1]) == {"people": cast.cast()} and cast.names


@pytest.mark.parametrize("more", [["--box", "1,1,9,9"], ["--config", "signer"], ["--config", "correlation_filter"]])
def test_what_is_of_one_face_is_refused(capsys, more):
    assert main(["run", str(FILM), "--faces", "all", "--live", *more]) == 2
    assert "--faces all --live looks for every face; leave out" in capsys.readouterr().err


def test_what_is_kept_of_a_stream_is_bounded(monkeypatch):
    monkeypatch.setattr("facetrack_cli.runs.live_people.KEPT", 2)
    cast = LiveCast(None, 25.0, {})
    with open_source(FILM) as source:
        for _ in cast.follow(iter(source), load_recipe("face")):
            assert len(cast.names) <= 4 and len(cast._past) <= 2, "those that are there, and two that were"
