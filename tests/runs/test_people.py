"""A film from the command line: everybody over cuts, under one name, and corrections of that."""

import base64
import csv
import json
import os
import re
import shutil
from collections import Counter, defaultdict
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree as ET

import cv2
import numpy as np
import pytest

import facetrack_cli as facetrack
from facetrack_cli.__main__ import main
from facetrack_cli.cli.options import frame_at
from facetrack_cli.core.errors import BusyError, ExitCode, InputError, UsageError
from facetrack_cli.run_folder.lease import NOTE
from facetrack_cli.runs import clip, record
from facetrack_cli.runs import people as runs_people
from facetrack_cli.runs.people import people_in, recast
from facetrack_cli.runs.plan import Job
from facetrack_cli.runs.seeds import load_recipes
from facetrack_cli.runs.signals import Stop, StoppedError
from facetrack_cli.start import presence
from facetrack_cli.trackers.people import descriptor
from facetrack_cli.trackers.people.descriptor import UNKNOWN, VIEWS, Cast, Describer, Doubt, TrackSummary, cast_of
from facetrack_cli.trajectory.people import read_people, read_still, rename, under_names
from facetrack_cli.trajectory.reader import read_trajectory
from facetrack_cli.trajectory.views import Clock
from facetrack_cli.video.shots import Shot
from facetrack_cli.video.source import open_source
from facetrack_cli.video.writer import VideoWriter
from tests.support.film_run import FILM, film_run
from tests.support.samples import FOLDER, read_rows

CUTS = [45, 90, 140, 190, 253]


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """A run of the sample film."""
    return film_run(tmp_path_factory)


def job(out, stop=108, **more):
    [recipe] = load_recipes([("face", ())], None)
    return Job(FILM, recipe, out, video=False, faces="all", start=80, stop=stop, **more)


@pytest.fixture(scope="module")
def tracked(tmp_path_factory):
    """Some frames of the film, tracked, and interrupted before they were named."""
    out, stop = tmp_path_factory.mktemp("tracked") / "out", Stop()

    def looked(done, total, doing="", unit=""):
        if doing == "looking at people":
            stop.code = ExitCode.TERMINATED

    assert clip.run(job(out), stop, looked=looked).stopped is not None
    return out


@pytest.fixture(scope="module")
def named(tracked):
    """The same, named by the next run."""
    out = shutil.copytree(tracked, tracked.parent / "named")
    assert read_people(out) is None and clip.run(job(out), Stop()).failure is None
    assert read_trajectory(out / "trajectory.json").targets == ("person_1", "person_2")
    return out


@pytest.fixture
def copy(ran, tmp_path):
    """A copy of the run of the sample film."""
    return shutil.copytree(ran, tmp_path / "out")


@pytest.fixture
def few(named, tmp_path):
    """A copy of the run of some frames."""
    return shutil.copytree(named, tmp_path / "out")


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def matched(rows):
    """How many boxes of the ground truth each pair of person and target shares, and how many are of nobody."""
    true = defaultdict(dict)
    for row in read_rows("film"):
        true[int(row["frame"])][row["target"]] = np.array([float(row[key]) for key in "xyw"])
    pairs, false = Counter(), 0
    for part in rows.parts:
        for i in np.flatnonzero((part.status != "lost") if part.part == "box" else []).tolist():
            at = {n: np.hypot(part.x[i] - x, part.y[i] - y) / w for n, (x, y, w) in true[int(part.frame[i])].items()}
            best = min(at, key=at.get, default=None)
            if best is None or at[best] > 0.35:
                false += 1
            else:
                pairs[best, part.target] += 1
    return pairs, false, sum(map(len, true.values()))


def test_everybody_has_one_name_from_the_first_frame_to_the_last(ran):
    pairs, false, there = matched(read_trajectory(ran / "trajectory.json"))
    assert set(pairs) == {("collins", "person_1"), ("hopper", "person_2")}
    assert pairs.total() > 0.95 * there and false < 0.03 * there
    people = read_people(ran)
    begins = [shot.first for shot in people.shots]
    assert len(begins) == 7 and all(cut in begins for cut in CUTS) and any(205 <= one <= 216 for one in begins)
    assert people.names == ("person_1", "person_2") and not any(one.photograph for one in people.people)
    assert people.seconds_together()["person_1", "person_2"] == pytest.approx(2.0, abs=0.1)


