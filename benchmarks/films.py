"""Everybody in edited clips, against what people would put together themselves: docs/results.md.

    python benchmarks/films.py clips/*.mp4 [-j 2]

Each clip NAME.mp4 has NAME.truth.csv beside it: frame, person, part, x, y, unit (distance between the eyes in pixels).
A face counts where nose and corners of the mouth are within .35 eye distances. Trackers:

    film, film without   facetrack run --faces all, with the extra `people` and without
    face, face without   one face from the first frame: recall of that person, and precision
    detector             YuNet in every frame, tracks by overlap, dlib's embeddings of three views of a track, which are
                         of one person below a mean distance of .5

The table has recall, precision, IDF1, HOTA, switches, and people beside those in the clip.
"""

import argparse
import csv
from collections import defaultdict
from collections.abc import Sequence
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import numpy as np

import facetrack_cli as facetrack
from facetrack_cli.core.geometry import overlap
from facetrack_cli.core.types import Array
from facetrack_cli.evaluation.identities import SAME, Seen, measure_people
from facetrack_cli.trackers.face.detectors import Detection, detector
from facetrack_cli.trackers.face.stabilized import Similarity, slope
from facetrack_cli.trackers.people import descriptor as looks
from facetrack_cli.video.source import open_source

POINTS = ("nose", "mouth_left", "mouth_right")
WITHIN = 0.35  # distances between the eyes
Faces = dict[int, dict[str, Array]]  # by frame and name, (3, 2)


def truth_of(clip: Path) -> tuple[Faces, dict[tuple[int, str], float]]:
    """The faces, and the distance between the eyes of each."""
    found: Faces = defaultdict(dict)
    units = {}
    with clip.with_name(f"{clip.stem}.truth.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            if row["part"] in POINTS:
                frame, name = int(row["frame"]), row["person"]
                face = found[frame].setdefault(name, np.full((3, 2), np.nan))
                face[POINTS.index(row["part"])] = float(row["x"]), float(row["y"])
                units[frame, name] = float(row["unit"])
    return found, units


def tracked(clip: Path, faces: str) -> Faces:
    rows = facetrack.track_video(clip, faces="all" if faces == "film" else "one")
    found: Faces = defaultdict(dict)
    for target in rows.targets:
        parts = [one for part in POINTS if (one := rows.find(target, part)) is not None]
        for k, frame in enumerate(parts[0].frame.tolist()):
            if parts[0].status[k] not in ("lost", "absent"):
                found[frame][target] = np.array([[one.x[k], one.y[k]] for one in parts])
    return found


def detected(clip: Path) -> Faces:
    """Tracks by overlap, and people by clusters of mean embeddings."""
    look, open_ = detector("yunet"), list[list[tuple[int, Detection, Any]]]()
    done = list[list[tuple[int, Detection, Any]]]()
    with open_source(clip) as source:
        for frame in source:
            faces = look.find(frame)
            for track in list(open_):
                if track[-1][0] < frame.index - 10:
                    open_.remove(track)
                    done.append(track)
                    continue
                best = max(faces, key=lambda one: overlap(one.box, track[-1][1].box), default=None)
                if best is not None and overlap(best.box, track[-1][1].box) > 0.3:
                    faces = [one for one in faces if one is not best]
                    track.append((frame.index, best, chip(frame, best) if len(track) % 10 == 0 else None))
            open_ += [[(frame.index, one, chip(frame, one))] for one in faces]
    tracks = [track for track in (*done, *open_) if len(track) >= 5]
    views = [np.array([looks.embedded(x) for _, _, x in t if x is not None][:3]).mean(axis=0) for t in tracks]
    far = np.linalg.norm(np.array(views)[:, None] - np.array(views), axis=2)
    label = looks.clusters(0.5 - far, np.zeros(far.shape, np.bool_))
    found: Faces = defaultdict(dict)
    for name, track in zip(label.tolist(), tracks, strict=True):
        for frame_index, face, _ in track:
            found[frame_index][str(name)] = np.array([face.points[part] for part in POINTS])
    return found


def chip(frame: Any, face: Detection) -> Any:
    x, y, w, h = face.box
    turn = 0.0 if face.eyes is None else slope(np.array(face.eyes))
    return looks.Picture.of(frame, Similarity(np.array([x + w / 2, y + h / 2]), w, turn)).chip


def measured(clip: Path, tracker: str) -> tuple[str, str, list[float]]:
    kind, _, without = tracker.partition(" ")
    if without:
        looks.embedding_model = lambda: None  # type: ignore[assignment]
    truth, units = truth_of(clip)
    ours = detected(clip) if kind == "detector" else tracked(clip, kind)
    people = sorted({name for faces in truth.values() for name in faces})
    targets = sorted({name for faces in ours.values() for name in faces})
    frames = []
    for frame in sorted({*truth, *ours}):
        true, mine = truth.get(frame, {}), ours.get(frame, {})
        off = [[np.hypot(*(mine[b] - true[a]).T).max() / units[frame, a] for b in mine] for a in true]
        similar = np.clip(1 - np.array(off).reshape(len(true), len(mine)) * SAME / WITHIN, 0, 1)
        numbers = [
            np.array([names.index(one) for one in of], np.int64) for names, of in ((people, true), (targets, mine))
        ]
        frames.append(Seen(numbers[0], numbers[1], similar))
    if kind == "face":  # the person whom it began with
        first = next(one for one in frames if one.similar.size and one.similar.max() >= SAME)
        who = int(first.people[int(first.similar.max(axis=1).argmax())])
        own = [one.similar[one.people == who] for one in frames]
        hits = sum(bool((one >= SAME).any()) for one in own)
        return clip.stem, tracker, [hits / sum(map(len, own)), hits / max(sum(len(one.targets) for one in frames), 1)]
    all_ = measure_people(frames)
    values = (all_.recall, all_.precision, all_.idf1, all_.hota, all_.switches, all_.targets, all_.people)
    return clip.stem, tracker, [float(value or 0) for value in values]


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("clips", nargs="+", type=Path)
    parser.add_argument("-j", type=int, default=1)
    given = parser.parse_args(argv)
    trackers = ("film", "film without", "face", "face without", "detector")
    jobs = [(clip, one) for one in trackers for clip in given.clips]
    with Pool(given.j, maxtasksperchild=1) as pool:
        rows = pool.starmap(measured, jobs, chunksize=1)
    for tracker in trackers:
        values = np.array([row[2] for row in rows if row[1] == tracker])
        for name, of, own in rows:
            if of == tracker:
                print(f"{tracker:14s}{name:12s}", *(f"{value:8.3f}" for value in own))
        print(f"{tracker:14s}{'mean':12s}", *(f"{value:8.3f}" for value in values.mean(axis=0)))
        print(f"{tracker:14s}{'least':12s}", *(f"{value:8.3f}" for value in values.min(axis=0)))


if __name__ == "__main__":
    main()
