"""Tables for other programs: of rows, head poses, measures, events; and points as COCO, DeepLabCut and OpenFace have.

Tables keep the conventions of trajectory.csv: frames and pixels from 0, x and y the centre, "" what is not known. Where
a row is a frame there is one for each of `every_frame`, since readers count them. Times of events are seconds in the
clip; an event ends when the frame after its last one begins.

BORIS 8: a clip is an observation, a tier a behaviour, an event two rows, its begin and its end, with the value as
modifier of both; rows stand in the order of time. A subject that is not declared would not be shown.

COCO (cocodataset.org/#format-data): a target of one part called `box` is a plain detection.

- `id` of an image is the frame + 1, since an id of 0 misleads COCO's own evaluation; `frame_id` is the 0-based frame.
- Visibility v of a keypoint: 2 tracked (or visible in truth), 1 lost (or hidden): the place is the tracker's estimate;
  0 not known, at 0, 0. A target without any known part has no annotation in that image.
- `score` is the confidence (the mean over the parts; 1 where not known), so that `loadRes(annotations)` reads them as
  results too; `keypoint_scores` are the parts' own; `track_id` counts the targets from 1.
- COCO's keypoints are indices of pixels: a pixel's centre is a whole number, as here (Detectron2 adds 0.5). COCO's
  boxes are measured from the image's corner: a box over the first ten columns is 0 to 10, left 0 and width 10, which
  are the same numbers as here. So nothing is shifted.

DeepLabCut's CSV and HDF5: whole numbers are pixel centres too; a part `box` is the centre of a box, whose size has no
room.

OpenFace 2's FeatureExtraction (Baltrusaitis et al., FG 2018; its wiki page "Output Format"), as docs/export.md says:

- `timestamp` in seconds; `success` is 1 where all landmarks of the face are seen. All places are written, as OpenFace
  does; `confidence` is the mean over the parts. Nothing is interpolated.
- `pose_R`: pitch, yaw, roll of R = R_x R_y R_z in the camera's axes. `pose_T`: the middle between the eyes of a generic
  head, which OpenFace has near the middle of the face, by OpenFace's own guess of a camera: a focal length of the mean
  of 500 width / 640 and 500 height / 480, through the image's centre.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from functools import partial
from html import escape
from itertools import pairwise, product
from operator import itemgetter
from typing import Any, Final, NamedTuple

import numpy as np

from facetrack_cli.core.errors import InputError, needed
from facetrack_cli.core.face_points import LINES, MESH, POINTS
from facetrack_cli.core.numbers import csv_text, dumps
from facetrack_cli.core.types import BOX, Array, Whole
from facetrack_cli.trajectory.head import SHAPE, euler, head_pose, rotation_of
from facetrack_cli.trajectory.measures import HAND_MEASURES, MEASURES, Measured, events_of
from facetrack_cli.trajectory.reader import clip_of
from facetrack_cli.trajectory.trajectory import DECIMALS, SEEN, Trajectory, aligned, header_value, joined, places
from facetrack_cli.trajectory.views import Around, enclose, every_frame, frame_milliseconds, mean

WIDE = ("x", "y", "w", "h", "confidence", "status")
STD = ("", "_std", "_noise")
POSE = ("frame", "time_s", "target", "pitch", "yaw", "roll", "std_pitch", "std_yaw", "std_roll", "ambiguous")
EVENT_COLUMNS = (
    "clip", "person", "tier", "value", "begin_s", "peak_s", "end_s", "first_frame", "last_frame", "probability",
)  # fmt: skip


class Clip(NamedTuple):
    """A clip's name, and its trajectory."""

    name: str
    table: Trajectory


