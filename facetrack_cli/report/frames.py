"""Pictures of a run's key frames: the clip's own frames with the overlay drawn anew, else those of annotated.mp4.

A clip is decoded once, up to the last frame that is wanted; of an image folder, only the images wanted are read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

import cv2
import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Frame, Image
from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory, joined, recorded
from facetrack_cli.video.images import listing
from facetrack_cli.video.overlay.overlay import Overlay
from facetrack_cli.video.source import open_source

SMALLEST: Final = (640, 480)  # pictures are enlarged to fit this, so that the overlay can be read ...
LARGEST: Final = (960, 720)  # ... and reduced to fit this
MOST_BYTES: Final = 220_000  # of one JPEG: twelve stay below 4 MB as text
_VIEW = 3.5  # a picture shows this many times the target's size; larger clips are cut out around it
_TRAIL_S = 1.0
_TRAIL = 25  # frames of it that are drawn
_APART_S = 0.002  # a clip whose frames have other times than the run's is another clip

Report: TypeAlias = Callable[[int, int], None]  # frames read, frames to read
View: TypeAlias = tuple[int, int, int, int]  # left, top, width, height in the clip's pixels
_Read: TypeAlias = Callable[["Clip", Sequence[int]], Iterator[Frame]]
_Fill: TypeAlias = Callable[["Pictures", "_Maker", "Clip", Sequence[int], _Read], None]


class Clip(NamedTuple):
    """The run's clip as its header tells: where it was, (width, height), nominal rate."""

    path: Path
    size: tuple[int, int]
    fps: float


class Picture(NamedTuple):
    """One key frame: a JPEG of `size` (width, height), which shows `view` of the clip."""

    jpeg: bytes
    size: tuple[int, int]
    view: View


@dataclass
class Pictures:
    """What could be had: by frame; `origin` says of what they were made, `notes` what was missing or odd."""

    found: dict[int, Picture] = field(default_factory=dict)
    origin: str = ""
    notes: list[str] = field(default_factory=list)


def pictures(
    table: Trajectory,
    clip: Clip,
    wanted: Sequence[int],
    *,
    given: Path | None = None,
    annotated: Path | None = None,
    title: str = "",
    unit: float | None = None,
    report: Report = lambda done, total: None,
) -> Pictures:
    """Pictures of the `wanted` frames: from the clip `given` or the header's, else from the MP4 `annotated`.

    `unit` is the target's size in pixels, None if unknown. Raises InputError if the clip `given` is not the run's;
    what is wrong with the header's becomes a note.
    """
    maker = _Maker(table, clip, title, unit)
    if given is not None:
        done = _attempt(_clip_frames, maker, clip._replace(path=given), wanted, report)
        if len(done.found) < len(wanted):
            raise InputError(done.notes[-1])
        return done
    best = _attempt(_clip_frames, maker, clip, wanted, report)
    if len(best.found) == len(wanted) or annotated is None:
        return best
    other = _attempt(_annotated_frames, maker, clip._replace(path=annotated), wanted, report)
    first, second = (best, other) if len(best.found) > len(other.found) else (other, best)
    return Pictures(first.found, first.origin, second.notes + first.notes)


def _attempt(fill: _Fill, maker: _Maker, clip: Clip, wanted: Sequence[int], report: Report) -> Pictures:
    """What one source gives; what is wrong with it is in the notes."""
    done = Pictures(origin="clip" if fill is _clip_frames else "annotated")
    try:
        fill(done, maker, clip, wanted, lambda c, w: _frames(c, w, report))
        missing = [frame for frame in wanted if frame not in done.found]
        if missing:
            done.notes.append(f"{clip.path}: has no frame {missing[0]}, which the run has; name its clip with --clip")
    except InputError as e:
        done.notes.append(str(e))
    return done