def test_one_face_is_followed_over_cuts_and_nobody_in_its_place(tmp_path):
    few = ["--no-video", "--start", "20", "--stop", "105"]
    assert main(["run", str(FILM), *few, "-o", str(tmp_path / "out"), "-q"]) == 0
    pairs, false, _ = matched(read_trajectory(tmp_path / "out" / "trajectory.json"))
    there = sum(row["target"] == "collins" and 20 <= int(row["frame"]) < 105 for row in read_rows("film"))
    assert set(pairs) == {("collins", "face")} and pairs.total() > 0.95 * there and false < 0.03 * there


def test_the_files_of_a_film_which_the_same_command_leaves(ran, capsys):
    names = {path.name for path in ran.iterdir()}
    assert names == {"annotated.mp4", "people", "people.json", "run.json", "trajectory.csv", "trajectory.json"}
    assert {path.name for path in (ran / "people").iterdir()} == {"1.jpg", "2.jpg"}
    assert cv2.imread(str(ran / "people" / "1.jpg")).shape == (240, 240, 3)
    with open_source(ran / "annotated.mp4") as source:
        assert sum(1 for _ in source) == 293
    run = json.loads((ran / "run.json").read_text())
    assert run["frames"] == 293 and run["complete"] and "people.json" in run["files"]
    # nobody is there in the shot of the desk, and no row is
    frames = {int(row["frame"]) for row in csv.DictReader((ran / "trajectory.csv").read_text().splitlines())}
    assert not frames & set(range(190, 205))
    before = {path: path.stat().st_mtime_ns for path in ran.iterdir()}
    assert main(["run", str(FILM), "--faces", "all", "-o", str(ran)]) == 0
    assert "done before" in capsys.readouterr().err
    assert {path: path.stat().st_mtime_ns for path in ran.iterdir()} == before


def test_the_cast_is_shown_and_corrected(ran, copy, capsys):
    assert main(["people", str(copy)]) == 0
    said = capsys.readouterr().out
    assert "2 people in 7 shots" in said and "person_2" in said
    changes = ["--rename", "person_2=Grace", "--split", "person_1@0:06"]
    assert main(["people", str(copy), *changes, "--no-video", "-q"]) == 0
    rows = read_trajectory(copy / "trajectory.json")
    assert rows.targets == ("person_1", "Grace", "person_3")
    assert rows.find("person_3", "box").frame[0] == 150
    before, after = read_people(ran), read_people(copy)
    assert {f"people/{path.name}" for path in (copy / "people").iterdir()} == {one.still for one in after.people}
    assert [one.name for one in after.people] == ["person_1", "Grace", "person_3"]
    assert (ran / before.people[1].still).read_bytes() == (copy / after.people[1].still).read_bytes()
    capsys.readouterr()
    assert main(["people", str(copy), "--merge", "person_3=person_1", "-q"]) == 0
    assert capsys.readouterr().out == ""
    people = json.loads((copy / "people.json").read_bytes())
    assert [one["name"] for one in people["people"]] == ["person_1", "Grace"]
    assert people["corrections"] == ["split person_1@0:06", "rename person_2=Grace", "merge person_3=person_1"]
    before, after = (read_trajectory(folder / "trajectory.json") for folder in (ran, copy))
    assert np.array_equal(before.find("person_1", "nose").x, after.find("person_1", "nose").x)
    assert main(["people", str(copy), "--merge", "Grace=person_1"]) == ExitCode.USAGE
    assert "both seen in frame 9" in capsys.readouterr().err


OUTSIDE = ("../x", "a/b", "a\\b", "", " ", "..", "a\0b", "a\nb", "\ud800", "x" * 101, "\x1b[2J", "\u202eb")


@pytest.mark.parametrize("name", OUTSIDE)
def test_names_that_are_none_are_refused_wherever_they_come_from(few, capsys, name):
    before = contents(few)
    with pytest.raises(UsageError, match="name of a person"):
        recast(few, [("", lambda tracks: rename(tracks, "person_1", name))], video=False)
    assert contents(few) == before
    told = (few / "people.json").read_text().replace("person_1", json.dumps(name)[1:-1])
    (few / "people.json").write_text(told)
    (few / "run.json").unlink()
    assert main(["people", str(few)]) == ExitCode.INPUT
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "people.json" in said and "internal" not in said


def test_a_gallery_has_names_that_are_some(tmp_path):
    path = tmp_path / "known.npz"
    looks = descriptor.FaceDescriptor(*(np.zeros((1, n), "<f8") for n in (576, 3, 3, 36, 0, 1)))
    descriptor.save_people(path, {"../x": looks})
    with pytest.raises(InputError, match=r"known.npz: is not a usable file of known people: .*name of a person"):
        descriptor.load_people(path)


