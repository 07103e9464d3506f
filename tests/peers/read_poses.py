"""What programs that analyse poses read in DeepLabCut files, as JSON: `PYTHON read_poses.py FILE...`

Run by the Python that has them (pose.txt); imports nothing of ours.
"""

import contextlib
import json
import sys

with contextlib.redirect_stdout(sys.stderr):
    import keypoint_moseq
    from movement.io import load_poses


def movement(path):
    """Times of 25 frames/s, names, and (time, individual, keypoint, x and y and confidence)."""
    found = load_poses.from_dlc_file(path, fps=25)
    place = found.position.transpose("time", "individuals", "keypoints", "space").to_numpy()
    sure = found.confidence.transpose("time", "individuals", "keypoints").to_numpy()
    values = [[[[*xy, c] for xy, c in zip(*one, strict=True)] for one in zip(*frame, strict=True)]
              for frame in zip(place.tolist(), sure.tolist(), strict=True)]  # fmt: skip
    names = {name: found.coords[name].to_numpy().tolist() for name in ("individuals", "keypoints")}
    return {"time": found.time.to_numpy().tolist(), **names, "values": values}


def moseq(path):
    """(time, keypoint, x and y and confidence) of each recording and individual, by name."""
    coordinates, confidences, _ = keypoint_moseq.load_keypoints(path, "deeplabcut")
    return {
        name.rsplit("_", 1)[-1]: [
            [[*xy, c] for xy, c in zip(*frame, strict=True)]
            for frame in zip(places.tolist(), confidences[name].tolist(), strict=True)
        ]
        for name, places in coordinates.items()
    }


def main():
    with contextlib.redirect_stdout(sys.stderr):
        found = {path: {"movement": movement(path), "moseq": moseq(path)} for path in sys.argv[1:]}
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    main()