def write_csv_wide(table: Trajectory) -> str:
    """A CSV with one row a frame: frame, time_s, of each part `target_part_x`, y, ..., of each measure `target_smile`.

    Of a part `box` the name is the target's alone. The text begins with a byte order mark only where a name is not
    ASCII: spreadsheets need it then. A name that they would take for a formula is put behind an underscore.
    """
    frames, times = timed(table)
    _, columns = aligned(table.parts, *WIDE, frame=frames)
    cells = np.full((len(frames), 2 + len(WIDE) * len(table.parts)), "", dtype=object)
    cells[:, 0] = frames
    cells[:, 1] = times
    for at, (name, values) in enumerate(columns.items(), 2):
        cells[:, at :: len(WIDE)] = values if name == "status" else texts(values, DECIMALS[name])
    names = [f"{_called(*pair)}_{column}" for pair in table.names for column in WIDE]
    for target, measures in table.measures.items():
        cells = np.hstack([cells, _measured(measures, [*measures], frames)])
        names += [f"{_called(target, name)}{end}" for name in measures for end in STD]
    text = csv_text(["frame", "time_s", *names], cells.tolist())
    return text if "".join(names).isascii() else "\ufeff" + text


def write_pose(table: Trajectory) -> str:
    """A CSV with a row for each frame and target: pitch, yaw, roll in degrees, and spreads. InputError without pose."""
    rows: list[list[Any]] = []
    frames, times = timed(table)
    for name in table.targets:
        if (pose := head_pose(table.of_target(name))) is not None:
            cells = np.full((len(frames), 7), "", dtype=object)
            angles = texts(np.hstack([pose.angles, pose.std]), 2)
            cells[pose.frame, :6] = angles
            cells[pose.frame, 6] = np.where(angles[:, 0] == "", "", pose.ambiguous.astype(int))
            lines = zip(frames.tolist(), times.tolist(), cells.tolist(), strict=True)
            rows += ([frame, time, name, *row] for frame, time, row in lines)
    if not rows:
        raise InputError(f"a pose needs four parts that are not in a plane, among {', '.join(SHAPE)}")
    return csv_text(POSE, sorted(rows, key=itemgetter(0)))


def write_measures(clips: Sequence[Clip], many: bool = False) -> str:
    """A CSV with a row for each frame and target: those measures that any target has, and of each `_std` and `_noise`.

    Of `many` clips the first column has their names. InputError where none has the points, or hands, of a measure.
    """
    measures = [{target: measured for target, measured in clip.table.measures.items() if measured} for clip in clips]
    names_known = {name for targets in measures for measured in targets.values() for name in measured}
    names = [measure.name for measure in (*MEASURES, *HAND_MEASURES) if measure.name in names_known]
    if not names:
        raise InputError(f"a measure needs parts of a face, among {', '.join(POINTS)}, and its box or eyes, or hands")
    lines: list[list[Any]] = []
    for clip, targets in zip(clips, measures, strict=True):
        frames, times = timed(clip.table)
        cells = [_measured(measured, names, frames).tolist() for measured in targets.values()]
        for frame, time, *rows in zip(frames.tolist(), times.tolist(), *cells, strict=True):
            begin = [clip.name, frame, time][not many :]
            lines += ([*begin, target, *row] for target, row in zip(targets, rows, strict=True))
    first = ["clip", "frame", "time_s", "target"][not many :]
    return csv_text([*first, *(name + end for name in names for end in STD)], lines)


def _measured(measures: Mapping[str, Measured], names: Sequence[str], frames: Whole) -> Any:
    """(T, 3 N) texts of N measures, their spreads and noises in T frames, "" of what is not known."""
    values = np.full((len(names), len(STD), len(frames)), np.nan)
    for k, name in enumerate(names):
        if (measure := measures.get(name)) is not None:
            values[k][:, np.searchsorted(frames, measure.frame)] = measure.value, measure.std, measure.noise
    return texts(values.reshape(-1, len(frames)).T, 4)


def _called(target: str, part: str) -> str:
    return part if not target else target if part == BOX else f"{target}_{part}"


def timed(table: Trajectory) -> tuple[Whole, Any]:
    """The frames of `every_frame`, and their times as text, by which readers know a constant rate to 1e-5 of a step."""
    frames, times = every_frame(table)
    return frames, texts(times, 9 if np.any(np.diff(times) < 1 / 61) else 7)


def texts(values: Any, decimals: int) -> Any:
    """The numbers as text with so many decimals, and never -0; "" for what is not known."""
    return np.where(np.isfinite(values), np.char.mod(f"%.{decimals}f", np.round(values, decimals) + 0.0), "")