def test_a_film_without_its_rows_is_one_line(copy, capsys):
    for path in copy.glob("trajectory.*"):
        path.unlink()
    for options in ([], ["--split", "person_1@0:01"], ["--rename", "person_1=Ann"]):
        assert main(["people", str(copy), *options]) == 3
        assert capsys.readouterr().err.startswith(f"facetrack: error: {copy}: cannot be read: Is a directory; name a ")


def test_pictures_are_not_taken_of_another_film(copy, tmp_path, capsys):
    other = shutil.copy(FOLDER / "lamp.mp4", tmp_path / "other.mp4")
    before = (copy / "people.json").read_bytes()
    for options in (["--rename", "person_1=Ann"], ["--save", str(tmp_path / "known.npz")], ["--page"]):
        assert main(["people", str(copy), *options, "--clip", str(other)]) == 3
        assert f"{other}: is not the clip that trajectory.json was made from" in capsys.readouterr().err
    assert (copy / "people.json").read_bytes() == before


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("fps", 0), ("fps", float("inf")), ("people", []), ("shots", []), ("tracks", []), ("tracks.0.stop", 0),
        ("people.0.intervals", []), ("people.0.intervals", [[5, 5]]), ("people.0.intervals", [[0, 10**30]]),
        ("people.0.seconds", float("nan")), ("people.0.times", [[0, float("nan")]]),
        ("people.0.times", [[0, 1]] * 99), ("people.0.name", "nobody"), ("people.0.still", "../run.json"),
        ("people.0.still", "people/../run.json"), ("people.0.still", "people/.."), ("people.0.still", "run.json"),
        ("people.0.still", "people/a\0.jpg"),
    ],
)  # fmt: skip
def test_what_is_no_cast_is_one_line(few, capsys, key, value):
    told = holder = json.loads((few / "people.json").read_text())
    *above, last = key.split(".")
    for step in above:
        holder = holder[int(step) if step.isdigit() else step]
    holder[last] = value
    (few / "people.json").write_text(json.dumps(told))
    (few / "run.json").unlink()
    for words in (["people", few], ["people", few, "--rename", "person_1=Ann", "--no-video"], ["report", few]):
        assert main([*map(str, words), "-q"]) == ExitCode.INPUT
        said = capsys.readouterr().err
        assert said.count("\n") == 1 and "people.json" in said and "internal" not in said


def test_a_picture_is_a_file_of_the_folder(named, tmp_path, capsys, no_plot):
    """A link in the place of a picture, or of the folder of pictures, is neither shown nor copied nor written to."""
    secret = tmp_path / "secret.jpg"
    secret.write_bytes(b"\xff\xd8 not yours")
    for at in ("people/1.jpg", "people"):
        out = shutil.copytree(named, tmp_path / at.replace("/", "_"))
        if at == "people":
            shutil.move(out / at, tmp_path / "elsewhere")
            (out / at).symlink_to(tmp_path / "elsewhere")
        else:
            (out / at).unlink()
            (out / at).symlink_to(secret)
        page = tmp_path / "page.html"
        assert main(["report", str(out), "-o", str(page), "-q", "--overwrite"]) == 0
        assert base64.b64encode(secret.read_bytes()).decode() not in page.read_text(encoding="utf-8")
        code = main(["people", str(out), "--rename", "person_1=Ann", "--no-video", "-q"])
        assert code == ExitCode.USAGE and "is a link" in capsys.readouterr().err
        assert secret.read_bytes() == b"\xff\xd8 not yours" and "Ann" not in (out / "people.json").read_text()


def test_a_picture_without_end_or_of_any_size(copy):
    (copy / "people" / "1.jpg").unlink()
    if hasattr(os, "mkfifo"):
        os.mkfifo(copy / "people" / "1.jpg")
        assert read_still(copy, "people/1.jpg") == b""
    with (copy / "people" / "2.jpg").open("wb") as file:
        file.truncate(1 << 40)
    assert read_still(copy, "people/2.jpg") == b""
    with (copy / "people.json").open("ab") as file:
        file.truncate(1 << 40)
    with pytest.raises(InputError, match="too large"):
        read_people(copy)


