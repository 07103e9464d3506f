"""Report pages: the right frames in their images, sound HTML whatever names hold, one line for what is wrong; who it
is, in words and on the images; and the page of a batch.
"""

import base64
import hashlib
import html
import json
import re
import shutil
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import ExitCode
from facetrack_cli.core.geometry import corners
from facetrack_cli.report.make import identities, key_images, make_report
from facetrack_cli.run_folder.manifest import read_manifest
from facetrack_cli.trajectory.reader import read_header, read_trajectory
from facetrack_cli.trajectory.writers import RunSummary
from tests.support.media import number, write_pictures, write_video
from tests.support.report_run import KEYS, LOST, write_run
from tests.support.sway import SMALL, make_clip


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """Thirty frames with their numbers."""
    return write_video(tmp_path_factory.mktemp("clips") / "clip.mp4", frames=30)


def image_of(run, frame):
    """The image of a frame of a run, and its pixels."""
    table = read_trajectory(run)
    found = key_images(table, read_header(table), [frame], None, lambda *_: None)[0][frame]
    return found, cv2.imdecode(np.frombuffer(found.data, np.uint8), cv2.IMREAD_COLOR)


def shown(html: bytes) -> dict[int, np.ndarray]:
    """The images of a page by the frame that its caption names."""
    found = {}
    figure = r'<img src="data:image/jpeg;base64,([^"]*)"[^>]*>\s*<figcaption>\s*<p><strong>Frame (\d+)<'
    for data, frame in re.findall(figure, html.decode()):
        found[int(frame)] = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
    return found


def seen(html: bytes) -> dict[int, int]:
    """The number that each image shows, by the frame that its caption names."""
    return {frame: number(picture) for frame, picture in shown(html).items()}