def write_events(clips: Sequence[Clip]) -> str:
    """The table, in the order of clips and times, which are rounded to 4 decimals, as the probabilities are."""
    rows: list[list[Any]] = []
    for name, table in clips:
        for e in table.events:
            times = [round(t, 4) for t in (e.begin_s, e.peak_s, e.end_s)]
            rows.append([name, e.target, e.tier, e.value, *times, e.first_frame, e.last_frame, round(e.probability, 4)])
    return csv_text(EVENT_COLUMNS, rows)


def write_subtitles(table: Trajectory, form: str) -> str:
    """The events as `srt` or `vtt`, to the nearest millisecond, without those that have no extent then."""
    several, texts = len(table.targets) > 1, [] if form == "srt" else ["WEBVTT"]
    spans = [(round(e.begin_s * 1000), round(e.end_s * 1000), e) for e in table.events]
    for n, (begin, end, e) in enumerate((span for span in spans if span[1] > span[0]), 1):
        who = f"{e.target}: " if several and e.target else ""
        text = f"{who}{e.tier.replace('_', ' ')}: {e.value}"
        text = escape(text, quote=False) if form == "vtt" else text
        texts.append(f"{n}\n{_clock(begin, form)} --> {_clock(end, form)}\n{text}")
    return "\n\n".join(texts) + "\n"


def _clock(ms: int, form: str) -> str:
    point = "," if form == "srt" else "."
    return f"{ms // 3600000:02d}:{ms // 60000 % 60:02d}:{ms // 1000 % 60:02d}{point}{ms % 1000:03d}"


write_srt, write_vtt = partial(write_subtitles, form="srt"), partial(write_subtitles, form="vtt")


def write_textgrid(table: Trajectory) -> str:
    """The events in Praat's long text format: a tier of intervals for each kind that could be told, "" between them.

    It begins at 0, as sound does. InputError where the points tell no kind of event.
    """
    kinds = [
        (f"{kind}@{name or 'target'}".replace('"', '""'), events)
        for name in table.targets
        for kind, events in events_of(name, table.measures[name]).items()
    ]
    if not kinds:
        raise InputError("has no points or hands that tell an event; a TextGrid needs a tier")
    last = frame_milliseconds(table)[1][int(table.frames[-1])] / 1000
    end = max([last, *(e.end_s for _, events in kinds for e in events)])
    lines = ['File type = "ooTextFile"', 'Object class = "TextGrid"', "", "xmin = 0", f"xmax = {end:.6f}"]
    lines += ["tiers? <exists>", f"size = {len(kinds)}", "item []:"]
    for n, (name, events) in enumerate(kinds, 1):
        spans, at = list[tuple[float, float, str]](), 0.0
        for e in events:
            begin = max(e.begin_s, at)
            spans += [(at, begin, "")] * (begin > at) + [(begin, e.end_s, e.value)] * (e.end_s > begin)
            at = max(e.end_s, at)
        spans += [(at, end, "")] * (end > at or not spans)
        lines += [f"    item [{n}]:", '        class = "IntervalTier"', f'        name = "{name}"']
        lines += ["        xmin = 0", f"        xmax = {end:.6f}", f"        intervals: size = {len(spans)}"]
        for k, (begin, stop, text) in enumerate(spans, 1):
            lines += [f"        intervals [{k}]:", f"            xmin = {begin:.6f}", f"            xmax = {stop:.6f}"]
            lines += [f'            text = "{text}"']
    return "\n".join(lines) + "\n"


