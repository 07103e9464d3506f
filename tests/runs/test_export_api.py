"""Trajectories in Python: exported, as data frames and datasets, as pictures and videos in a notebook."""

import av
import numpy as np
import pytest

import facetrack_cli as facetrack
from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError, OutputError, UsageError
from facetrack_cli.trajectory.trajectory import joined, one_part
from tests.support.face_shape import moving_face
from tests.support.samples import FOLDER

CLIP = FOLDER / "expressions.mp4"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "out"
    assert main(["run", str(CLIP), "--config", "sir", "--stop", "6", "-q", "-o", str(folder)]) == 0
    return folder


def rows():
    """A nose that is not known in frame 12, and a lip from there on; frame 13 is missing."""
    nose = {"x": [1.0, 2, 4, 6], "y": [5.0] * 4, "confidence": [0.9, 0.9, 0.2, 0.9]}
    lip = {"x": [7.0, 8], "y": [9.0, 9], "confidence": [0.8, 0.7]}
    header = {"source": {"path": "clip.mp4", "fps": 25.0}}
    found = [
        one_part("face", "nose", [10, 11, 12, 14], time_s=np.array([10, 11, 12, 14]) / 25, **nose),
        one_part("face", "lip", [12, 14], time_s=np.array([12, 14]) / 25, **lip),
    ]
    return joined(found, header=header)


def decoded(data, tmp_path):
    (tmp_path / "video.mp4").write_bytes(data)
    with av.open(tmp_path / "video.mp4") as file:
        return [frame.to_ndarray(format="bgr24") for frame in file.decode(video=0)]


@pytest.mark.parametrize("form", ["otb", "csv-wide", "vot", "mot", "dlc"])
def test_it_is_what_the_command_writes(run, tmp_path, form):
    nose = facetrack.read_trajectory(run).find("face", "nose")
    call = ["export", str(run), "--to", form, "--target", "face/nose", "-o", str(tmp_path / "file")]
    assert main(call) == 0
    assert nose.export(form) == (tmp_path / "file").read_text()
    assert nose.export(form, tmp_path / "ours") == tmp_path / "ours"
    assert (tmp_path / "ours").read_bytes() == (tmp_path / "file").read_bytes()


def test_elan_is_a_name_of_eaf_and_nothing_is_replaced_unasked(run, tmp_path):
    table = facetrack.read_trajectory(run)
    path = table.export("elan", tmp_path / "clip.eaf")
    assert b"expressions.mp4" in path.read_bytes()
    with pytest.raises(OutputError, match="exists already"):
        table.export("eaf", path)
    added = table.export("eaf", path, into=path, overwrite=True)
    assert added.read_bytes().count(b"<HEADER") == 1
    with pytest.raises(UsageError, match=r"eav is no format; there are boris, .*eaf, .*textgrid"):
        table.export("eav")
    with pytest.raises(UsageError, match="drop_lost is not for eaf"):
        table.export("elan", drop_lost=True)
    with pytest.raises(UsageError, match="vot holds one target"):
        joined([*rows().parts, one_part("hand", "box", [10], x=[1.0], y=[1.0])]).export("vot")


def test_the_video_is_that_of_the_run_or_drawn_from_the_rows(run, tmp_path):
    table = facetrack.read_trajectory(run)
    own = table.video()
    assert own.data == (run / "annotated.mp4").read_bytes()
    assert own._repr_html_().startswith("<video controls") and "data:video/mp4;base64,AAAA" in own._repr_html_()
    in_memory = facetrack.track_video(CLIP, "sir", stop=6, report=lambda done, total: None)
    shots, drawn = decoded(own.data, tmp_path), decoded(in_memory.video().data, tmp_path)
    assert len(shots) == len(drawn) == 6
    # the run's own shows its particles, too
    assert np.mean(np.abs(shots[3].astype(float) - drawn[3])) < 3
    bare = in_memory.take(slice(None), header={})
    with pytest.raises(InputError, match="does not name its clip"):
        bare.video()
    assert len(decoded(bare.video(media=CLIP).data, tmp_path)) == 6


def test_a_notebook_gets_the_plot_as_a_picture(run):
    pytest.importorskip("matplotlib")
    assert facetrack.read_trajectory(run)._repr_png_().startswith(b"\x89PNG")
    assert facetrack.read_trajectory(run).take(slice(0, 0))._repr_png_() is None


def test_rows_of_pandas_have_the_measures_of_their_frames():
    pytest.importorskip("pandas")
    table = moving_face(30, open=np.linspace(0, 0.3, 30))
    found = table.to_pandas(measures=True)
    assert len(found) == len(table) and [*found.columns[: len(table.columns())]] == [*table.columns()]
    opening = table.measures["face"]["mouth_opening"]
    for part in ("nose", "lip_upper"):
        assert np.allclose(found[found.part == part].mouth_opening, opening.value, equal_nan=True)
    assert "mouth_opening" not in table.to_pandas().columns


def test_a_dataset_has_a_time_for_each_frame_and_nan_where_nothing_is_known():
    pytest.importorskip("xarray")
    found = rows().to_xarray()
    assert found.position.dims == ("time", "space", "keypoints", "individuals")
    assert found.confidence.dims == ("time", "keypoints", "individuals")
    assert found.frame.values.tolist() == [10, 11, 12, 13, 14]
    assert np.allclose(found.time, np.arange(10, 15) / 25)
    nose = found.position.sel(keypoints="nose", individuals="face")
    assert np.allclose(nose.sel(space="x"), [1, 2, 4, np.nan, 6], equal_nan=True)
    lip = found.sel(keypoints="lip", individuals="face")
    assert np.allclose(lip.confidence, [np.nan, np.nan, 0.8, np.nan, 0.7], equal_nan=True)
    assert found.attrs == {"source_software": "facetrack", "ds_type": "poses", "time_unit": "seconds", "fps": 25.0}
    with pytest.raises(InputError, match="no row has a time_s"):
        one_part("face", "nose", [1], x=[1.0], y=[1.0]).to_xarray()