def test_of_two_corrections_at_once_none_is_lost(few, monkeypatch):
    """The second one is refused while the first is at work: it would begin from what the first replaces."""

    def meanwhile(rows, tracks):
        with pytest.raises(BusyError):
            recast(few, [("b", lambda tracks: rename(tracks, "person_2", "Ben"))], video=False)
        return under_names(rows, tracks)

    monkeypatch.setattr(runs_people, "under_names", meanwhile)
    recast(few, [("a", lambda tracks: rename(tracks, "person_1", "Ann"))], video=False)
    monkeypatch.undo()
    recast(few, [("b", lambda tracks: rename(tracks, "person_2", "Ben"))], video=False)
    assert read_people(few).names == ("Ann", "Ben") and read_people(few).corrections == ("a", "b")


def test_a_correction_that_is_stopped_leaves_all_as_it_was(copy):
    shutil.rmtree(copy / "people")
    before = contents(copy)
    with pytest.raises(StoppedError):
        recast(copy, [("a", lambda tracks: rename(tracks, "person_1", "Ann"))], stop=lambda: True)
    assert contents(copy) == before


@pytest.mark.parametrize("after", range(6))
def test_a_kill_between_two_files_of_a_correction(few, monkeypatch, after):
    """Rows, people.json and pictures are all new, whenever the process ends once the note is written."""
    replace, done = Path.replace, []

    class Killed(BaseException):
        pass

    def killed(self, to):
        if to.name == NOTE:
            return replace(self, to)
        if len(done) == after:
            raise Killed
        done.append(to)
        return replace(self, to)

    monkeypatch.setattr(Path, "replace", killed)
    monkeypatch.setattr("facetrack_cli.runs.finished.discard", lambda path: None)
    with pytest.raises(Killed):
        recast(few, [("a", lambda tracks: rename(tracks, "person_1", "Ann"))], video=False)
    monkeypatch.undo()
    found = people_in(few)
    assert found.names == ("Ann", "person_2")
    assert {f"people/{path.name}" for path in (few / "people").iterdir()} == {one.still for one in found.people}


@pytest.mark.parametrize("doubts", [(), (Doubt(0, 1, 0.4),)])
def test_more_views_are_embedded_where_somebody_is_in_doubt(tracked, tmp_path, monkeypatch, doubts):
    looks, asked = Describer.looks, []
    monkeypatch.setattr(Describer, "looks", lambda self, most=VIEWS: asked.append(most) or looks(self, most))
    monkeypatch.setattr(runs_people, "cast_of", lambda tracks, *more: cast_of(tracks)._replace(doubts=doubts))
    assert clip.run(job(shutil.copytree(tracked, tmp_path / "out")), Stop()).failure is None
    few = asked.count(runs_people.FIRST_VIEWS)
    assert few > 0 and asked[few:] == [VIEWS] * (few if doubts else 0)


def test_the_report_shows_the_cast_and_doubts_side_by_side(tracked, tmp_path, monkeypatch, no_plot):
    def unsure(tracks, known, fps):
        return cast_of(tracks)._replace(doubts=(Doubt(0, 1, 0.4), Doubt(1, None, 0.3)))

    out, page = shutil.copytree(tracked, tmp_path / "out"), tmp_path / "page.html"
    monkeypatch.setattr(runs_people, "cast_of", unsure)
    assert clip.run(job(out), Stop()).failure is None
    doubts = read_people(out).doubts
    assert len(doubts) == 2 and all((out / one.still).is_file() for one in doubts)
    assert main(["report", str(out), "-o", str(page), "-q"]) == 0
    html = page.read_text(encoding="utf-8")
    assert html.index('id="people"') < html.index('id="summary"')
    section = html[html.index('id="people"') : html.index('id="summary"')]
    assert section.count("<img ") == 2 + 3 + 2 and section.count(">?</span>") == 1
    assert "2 people in 2 shots" in section and "somebody new with P 0.30" in section
    assert "Who is on the screen with whom" in section and "corrected by hand" not in html
    # a correction keeps the pictures of what is still in doubt
    assert main(["people", str(out), "--rename", "person_1=Eileen", "-q"]) == 0
    assert all((out / one.still).is_file() for one in read_people(out).doubts)


