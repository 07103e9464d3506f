"""facetrack gallery fit and show: files, words, refusals, and the figure."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from facetrack_cli.core.errors import UsageError
from facetrack_cli.report.figures.gallery import calibrated, gallery_figure, kept
from facetrack_cli.report.figures.style import DPI, WIDTH, render
from facetrack_cli.trackers.appearance.gallery import load_gallery
from facetrack_cli.trackers.appearance.gallery_fit import fit_gallery
from tests.support.gallery_faces import NAMES, people_folder
from tests.support.samples import FOLDER

pytest.importorskip("matplotlib", reason="needs the extra: pip install -e '.[plot]'")


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """`IN`: people/ with two persons of three images each, single/ with one image each."""
    folder = tmp_path_factory.mktemp("galleries")
    people_folder(folder / "people", 3)
    people_folder(folder / "single", 1)
    return folder


def missing():
    raise UsageError("figures need matplotlib")


def names_here():
    return sorted(path.name for path in Path().iterdir())


def some_gallery(names, pictures=3, shape=(30, 26), seed=0):
    """Faces made of smooth noise, with a calibration as real ones have."""
    rng = np.random.default_rng(seed)

    def smooth(count):
        noise = rng.normal(size=(count, *shape))
        blurred = np.stack([cv2.GaussianBlur(one, (0, 0), 3) for one in noise]).reshape(count, -1)
        return (blurred - blurred.mean(1, keepdims=True)) / blurred.std(1, keepdims=True)

    own = np.repeat(smooth(len(names)), pictures, 0) + 0.3 * smooth(len(names) * pictures)
    own = (own - own.mean(1, keepdims=True)) / own.std(1, keepdims=True)
    return fit_gallery(own, np.repeat(names, pictures).tolist(), shape, negatives=smooth(60))


def test_fit_and_show(facetrack, clips):
    code, out, err = facetrack("gallery", "fit", "IN/people", "-o", "own.npz")
    assert (code, out) == (0, "")
    gallery = load_gallery(Path("own.npz"))
    assert gallery.names == NAMES and gallery.counts == (3, 3) and gallery.shape == (30, 26)
    lines = [line for line in err.splitlines() if "frames/s" not in line]  # of a busy machine
    assert [line.split() for line in lines[:3]] == [
        ["person", "used", "skipped"],
        ["collins", "3", "0"],
        ["hopper", "3", "0"],
    ]
    assert calibrated(gallery) in lines and lines[-1] == "own.npz: 2 persons, 6 images"
    assert f"intra-personal: {kept(gallery.intra)}" in lines

    code, out, err = facetrack("gallery", "show", "own.npz")
    assert (code, err) == (0, "")
    for said in ("template: 26 points across, 30 down", "   1 collins: 3 images", "figure: own.png"):
        assert said in out.splitlines()
    assert cv2.imread("own.png").shape[1] == WIDTH * DPI
    code, _, err = facetrack("gallery", "show", "own.npz")
    assert code == 2 and "own.png" in err and "--overwrite" in err
    assert facetrack("gallery", "show", "own.npz", "--overwrite")[0] == 0
    for ending, begins in (("svg", b"<?xml"), ("PDF", b"%PDF")):
        assert facetrack("gallery", "show", "own.npz", "-o", f"own.{ending}")[0] == 0
        assert Path(f"own.{ending}").read_bytes().startswith(begins)
    assert names_here() == ["own.PDF", "own.npz", "own.png", "own.svg"]


def test_without_matplotlib_show_says_how_to_get_it_and_writes_nothing(facetrack, clips, monkeypatch):
    some_gallery(["anna", "ben"]).save(Path("gallery.npz"))
    monkeypatch.setattr("facetrack_cli.report.figures.style.need_matplotlib", missing)
    code, out, err = facetrack("gallery", "show")
    assert (code, out, err) == (2, "", "facetrack: error: figures need matplotlib\n")
    assert names_here() == ["gallery.npz"]


@pytest.mark.nightly
def test_the_sample_gallery_is_whole(facetrack):
    code, _, err = facetrack("gallery", "fit", FOLDER / "gallery", "--jitter", "0")
    assert code == 0 and "warning" not in err
    gallery = load_gallery(Path("gallery.npz"))
    assert len(gallery.names) == 6 and gallery.counts == (5,) * 6


def test_a_single_picture_each_is_told_and_without_copies_refused(facetrack, clips):
    code, _, err = facetrack("gallery", "fit", "IN/single", "--jitter", "0")
    assert code == 3 and f"{clips}/single: " in err and "cannot be learned" in err and "--jitter" in err
    assert err.count("\n") == 1 and names_here() == []
    code, _, err = facetrack("gallery", "fit", "IN/single")
    note = [line for line in err.splitlines() if line.startswith("note: ")]
    assert code == 0 and len(note) == 1 and "collins, hopper" in note[0] and "cannot be learned" in note[0]
    assert note[0] in facetrack("gallery", "show")[1].splitlines()


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["IN/absent"], 3, "no such folder"),
        (["IN/people", "-o", "own.npy"], 2, "own.npy"),
        (["IN/people", "-o", "no/own.npz"], 2, "no folder no"),
        (["IN/people", "--start", "5", "--stop", "5"], 2, "--stop"),
        (["IN/people", "--template", "30"], 2, "26x30"),
        (["IN/people", "--template", "3x900"], 2, "from 6 to 128"),
        (["IN/people", "--frames", "0"], 2, "--frames"),
        (["IN/people/collins"], 3, "no folders"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(facetrack, arguments, code, said):
    found, out, err = facetrack("gallery", "fit", *arguments)
    assert found == code and said in err and err.count("\n") == 1 and out == "" and names_here() == []


def test_what_is_there_is_not_replaced(facetrack):
    Path("gallery.npz").write_text("precious")
    code, _, err = facetrack("gallery", "fit", "IN/people")
    assert code == 2 and "gallery.npz" in err and "--overwrite" in err
    assert Path("gallery.npz").read_text() == "precious"
    code, _, err = facetrack("gallery", "show")
    assert code == 3 and "gallery.npz: is not a usable gallery" in err
    code, _, err = facetrack("gallery", "show", "-o", "look.jpg")
    assert code == 2 and "look.jpg" in err and ".png" in err
    assert facetrack("gallery", "fit", "IN/people", "--overwrite", "-q", "--jitter", "0", "--template", "13x15")[0] == 0
    gallery = load_gallery(Path("gallery.npz"))
    assert gallery.names == NAMES and gallery.shape == (15, 13), "width by height"


@pytest.mark.parametrize("place", ["start.gallery_images.find_faces", "core.files.publish"])
def test_an_interrupt_leaves_nothing_behind(facetrack, monkeypatch, place):
    def interrupted(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(f"facetrack_cli.{place}", interrupted)
    code, out, err = facetrack("gallery", "fit", "IN/people", "--jitter", "0")
    assert (code, out) == (130, "") and err.splitlines()[-1] == "facetrack: interrupted"
    assert names_here() == []


# --- the figure ----------------------------------------------------------------------------------------------------

LONG = "Ada Augusta King, Countess of Lovelace, of Ockham Park"


def drawn(gallery, title="gallery.npz"):
    return cv2.imdecode(np.frombuffer(render(gallery_figure(gallery, title=title)), np.uint8), cv2.IMREAD_COLOR)


@pytest.mark.parametrize("count", [10, *(pytest.param(count, marks=pytest.mark.nightly) for count in (2, 60, 90))])
def test_the_figure_has_everyone_in_it(count):
    names = [f"person {number:03}" for number in range(count)]
    gallery = some_gallery(names, pictures=2, shape=(15, 13))
    figure = gallery_figure(gallery, title="gallery.npz")
    assert figure.get_figheight() < 35
    said = " ".join(text.get_text() for text in figure.axes[0].texts)
    assert all(f"{number + 1} {name}" in said for number, name in enumerate(names))
    assert said.count("2 images") == count
    picture = drawn(gallery)
    # no text or face runs out of the page
    edge = np.concatenate([picture[:, :20], picture[:, -20:]], axis=1)
    assert (edge == 255).all() and (picture[-6:] == 255).all()
    # another name or another face shows
    other = some_gallery([*names[:-1], "zz"], pictures=2, shape=(15, 13))
    changed = np.argwhere((drawn(other) != picture).any(2))
    assert len(changed) and changed[:, 0].min() > 500
    assert (drawn(gallery) == picture).all()


@pytest.mark.one_in(4)
@pytest.mark.parametrize(
    "name", [LONG, LONG.replace(" ", ""), "Ñandú Žižek", "李小龍", "a", "$x_1^2$", "x" * 300, "_a"]
)
def test_names_of_every_kind_are_drawn(name):
    picture = drawn(some_gallery([name, "ben"]), name)
    assert (picture[:, -20:] == 255).all()
    assert (picture < 128).any(2).sum() > 5000


def test_a_name_without_room_is_cut_on_its_second_line():
    names = [LONG, LONG.replace(" ", ""), "W" * 40, *(f"person {number}" for number in range(8))]
    texts = [text.get_text() for text in gallery_figure(some_gallery(names), title="t").axes[0].texts]
    at = texts.index("Who is in it") + 1
    for number in range(1, 4):
        assert texts[at].startswith(f"{number} ") and texts[at + 1].endswith("…") and texts[at + 2] == "3 images"
        at += 3
