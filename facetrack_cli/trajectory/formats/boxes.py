"""Boxes as plain text: a CSV of ours, and the texts of OTB, GOT-10k, VOT and MOTChallenge; docs/measure.md lists them.

- `otb`: Matlab's pixels: 1 is subtracted. Line 1 is the first frame. A line of zeros or nan: the target is absent.
- `got10k`: also from 1 ("All coordinate values are 1-based", its author in got-10k/toolkit#6). Absent is also a box
  without width or height, four times -1, and what `absence.label` marks. Where `cover.label` is 0 the target is hidden.
- `vot`: as vot-toolkit reads, writes and draws it. Line 1 is frame 0. Polygons are kept as `corners`; their x, y, w, h
  are the axis-aligned bounding box, width = right - left, and the angle is not known. In ground truth, the code 0
  ("unknown") and regions of nan are absent. A file with a code 1 is a result: 1 is the frame where the tracker was set
  on the target (status init, no place); 2 is a failure (lost, no place); 0 was not tracked, and has no row.
- `mot`: ground truth (motchallenge.net/instructions; MOT16 and later) has nine values, results and MOT15 ground truth
ten, -1 where not known (`MOT_COLUMNS`). Ids become the targets "1", "2", ..., each with the part "box". A row of flag 0
is left out, as if the frame were not annotated. A visibility of 0 is "hidden". If every conf of ten values is 0 or 1 it
is taken for the flag, else for a confidence, and then all rows count, as the benchmark has it. As in TrackEval class 1
alone counts; rows of the classes in DISTRACTORS are "hidden" whatever their flag, so that targets on them are neither
right nor wrong; rows of others are left out. A file of a single class is of what counts.
"""

import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array, Mask
from facetrack_cli.trajectory.formats.lines import FROM_ONE, Lines, delimiter, read_bytes
from facetrack_cli.trajectory.reader import MAX_PIXELS
from facetrack_cli.trajectory.trajectory import MAX_ROWS, SEEN, Trajectory

BOX_COLUMNS = ("frame", "x", "y", "w", "h")
LTWH = "left,top,width,height"
REGION = f"{LTWH} or x1,y1,...,x4,y4"
UNKNOWN, INIT, FAILURE = 0, 1, 2
FORMS, POLYGON, MASK = {0: "I", 1: "4f", 4: "2f"}, 2, 3  # of binary results: codes, rectangles and points
DISTRACTORS = (2, 7, 8, 12)  # of MOT16 and MOT17: on a vehicle, a static person, a distractor, a reflection
_MOT = f"frame,id,{LTWH}"
MOT_COLUMNS = {6: _MOT, 7: f"{_MOT},conf", 9: f"{_MOT},flag,class,visibility", 10: f"{_MOT},conf,x,y,z"}


def read_boxes(path: Path, *, shift: int = 0) -> Trajectory:
    """CSV with the header frame,x,y,w,h: frames from 0, the left and top edges in pixels from 0."""
    lines = Lines.with_frame(path)
    names = [name.strip().strip('"').lower() for name in lines.texts[0].split(",")]
    centres = "has the columns target and part, and with them x, y are centres; read it as facetrack's own table"
    lines.refuse([{"target", "part"} <= set(names)], centres)
    missing = ", ".join(name for name in BOX_COLUMNS if name not in names)
    lines.refuse([bool(missing)], f"the header has no column {missing}; it should read frame,x,y,w,h")
    if len(lines) == 1:
        raise InputError(f"{path}: has a header and no rows; there is nothing in it to measure")
    lines = lines.take(slice(1, None))
    values = lines.numbers(len(names), ",".join(names), [names.index(name) for name in BOX_COLUMNS])
    frame = lines.whole(values[:, 0], "frame", 0)
    lines.refuse_twice(frame[:, None], "frame")
    return lines.boxes(frame + shift, values[:, 1:], header={"read_as": "boxes: frame,x,y,w,h, all from 0"})


def read_otb(path: Path, *, shift: int = 0) -> Trajectory:
    """OTB text; line i, from 0, is frame i + `shift`."""
    lines = Lines.by_frame(path)
    header = {"read_as": f"OTB text: {LTWH} a line, pixels from 1 (--truth-format vot: from 0)"}
    return lines.boxes(np.arange(len(lines)) + shift, lines.numbers(4, LTWH) - FROM_ONE, header=header)


