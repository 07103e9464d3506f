"""DeepLabCut's files of ours as movement and keypoint-moseq read them, value by value."""

import json
import os
import site
import subprocess
from pathlib import Path

import av
import numpy as np
import pytest

from facetrack_cli.trajectory.formats.keypoints import write_dlc, write_dlc_h5
from facetrack_cli.trajectory.trajectory import joined, one_part

PEERS = os.environ.get("FACETRACK_POSE_PEERS")
pytestmark = pytest.mark.skipif(
    not PEERS, reason="FACETRACK_POSE_PEERS names no Python with the packages of tests/peers/pose.txt"
)
PARTS = ("nose", "chin")


def one(target, part, frames):
    frames, own = np.array(frames), len(target) + 100 * PARTS.index(part)
    return one_part(target, part, frames, x=frames + own + 0.5, y=frames + own + 0.25, confidence=1 - frames / 400)


@pytest.mark.parametrize("ending", ["csv", "h5"])
def test_people_who_come_and_go_are_read_when_they_are_there(tmp_path, ending):
    """Anna from 3 s to 10.12 s, Ben, who has no chin, for a while; nobody between 5 and 6 s."""
    there = {("Anna", "nose"): [*range(75, 125), *range(150, 254)], ("Anna", "chin"): [*range(75, 125)],
             ("Ben", "nose"): [*range(100, 120)]}  # fmt: skip
    table = joined([one(*name, frames) for name, frames in there.items()])
    path = tmp_path / f"clip.{ending}"
    path.write_bytes(write_dlc_h5(table) if ending == "h5" else write_dlc(table).encode())
    script = Path(__file__).parents[1] / "peers/read_poses.py"
    run = subprocess.run([PEERS, script, path], capture_output=True, text=True, check=False, timeout=300)
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout.splitlines()[-1])[str(path)]
    wanted = np.full((254, 2, 2, 3), np.nan)
    for (target, part), frames in there.items():
        own = one(target, part, frames)
        place = np.stack([own.x, own.y, own.confidence], axis=1)
        wanted[frames, ["Anna", "Ben"].index(target), PARTS.index(part)] = place
    seen = found["movement"]
    assert (seen["individuals"], seen["keypoints"]) == (["Anna", "Ben"], list(PARTS))
    assert seen["time"] == pytest.approx(np.arange(254) / 25)
    for k, target in enumerate(("Anna", "Ben")):
        moseq = np.array(found["moseq"][target], dtype=float)
        np.testing.assert_allclose(np.array(seen["values"], dtype=float)[:, k], wanted[:, k], atol=6e-5)
        np.testing.assert_allclose(moseq, wanted[:, k], atol=6e-5)


def test_movement_reads_filters_and_saves_the_dataset(tmp_path):
    lines = ["frame,time_s,target,part,x,y,w,h,angle,confidence,status"]
    lines += [f"{t},{t / 25},face,nose,{10 + 2 * t},50,,,,{0.2 if t == 3 else 0.9},tracked" for t in range(8)]
    lines += [f"{t},{t / 25},face,lip,{20 + 2 * t},60,,,,0.9,tracked" for t in range(2, 8)]
    (tmp_path / "trajectory.csv").write_text("\n".join(lines) + "\n")
    script, root = Path(__file__).parents[1] / "peers/read_dataset.py", Path(__file__).parents[2]
    ours = [str(root), *site.getsitepackages(), str(Path(av.__file__).parents[1])]
    done = subprocess.run(
        [PEERS, script, tmp_path / "trajectory.csv", *ours], capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr
    read = json.loads(done.stdout.splitlines()[-1])
    assert read["dims"] == {"time": 8, "space": 2, "keypoints": 2, "individuals": 1}
    assert read["missing"] == 2 + 4, "x and y of the doubtful nose, and of the lip before it is there"
    assert read["filled"] == [10 + 2 * t for t in range(8)]
    assert read["speed"] == pytest.approx([50.0] * 8) and read["same"] and read["times"]
