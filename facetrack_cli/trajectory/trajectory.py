"""The one type for trajectories and ground truth: rows as typed columns, from the tracker's result to every file.

Axes: R rows, one for each frame, target and part. Rows of one part stand together, in the order of their frames; a
number that is not known is nan, a text "".
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, TypeAlias

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError, needed
from facetrack_cli.core.geometry import shown_angle
from facetrack_cli.core.numbers import spans
from facetrack_cli.core.types import BOX, Array, Frame, Mask, Start, Texts, Whole
from facetrack_cli.trajectory.diagnostics import POSTERIOR, SURE, Diagnostics, outlines

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

    from facetrack_cli.trajectory.measures import FaceEvent, Measured
    from facetrack_cli.trajectory.people import People

Status: TypeAlias = Literal["init", "tracked", "hidden", "lost", "absent"]
Names: TypeAlias = tuple[tuple[str, str], ...]
UNSEEN: Final = ("hidden", "lost")  # statuses of parts that the tracker does not see, and has a place for
SEEN: Final = ("", "visible", "init", "tracked")  # statuses, also of ground truth, of what can be seen
SPREAD: Final = ("std_x", "std_y", "cov_xy", "std_w", "std_h")
_OF_POSTERIOR: Final = {**dict.fromkeys(SPREAD, 3), "ess": 1, "identity_prob": 4}
DECIMALS: Final = {"time_s": 4, **dict.fromkeys("xywh", 3), "angle": 2, "confidence": 4, **_OF_POSTERIOR}
"""The decimals of each column of numbers: the bytes of a file are a function of the values."""
COLUMNS: Final = (
    "frame", "time_s", "target", "part", "x", "y", "w", "h", "angle", "confidence", "status", *SPREAD,
    "particles", "ess", "identity", "identity_prob",
)  # fmt: skip
"""The columns of the CSV, in their order."""
FLOATS: Final = (*DECIMALS, "particles")
TEXTS: Final = ("status", "identity")
MAX_ROWS: Final = 10**7  # four days of video
PLACE: Final = ("x", "y", "w", "h", "angle", "confidence", *SPREAD, "ess")
"""The columns that an absent part has no value in."""

_WIDTH, _HEIGHT, _MEANS = 160, 24, 80  # of a line of confidence: pixels, and means that it shows


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Where parts of targets are in the frames of a clip, and how sure the tracker is. Every array is (R,).

    `names` are the (target, part) pairs, `which` the index of each row's pair, `frame` the 0-based source frame. (x, y)
    is the centre and (w, h) the size in pixels; `angle` in degrees, as the picture is shown; `confidence` 0..1;
    `std_x`, `std_y` the posterior's standard deviations in pixels, `cov_xy` its covariance of x and y in square pixels,
    `std_w`, `std_h` those of a box's size. `status` is init, tracked, hidden, lost or absent in a trajectory; visible,
    hidden or absent in ground truth; "" where nothing is said. `by_hand` marks rows that a correction gave, which a CSV
    does not tell. `corners` (R, 4, 2), clockwise from the top left, are there for rotated boxes and polygons.
    `header` is what a JSON file says of its run, `diagnostics` what a tracker reports of each target beside its rows,
    `path` the file.
    """

    names: Names
    which: Whole
    frame: Whole
    time_s: Array
    x: Array
    y: Array
    w: Array
    h: Array
    angle: Array
    confidence: Array
    status: Texts
    std_x: Array
    std_y: Array
    cov_xy: Array
    std_w: Array
    std_h: Array
    particles: Array
    ess: Array
    identity: Texts
    identity_prob: Array
    by_hand: Mask
    corners: Array | None = None
    header: Mapping[str, Any] = field(default_factory=dict)
    diagnostics: Mapping[str, Diagnostics] = field(default_factory=dict)
    path: Path = Path()

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def targets(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(target for target, _ in self.names))

    @property
    def target(self) -> str:
        """The target of the first part, as `part` and `name` (`target/part`) are its own."""
        return self.names[0][0]

    @property
    def part(self) -> str:
        return self.names[0][1]

    @property
    def name(self) -> str:
        return "/".join(self.names[0])

    @cached_property
    def parts(self) -> tuple[Trajectory, ...]:
        """A trajectory of each part, in the order of `names`."""
        if len(self.names) == 1:
            return (self,)
        ends = np.searchsorted(self.which, np.arange(len(self.names) + 1))
        return tuple(self.take(slice(*ends[i : i + 2].tolist()), names=(name,)) for i, name in enumerate(self.names))

    def find(self, target: str, part: str) -> Trajectory | None:
        """The rows of one part; None if there are none."""
        return next((rows for rows in self.parts if rows.names[0] == (target, part)), None)

    def of_target(self, target: str) -> tuple[Trajectory, ...]:
        """A trajectory of each part of one target."""
        return tuple(part for part in self.parts if part.target == target)

    @cached_property
    def frames(self) -> Whole:
        """The frames that have a row, increasing."""
        return np.unique(self.frame)

    def take(self, rows: Whole | Mask | slice, **others: Any) -> Trajectory:
        """These rows, in their order; `others` are replaced."""
        picked = {name: array[rows] for name in _ARRAYS if (array := getattr(self, name)) is not None}
        if "names" in others:
            picked["which"] = np.zeros(len(picked["frame"]), np.int64)
        return replace(self, **picked, **others)

    def renamed(self, target: str, part: str) -> Trajectory:
        """A trajectory of one part under another name."""
        return replace(self, names=((target, part),))

    def row(self, frame: int) -> int | None:
        """The index of a frame's row, of a trajectory of one part; None if there is none."""
        at = int(np.searchsorted(self.frame, frame))
        return at if at < len(self) and self.frame[at] == frame else None

    @cached_property
    def _by_frame(self) -> tuple[Whole, Whole]:
        order = np.lexsort((self.which, self.frame))
        return order, self.frame[order]

    def at(self, frame: int) -> Trajectory:
        """The rows of one frame."""
        order, frames = self._by_frame
        return self.take(order[slice(*np.searchsorted(frames, [frame, frame + 1]).tolist())])

    def between(self, first: int, stop: int) -> Trajectory:
        """The rows of frames from `first` to before `stop`, with the diagnostics of those."""
        kept = self.take((self.frame >= first) & (self.frame < stop))
        parts = {name: part.between(first, stop) for name, part in self.diagnostics.items()}
        return replace(kept, diagnostics={name: part for name, part in parts.items() if len(part.frame)})

    @property
    def times(self) -> Array:
        """(T,) seconds of `frames`, nan where no row says when."""
        frames = self.frames
        times, timed = np.full(len(frames), np.nan), np.isfinite(self.time_s)
        times[np.searchsorted(frames, self.frame[timed])] = self.time_s[timed]
        return times

    def beliefs(self, target: str) -> tuple[Whole, tuple[str, ...], Array]:
        """(T,) frames, (P,) names and (T, P) their probabilities; of a CSV those of the most likely identity alone."""
        reported = self.diagnostics.get(target)
        if reported is not None and POSTERIOR.name in reported.values:
            return reported.frame, reported.labels[POSTERIOR.name], reported.values[POSTERIOR.name]
        rows = self.of_target(target)[0]
        names = tuple(dict.fromkeys(name for name in rows.identity.tolist() if name))
        named = rows.identity[:, None] == np.array(names, dtype=np.str_)[None]
        return rows.frame, names, np.where(named, rows.identity_prob[:, None], np.nan)

    def recognised(self, target: str, name: str, level: float = SURE) -> int | None:
        """The first frame in which the identity `name` has a probability above `level`; None if there is none."""
        frame, names, probabilities = self.beliefs(target)
        above = np.flatnonzero(probabilities[:, names.index(name)] > level) if name in names else np.empty(0)
        return int(frame[above[0]]) if above.size else None

    @property
    def boxes(self) -> Array:
        """(R, 4): left, top, width, height; a box over whole pixels has its centre at left + (w - 1) / 2."""
        return np.stack([self.x - (self.w - 1) / 2, self.y - (self.h - 1) / 2, self.w, self.h], axis=1)

    @property
    def unseen(self) -> Mask:
        """(R,) which rows the tracker has a place for and does not see: those that are lost or hidden."""
        return np.isin(self.status, UNSEEN)

    @property
    def vanished(self) -> Mask:
        """(R,) rows of boxes that the tracker itself calls absent, as a hand below the picture."""
        box = np.array([part == BOX for _, part in self.names], np.bool_)
        return np.asarray((self.status == "absent") & box[self.which] & np.isfinite(self.particles))

    @property
    def corrected(self) -> Mask:
        """(R,) rows of a part that corrections gave; in a CSV `init` after the first row, or where `absent` begins.

        Not those that begin where chunks of a clip meet; a box that the tracker itself calls absent has particles.
        """
        absent = self.status == "absent"
        seams = self.header.get("seams")
        meet = [seam.get("frame") for seam in seams if isinstance(seam, dict)] if isinstance(seams, list) else []
        shown = (self.status == "init") & ~np.isin(self.frame, [seam for seam in meet if isinstance(seam, int)])
        shown |= absent & ~self.vanished & ~np.concatenate([absent[:1], absent[:-1]])
        return np.asarray(self.by_hand | (shown & (np.arange(len(self)) > 0)))

    @property
    def pixel_aspect(self) -> float:
        """The width of a pixel over its height, by the header."""
        aspect = header_value(self, "source", "pixel_aspect")
        return float(aspect) if isinstance(aspect, int | float) and 0.01 < aspect <= 100 else 1.0

    @property
    def squared(self) -> Trajectory:
        """The rows in pixels that are as wide as high, as the picture is shown."""
        wide = self.pixel_aspect
        if wide == 1:
            return self
        columns = {name: getattr(self, name) * wide for name in ("x", "w", "std_x", "std_w", "cov_xy")}
        corners = None if self.corners is None else self.corners * (wide, 1)
        return replace(self, **columns, corners=corners, header={})

    @cached_property
    def measures(self) -> Mapping[str, Mapping[str, Measured]]:
        """Of each target what its face does, or the hand, by the measure's name."""
        from facetrack_cli.trajectory.measures import hand_measures, measures_of

        return {target: measures_of(self.of_target(target)) for target in self.targets} | hand_measures(self)

    @cached_property
    def events(self) -> tuple[FaceEvent, ...]:
        """When mouths open and close, eyes blink, heads nod, hands move, hold still and touch, in the order of time."""
        from facetrack_cli.trajectory.measures import events_of

        kinds = (kind for name, measures in self.measures.items() for kind in events_of(name, measures).values())
        return tuple(sorted(event for kind in kinds for event in kind))

    @cached_property
    def people(self) -> People | None:
        """Who is in a film, by the header or the people.json beside the file; None of a clip of one target."""
        from facetrack_cli.trajectory.people import People, read_people

        record = self.header.get("people")
        return read_people(self.path.parent) if record is None else People.model_validate(record)

    def intervals(self, *statuses: str) -> dict[str, list[tuple[int, int]]]:
        """Frames [first, stop) in which each `target/part` has one of these statuses, in the order of time."""
        intervals = {}
        for part in self.parts:
            there = spans(np.isin(part.status, statuses), np.diff(part.frame) > 1)
            intervals[part.name] = [(int(part.frame[a]), int(part.frame[b - 1]) + 1) for a, b in there]
        return intervals

    def columns(self) -> dict[str, Any]:
        """The columns of the CSV as arrays, rows in the order of the file: by frame, then by part."""
        order, _ = self._by_frame
        targets, parts = (np.array([name[i] for name in self.names], dtype=np.str_) for i in (0, 1))
        own = {"target": targets[self.which], "part": parts[self.which]}
        return {name: (own[name] if name in own else getattr(self, name))[order] for name in COLUMNS}

    def _repr_html_(self) -> str:
        """A small table: of each target its parts, frames, the share of rows that are seen, events, and confidence."""
        events = Counter((event.target, event.value) for event in self.events)
        lines = []
        for target in self.targets:
            parts = self.of_target(target)
            seen = np.concatenate([np.isin(part.status, SEEN) for part in parts])
            said = ", ".join(f"{n} {value}" for (of, value), n in sorted(events.items()) if of == target)
            share = f"{seen.mean():.0%}" if seen.size else ""
            confidence = np.array_split(np.nan_to_num(parts[0].confidence), _MEANS)
            means = [float(values.mean()) for values in confidence if len(values)]
            x = np.linspace(0, _WIDTH, len(means)).tolist()
            points = " ".join(f"{a:.1f},{_HEIGHT - 1 - v * (_HEIGHT - 2):.1f}" for a, v in zip(x, means, strict=True))
            line = f'<polyline points="{points}" fill="none" stroke="currentColor"/>'
            line = f'<svg width="{_WIDTH}" height="{_HEIGHT}" role="img" aria-label="confidence over time">{line}</svg>'
            cells = target or "-", len(parts), len(parts[0]), share, said
            lines.append("<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in cells) + f"<td>{line}</td>")
        heads = "".join(f"<th>{head}" for head in ("target", "parts", "frames", "seen", "events", "confidence"))
        return f"<table><tr>{heads}{''.join(lines)}</table>"

    def to_xarray(self) -> Dataset:
        """The places as an xarray.Dataset in the layout of `movement`'s poses.

        `position` (time, space, keypoints, individuals) in pixels, and `confidence` (time, keypoints, individuals);
        parts are keypoints, targets individuals. There is a time, in seconds, for each frame from the first to the last
        one, whose number is the coordinate `frame`; what is not known is nan. Lost rows have the tracker's estimate.
        UsageError without xarray, which the extra `xarray` brings.
        """
        with needed("datasets", "xarray", "xarray"):
            import xarray

        timed = np.isfinite(self.times)
        if not timed.any():
            raise InputError("no row has a time_s, and a dataset needs times; fill that column")
        frames = np.arange(self.frames[0], self.frames[-1] + 1)
        time_s = np.interp(frames, self.frames[timed], self.times[timed])
        parts, values = places(self, frames)
        fps = header_value(self, "source", "fps")
        about: dict[str, Any] = {"source_software": "facetrack", "ds_type": "poses", "time_unit": "seconds"}
        if fps is not None or len(frames) > 1:
            about["fps"] = round(1 / float(np.median(np.diff(time_s))), 6) if fps is None else fps
        axes, targets = ("time", "space", "keypoints", "individuals"), [target or "target" for target in self.targets]
        named = dict(zip(axes, (time_s, ["x", "y"], parts, targets), strict=True))
        position, confidence = values[..., :2].transpose(0, 3, 2, 1), values[..., 2].transpose(0, 2, 1)
        columns = {"position": (axes, position), "confidence": (axes[:1] + axes[2:], confidence)}
        return xarray.Dataset(columns, {**named, "frame": ("time", frames)}, about)

    def to_pandas(self, what: Literal["rows", "measures", "events"] = "rows") -> DataFrame:
        """The columns, the measures or the events as a pandas DataFrame.

        Of measures there is a row for each target, measure and frame: value, std and noise. UsageError without pandas,
        which the extra `pandas` brings.
        """
        from facetrack_cli.trajectory.measures import FaceEvent

        if what not in ("rows", "measures", "events"):
            raise UsageError(f"{what!r} is no table; give rows, measures or events")
        with needed("data frames", "pandas", "pandas"):
            import pandas

        if what == "events":
            return pandas.DataFrame(self.events, columns=FaceEvent._fields)
        if what == "rows":
            return pandas.DataFrame(self.columns())
        names, frames = ("frame", "time_s", "value", "std", "noise"), []
        for target, measures in self.measures.items():
            for name, line in measures.items():
                about = {"target": target, "measure": name, "unit": line.unit}
                frames.append(pandas.DataFrame({**about, **{column: getattr(line, column) for column in names}}))
        return pandas.concat(frames or [pandas.DataFrame(columns=["target", "measure", *names])], ignore_index=True)


def header_value(table: Trajectory, group: str, key: str) -> Any:
    """The value of the header below `group`, as of "recipe" and "name"; None where there is none."""
    members = table.header.get(group)
    return members.get(key) if isinstance(members, dict) else None


_UNKNOWN: Final[Mapping[str, Any]] = {**dict.fromkeys(FLOATS, np.nan), **dict.fromkeys(TEXTS, ""), "by_hand": False}
_KINDS: Final[Mapping[str, Any]] = {name: type(value) for name, value in _UNKNOWN.items()}
_ARRAYS: Final = ("which", "frame", *_UNKNOWN, "corners")


def build(names: Sequence[tuple[str, str]], which: Any, frame: Any, **others: Any) -> Trajectory:
    """A trajectory from the columns that are known, with rows in any order; None and columns left out are not known.

    `others` are columns, header, diagnostics and path. Raises InputError for two rows of one frame, target and part.
    """
    about = {name: others.pop(name) for name in ("header", "diagnostics", "path") if name in others}
    which, frame = np.asarray(which, np.int64), np.asarray(frame, np.int64)
    order: Any = np.lexsort((frame, which))
    if (order == np.arange(len(order))).all():
        order = slice(None)
    which, frame = which[order], frame[order]
    twice = np.flatnonzero((frame[1:] == frame[:-1]) & (which[1:] == which[:-1]))
    if twice.size:
        at, name = frame[twice[0]], "/".join(names[which[twice[0]]])
        raise InputError(f"{about.get('path', Path())}: frame {at} has two rows of {name}; keep one row of them")
    columns = {name: values for name, values in others.items() if values is not None}
    for name, values in columns.items():
        columns[name] = np.asarray(values, dtype=_KINDS.get(name, float))[order]
    columns = {**unknown_columns(len(frame)), **columns, "which": which, "frame": frame}
    return Trajectory(tuple(names), **columns, **about)


def of_frame(names: Names, frame: Frame, diagnostics: Mapping[str, Diagnostics], **columns: Any) -> Trajectory:
    """`build` of the rows of one frame, one for each of `names` and in their order, without looking for mistakes.

    An angle is that in the frame's pixels. What lies beyond the outermost pixels of the frame cannot be seen: it is
    hidden where it would be tracked.
    """
    rows, values_of = len(names), dict(unknown_columns(len(names)))
    values_of |= {"which": np.arange(rows), "frame": np.full(rows, frame.index), "time_s": np.full(rows, frame.time_s)}
    values_of |= {name: np.asarray(values, dtype=_KINDS.get(name, float)) for name, values in columns.items()}
    values_of["angle"] = shown_angle(values_of["angle"], frame.aspect)
    return hide_outside(Trajectory(names, **values_of, diagnostics=diagnostics), frame.size, ("tracked",))


def hide_outside(rows: Trajectory, size: tuple[int, int], seen: Sequence[str] = SEEN) -> Trajectory:
    """The rows in which places beyond the outermost pixels of pictures of `size` (width, height) are hidden."""
    beyond = (rows.x < 0) | (rows.x > size[0] - 1) | (rows.y < 0) | (rows.y > size[1] - 1)
    if not beyond.any():
        return rows
    return replace(rows, status=np.where(beyond & np.isin(rows.status, seen), "hidden", rows.status))


@lru_cache
def unknown_columns(rows: int) -> dict[str, Any]:
    """Columns of which nothing is known: read-only, and one value each in memory."""
    return {name: np.broadcast_to(np.array(value, _KINDS[name]), rows) for name, value in _UNKNOWN.items()}


def one_part(target: str, part: str, frame: Any, **columns: Any) -> Trajectory:
    """The trajectory of one part, from what is known of it."""
    return build([(target, part)], np.zeros(len(frame), np.int64), frame, **columns)


def joined(parts: Iterable[Trajectory], **others: Any) -> Trajectory:
    """Trajectories of different parts, or of different frames, as one; `others` are header, diagnostics and path."""
    tables = list(parts)
    if len(tables) < 2:
        return replace(tables[0] if tables else build((), [], []), **others)
    kinds = dict.fromkeys(table.names for table in tables)  # frames have the same names again and again
    numbers = {name: i for i, name in enumerate(dict.fromkeys(name for names in kinds for name in names))}
    index = {names: np.array([numbers[name] for name in names], np.int64) for names in kinds}
    which = [index[table.names][table.which] for table in tables]
    columns: dict[str, Any] = {}
    for column in _ARRAYS[1:]:
        arrays = [getattr(table, column) for table in tables]
        if column == "corners" and any(array is not None for array in arrays):
            arrays = [np.full((len(t), 4, 2), np.nan) if t.corners is None else t.corners for t in tables]
        columns[column] = None if arrays[0] is None else np.concatenate(arrays)
    whole = np.concatenate(which)
    if (whole[1:] > whole[:-1]).all():  # the targets of one frame: nothing is to be sorted
        return Trajectory(tuple(numbers), which=whole, **columns, **others)
    return build(tuple(numbers), whole, **columns, **others)


def aligned(parts: Sequence[Trajectory], *columns: str, frame: Whole | None = None) -> tuple[Whole, dict[str, Any]]:
    """The T frames of K trajectories of one part each, and the values (T, K) of each column, unknown without a row.

    `frame` (T,) are those frames and more, increasing.
    """
    if frame is None:
        frame = np.unique(np.concatenate([part.frame for part in parts]))
    values = {}
    for name in columns:
        values[name] = np.full((len(frame), len(parts)), _UNKNOWN[name], "<U8" if name in TEXTS else None)
        for k, part in enumerate(parts):
            values[name][np.searchsorted(frame, part.frame), k] = getattr(part, name)
    return frame, values


def places(table: Trajectory, frames: Whole) -> tuple[list[str], Array]:
    """The names of the parts, and (T, targets, parts, 3) x, y and confidence: each target has all parts, or nan."""
    targets, parts = table.targets, list(dict.fromkeys(part for _, part in table.names))
    values = np.full((len(frames), len(targets), len(parts), 3), np.nan)
    at = np.array([(targets.index(target), parts.index(part)) for target, part in table.names]).T
    _, columns = aligned(table.parts, "x", "y", "confidence", frame=frames)
    values[:, at[0], at[1]] = np.stack([*columns.values()], axis=2)
    return parts, values


def mean_confidence(confidences: Array) -> float:
    """The mean of a frame's confidences, of the digits that a file has: it is the same from rows and from a file."""
    return round(float(np.add.reduce(confidences.round(DECIMALS["confidence"]))) / len(confidences), 12)


class TargetResult(NamedTuple):
    """What a tracker says of one target in one frame: a row for each of its K parts, with its diagnostics.

    `cloud` (N, K, 2) are the particles' centres in pixels; `notes` are lines for the user, of the frame in which they
    arise. `beliefs` gives what the smoother needs (`engine.protocols.Belief`); None of what has none.
    """

    rows: Trajectory
    cloud: Array
    notes: tuple[str, ...] = ()
    beliefs: Callable[[], tuple[Any, ...]] | None = None


@dataclass(frozen=True, eq=False)
class FrameResult:
    """What a tracker says of one frame. The first result of `track_frames` has the `start` of the track."""

    frame: Frame
    targets: tuple[TargetResult, ...]
    start: Start | None = None

    @cached_property
    def rows(self) -> Trajectory:
        """A row for each target and part, in the tracker's order."""
        if len(self.targets) == 1:
            return self.targets[0].rows
        diagnostics = {name: reported for target in self.targets for name, reported in target.rows.diagnostics.items()}
        return joined([target.rows for target in self.targets], diagnostics=diagnostics)

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines for the user, each once, with the first target that it is said of where there are several."""
        first: dict[str, str] = {}
        for target in self.targets:
            for note in target.notes:
                first.setdefault(note, target.rows.target)
        return tuple(f"{name}: {note}" if len(self.targets) > 1 else note for note, name in first.items())


def recorded(frame: int, rows: Trajectory) -> tuple[TargetResult, ...]:
    """The rows and diagnostics of one frame by target, with the corners that follow from affine maps."""
    now, targets = rows.between(frame, frame + 1), []
    for target in now.targets:
        if parts := [part for part in now.of_target(target) if len(part)]:
            mine = joined(parts, diagnostics={name: part for name, part in now.diagnostics.items() if name == target})
            corners = outlines(mine)
            mine = replace(mine, corners=mine.corners if corners is None else corners)
            targets.append(TargetResult(mine, np.empty((0, len(mine), 2))))
    return tuple(targets)


class Collector:
    """Collects the rows of successive frames into one trajectory, in little more memory than that."""

    def __init__(self) -> None:
        self._chunks, self._frames = list[Trajectory](), list[Trajectory]()

    def add(self, rows: Trajectory) -> None:
        self._frames.append(rows)
        if len(self._frames) == 500:  # a frame by itself takes several times its numbers
            self._chunks.append(successive(self._frames))
            self._frames.clear()

    def trajectory(self, **others: Any) -> Trajectory:
        """All rows so far; `others` are header and path."""
        return replace(successive([*self._chunks, *self._frames]), **others)


def successive(pieces: Sequence[Trajectory], like: Trajectory | None = None) -> Trajectory:
    """Rows of different frames or targets as one, with their diagnostics; names, header and path as in `like`."""
    targets = dict.fromkeys(name for piece in pieces for name in piece.diagnostics)
    by_target = {name: [piece.diagnostics[name] for piece in pieces if name in piece.diagnostics] for name in targets}
    diagnostics = {name: Diagnostics.joined(parts) for name, parts in by_target.items()}
    if like is None:
        return joined(pieces, diagnostics=diagnostics)
    # the first piece gives the order of the names
    return joined([like.take(slice(0, 0)), *pieces], diagnostics=diagnostics, header=like.header, path=like.path)