def _clip_frames(done: Pictures, maker: _Maker, clip: Clip, wanted: Sequence[int], frames: _Read) -> None:
    """The clip's own frames, drawn on; a note if they come at other times than in the run."""
    for frame in frames(clip, wanted):
        then = maker.time_of(frame.index)
        if abs(frame.time_s - then) > _APART_S + 0.05 / clip.fps and not done.notes:
            done.notes.append(
                f"{clip.path}: frame {frame.index} is at {frame.time_s:.3f} s, in the run it was at {then:.3f} s; "
                "is it the same clip?"
            )
        done.found[frame.index] = maker.draw(frame)


def _annotated_frames(done: Pictures, maker: _Maker, clip: Clip, wanted: Sequence[int], frames: _Read) -> None:
    """Frames of the annotated MP4, which counts from the run's first frame and pads odd sizes."""
    place = {int(np.searchsorted(maker.frames, frame)): frame for frame in wanted}
    width, height = clip.size
    padded = clip._replace(size=(width + width % 2, height + height % 2))
    for frame in frames(padded, sorted(place)):
        index = place[frame.index]
        done.found[index] = maker.cut(frame.bgr[:height, :width], index)


def _frames(clip: Clip, wanted: Sequence[int], report: Report) -> Iterator[Frame]:
    """The wanted frames, in their order, in one pass. InputError if the clip is of another size."""
    path = clip.path
    folder = listing(path) is not None
    fps = Fraction(clip.fps).limit_denominator(1001) if folder else None
    runs = [(n, n + 1) for n in wanted] if folder else [(wanted[0], wanted[-1] + 1)]
    picked, total = set(wanted), sum(end - begin for begin, end in runs)
    done = 0
    for begin, end in runs:
        with open_source(path, fps=fps, start=begin, stop=end) as source:
            if source.size != clip.size:
                raise InputError(
                    f"{path}: is {source.size[0]}x{source.size[1]}, not {clip.size[0]}x{clip.size[1]} pixels as in the "
                    "run; name its clip with --clip"
                )
            for frame in source:
                done += 1
                report(done, total)
                if frame.index in picked:
                    yield frame


