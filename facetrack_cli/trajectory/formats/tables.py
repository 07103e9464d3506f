"""Tables of rows, head poses, measures and events; events also as subtitles, a TextGrid and a BORIS 8 project.

Tables keep the conventions of trajectory.csv: frames and pixels from 0, x and y the centre, "" what is not known. Where
a row is a frame there is one for each of `every_frame`, since readers count them. Times of events are seconds in the
clip; an event ends when the frame after its last one begins.

In BORIS a clip is an observation, a tier a behaviour, an event two rows, its begin and its end, with the value as
modifier of both; rows stand in the order of time. A subject that is not declared would not be shown.

Also a trajectory as data frames of pandas, as a dataset of xarray, and as notebooks show it.
"""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import partial
from html import escape
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError, needed
from facetrack_cli.core.face_points import POINTS
from facetrack_cli.core.numbers import csv_text, dumps
from facetrack_cli.core.types import BOX, Array, Whole
from facetrack_cli.trajectory.face_events import FaceEvent, events_of
from facetrack_cli.trajectory.head import SHAPE, head_pose
from facetrack_cli.trajectory.measures import HAND_MEASURES, MEASURES, Measured
from facetrack_cli.trajectory.reader import clip_of
from facetrack_cli.trajectory.trajectory import DECIMALS, SEEN, Trajectory, aligned, header_value
from facetrack_cli.trajectory.views import every_frame, frame_milliseconds

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

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
    """A CSV with one row a frame: frame, time_s, of each part `target_part_x`, y, w, h, confidence, status, and of each
    measure (measures.py) `target_mouth_opening`, `target_mouth_opening_std`, ...

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
    """A CSV with a row for each frame and target that has points: roll, yaw, pitch in degrees, and their spread.

    InputError if no target has enough points for a pose.
    """
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

    Of `many` clips the first column has their names.

    Raises
    ------
    InputError : where no clip has the points, or the hands, that a measure needs.
    """
    measures = [{target: measured for target, measured in clip.table.measures.items() if measured} for clip in clips]
    names_known = {name for targets in measures for measured in targets.values() for name in measured}
    names = [measure.name for measure in (*MEASURES, *HAND_MEASURES) if measure.name in names_known]
    if not names:
        face = f"a measure needs parts of a face, among {', '.join(POINTS)}, and its box or its eyes"
        raise InputError(f"{face}, or hands beside the box of a head")
    lines: list[list[Any]] = []
    for clip, targets in zip(clips, measures, strict=True):
        frames, times = timed(clip.table)
        cells = [_measured(measured, names, frames).tolist() for measured in targets.values()]
        for frame, time, *rows in zip(frames.tolist(), times.tolist(), *cells, strict=True):
            begin = [*([clip.name] if many else []), frame, time]
            lines += ([*begin, target, *row] for target, row in zip(targets, rows, strict=True))
    first = [*(["clip"] if many else []), "frame", "time_s", "target"]
    return csv_text([*first, *(name + end for name in names for end in STD)], lines)


def _measured(measures: Mapping[str, Measured], names: Sequence[str], frames: Whole) -> Any:
    """(T, 3 N) texts of N measures, their spreads and noises in T frames, "" of what is not known."""
    values = np.full((len(names), len(STD), len(frames)), np.nan)
    for k, name in enumerate(names):
        if name in measures:
            measure = measures[name]
            values[k][:, np.searchsorted(frames, measure.frame)] = measure.value, measure.std, measure.noise
    return texts(values.reshape(-1, len(frames)).T, 4)


def _called(target: str, part: str) -> str:
    return part if not target else target if part == BOX else f"{target}_{part}"


def timed(table: Trajectory) -> tuple[Whole, Any]:
    """The frames of `every_frame`, and their times as text, by which readers know a constant rate to 1e-5 of a step."""
    frames, times = every_frame(table)
    steps = np.diff(times)
    return frames, texts(times, 9 if np.any(steps < 1 / 61) else 7)


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
        text = html.escape(text, quote=False) if form == "vtt" else text
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
        (f"{kind}@{name or 'target'}", events)
        for name in table.targets
        for kind, events in events_of(name, table.measures[name]).items()
    ]
    if not kinds:
        raise InputError("has no points or hands that tell an event; a TextGrid needs a tier")
    end = max(
        [frame_milliseconds(table)[1][int(table.frames[-1])] / 1000, *(e.end_s for _, events in kinds for e in events)]
    )
    lines = ['File type = "ooTextFile"', 'Object class = "TextGrid"', "", "xmin = 0", f"xmax = {end:.6f}"]
    lines += ["tiers? <exists>", f"size = {len(kinds)}", "item []:"]
    for n, (name, events) in enumerate(kinds, 1):
        spans, at = list[tuple[float, float, str]](), 0.0
        for e in events:
            begin = max(e.begin_s, at)
            spans += [(at, begin, "")] * (begin > at) + [(begin, e.end_s, e.value)] * (e.end_s > begin)
            at = max(e.end_s, at)
        spans += [(at, end, "")] * (end > at or not spans)
        quoted = [name.replace('"', '""'), *(text.replace('"', '""') for _, _, text in spans)]
        lines += [f"    item [{n}]:", '        class = "IntervalTier"', f'        name = "{quoted[0]}"']
        lines += ["        xmin = 0", f"        xmax = {end:.6f}", f"        intervals: size = {len(spans)}"]
        for k, ((begin, stop, _), text) in enumerate(zip(spans, quoted[1:], strict=True), 1):
            lines += [f"        intervals [{k}]:", f"            xmin = {begin:.6f}", f"            xmax = {stop:.6f}"]
            lines += [f'            text = "{text}"']
    return "\n".join(lines) + "\n"