def write_boris(clips: Sequence[Clip], written: datetime) -> str:
    """A project with an observation for each clip; several of one name are numbered."""
    date, subjects = written.isoformat(timespec="seconds"), dict[str, None]()
    observations, values = dict[str, Any](), dict[str, dict[str, None]]()
    for name, table in clips:
        path, fps = str(clip_of(table) or name), header_value(table, "source", "fps")
        rows = list[list[Any]]()
        for e in table.events:
            subjects[e.target] = values.setdefault(e.tier, {})[e.value] = None
            for time, frame in ((e.begin_s, e.first_frame), (e.end_s, e.last_frame + 1)):
                rows.append([round(time, 3), e.target, e.tier, e.value, f"probability {e.probability:.2f}", frame])
        known = {"length": {path: float(np.nan_to_num(table.times).max())}, "fps": {path: fps or 25.0}}
        media = {"hasVideo": {path: True}, "hasAudio": {path: False}, "offset": {"1": 0.0}}
        number = sum(title.partition(" (")[0] == name for title in observations)
        observations[f"{name} ({number + 1})" if number else name] = {
            "file": {"1": [path], **{str(n): [] for n in range(2, 9)}}, "type": "MEDIA", "date": date,
            "description": "", "time offset": 0, "events": sorted(rows, key=lambda row: row[0]),
            "observation time interval": [0, 0], "independent_variables": {}, "media_info": known | media,
            "close_behaviors_between_videos": False, "visualize_spectrogram": False, "visualize_waveform": False,
        }  # fmt: skip
    about = {"key": "", "description": ""}
    behaviours = [
        {**about, "type": "State event", "code": tier, "color": "", "category": "", "excluded": "", "coding map": "",
         "modifiers": {"0": {"name": "value", "description": "", "type": 0, "ask at stop": False, "values": [*these]}}}
        for tier, these in values.items()
    ]  # fmt: skip
    return dumps({
        "time_format": "hh:mm:ss", "project_date": date, "project_name": "facetrack", "project_description": "",
        "project_format_version": "7.0", "observations": observations,
        "subjects_conf": {str(n): {**about, "name": name} for n, name in enumerate(subjects)},
        "behaviors_conf": {str(n): behaviour for n, behaviour in enumerate(behaviours)},
        "behavioral_categories": [], "independent_variables": {}, "coding_map": {}, "behaviors_coding_map": [],
        "converters": {},
    })  # fmt: skip


EDGES = (("nose", "lip_upper"), *(edge for line in LINES for edge in pairwise(line)))
"""How the points of a face hang together; other parts are drawn without lines."""
IN_MESH: Final = (
    127, 234, 93, 132, 172, 136, 150, 176, 152, 400, 379, 365, 397, 361, 323, 454, 356,  # jaw
    70, 63, 105, 66, 107, 336, 296, 334, 293, 300,  # brows
    168, 197, 5, 1, 98, 97, 2, 326, 327,  # nose
    33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380,  # eyes
    61, 39, 37, 0, 267, 269, 291, 321, 314, 17, 84, 91,  # lips, outer border
    78, 82, 13, 312, 308, 317, 14, 87,  # inner border
)  # fmt: skip
"""The point of MediaPipe's mesh for each of the 68, from iBUG's mean face beside MediaPipe's canonical face; much as in
github.com/PeizhiYan/Mediapipe_2_Dlib_Landmarks, which takes the mean of two points for some of the 68."""
COUNT: Final = len(IN_MESH)
_NAMES: Final = {number: name for name, number in MESH.items()}
LANDMARKS: Final = {_NAMES.get(number, f"mesh_{number}"): i for i, number in enumerate(IN_MESH)} | {
    f"point_{i + 1:02d}": i for i in range(COUNT)
}
"""The number of each part: a point of the face, another point of the mesh, or a point as .pts files are read."""
OPENFACE: Final = (
    "frame", "face_id", "timestamp", "confidence", "success",
    *(f"pose_{what}{axis}" for what in "TR" for axis in "xyz"), *(f"{axis}_{i}" for axis in "xy" for i in range(COUNT)),
)  # fmt: skip