def read_got10k(path: Path, *, shift: int = 0) -> Trajectory:
    """GOT-10k text, with absence.label and cover.label where they lie beside it."""
    lines = Lines.by_frame(path)
    ltwh, used = lines.numbers(4, LTWH) - FROM_ONE, list[str]()
    gone = (ltwh[:, 2:] == 0).any(axis=1) | (ltwh == [-2, -2, -1, -1]).all(axis=1)
    status = np.where(gone, "absent", "visible")
    for name in ("cover", "absence"):  # what is absent is so whatever covers it
        file = path.with_name(f"{name}.label")
        if not file.is_file():
            continue
        labels = Lines.by_frame(file).numbers(1, "one number")[:, 0]
        if len(labels) != len(lines):
            why = "they belong to different clips: move one away"
            raise InputError(f"{file}: has {len(labels)} lines, {path.name} beside it {len(lines)}; {why}")
        seen = (labels == 0) | gone if name == "absence" else (labels != 0) | gone
        status = np.where(seen, status, "absent" if name == "absence" else "hidden")
        used.insert(0, file.name)
    with_labels = f", with {' and '.join(used)}" if used else ""
    header = {"read_as": f"GOT-10k text: {LTWH} a line, pixels from 1{with_labels}"}
    return lines.boxes(np.arange(len(lines)) + shift, ltwh, status=status, header=header)


