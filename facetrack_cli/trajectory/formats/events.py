"""Events of faces and hands, of one clip or of many: a table, subtitles (SRT, WebVTT), a TextGrid, a BORIS 8 project.

A row of the table is an event. Times are seconds in the clip; an event ends when the frame after its last one begins.
In BORIS a clip is an observation, a tier a behaviour, an event two rows, its begin and its end, with the value as
modifier of both; rows stand in the order of time. A subject that is not declared would not be shown.
"""

import html
from collections.abc import Sequence
from datetime import datetime
from functools import partial
from typing import Any

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.numbers import csv_text, dumps
from facetrack_cli.trajectory.analysis.face_events import events_of
from facetrack_cli.trajectory.clock import frame_milliseconds
from facetrack_cli.trajectory.formats.tables import Clip
from facetrack_cli.trajectory.header import clip_of
from facetrack_cli.trajectory.trajectory import Trajectory, header_value

COLUMNS = (
    "clip", "person", "tier", "value", "begin_s", "peak_s", "end_s", "first_frame", "last_frame", "probability",
)  # fmt: skip


def write_events(clips: Sequence[Clip]) -> str:
    """The table, in the order of clips and times, which are rounded to 4 decimals, as the probabilities are."""
    rows: list[list[Any]] = []
    for name, table in clips:
        for e in table.events:
            times = [round(t, 4) for t in (e.begin_s, e.peak_s, e.end_s)]
            rows.append([name, e.target, e.tier, e.value, *times, e.first_frame, e.last_frame, round(e.probability, 4)])
    return csv_text(COLUMNS, rows)


def write_subtitles(table: Trajectory, form: str) -> str:
    """The events as `srt` or `vtt`, to the nearest millisecond, without those that have no extent then."""
    several, texts = len(table.targets) > 1, [] if form == "srt" else ["WEBVTT"]
    spans = [(round(e.begin_s * 1000), round(e.end_s * 1000), e) for e in table.events]
    for n, (begin, end, e) in enumerate((one for one in spans if one[1] > one[0]), 1):
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
        known = {"length": {path: float(table.times[-1])}, "fps": {path: fps or 25.0}}
        media = {"hasVideo": {path: True}, "hasAudio": {path: False}, "offset": {"1": 0.0}}
        number = sum(one.partition(" (")[0] == name for one in observations)
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
        "behaviors_conf": {str(n): one for n, one in enumerate(behaviours)},
        "behavioral_categories": [], "independent_variables": {}, "coding_map": {}, "behaviors_coding_map": [],
        "converters": {},
    })  # fmt: skip