def write_coco(table: Trajectory, size: tuple[int, int], file_name: Callable[[int], str], around: Around) -> str:
    """The JSON text for images of `size` (width, height), named `file_name(frame)`. InputError as of `enclose`."""
    categories, annotations = [], list[dict[str, Any]]()
    for ident, target in enumerate(table.targets, 1):
        parts = table.of_target(target)
        points = tuple(part for part in parts if part.part != BOX)
        names = [part.part for part in points]
        # COCO counts the ends of a skeleton's edges from 1
        skeleton = [[names.index(a) + 1, names.index(b) + 1] for a, b in EDGES if a in names and b in names]
        about = {"keypoints": names, "skeleton": skeleton} if names else {}
        categories.append({"id": ident, "name": target or "target", "supercategory": "", **about})
        box, zeros, rows = enclose(parts, around), [0] * len(points), dict[int, dict[str, Any]]()
        for frame, ltwh, sure in zip(box.frame.tolist(), box.boxes.tolist(), box.confidence.tolist(), strict=True):
            if math.isfinite(sum(ltwh)):
                whose = {"id": 0, "image_id": frame + 1, "category_id": ident, "track_id": ident}
                place = {"bbox": [round(value, 3) for value in ltwh], "area": round(ltwh[2] * ltwh[3], 3), "iscrowd": 0}
                rows[frame] = {**whose, **place, "score": sure if math.isfinite(sure) else 1.0}
                if points:
                    rows[frame] |= {"num_keypoints": 0, "keypoints": zeros * 3, "keypoint_scores": list(zeros)}
        for k, part in enumerate(points):
            flags = np.where(np.isin(part.status, SEEN), 2, 1).tolist()
            columns = (part.frame.tolist(), part.x.tolist(), part.y.tolist(), flags, part.confidence.tolist())
            for frame, x, y, flag, sure in zip(*columns, strict=True):
                if frame in rows and math.isfinite(x) and math.isfinite(y):
                    row = rows[frame]
                    row["keypoints"][3 * k : 3 * k + 3] = [round(x, 3), round(y, 3), flag]
                    row["keypoint_scores"][k] = sure if math.isfinite(sure) else 1.0
                    row["num_keypoints"] += 1
        annotations += rows.values()
    annotations.sort(key=lambda annotation: (annotation["image_id"], annotation["category_id"]))
    for ident, one in enumerate(annotations, 1):
        one["id"] = ident
    sides, frames = {"width": size[0], "height": size[1]}, table.frames.tolist()
    images = [{"id": n + 1, "file_name": file_name(n), **sides, "frame_id": n} for n in frames]
    groups = {"images": images, "annotations": annotations, "categories": categories}
    info = {"description": f"Tracked by facetrack: {table.path.name}", "version": "1.0"}
    # a line for each image and annotation: large files stay readable, and can be compared
    lists = ",\n".join(f"{dumps(name)}: [\n" + ",\n".join(map(dumps, rows)) + "\n]" for name, rows in groups.items())
    return f'{{\n"info": {dumps(info)},\n"licenses": [],\n{lists}\n}}\n'


def write_dlc(table: Trajectory, scorer: str = "facetrack") -> str:
    """The text of the CSV. `scorer` names what tracked."""
    names, columns, frames, values = _dlc(table, scorer)
    cells = np.stack([texts(values[..., i], DECIMALS[name]) for i, name in enumerate(("x", "y", "confidence"))], axis=2)
    if not np.isfinite(values[0]).any():
        cells[0] = "nan"  # pandas takes an empty first row for the name of the index, and every frame moves by one
    rows = zip(frames.tolist(), cells.reshape(len(frames), -1).tolist(), strict=True)
    heads = [[name, *level] for name, level in zip(names, zip(*columns, strict=True), strict=True)]
    return csv_text(heads[0], [*heads[1:], *([frame, *row] for frame, row in rows)])


