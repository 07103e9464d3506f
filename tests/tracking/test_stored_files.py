"""The contract of stored arrays: a shape prior, a gallery and regressions are read back, or refused in one line."""

import io
import zipfile
from functools import cache

import numpy as np
import pytest

from facetrack_cli.core.errors import InputError
from facetrack_cli.trackers.appearance.gallery import load_gallery
from facetrack_cli.trackers.face import eyes
from facetrack_cli.trackers.face.cascaded_regression import DEFAULT, load_regression
from facetrack_cli.trackers.points.shape_prior import default_prior_path, load_prior
from tests.support.samples import FOLDER

LOADED = {
    "shape prior": (load_prior, default_prior_path()),
    "gallery": (load_gallery, FOLDER / "people.npz"),
    "mouth descent": (load_regression, default_prior_path().with_name(DEFAULT)),
    "eye descent": (eyes.load_eyes, default_prior_path().with_name(eyes.DEFAULT)),
}
KINDS = pytest.mark.parametrize("kind", LOADED)
OPTIONAL = {"format", "version", "proportion"}  # of the first two the message says more


@cache
def stored(kind):
    """The object in a file, and its arrays."""
    load, path = LOADED[kind]
    with np.load(path) as file:
        return load(path), dict(file)


def refused(kind, path):
    with pytest.raises(InputError) as caught:
        LOADED[kind][0](path)
    message = str(caught.value)
    assert message.startswith(str(path)) and "\n" not in message
    return message


@KINDS
def test_what_is_written_is_read_back_and_equal_objects_give_equal_bytes(kind, tmp_path):
    one, arrays = stored(kind)
    one.save(tmp_path / "a.npz")
    LOADED[kind][0](tmp_path / "a.npz").save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    with np.load(tmp_path / "a.npz") as file:
        for name, values in file.items():
            np.testing.assert_array_equal(values, arrays[name])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npz", "b.npz"]


@KINDS
def test_a_file_of_another_kind_or_without_an_array_is_refused(kind, tmp_path):
    path = tmp_path / "x.npz"
    assert "No such file" in refused(kind, path)
    assert "cannot be read" in refused(kind, tmp_path)
    arrays = stored(kind)[1]
    name = next(name for name, one in arrays.items() if name not in OPTIONAL and one.dtype.kind == "f" and one.ndim)
    for changed, said in (
        ({"version": np.array(2)}, "format version 2, and this facetrack reads version 1"),
        ({"version": np.array([])}, "is not a usable"),
        ({"format": np.array("other")}, f"is not a {kind}"),
        ({name: np.array([{}])}, "no .npz of plain arrays"),
        ({name: np.array(["x"])}, f"{name} is of"),
        ({name: np.full_like(arrays[name], np.nan)}, "not finite"),
    ):
        np.savez(path, **(arrays | changed))
        assert said in refused(kind, path)
    for key in set(arrays) - OPTIONAL:
        np.savez(path, **{name: array for name, array in arrays.items() if name != key})
        assert f"{key} is not a file in the archive" in refused(kind, path)


DAMAGE = {
    "shape prior": [
        ("shapes", lambda a: a[:, :4], r"4, 2"),
        ("shapes", lambda a: a[:0], r"0, 5, 2"),
        ("shapes", lambda a: a + 300, "pixels"),
        ("stable", lambda a: np.array("ear"), "ear"),
        ("scale", lambda a: a[:1], "two of the scale"),
        ("parts", lambda a: a[[0, 0, 1, 2, 3]], "once"),
    ],
    "gallery": [
        ("intra_mean", lambda a: a + np.inf, "not finite"),
        ("extra_values", lambda a: -a, "out of range"),
        ("frontal_rho", lambda a: a * 0, "out of range"),
        ("intra_vectors", lambda a: a[:, :-1], "do not fit"),
        ("shape", lambda a: a + 1, "template"),
        ("names", lambda a: np.repeat(a[:1], len(a)), "each named once"),
        ("names", lambda a: np.char.add(a, "\n"), "no name"),
        ("names", lambda a: a[:-1], "5 persons"),
        ("proportion", lambda a: a * np.nan, "not finite"),
        ("proportion", lambda a: a * 0, "out of range"),
        ("counts", lambda a: a[:-1], "out of range"),
        ("most_frontal", lambda a: a * 0 + 1.5, "out of range"),
        ("threshold", lambda a: a * np.nan, "not finite"),
    ],
    "mouth descent": [
        ("points", lambda a: np.repeat(a[:1], len(a)), "each named once"),
        ("points", lambda a: a[:0], "do not fit 0 points"),
        ("stages", lambda a: a[:2], "do not fit"),
        ("odds", lambda a: a[:, :3], "do not fit"),
        ("odds", lambda a: a * np.inf, "not finite"),
        ("std", lambda a: a * 0, "not above 0"),
        ("scales", lambda a: a[:0], "a stage or more"),
    ],
    "eye descent": [
        ("lids", lambda a: a[:-1], "are no regressions of eyes"),
        ("scales", lambda a: a * 0, "above 0"),
        ("first", lambda a: a * np.nan, "not finite"),
        ("std", lambda a: 0 * a, "above 0"),
    ],
}


@KINDS
def test_arrays_that_do_not_fit_are_refused(kind, tmp_path):
    arrays = stored(kind)[1]
    for number, (name, change, said) in enumerate(DAMAGE[kind]):
        path = tmp_path / f"{number}.npz"  # a regression is read once
        with np.errstate(invalid="ignore"):
            np.savez(path, **(arrays | {name: change(arrays[name])}))
        assert said in refused(kind, path), name


@KINDS
def test_damaged_bytes_are_refused(kind, tmp_path):
    path = tmp_path / "x.npz"
    stored(kind)[0].save(path)
    whole = path.read_bytes()
    other, bare = io.BytesIO(), io.BytesIO()
    with zipfile.ZipFile(other, "w") as archive:
        archive.writestr("format.npy", "no array")
    np.save(bare, np.zeros(3))
    for content in (b"", b"text\n", whole[: len(whole) // 2], whole[:100], other.getvalue(), bare.getvalue()):
        path.write_bytes(content)
        refused(kind, path)
