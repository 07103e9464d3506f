"""What `movement` makes of a trajectory's dataset, as JSON: `PYTHON read_dataset.py TRAJECTORY PATH...`

Run by the Python that has it (pose.txt); facetrack is taken from the folders PATH.
"""

import json
import sys
from pathlib import Path

sys.path += sys.argv[2:]  # behind its own packages

import numpy as np
from movement.filtering import filter_by_confidence, interpolate_over_time
from movement.io import load_poses, save_poses
from movement.kinematics import compute_speed

import facetrack_cli as facetrack


def main():
    path = Path(sys.argv[1])
    poses = facetrack.read_trajectory(path).to_xarray()
    kept = filter_by_confidence(poses.position, poses.confidence, threshold=0.5)
    filled = interpolate_over_time(kept)
    saved = path.with_name("saved.csv")
    save_poses.to_dlc_file(poses, saved, split_individuals=False)
    again = load_poses.from_dlc_file(saved, fps=poses.fps)
    found = {
        "dims": dict(poses.sizes),
        "missing": int(np.isnan(kept).sum()),
        "filled": filled.sel(space="x", keypoints="nose", individuals="face").values.tolist(),
        "speed": compute_speed(poses.position).sel(keypoints="nose", individuals="face").values.tolist(),
        "same": bool(np.allclose(again.position, poses.position, equal_nan=True)),
        "times": again.time.values.tolist() == poses.time.values.tolist(),
    }
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    main()