def write_dlc_h5(table: Trajectory, scorer: str = "facetrack") -> bytes:
    """The HDF5 file: the same as a data frame, under DeepLabCut's key, without the time of writing.

    UsageError without pandas and PyTables, InputError for more columns than such a table has room for.
    """
    with needed("DeepLabCut's HDF5 files", "pandas", "pandas"):
        import pandas
        from tables.exceptions import HDF5ExtError
    names, columns, frames, values = _dlc(table, scorer)
    head = pandas.MultiIndex.from_tuples(columns, names=names)
    frame = pandas.DataFrame(values.reshape(len(frames), -1), index=frames, columns=head)
    in_memory: dict[str, Any] = {"driver": "H5FD_CORE", "driver_core_backing_store": 0}
    with pandas.HDFStore("track.h5", mode="w", **in_memory) as store:
        try:
            store.put("df_with_missing", frame, format="table", index=False, track_times=False)
        except HDF5ExtError:
            why = f"HDF5 has no room for the names of {len(columns)} columns; choose a target, or export to dlc"
            raise InputError(why) from None
        # readers before pandas 3, as DeepLabCut has, find no values without what pandas 3.1 no longer writes
        store.get_storer("df_with_missing").attrs.pandas_version = "0.15.2"
        store.flush()
        image: bytes = store._handle.get_file_image()
    return image


def _dlc(table: Trajectory, scorer: str) -> tuple[list[str], list[tuple[str, ...]], Whole, Array]:
    """The names of the header's levels, its columns, T frames, and (T, K, 3) values: x, y, likelihood.

    Readers take the columns for individuals x body parts: each individual has all parts, empty where it has none.
    """
    several, (frames, _) = len(table.targets) > 1, every_frame(table)
    parts, values = places(table, frames)
    values[~np.isfinite(values[..., :2]).all(axis=3)] = np.nan
    names = ["scorer", *(["individuals"] if several else []), "bodyparts", "coords"]
    individuals = [(scorer, target) if several else (scorer,) for target in table.targets]
    columns = [(*one, part, coord) for one, part, coord in product(individuals, parts, ("x", "y", "likelihood"))]
    return names, columns, frames, values.reshape(len(frames), -1, 3)


def write_openface(table: Trajectory, size: tuple[int, int] | None) -> str:
    """The text for images of `size` (width, height), None if that is not known. InputError without any landmark."""
    rows = list[list[Any]]()
    shown = size and (size[0] * table.pixel_aspect, size[1])
    faces = [[part for part in table.of_target(name) if part.part in LANDMARKS] for name in table.targets]
    for ident, parts in enumerate(filter(None, faces)):
        frames, columns = aligned(parts, "x", "y", "confidence", "status")
        cells = np.full((len(frames), len(OPENFACE)), "", dtype=object)
        seen = np.isin(columns["status"], SEEN) & np.isfinite(columns["x"] + columns["y"])
        cells[:, 0], cells[:, 1], cells[:, 2] = frames + 1, ident, texts(joined(parts).times, 3)
        cells[:, 3], cells[:, 4] = texts(mean(columns["confidence"]), 4), seen.all(axis=1).astype(int)
        if (pose := head_pose(table.of_target(parts[0].target))) is not None:
            at, there = np.searchsorted(frames, pose.frame), np.isin(pose.frame, frames)
            place, rotation = np.full_like(pose.angles, np.nan), np.radians(pose.angles)
            if shown is not None:
                focal = (500 * shown[0] / 640 + 500 * shown[1] / 480) / 2
                off = (pose.origin - (np.array(shown) - 1) / 2) / focal
                place = np.concatenate([off, np.ones((len(off), 1))], axis=1) * (focal / pose.scale)[:, None]
                # from the line of sight, along which weak perspective looks, to the camera's axis
                pitch, yaw = np.arctan2(-off[:, 1], 1), np.arctan2(off[:, 0], np.hypot(1, off[:, 1]))
                towards = rotation_of(np.stack([pitch, yaw, np.zeros_like(yaw)], axis=1))
                rotation = euler(towards @ rotation_of(rotation))
            cells[at[there], 5:8], cells[at[there], 8:11] = texts(place[there], 1), texts(rotation[there], 4)
        for k, part in enumerate(parts):
            for first, name in ((11, "x"), (11 + COUNT, "y")):
                cells[:, first + LANDMARKS[part.part]] = texts(columns[name][:, k], 3)
        rows += cells.tolist()
    if not rows:
        names = ", ".join(name for name in MESH if name in LANDMARKS)
        raise InputError(f"no part is one of OpenFace's landmarks, which are {names}, and point_01 to point_68")
    return csv_text(OPENFACE, sorted(rows, key=itemgetter(0, 1)))