def read_vot(path: Path, *, shift: int = 0) -> Trajectory:
    """VOT ground truth or results, also binary; line i, from 0, is frame i + `shift`. InputError also for masks."""
    lines = _binary(path) if path.suffix.lower() == ".bin" else Lines.by_frame(path)
    between = delimiter(next((text for text in lines.texts if "," in text), ""))
    shapes = np.array([len(text.split(between)) for text in lines.texts], dtype=np.int64)
    masks = [text[0] in "mM" for text in lines.texts]
    lines.refuse(masks, "a mask; masks are not read: give the regions as rectangles or polygons")
    others = (shapes > 4) & (shapes % 2 == 0) & (shapes != 8)
    of_corners = "a polygon of {} corners; polygons of four corners and rectangles are read"
    lines.refuse(others, lambda row: of_corners.format(shapes[row] // 2))
    lines.refuse(~np.isin(shapes, (1, 4, 8)), lambda row: f"{shapes[row]} values; a line holds {REGION}")
    t = len(lines)
    codes, ltwh, polygons = np.full(t, np.nan), np.full((t, 4), np.nan), np.full((t, 8), np.nan)
    for values in (codes[:, None], ltwh, polygons):
        if (rows := np.flatnonzero(shapes == values.shape[1])).size:
            values[rows] = lines.take(rows).numbers(values.shape[1], REGION)
    code = "{:.15g} is no code of VOT; 0 is unknown, 1 the start, 2 a failure"
    lines.refuse(~np.isin(codes, (UNKNOWN, INIT, FAILURE)) & ~np.isnan(codes), lambda row: code.format(codes[row]))
    codes[(shapes == 1) & np.isnan(codes)] = UNKNOWN
    half = np.isnan(polygons).any(axis=1) & ~np.isnan(polygons).all(axis=1)
    lines.refuse(half, "nan in a polygon; give all eight numbers, or eight times nan")
    with np.errstate(invalid="ignore"):
        far = (np.abs(polygons) > MAX_PIXELS).any(axis=1)
    lines.refuse(far, "the polygon is farther out than any image; correct it")
    corners = polygons.reshape(-1, 4, 2)
    low, high = corners.min(axis=1), corners.max(axis=1)
    ltwh = np.where((shapes == 8)[:, None], np.concatenate([low, high - low], axis=1), ltwh)
    result = bool((codes == INIT).any())
    if not result:
        lines.refuse(codes == FAILURE, "the code 2, a failure, in a file without a 1, where a track begins")
    kept = np.flatnonzero(codes != UNKNOWN) if result else np.arange(t)
    header = {"read_as": f"VOT {'result' if result else 'text'}: pixels from 0"}
    found = lines.take(kept).boxes(kept + shift, ltwh[kept], header=header)
    unknown, outline = np.isnan(found.x), np.where(np.isnan(found.x)[:, None, None], np.nan, corners[kept])
    status = np.select([codes[kept] == INIT, unknown], ["init", "lost"], "tracked") if result else found.status
    return replace(found, status=status, corners=None if np.isnan(outline).all() else outline)


def read_mot(path: Path, *, shift: int = 0, results: bool | None = None) -> Trajectory:
    """A series for each id; `results`: column 7 is a confidence, not a flag; None: look. InputError, with the line."""
    lines = Lines.with_frame(path)
    count = len(lines.texts[0].split(delimiter(lines.texts[0])))
    known = f"{count} values; MOTChallenge text has {MOT_COLUMNS[9]}, or {MOT_COLUMNS[10]}"
    lines.refuse([count not in MOT_COLUMNS], known)
    values = lines.numbers(count, MOT_COLUMNS[count])
    frame, ident = lines.whole(values[:, 0], "frame", 1), lines.whole(values[:, 1], "id", 1)
    lines.refuse_twice(np.stack([frame, ident], axis=1), "frame and id")
    seventh = values[:, 6] if count > 6 else np.full(len(lines), np.nan)
    if results is None:
        results = count != 9 and not np.isin(seventh, (0, 1)).all()
    kept: Mask = np.full(len(lines), True) if results else seventh != 0
    eighth = values[:, 7] if count > 7 and not results else np.full(len(lines), np.nan)
    # of ten values the eighth is a class where all are whole numbers, else a coordinate in the world
    of_class = (count == 9 or bool((eighth == np.floor(eighth)).all())) & (eighth >= 1)
    classes = [f"{one:.0f}" for one in np.unique(eighth[of_class & kept])]
    other: Mask = of_class & (eighth != (float(classes[0]) if len(classes) == 1 else 1))
    ignored = other & np.isin(eighth, DISTRACTORS)
    if not kept.any():
        raise InputError(f"{path}: every row has the flag 0, not to be considered; there is nothing in it to measure")
    if not (kept & ~other).any():
        raise InputError(
            f"{path}: has the classes {', '.join(classes)}, and 1 alone counts; write 1 for that of people"
        )
    confidence = np.where(results & (seventh >= 0) & (seventh <= 1), seventh, np.nan)
    covered = values[:, 8] if count == 9 and not results else np.full(len(lines), np.nan)
    about = {
        "rows of flag 0 left out": ~kept & ~other,
        "rows of other classes left out": other & ~ignored,
        "rows of other classes not judged": ignored,
        "rows of a visibility below .5 count as visible": kept & ~other & (covered > 0) & (covered < 0.5),
    }
    said = "".join(f", {rows.sum()} {what}" for what, rows in about.items() if rows.any())
    header = {"read_as": f"MOTChallenge: frames and pixels from 1{said}"}
    kept = (kept & ~other) | ignored
    status = np.where(ignored | (covered == 0), "hidden", "visible")[kept]
    frame, ltwh = frame[kept] - 1 + shift, values[kept, 2:6] - FROM_ONE
    own = {"ids": ident[kept], "status": status, "confidence": confidence[kept]}
    return lines.take(kept).boxes(frame, ltwh, header=header, **own)


def _binary(path: Path) -> Lines:
    """The regions of vot-toolkit's binary results (`vot.region.io`, version 1) as lines of its text."""
    data, at, texts = read_bytes(path), 0, list[str]()

    def take(form: str) -> tuple[Any, ...]:
        nonlocal at
        found = struct.unpack_from("<" + form, data, at)
        at += struct.calcsize("<" + form)
        return found

    try:
        version, count = take("hI")
        for _ in range(count if version == 1 else 0):
            (kind,) = take("B")
            if kind == MASK:
                form = f"{take('hhHHH')[4]}H"
            else:
                form = f"{2 * take('H')[0]}f" if kind == POLYGON else FORMS[kind]
            region = take(form)
            texts.append("m" if kind == MASK else ",".join(f"{value:.9g}" for value in region))
    except (struct.error, LookupError):
        version = 0
    if version != 1 or at != len(data) or not texts:
        why = "is no binary result of vot-toolkit, or is cut short"
        raise InputError(f"{path}: {why}; let the toolkit write text, with VOT_RESULTS_BINARY=false")
    return Lines(path, texts, list(range(1, len(texts) + 1)))


def write_otb(one: Trajectory, unknown: str = "nan,nan,nan,nan") -> str:
    """A box a line, pixels from 1, at most 4 decimals: `read_otb` with the first frame as `shift` gives it back.

    The format has no frame numbers: line 1 is the series' first frame, as in OTB's own files of clips that begin late
    (David at frame 300). A place that is not known is the line `unknown`. Raises InputError for a gap between frames,
    or a row with a place and no size.
    """
    if (gaps := np.flatnonzero(np.diff(one.frame) != 1)).size:
        between = f"no row between frames {one.frame[gaps[0]]} and {one.frame[gaps[0] + 1]}"
        why = "a format without frame numbers has no room for a gap; export to mot or vot"
        raise InputError(f"{one.name}: {between}, and {why}")
    boxes = (_known_boxes(one) + FROM_ONE).tolist()
    return "".join((",".join(map(_decimal, box)) if box[0] == box[0] else unknown) + "\n" for box in boxes)


def write_got10k(one: Trajectory) -> str:
    """The same as GOT-10k's toolkit has it, which wants it as `<clip>_001.txt`: after nan the mean overlap is nan."""
    return write_otb(one, "0,0,0,0")


def write_vot(one: Trajectory) -> str:
    """A result of vot-toolkit from frame 0 on: 1 in the first frame of the series, then a region a line, 4 decimals.

    Frames before the first and in gaps are 0, a place that is not known is 2. Rows with corners are polygons.
    `read_vot` gives all rows back but for the place in the first frame. Raises InputError for a row with a place and no
    size, and for a frame below 0.
    """
    first, last = int(one.frame[0]), int(one.frame[-1])
    if first < 0:
        raise InputError(f"{one.name}: frame {first} is before the clip's first; VOT text begins at frame 0")
    if last >= MAX_ROWS:
        raise InputError(f"{one.name}: frame {last} is too far on for VOT text, which has a line a frame")
    lines = ["0"] * (last + 1)
    corners = np.full((len(one), 8), np.nan) if one.corners is None else one.corners.reshape(-1, 8)
    for frame, box, polygon in zip(one.frame.tolist(), _known_boxes(one).tolist(), corners.tolist(), strict=True):
        region = polygon if polygon[0] == polygon[0] else box  # nan is not equal to itself
        lines[frame] = ",".join(map(_decimal, region)) if region[0] == region[0] else "2"
    lines[first] = "1"
    return "\n".join(lines) + "\n"


def write_mot(chosen: Sequence[Trajectory]) -> str:
    """Results or ground truth of MOTChallenge, sorted by frame, at most 4 decimals.

    Ground truth, as its statuses say, has nine values: flag and class 1, and visibility, 0 of hidden rows. Results have
    ten: a conf, -1 where not known, then class and visibility as well, which readers look for there, and -1.
    A series is an id: its target's name if all are numbers and differ, else 1, 2, ... in their order. Rows without a
    place are left out, which is how the format says that nothing was found. `read_mot(..., results=True)` gives the
    rest back. Raises InputError for a row with a place and no size.
    """
    idents = [int(one.target) if one.target.isascii() and one.target.isdigit() else 0 for one in chosen]
    if 0 in idents or len(set(idents)) < len(idents):
        idents = list(range(1, len(chosen) + 1))
    said = {status for one in chosen for status in one.status.tolist()}
    truth = "visible" in said and said <= {"", "visible", "hidden", "absent"}
    rows: list[tuple[int, int, str]] = []
    for ident, one in zip(idents, chosen, strict=True):
        boxes, seen = (_known_boxes(one) + FROM_ONE).tolist(), np.isin(one.status, SEEN).astype(int).tolist()
        for frame, conf, ltwh, visible in zip(one.frame.tolist(), one.confidence.tolist(), boxes, seen, strict=True):
            if ltwh[0] == ltwh[0]:  # not nan
                known = _decimal(conf) if conf == conf else "-1"
                rest = f"1,1,{visible}" if truth else f"{known},1,{visible},-1"
                rows.append((frame + 1, ident, f"{','.join(map(_decimal, ltwh))},{rest}\n"))
    return "".join(f"{frame},{ident},{rest}" for frame, ident, rest in sorted(rows))


def _known_boxes(one: Trajectory) -> Array:
    """(T, 4) left, top, width, height from 0; nan where the place is not known. InputError for a place without size."""
    found = one.boxes
    if (sizeless := np.flatnonzero(np.isnan(found).any(axis=1) & ~np.isnan(one.x))).size:
        why = "has no w and h, and these formats hold boxes; export points to coco or dlc"
        raise InputError(f"{one.name}: frame {one.frame[sizeless[0]]} {why}")
    return found


def _decimal(value: float) -> str:
    """At most 4 decimals, as many as the centres of a CSV need: it has 3, and half a width makes a fourth."""
    text = f"{value:.4f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