def write_boris(clips: Sequence[Clip], written: datetime) -> str:
    """A project with an observation for each clip; several of one name are numbered."""
    date, subjects = written.isoformat(timespec="seconds"), dict[str, None]()
    observations: dict[str, Any] = {}
    values: dict[str, dict[str, None]] = {}
    for name, table in clips:
        path, fps = str(clip_of(table) or name), header_value(table, "source", "fps")
        rows: list[list[Any]] = []
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


_WIDTH, _HEIGHT, _MEANS = 160, 24, 80  # of a line of confidence: pixels, and means that it shows


def data_frame(table: Trajectory, what: Literal["rows", "measures", "events"], *, measures: bool) -> DataFrame:
    """As `Trajectory.to_pandas` says."""
    if what not in ("rows", "measures", "events"):
        raise UsageError(f"{what!r} is no table; give rows, measures or events")
    with needed("data frames", "pandas", "pandas"):
        import pandas

    if what == "events":
        return pandas.DataFrame(table.events, columns=FaceEvent._fields)
    measured = table.measures if measures or what == "measures" else {}
    each = [(target, name, line) for target, by_name in measured.items() for name, line in by_name.items()]
    if what == "rows":
        rows = pandas.DataFrame(table.columns())
        for target, name, line in each:
            here = rows.target == target
            rows.loc[here, name] = rows.frame[here].map(dict(zip(line.frame, line.value, strict=True)))
        return rows
    names = ("frame", "time_s", "value", "std", "noise")
    frames = [
        pandas.DataFrame({"target": target, "measure": name, "unit": line.unit, **{k: getattr(line, k) for k in names}})
        for target, name, line in each
    ]
    if not frames:
        return pandas.DataFrame(columns=["target", "measure", *names])
    return pandas.concat(frames, ignore_index=True)


def dataset(table: Trajectory) -> Dataset:
    """As `Trajectory.to_xarray` says."""
    with needed("datasets", "xarray", "xarray"):
        import xarray

    timed = np.isfinite(table.times)
    if not timed.any():
        raise InputError("no row has a time_s, and a dataset needs times; fill that column")
    frames = np.arange(table.frames[0], table.frames[-1] + 1)
    time_s = np.interp(frames, table.frames[timed], table.times[timed])
    parts, values = places(table, frames)
    fps = header_value(table, "source", "fps")
    about: dict[str, Any] = {"source_software": "facetrack", "ds_type": "poses", "time_unit": "seconds"}
    if fps is not None or len(frames) > 1:
        about["fps"] = round(1 / float(np.median(np.diff(time_s))), 6) if fps is None else fps
    return xarray.Dataset(
        {
            "position": (("time", "space", "keypoints", "individuals"), values[..., :2].transpose(0, 3, 2, 1)),
            "confidence": (("time", "keypoints", "individuals"), values[..., 2].transpose(0, 2, 1)),
        },
        {
            "time": time_s,
            "space": ["x", "y"],
            "keypoints": parts,
            "individuals": [target or "target" for target in table.targets],
            "frame": ("time", frames),
        },
        about,
    )


def places(table: Trajectory, frames: Whole) -> tuple[list[str], Array]:
    """The names of the parts, and (T, targets, parts, 3) x, y and confidence: each target has all parts, or nan."""
    targets, parts = table.targets, list(dict.fromkeys(part for _, part in table.names))
    values = np.full((len(frames), len(targets), len(parts), 3), np.nan)
    at = np.array([(targets.index(target), parts.index(part)) for target, part in table.names]).T
    _, columns = aligned(table.parts, "x", "y", "confidence", frame=frames)
    values[:, at[0], at[1]] = np.stack([*columns.values()], axis=2)
    return parts, values


def html_table(table: Trajectory) -> str:
    """A small table: of each target its parts, frames, the share of rows that are seen, its events, and confidence."""
    events = Counter((event.target, event.value) for event in table.events)
    lines = []
    for target in table.targets:
        parts = table.of_target(target)
        seen = np.concatenate([np.isin(part.status, SEEN) for part in parts])
        said = ", ".join(f"{n} {value}" for (of, value), n in sorted(events.items()) if of == target)
        share = f"{seen.mean():.0%}" if seen.size else ""
        cells = target or "-", len(parts), len(parts[0]), share, said, _confidence_line(parts[0].confidence)
        lines.append("<tr>" + "".join(f"<td>{td if i == 5 else escape(str(td))}</td>" for i, td in enumerate(cells)))
    heads = "".join(f"<th>{head}" for head in ("target", "parts", "frames", "seen", "events", "confidence"))
    return f"<table><tr>{heads}{''.join(lines)}</table>"


def _confidence_line(values: Array) -> str:
    """Values from 0 to 1 over time as a picture."""
    means = [float(share.mean()) for share in np.array_split(np.nan_to_num(values), _MEANS) if len(share)]
    x = np.linspace(0, _WIDTH, len(means)).tolist()
    points = " ".join(f"{a:.1f},{_HEIGHT - 1 - v * (_HEIGHT - 2):.1f}" for a, v in zip(x, means, strict=True))
    line = f'<polyline points="{points}" fill="none" stroke="currentColor"/>'
    return f'<svg width="{_WIDTH}" height="{_HEIGHT}" role="img" aria-label="confidence over time">{line}</svg>'