def test_intervals_are_csv_and_tiers_and_in_python(ran, tmp_path, capsys):
    assert main(["people", str(ran), "--csv"]) == 0
    rows = list(csv.DictReader(capsys.readouterr().out.splitlines()))
    spans = [(row["person"], int(row["first_frame"]), int(row["last_frame"])) for row in rows]
    people = read_trajectory(ran / "trajectory.json").people
    assert spans == sorted(
        ((one.name, first, stop - 1) for one in people.people for first, stop in one.intervals),
        key=lambda span: span[1:],
    )
    assert float(rows[1]["begin_s"]) == pytest.approx(45 / 25)
    assert main(["export", str(ran), "--to", "eaf", "-o", str(tmp_path / "film.eaf")]) == 0
    tiers = {tier.get("TIER_ID"): tier for tier in ET.parse(tmp_path / "film.eaf").iter("TIER")}
    for name in people.names:
        seen = [span for span in spans if span[0] == name]
        assert [one.text for one in tiers[f"seen@{name}"].iter("ANNOTATION_VALUE")] == ["seen"] * len(seen)


def test_people_of_another_film_have_their_names(named, tmp_path, capsys):
    out, known = shutil.copytree(named, tmp_path / "out"), tmp_path / "people.npz"
    names = ["--rename", "person_1=Grace", "--rename", "person_2=Eileen", "--no-video", "--save", str(known), "-q"]
    assert main(["people", str(out), *names]) == 0
    again = ["run", str(FILM), "--faces", "all", "--start", "100", "--stop", "115", "--no-video", "--gallery"]
    assert main([*again, str(known), "-o", str(tmp_path / "named"), "-q"]) == 0
    pairs, _, _ = matched(read_trajectory(tmp_path / "named" / "trajectory.json"))
    assert set(pairs) == {("hopper", "Grace"), ("collins", "Eileen")}
    capsys.readouterr()
    assert main([*again, str(tmp_path / "none.npz"), "-o", str(tmp_path / "no")]) == ExitCode.INPUT
    assert "none.npz: cannot be read: No such file" in capsys.readouterr().err


def test_a_gallery_of_affine_faces_is_for_recipes_that_recognise_by_it(tmp_path, capsys):
    """Whatever --faces says: it is read as a gallery of `gallery fit`, and the recipe is not said to lack one."""
    missing = ["--faces", "all", "--gallery", str(tmp_path / "none.npz"), "-o", str(tmp_path / "out")]
    assert main(["run", str(FILM), "--config", "adaptive_recognition", *missing]) == ExitCode.INPUT
    assert "none.npz: no such file; name one as facetrack gallery fit" in capsys.readouterr().err
    assert main(["run", str(FILM), "--box", "10,10,60,60", "--config", "face", *missing]) == ExitCode.USAGE
    assert "has a start" in capsys.readouterr().err


def test_a_film_in_python_is_that_of_the_command_line():
    found = facetrack.track_video(FILM, faces="all", start=80, stop=100)
    assert found.targets == ("person_1", "person_2") and found.people.names == found.targets
    assert found.people.seconds_together()["person_1", "person_2"] == pytest.approx(0.4, abs=0.1)
    assert facetrack.track_video(FILM, start=80, stop=82).people is None


def test_a_run_of_one_face_has_no_cast(tmp_path, capsys):
    assert main(["people", str(tmp_path)]) == ExitCode.INPUT
    assert "has no people.json; facetrack run --faces all writes it" in capsys.readouterr().err
    assert main(["people", str(tmp_path / "none")]) == ExitCode.INPUT
    assert "none: has no people.json; facetrack run --faces all writes" in capsys.readouterr().err


def test_a_film_that_was_interrupted_goes_on_with_the_same_rows(named, tmp_path, monkeypatch):
    monkeypatch.setattr(record, "EVERY_FRAMES", 7)
    out, stop = tmp_path / "out", Stop()

    def report(done, total, doing=""):
        if done >= 23 and not doing:
            stop.code = ExitCode.INTERRUPTED

    assert clip.run(job(out), stop, report).stopped is not None
    done = clip.run(job(out), Stop())
    assert done.failure is None and done.resumed
    for name in ("trajectory.csv", "trajectory.json", "people.json"):
        assert (out / name).read_bytes() == (named / name).read_bytes()


def test_a_crowd_is_bounded_and_said(tmp_path, monkeypatch):
    monkeypatch.setattr(presence, "MAX_FACES", 1)
    done = clip.run(job(tmp_path / "out", stop=98), Stop())
    assert done.failure is None
    [said] = [line for line in done.warnings if "faces at a time" in line]
    assert said.startswith("more than 1 faces at a time, first in frame 9")
    boxes = [one for one in read_trajectory(tmp_path / "out" / "trajectory.json").parts if one.part == "box"]
    assert np.unique(np.concatenate([one.frame for one in boxes]), return_counts=True)[1].max() == 1


