#!/usr/bin/env bash
# One frame that was put right by hand takes scores and tracks from all frames in NWB.
#
# Found: sleap-io 0.9.5 writes tracked points as NWB in one of two forms, and save_nwb chooses. Predictions alone become
# PoseEstimation. Two people with tracks come back without tracks, as the reader asks whether a name is "track" and a number, and
# the writer writes "track=anna". The score of an instance, .8, comes back as the mean of its points' scores, .6, and as
# nan if one point is missing. With one instance of five frames corrected by hand, the file becomes PoseTraining: no
# track, likelihood or score of any frame is in it, and all predictions come back as labels by hand.
# nwb_format="predictions" leaves out what was corrected. Nothing is said. Take .slp, which keeps all.
# Packages: sleap-io 0.9.5, pynwb 4.2.0, ndx-pose 0.4.0, hdmf 6.2.0, h5py 3.16.0, numpy 2.4.6, pandas 3.1.1, av 18.1.0.
# Data: three points of two people in five frames, and a clip of five grey pictures, made here.
# Output seen:
#   one corrected: False, auto
#     frame 3 PredictedInstance None nan
#     frame 3 PredictedInstance None nan
#     frame 4 PredictedInstance None 0.6
#     frame 4 PredictedInstance None 0.6
#   one corrected: True, auto
#     frame 3 Instance None None
#     frame 3 Instance None None
#     frame 4 Instance None None
#     frame 4 Instance None None
#   one corrected: True, predictions
#     frame 3 PredictedInstance None nan
#     frame 3 PredictedInstance None nan
#     frame 4 PredictedInstance None 0.6
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check sleap-io==0.9.5 pynwb==4.2.0 ndx-pose==0.4.0 hdmf==6.2.0 h5py==3.16.0 numpy==2.4.6 pandas==3.1.1 av==18.1.0
env/bin/python - <<'PYTHON'
import sys
import warnings

import av
import numpy as np
import sleap_io

with av.open("clip.mp4", "w") as clip:
    stream = clip.add_stream("libx264", rate=25)
    stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
    for _ in range(5):
        clip.mux(stream.encode(av.VideoFrame.from_ndarray(np.full((48, 64, 3), 128, np.uint8))))
    clip.mux(stream.encode())
face = sleap_io.Skeleton(["nose", "eye", "chin"], edges=[("nose", "eye")], name="face")
video = sleap_io.Video.from_filename("clip.mp4")
seen = []
for corrected, form in ((False, "auto"), (True, "auto"), (True, "predictions")):
    tracks = [sleap_io.Track(name) for name in ("anna", "bert")]
    frames = []
    for k in range(5):
        instances = []
        for i, track in enumerate(tracks):
            points = np.array([[10 + k + 20.0 * i, 20], [15 + k + 20 * i, 25], [12 + 20 * i, 40]])
            if k == 3:
                points[1] = np.nan
            if corrected and k == 4 and i == 0:
                instances.append(sleap_io.Instance.from_numpy(points, skeleton=face, track=track))
            else:
                scores = np.array([0.9, 0.8, 0.1])
                instances.append(sleap_io.PredictedInstance.from_numpy(points, skeleton=face, point_scores=scores, score=0.8, track=track))
        frames.append(sleap_io.LabeledFrame(video=video, frame_idx=k, instances=instances))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        warnings.simplefilter("ignore", FutureWarning)
        sleap_io.save_nwb(sleap_io.Labels(frames), "face.nwb", nwb_format=form)
        back = sleap_io.load_nwb("face.nwb")
    rows = []
    for k in (3, 4):
        for frame in back.labeled_frames:
            if frame.frame_idx == k:
                for one in frame.instances:
                    score = round(float(one.score), 2) if isinstance(one, sleap_io.PredictedInstance) else None
                    rows.append((k, type(one).__name__, one.track and one.track.name, str(score)))
    seen.append(rows)
    print(f"one corrected: {corrected}, {form}")
    for row in rows:
        print("  frame", *row)
expected = [
    [(3, "PredictedInstance", None, "nan")] * 2 + [(4, "PredictedInstance", None, "0.6")] * 2,
    [(k, "Instance", None, "None") for k in (3, 3, 4, 4)],
    [(3, "PredictedInstance", None, "nan")] * 2 + [(4, "PredictedInstance", None, "0.6")],
]
sys.exit(seen != expected)
PYTHON