class _Maker:
    """Turns frames into pictures: cut out, scaled, drawn on, packed."""

    def __init__(self, table: Trajectory, clip: Clip, title: str, unit: float | None) -> None:
        self._table, self._clip, self._title = table, clip, title
        marked = [replace(part, by_hand=part.corrected) for part in table.parts]
        self._marked = joined(marked, diagnostics=table.diagnostics)
        self.frames, self._times = table.frames, table.times
        self._unit = unit if unit is not None and unit > 0 else self._typical()

    def time_of(self, frame: int) -> float:
        """Seconds, as the rows say, else by the nominal rate."""
        at = int(np.searchsorted(self.frames, frame))
        known = at < len(self.frames) and self.frames[at] == frame and math.isfinite(self._times[at])
        return float(self._times[at]) if known else frame / self._clip.fps

    def draw(self, frame: Frame) -> Picture:
        """The frame with the overlay that `facetrack run` draws, at the picture's own size, with its trail."""
        view, size = self._layout(frame.index)
        picture = _scaled(frame.bgr, view, size)
        overlay = Overlay(size, title=self._title, trail_s=_TRAIL_S)
        last, now = int(np.searchsorted(self.frames, frame.index)), self.time_of(frame.index)
        past = self.frames[max(0, last - math.ceil(self._clip.fps * _TRAIL_S)) : last].tolist()
        past = [index for index in past if self.time_of(index) >= now - _TRAIL_S]
        for index in past[:: max(1, math.ceil(len(past) / _TRAIL))]:  # an overlay draws the trail that it has seen
            overlay.draw(self._result(Frame(index, self.time_of(index), picture), view, size[0] / view[2]))
        drawn = overlay.draw(self._result(Frame(frame.index, now, picture), view, size[0] / view[2]))
        return Picture(_jpeg(drawn), size, view)

    def cut(self, image: Image, frame: int) -> Picture:
        """A picture of the annotated video, which has its overlay."""
        view, size = self._layout(frame)
        return Picture(_jpeg(_scaled(image, view, size)), size, view)

    def _result(self, frame: Frame, view: View, zoom: float) -> FrameResult:
        """The rows of one frame as the tracker's result, in the pixels of a view enlarged by `zoom`."""
        rows = self._marked.at(frame.index)
        shown = replace(
            rows,
            x=(rows.x - view[0] + 0.5) * zoom - 0.5,
            y=(rows.y - view[1] + 0.5) * zoom - 0.5,
            w=np.nan_to_num(rows.w) * zoom,
            h=np.nan_to_num(rows.h) * zoom,
            std_x=rows.std_x * zoom,
            std_y=rows.std_y * zoom,
            status=np.where(rows.status == "", "tracked", rows.status),
        )
        # without diagnostics: their numbers stand in the plots
        targets = (one._replace(rows=replace(one.rows, diagnostics={})) for one in recorded(frame.index, shown))
        return FrameResult(frame, tuple(targets))

    def _typical(self) -> float:
        """The size of the targets where nothing else says it: the median span of their windows."""
        of_one = [s for s in self._table.parts if len(s) == len(self._table.parts[0])]
        spans = []
        for centres, sides in (
            ([s.x for s in of_one], [s.w for s in of_one]),
            ([s.y for s in of_one], [s.h for s in of_one]),
        ):
            middle, half = np.stack(centres), np.nan_to_num(np.stack(sides)) / 2
            span = (middle + half).max(axis=0) - (middle - half).min(axis=0)
            spans += [float(np.median(span[np.isfinite(span)]))] if np.isfinite(span).any() else []
        return max(spans, default=0.0) or max(self._clip.size)

    def _layout(self, frame: int) -> tuple[View, tuple[int, int]]:
        """What of the clip to show, and how large."""
        width, height = self._clip.size
        rows = [(s, at) for s in self._table.parts if (at := s.row(frame)) is not None]
        x = np.array([s.x[at] for s, at in rows])
        y = np.array([s.y[at] for s, at in rows])
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)  # nan is not
        shown = 1.25 * _VIEW * self._unit  # a little less than the whole is not worth a cut
        if max(width, height) <= shown or not inside.any():
            return (0, 0, width, height), _fit((width, height))
        low, high = (x[inside].min(), y[inside].min()), (x[inside].max(), y[inside].max())
        half = np.nan_to_num([[s.w[at], s.h[at]] for s, at in rows])[inside] / 2
        across = (x[inside] + half[:, 0]).max() - (x[inside] - half[:, 0]).min()
        down = (y[inside] + half[:, 1]).max() - (y[inside] - half[:, 1]).min()
        wide = max(_VIEW * self._unit, 1.5 * (high[0] - low[0]), 2 * (high[1] - low[1]), 1.2 * across, 1.8 * down)
        w = min(width, math.ceil(wide))
        h = min(height, math.ceil(0.75 * wide))
        left = round(min(max((low[0] + high[0] - w) / 2, 0), width - w))
        top = round(min(max((low[1] + high[1] - h) / 2, 0), height - h))
        return (left, top, w, h), _fit((w, h))


def _fit(size: tuple[int, int]) -> tuple[int, int]:
    """The size of a picture: enlarged to `SMALLEST`, or reduced to `LARGEST`, keeping its shape."""
    grow = min(SMALLEST[0] / size[0], SMALLEST[1] / size[1])
    zoom = grow if grow > 1 else min(1.0, LARGEST[0] / size[0], LARGEST[1] / size[1])
    return max(round(size[0] * zoom), 1), max(round(size[1] * zoom), 1)


def _scaled(image: Image, view: View, size: tuple[int, int]) -> Image:
    left, top, width, height = view
    part = np.ascontiguousarray(image[top : top + height, left : left + width])
    if size == (width, height):
        return part
    how = cv2.INTER_AREA if size[0] < width else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(part, size, interpolation=how), np.uint8)


def _jpeg(image: Image) -> bytes:
    """At the best quality of which it takes no more than `MOST_BYTES`."""
    data = b""
    for quality in (88, 80, 70, 55, 40, 25):
        data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
        if len(data) <= MOST_BYTES:
            break
    return data
