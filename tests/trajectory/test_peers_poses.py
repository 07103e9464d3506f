"""DeepLabCut's files of ours as movement and keypoint-moseq read them, value by value."""

import json
import os
import subprocess
from pathlib import Path

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
