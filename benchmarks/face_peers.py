"""YuNet and MediaPipe's face mesh in every frame, on clips made harder by `benchmarks/stress.py`: docs/results.md.

    python benchmarks/face_peers.py yunet model.onnx stress/*.mp4
    python benchmarks/face_peers.py mesh stress/*.mp4         # in an environment that has mediapipe

It needs numpy and OpenCV, and not facetrack. Each clip NAME.mp4 has NAME.mesh.csv beside it (frame, part, x, y, unit,
hidden). Of several faces the largest counts. The table has, for each variant, the share of frames whose visible nose
and mouth corners are within .35 eye distances of the reference, and the share of hidden points of which nothing is
said. Then, over the clips as they were, `opening` and `width` as `benchmarks/expressions.py` has them, and
milliseconds a frame, of one thread.
"""

import csv
import math
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Look = Callable[[NDArray[np.uint8]], dict[str, tuple[float, float]]]
CORE, LIPS = ("nose", "mouth_left", "mouth_right"), ("lip_upper", "lip_lower")
MESH = dict(zip((*CORE, *LIPS), (1, 61, 291, 0, 17), strict=True))
VARIES = 0.03


def yunet(path: str) -> Look:
    """A function from an image to points by name, none where no face is seen."""
    net: Any = cv2.FaceDetectorYN.create(path, "", (320, 320), 0.6)

    def look(image: NDArray[np.uint8]) -> dict[str, tuple[float, float]]:
        net.setInputSize(image.shape[1::-1])
        _, faces = net.detect(image)
        if faces is None:
            return {}
        face = max(faces, key=lambda one: one[2] * one[3])
        return dict(zip(CORE, face[8:14].reshape(3, 2).tolist(), strict=True))

    return look


def mesh() -> Look:
    model = import_module("mediapipe").solutions.face_mesh.FaceMesh(max_num_faces=1)

    def look(image: NDArray[np.uint8]) -> dict[str, tuple[float, float]]:
        found = model.process(cv2.cvtColor(image, cv2.COLOR_BGR2RGB)).multi_face_landmarks
        if not found:
            return {}
        h, w = image.shape[:2]
        return {name: (found[0].landmark[i].x * w - 0.5, found[0].landmark[i].y * h - 0.5) for name, i in MESH.items()}

    return look


def main() -> None:
    kind, *rest = sys.argv[1:]
    paths = rest if kind == "mesh" else rest[1:]
    cv2.setNumThreads(1)
    right, silent, alike = (defaultdict[str, list[Any]](list) for _ in range(3))
    taken: list[float] = []
    for path in map(Path, paths):
        look, variant = mesh() if kind == "mesh" else yunet(rest[0]), path.stem.split("-")[-1]
        truth: dict[int, dict[str, dict[str, str]]] = defaultdict(dict)
        for row in csv.DictReader(path.with_suffix(".mesh.csv").open(encoding="utf-8")):
            truth[int(row["frame"])][row["part"]] = row
        video, lengths, visible = cv2.VideoCapture(str(path)), list[Any](), list[bool]()
        for known in (truth[t] for t in sorted(truth)):
            image = np.asarray(video.read()[1], np.uint8)
            began = time.perf_counter()
            found = look(image)
            taken.append(time.perf_counter() - began)
            off = {}
            for part, row in known.items():
                x, y = found.get(part, (math.inf, math.inf))
                off[part] = math.hypot(x - float(row["x"]), y - float(row["y"])) / float(row["unit"])
                if row["hidden"] == "1" and part in CORE:
                    silent[variant].append(part not in found)
            shown = [off[part] <= 0.35 for part in CORE if part in known and known[part]["hidden"] == "0"]
            if shown:
                visible.append(all(shown))
            both = [
                [math.dist(of[a], of[b]) for a, b in (LIPS, CORE[1:])]
                for of in (found, {part: (float(row["x"]), float(row["y"])) for part, row in known.items()})
                if of.keys() >= {*CORE, *LIPS}
            ]
            if len(both) == 2:
                lengths.append(np.array(both) / float(known["nose"]["unit"]))
        right[variant].append(np.mean(visible))
        if variant == "plain" and lengths:
            for k, name in enumerate(("opening", "width")):
                mine, true = np.array(lengths)[:, :, k].T
                if true.std() >= VARIES:
                    alike[name].append(np.corrcoef(mine, true)[0, 1] * len(lengths) / len(truth))
    for variant, shares in right.items():
        hidden = f"{np.mean(silent[variant]):.2f}" if silent[variant] else "-"
        print(f"{variant:10s} right {np.mean(shares):.3f}  least {np.min(shares):.3f}  hidden, nothing said {hidden}")
    print({name: round(float(np.mean(each)), 3) for name, each in alike.items()}, f"{1e3 * np.mean(taken):.2f} ms")


if __name__ == "__main__":
    main()
