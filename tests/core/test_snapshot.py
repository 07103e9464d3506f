"""Values as a text and arrays: what comes back is what was given, bit for bit and as it lay in memory."""

from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from facetrack_cli.core import npz
from facetrack_cli.core.npz import STORED, flatten, restore
from facetrack_cli.core.types import Particles, TargetStart

TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=5)
PLAIN = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | TEXTS
KEYS = st.tuples(TEXTS, st.integers()) | TEXTS
VALUES = st.recursive(
    PLAIN | st.frozensets(st.integers(), max_size=3),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.tuples(inner, inner)
        | st.dictionaries(KEYS, inner, max_size=3)
        | st.lists(inner, max_size=3).map(lambda those: deque(those, 5))
    ),
    max_leaves=8,
)
ARRAYS = arrays.arrays(
    st.sampled_from([np.float64, np.float32, np.int64, np.uint8, np.bool_, np.complex128, "<U3"]),
    arrays.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4),
)


def back(value):
    return restore(*flatten(value))


@given(VALUES)
def test_values_come_back(value):
    found = back(value)
    assert found == value and type(found) is type(value) and repr(found) == repr(value)


@given(ARRAYS, st.data())
def test_arrays_come_back_as_they_lay_in_memory(array, data):
    array = array.transpose(data.draw(st.permutations(range(array.ndim))))
    found = back(array)
    assert found.dtype == array.dtype and found.shape == array.shape and found.tobytes() == array.tobytes()
    if 0 not in array.shape and 1 not in array.shape:
        assert found.strides == array.strides


def test_numbers_that_are_none_and_scalars():
    found = back((float("nan"), float("-inf"), -0.0, np.float32(0.1), np.int64(3)))
    assert repr(found) == repr((float("nan"), float("-inf"), -0.0, np.float32(0.1), np.int64(3)))


def test_random_numbers_go_on():
    rng = np.random.default_rng(np.random.SeedSequence(5, spawn_key=(2,)))
    rng.random(7)
    rng.integers(3, dtype=np.int32)  # leaves half a word over
    other = back({"rng": rng})["rng"]
    assert other.random(5).tolist() == rng.random(5).tolist()
    assert other.integers(9, size=9, dtype=np.int32).tolist() == rng.integers(9, size=9, dtype=np.int32).tolist()
    assert other.bit_generator.seed_seq.spawn_key == (2,)


def test_our_own_kinds_come_back():
    particles = Particles(np.ones((2, 1, 3)), np.zeros(2))
    found = back([particles, TargetStart((1.0, 2.0, 3.0, 4.0), {"nose": (1.0, 2.0)}), Path("a b")])
    assert isinstance(found[0], Particles) and found[0].x.shape == (2, 1, 3)
    assert found[1:] == [TargetStart((1.0, 2.0, 3.0, 4.0), {"nose": (1.0, 2.0)}), Path("a b")]


class Elsewhere(NamedTuple):
    x: int


@dataclass(frozen=True)
class Kept:
    x: int
    tool: object = field(metadata={STORED: False})


def test_what_is_left_out_comes_back_as_none(monkeypatch):
    monkeypatch.setattr(npz, "_PACKAGE", "tests")
    assert back(Kept(3, object())) == Kept(3, None)


@pytest.mark.parametrize("value", [object(), Elsewhere(1), lambda: 0, np.array([object()]), b"bytes", {1: print}])
def test_other_kinds_are_refused(value):
    with pytest.raises(TypeError, match="cannot be stored"):
        flatten(value)


@pytest.mark.parametrize(
    "text",
    [
        '{"of": "os:system", "fields": {}}',
        '{"of": "facetrack_cli.core.files:os.system", "fields": {}}',
        '{"of": "facetrack_cli.core.types:Particles", "fields": {"x": 1}}',
        '{"of": "facetrack_cli.nowhere:X", "fields": {}}',
        '{"array": "7", "axes": []}',
        '{"odd": [1]}',
        "{}",
        "{",
    ],
)
def test_texts_that_we_do_not_write_are_refused(text):
    with pytest.raises(ValueError):
        restore(text, {})
