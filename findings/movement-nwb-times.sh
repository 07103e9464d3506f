#!/usr/bin/env bash
# Points that an NWB file has at 12.4 s are read at 0 s, and the chin is .8 s ahead of the nose.
#
# Found: NWB files keep a time for each sample on the clock of the whole recording; a camera that starts late, or drops
# frames, shows in these times alone. movement 0.15.0 (load_poses.from_nwb_file) takes of them the median of the steps,
# as a rate, and lays all samples from 0 at that rate. (1) A camera that starts at 12.4 s starts at 0, also where the
# file says rate and starting_time. (2) After 30 dropped frames all samples are 1.2 s early. (3) Each point is laid by
# itself: of a chin that is first known 20 frames after the nose the first sample stands beside the nose's first.
# (4) Where the steps of two points differ by a little, each has its own rate, and the table has nearly twice as many
# times, with a number for one point in each. Nothing is said. Who joins tracks with gaze, voice or EEG by time joins
# the wrong frames. Take timestamps from the file (pynwb), and set ds["time"].
# Packages: movement 0.15.0, pynwb 4.2.0, ndx-pose 0.4.0, hdmf 6.2.0, xarray 2026.9.0, pandas 3.1.1, numpy 2.4.6.
# Data: two made-up points whose x is the number of the sample, at 25 frames/s, written here.
# Output seen:
#   late: in the file 12.4 to 16.36 s; read 0.0 to 3.96 s in 100 steps; the first sample of nose and chin at 0.0, 0.0
#   late, as rate and start: in the file 12.4 to 16.36 s; read 0.0 to 3.96 s in 100 steps; the first sample of nose and
#       chin at 0.0, 0.0
#   30 dropped: in the file 12.4 to 17.56 s; read 0.0 to 3.96 s in 100 steps; the first sample of nose and chin at 0.0, 0.0
#   chin later: in the file 12.4 to 16.36 s; read 0.0 to 3.96 s in 100 steps; the first sample of nose and chin at 0.0,
#       0.0 (in the file 12.4, 13.2)
#   own clocks: in the file 12.4 to 16.36 s; read 0.0 to 3.96 s in 199 steps; the first sample of nose and chin at 0.0, 0.0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check movement==0.15.0 pynwb==4.2.0 ndx-pose==0.4.0 hdmf==6.2.0 xarray==2026.9.0 pandas==3.1.1 numpy==2.4.6
env/bin/python - <<'PYTHON'
import logging
import sys
import warnings
from datetime import datetime, timezone

warnings.simplefilter("ignore")
import ndx_pose
import numpy as np
import pynwb
from movement.io import load_poses

logging.disable(logging.CRITICAL)
EVEN = 12.4 + np.arange(100) / 25


def series(name, times, as_rate):
    when = {"rate": 25.0, "starting_time": 12.4} if as_rate else {"timestamps": times}
    x = np.arange(len(times), dtype=float)
    return ndx_pose.PoseEstimationSeries(
        name=name, description="a point", data=np.stack([x, x], 1), unit="pixels", reference_frame="upper left",
        confidence=np.ones(len(times)), **when,
    )


def read(what, nose, chin, as_rate=False):
    file = pynwb.NWBFile("a face", "face", datetime(2026, 1, 1, tzinfo=timezone.utc))
    file.subject = pynwb.file.Subject(subject_id="p1", species="Homo sapiens")
    edges = np.array([[0, 1]], dtype="uint8")
    skeleton = ndx_pose.Skeleton(name="face", nodes=["nose", "chin"], edges=edges, subject=file.subject)
    poses = ndx_pose.PoseEstimation(
        name="PoseEstimation", description="made up", scorer="none", source_software="none", skeleton=skeleton,
        pose_estimation_series=[series("nose", nose, as_rate), series("chin", chin, as_rate)],
    )
    module = file.create_processing_module("behavior", "made up")
    module.add(ndx_pose.Skeletons(skeletons=[skeleton]))
    module.add(poses)
    with pynwb.NWBHDF5IO("face.nwb", "w") as io:
        io.write(file)
    table = load_poses.from_nwb_file("face.nwb")
    time = table.time.values
    x = table.position.sel(space="x").squeeze().transpose("time", "keypoints").sel(keypoints=["nose", "chin"]).values
    first = [float(time[np.flatnonzero(x[:, k] == 0)[0]]) for k in (0, 1)]
    found = [round(float(time[0]), 3), round(float(time[-1]), 3), len(time), *first]
    there = f" (in the file {nose[0]:.1f}, {chin[0]:.1f})" if chin[0] != nose[0] else ""
    print(
        f"{what}: in the file {nose[0]:.1f} to {nose[-1]:.2f} s; read {found[0]} to {found[1]} s in {found[2]} steps;",
        f"the first sample of nose and chin at {first[0]}, {first[1]}{there}",
    )
    return found


dropped = np.delete(12.4 + np.arange(130) / 25, slice(50, 80))
jitter = np.random.default_rng(0).uniform(-0.004, 0.004, 100)
seen = [
    read("late", EVEN, EVEN),
    read("late, as rate and start", EVEN, EVEN, as_rate=True),
    read("30 dropped", dropped, dropped),
    read("chin later", EVEN, EVEN[20:]),
    read("own clocks", EVEN, EVEN + jitter),
]
sys.exit(seen != [[0.0, 3.96, 100, 0.0, 0.0]] * 4 + [[0.0, 3.96, 199, 0.0, 0.0]])
PYTHON