class Reader(HTMLParser):
    """Fails where tags do not balance; collects what a page must have."""

    VOID = frozenset(("meta", "img", "source", "br", "link"))

    def __init__(self, html: bytes) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.all: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(html.decode())
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        assert len(dict(attributes)) == len(attributes), f"an attribute twice in {tag}"
        self.all.append((tag, dict(attributes)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] != "style":
            self.text += data


@pytest.mark.usefixtures("no_plot")
def test_key_frames_are_drawn_from_the_clip(tmp_path, clip):
    page = make_report(write_run(tmp_path / "run", clip))
    assert seen(page.html) == {frame: frame for frame in KEYS}
    assert not page.notes
    assert make_report(tmp_path / "run").html == page.html
    assert {picture.shape for picture in shown(page.html).values()} == {(480, 640, 3)}  # enlarged, to be read
    text = Reader(page.html).text
    for said in ("Called lost a", "No longer called lost a after 0.16 s", "End lost: b", "Lowest confidence 0.75"):
        assert said in text


def test_large_clips_are_cut_out_around_the_target_and_windows_stay_in_place(tmp_path):
    size = (1600, 1200)
    still = np.full((size[1], size[0], 3), 90, np.uint8)
    clip = write_pictures(tmp_path / "clip", [still] * 7)
    run = write_run(tmp_path / "run", clip, size=size, frames=2)
    data = json.loads((run / "trajectory.json").read_text())
    data["init"]["targets"]["face"]["box"] = [850, 450, 100, 100]
    for frame in data["frames"]:
        for part, x in zip(frame["targets"][0]["parts"], (900, 1000), strict=True):
            part.update(x=x, y=500, w=40, h=40)
    (run / "trajectory.json").write_text(json.dumps(data))
    found, picture = image_of(run, 6)
    left, top, width, height = found.view
    assert (width, height) == (350, 263)
    assert left < 900 < 1000 < left + width
    assert top < 500 < top + height
    # what was drawn is where the windows are: their edges, 20 px from the centres
    drawn = np.abs(picture.astype(int) - 90).sum(axis=2) > 120
    zoom = found.size[0] / width
    x0, y0 = round((880 - left + 0.5) * zoom), round((480 - top + 0.5) * zoom)
    along, down = drawn[y0 - 2 : y0 + 3].any(axis=0), drawn[:, x0 - 2 : x0 + 3].any(axis=1)
    below = np.flatnonzero(down[40:]) / zoom + 40 / zoom + top  # the status bar
    beside = np.flatnonzero(along) / zoom + left
    assert (below.min(), below.max()) == pytest.approx((480, 520), abs=2)
    assert (beside.min(), beside.max()) == pytest.approx((880, 1020), abs=2)


@pytest.mark.usefixtures("no_plot")
def test_whatever_names_hold_is_text(tmp_path):
    name = "a<b>&\"'$style\n\ud800ü.mp4"
    recipe = {"name": "</style><script>alert(1)</script>", "description": "<!-- & ${body}", "x": [1, {"y": None}]}
    footer = RunSummary(complete=False, stopped="<disk> & full", warnings=("<b>one</b>", "two\x00\x1b"))
    run = write_run(tmp_path / "run", Path(name), recipe=recipe, targets=("<anna>", 'b"en'), footer=footer)
    page = make_report(run)
    read = Reader(page.html)
    assert not {tag for tag, _ in read.all} & {"script", "i", "b", "anna"}
    for text in ("a<b>&\"'$style", "</style><script>", "<disk> & full", "<b>one</b>", "<anna>/a"):
        assert text in read.text
    assert "There are no images" in read.text
    assert not re.search("[\x00-\x08\x0b-\x1f]", page.html.decode())


def test_the_page_is_whole_accessible_and_alone(tmp_path, clip):
    page = make_report(write_run(tmp_path / "run", clip, targets=("anna", "ben")))
    read = Reader(page.html)
    tags = Counter(tag for tag, _ in read.all)
    assert (tags["html"], tags["title"], tags["h1"], tags["main"]) == (1, 1, 1, 1)
    assert read.all[0] == ("html", {"lang": "en"})
    by_tag = {name: [attributes for tag, attributes in read.all if tag == name] for name in tags}
    assert len(by_tag["img"]) == len(KEYS) + 1
    assert all(image["alt"] and image["src"].startswith("data:image/") for image in by_tag["img"])
    assert all(int(image["width"]) > 0 and int(image["height"]) > 0 for image in by_tag["img"])
    assert all(cell["scope"] in ("row", "col") for cell in by_tag["th"])
    ids = [attributes["id"] for _, attributes in read.all if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert {link["href"][1:] for link in by_tag["a"]} == set(ids)
    # nothing is fetched, no script runs, and the style is the one that the policy allows
    fetching = re.findall(r'(?:src|href|srcset)="(?!data:|#)', page.html.decode())
    assert not fetching
    assert not re.search(r"url\(|@import", page.html.decode())
    policy = next(meta["content"] for meta in by_tag["meta"] if meta.get("http-equiv") == "Content-Security-Policy")
    style = re.search(r"<style>(.*?)</style>", page.html.decode(), re.S)[1]
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()
    assert policy == f"default-src 'none'; img-src data:; style-src 'sha256-{digest}'"
    assert not any("style" in attributes or "onclick" in attributes for _, attributes in read.all)


@pytest.mark.usefixtures("no_plot")
def test_many_spans_are_cut_with_a_note(tmp_path, monkeypatch):
    for name in "ab":
        monkeypatch.setitem(LOST, name, range(1, 1000, 2))
    page = make_report(write_run(tmp_path / "run", tmp_path / "gone.mp4", start=0, frames=1000))
    assert "The 100 longest of 1,000 lost spans" in Reader(page.html).text
    assert len(page.html) < 200_000


def test_the_truth_brings_its_measures(tmp_path, no_plot):
    run = write_run(tmp_path / "run", tmp_path / "gone.mp4")
    lines = ["frame,target,part,x,y,status"]
    for frame in range(5, 25):
        lines += [f"{frame},face,a,{12 + 3 * (frame % 2)},44,visible"]
        lines += [f"{frame},face,b,42,48,{'hidden' if frame >= 14 else 'visible'}"]
    truth = tmp_path / "truth<&>.csv"
    truth.write_text("\n".join(lines) + "\n")
    assert main(["report", str(run), "--truth", str(truth), "--overwrite"]) == 0
    read = Reader((run / "report.html").read_bytes())
    assert "truth<&>.csv" in read.text
    assert "29 visible, 11 hidden" in read.text
    assert "Points: distance to the ground truth" in read.text
    assert "\na201.50" in read.text and "\nb94.00" in read.text, "20 rows of a, every other one off by 3 px; 9 of b"
    truth.write_text("\n".join(lines[:-8]) + "\n")
    assert main(["report", str(run), "--truth", str(truth), "--overwrite"]) == ExitCode.INPUT
    assert main(["report", str(run), "--truth", str(truth), "--overwrite", "--partial"]) == 0


@pytest.mark.usefixtures("no_plot")
def test_report_writes_beside_the_trajectory_and_never_over_a_file(tmp_path, capsys):
    clip = write_video(tmp_path / "clip.mp4", frames=30)
    run = write_run(tmp_path / "run", clip)
    assert main(["report", str(run)]) == 0
    said = capsys.readouterr()
    assert said.out == "" and f"{run} -> {run / 'report.html'}" in said.err
    assert main(["report", str(run)]) == ExitCode.USAGE
    assert "--overwrite" in capsys.readouterr().err
    write_video(clip, frames=30, size=(32, 24))  # it changed, and gives no images
    assert main(["report", str(run), "--overwrite"]) == 0
    assert f"warning: {clip}: is 32x24" in capsys.readouterr().err
    text = Reader((run / "report.html").read_bytes()).text
    assert "is 32x24" in text and "There are no images" in text
    assert sorted(path.name for path in run.iterdir()) == ["report.html", "trajectory.json"]


def refused(capsys, *words, code=ExitCode.INPUT) -> str:
    assert main(["report", *map(str, words)]) == code
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "Traceback" not in said
    return said


def test_bad_input_gets_one_line(tmp_path, capsys, clip):
    run = write_run(tmp_path / "run", clip)
    trajectory = run / "trajectory.json"
    whole = trajectory.read_text()
    small = write_video(tmp_path / "small.mp4", frames=30, size=(32, 24))
    short = write_video(tmp_path / "short.mp4", frames=12)
    for words, code, said in (
        ([tmp_path / "none"], ExitCode.INPUT, "name the folder of a run"),
        ([trajectory], ExitCode.INPUT, "name the folder"),
        ([tmp_path], ExitCode.INPUT, "no trajectory.json"),
        ([run, "-o", tmp_path / "no" / "x.html"], ExitCode.USAGE, "no folder"),
        ([run, "-o", tmp_path], ExitCode.USAGE, "is a folder"),
        ([run, "--clip", tmp_path / "none.mp4"], ExitCode.INPUT, "no such file"),
        ([run, "--clip", small], ExitCode.INPUT, "is 32x24, not 64x48"),
        ([run, "--clip", short], ExitCode.INPUT, "there is no frame 12"),
    ):
        assert said in refused(capsys, *words, code=code)
    for text, said in ((whole[:-300], "is not JSON"), (whole.replace("[64,48]", "[64,0]"), "source.size.1")):
        trajectory.write_text(text)
        assert said in refused(capsys, run)
    trajectory.rename(run / "trajectory.csv")
    assert "--format csv,json" in refused(capsys, run)
    assert [path.name for path in run.iterdir()] == ["trajectory.csv"]


def identified(folder, *, target="face", clip="clip.mp4", targets=("face",), **more):
    """A run of a part a target, with identities, and in every frame what else is given."""
    path = write_run(folder, folder.parent / clip, targets=targets) / "trajectory.json"
    whole = json.loads(path.read_text())
    for record in whole["frames"]:
        for one in record["targets"]:
            del one["parts"][1:]
            if one["target"] == target:
                sure = 0.4 if record["frame"] < 9 else 0.95
                one |= {"identity": "anna" if record["frame"] > 6 else "<b>", "identity_prob": sure, **more}
    path.write_text(json.dumps(whole))
    return folder


def test_who_it_is_since_when(tmp_path):
    for k, (more, said) in enumerate((
        ({}, [("face", "anna", 0.95, 9)]),
        ({"target": "b", "targets": ("a", "b")}, [("b", "anna", 0.95, 9)]),
        ({"identity_prob": 0.6}, [("face", "anna", 0.6, None)]),
        ({"target": ""}, []),
    )):  # fmt: skip
        assert list(identities(read_trajectory(identified(tmp_path / str(k), **more)))) == said


@pytest.mark.usefixtures("no_plot")
def test_the_page_and_its_pictures_have_the_name_and_the_parallelogram(tmp_path, clip):
    shutil.copy(clip, tmp_path / "clip.mp4")

    def drawn(name, **more):
        return image_of(identified(tmp_path / name, **more), 10)[1].astype(float)

    plain, named = drawn("plain", identity=None, identity_prob=None), drawn("named")
    upright, lean = (drawn(name, affine=[1, a, 0, 1, 12, 44]) for name, a in (("upright", 0), ("lean", 0.8)))
    assert np.abs(plain - named).max() > 100
    assert np.abs(lean - named).mean() > 1.5 * np.abs(upright - named).mean(), "half a pixel aside, a box is a box"
    assert b"is named" not in make_report(tmp_path / "plain").html
    page = make_report(tmp_path / "named").html.decode()
    named = "It is named anna at the end, with probability 95.0\u00a0%; that passed 0.9 in frame 9, at 0:00.36."
    assert named in html.unescape(page) and "what the tracker reported of identity" in page


def test_corners_follow_the_affine_map():
    def outline(*affine):
        (found,) = corners(np.array([affine]), np.array([(10.0, 20.0)]), np.array([(4.0, 6.0)]))
        return found

    assert outline(2.0, 0, 0, 3, 0, 0).tolist() == [[8, 17], [12, 17], [12, 23], [8, 23]]
    # a quarter turn: x goes down, y to the left
    assert outline(0.0, -1, 1, 0, 0, 0).tolist() == [[13, 18], [13, 22], [7, 22], [7, 18]]
    lean = outline(1.0, 1, 0, 1, 0, 0)
    assert np.linalg.norm(np.diff(lean, axis=0), axis=1)[:2] == pytest.approx([4, 6])
    assert np.isnan(outline(0.0, 1, 0, 1, 0, 0)).all() and np.isnan(outline(*[np.nan] * 6)).all()
    several = corners(np.array([(1.0, 0, 0, 1, 0, 0), (0.0,) * 6]), np.zeros((2, 2)), np.full((2, 2), 2.0))
    assert several[0].tolist() == [[-1, -1], [1, -1], [1, 1], [-1, 1]] and np.isnan(several[1]).all()


def test_the_page_of_a_batch_shows_each_clip_the_worst_first(tmp_path, monkeypatch, capsys):
    """Of three clips: one is lost at its end, one is no video."""
    monkeypatch.chdir(tmp_path)
    Path("clips").mkdir()
    for name in ("a b", "c"):
        make_clip(Path(f"clips/{name}.mp4"), 6)
    Path("clips/d.mp4").write_bytes(b"no video")
    shutil.copy("clips/c.init.yaml", "clips/d.init.yaml")
    assert main(["run", "clips", "-o", "out", "-q", *SMALL]) == 5
    said = replace(read_manifest(Path("out/c-face")), lost_frames={"face/nose": 5}, look=((1, 4),))
    Path("out/c-face/run.json").write_text(json.dumps(said.record()))
    assert main(["report", "out"]) == 0
    page = Path("out/batch.html").read_bytes()
    Reader(page)
    text = page.decode()
    assert re.findall(r'<th scope="row"[^>]*>([^<]*)<', text) == ["d-face", "c-face", "a b-face"]
    assert "not a video" in text and "face nose is lost in 5, frames 1 to 4" in text
    assert text.count("<img ") == 2 and 'href="a%20b-face/annotated.mp4"' in text
    for link in re.findall(r'href="([^"]+)"', text):
        assert (Path("out") / link.replace("%20", " ")).is_file()
    assert main(["report", "out"]) == 2, "it is not replaced"
    assert main(["report", "out", "-o", "elsewhere.html", "-q"]) == 0
    assert 'href="out/c-face/annotated.mp4"' in Path("elsewhere.html").read_text(encoding="utf-8")
    capsys.readouterr()
    assert "--truth and --clip are of one run" in refused(capsys, "out", "--truth", "x.csv", code=ExitCode.USAGE)