def test_a_film_of_nobody(tmp_path, capsys):
    path = tmp_path / "grey.mp4"
    with VideoWriter(path, (128, 96), 25) as video:
        for t in range(20):
            video.write(np.full((96, 128, 3), 90 + t, np.uint8), t / 25)
    assert main(["run", str(path), "--faces", "all", "-o", str(tmp_path / "out"), "-q"]) == ExitCode.INPUT
    assert "grey.mp4: no face found in frames 0 to 19" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--smooth"], "no row is smoothed over a cut"),
        (["--lag", "5"], "no row is smoothed over a cut"),
        (["-o", "-"], "name a folder"),
        (["--config", "signer"], "recipe signer follows the hands of one person"),
    ],
)
def test_what_a_film_cannot_is_refused(given, said, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["run", str(FILM), "--faces", "all", *given]) == ExitCode.USAGE
    told = capsys.readouterr().err
    assert "--faces all" in told and said in told and told.count("\n") == 1 and not [*tmp_path.iterdir()]


@pytest.mark.parametrize(
    ("clip", "config", "begins"),
    [(FOLDER / "expressions.mp4", "factorized", ".*expressions.init.yaml"), (FILM, "histogram", "[a-z]+")],
)
def test_who_has_a_start_is_followed_alone_and_that_is_said(tmp_path, capsys, clip, config, begins):
    few = ["--config", config, "--stop", "12", "--no-video", "-o", str(tmp_path)]
    assert main(["run", str(clip), "--faces", "all", *few]) == 0
    remedy = "recipe face with --init haar follows everybody, over cuts"
    said = f"--faces all: {config} follows those of frame 0, by {begins}, and no other; {remedy}"
    assert re.search(said, capsys.readouterr().err.replace("\n", " "))


def test_moments():
    assert [frame_at(one, Clock(None, 25.0)) for one in ("2075f", "83", "1:23", "0:01:23.0")] == [2075] * 4
    for odd in ("x", "1:x", "f", "1e999"):
        with pytest.raises(UsageError, match="is no time"):
            frame_at(odd, Clock(None, 25.0))


def seen(name, first, stop, x=100.0, side=50.0, shot=1):
    return TrackSummary(name, first, stop, (x, 40.0, side, side), (x, 40.0, side, side), shot, None)


SHOTS = [Shot(0, 40, 0, 40), Shot(40, 90, 40, 90)]


def test_a_cut_after_which_the_same_faces_go_on_in_the_same_places_was_none():
    before = [seen("a", 0, 40), seen("b", 5, 40, x=300)]
    after = [seen("c", 40, 90, shot=2), seen("d", 48, 90, 303, shot=2)]
    assert runs_people._true(SHOTS, [*before, *after], ["Ann", "Bob", "Ann", "Bob"], 25.0) == [Shot(0, 90, 0, 90)]
    for tracks, names in (
        ([*before, *after], ["Ann", "Bob", "Cleo", "Bob"]),
        ([*before, after[0]], ["Ann", "Bob", "Ann"]),
        ([before[0], after[1]], ["Ann", "Ann"]),
        ([before[0], seen("c", 60, 90, shot=2)], ["Ann", "Ann"]),
        ([], []),
    ):
        assert runs_people._true(SHOTS, tracks, names, 25.0) == SHOTS


def test_faces_that_cannot_be_told_again_are_unknown_and_those_of_one_frame_have_two_names():
    tracks = [seen("a", 0, 40), seen("b", 0, 30, x=300), seen("c", 10, 20, x=500), seen("d", 35, 40, x=300)]
    reader = SimpleNamespace(change=lambda: 9.0, best=(1.0, np.zeros((8, 8, 3), np.uint8)))
    found = Cast(np.array([0, UNKNOWN, UNKNOWN, UNKNOWN]), np.array([1.0, 0.4, 0.4, 0.4]), (Doubt(1, 0, 0.3),))
    named = runs_people._named(tracks, found, ["person_1"], defaultdict(lambda: reader), SHOTS[:1], Clock(None, 25.0))
    assert [one.person for one in named.tracks] == ["person_1", "unknown", "unknown_2", "unknown"]
    line = runs_people.cast_line(named.people)
    assert line.startswith("1 person in 1 shot: person_1 1.6 s; 1 of 4 tracks are in doubt")
    assert line.endswith("; 3 show no face that could be told again (unknown)")
