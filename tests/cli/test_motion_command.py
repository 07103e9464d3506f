"""facetrack motion fit as its users meet it."""

from pathlib import Path

import pytest

from facetrack_cli.core.errors import ExitCode
from tests.support.samples import FOLDER


@pytest.fixture
def clips():
    return FOLDER


def test_motion_fit_prints_or_writes_a_block(facetrack):
    truth = FOLDER / "map.truth.csv"
    code, out, err = facetrack("motion", "fit", truth)
    assert code == 0 and err == "" and "\nmotion:\n  type: first_order\n  position: {A: [[1, " in out
    code, printed, err = facetrack("motion", "fit", truth, "-o", "motion.yaml")
    assert code == 0 and not printed and Path("motion.yaml").read_text(encoding="utf-8") == out
    code, _, err = facetrack("motion", "fit", truth, "-o", "motion.yaml")
    assert code == ExitCode.USAGE and "--overwrite" in err
    code, out, _ = facetrack("motion", "fit", FOLDER / "expressions.truth.csv", "--target", "face/nose")
    assert code == ExitCode.INPUT
