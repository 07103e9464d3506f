"""Images of key frames, decoded in one pass: the clip's frames with the overlay drawn on them, else annotated.mp4's."""

import base64
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

import cv2
import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Frame
from facetrack_cli.core.types import Image as Pixels
from facetrack_cli.run_folder.manifest import check_belongs, other_clip
from facetrack_cli.runs.plan import Report
from facetrack_cli.trajectory.clock import Clock
from facetrack_cli.trajectory.header import Header
from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory, joined, recorded
from facetrack_cli.video.files import given_rate
from facetrack_cli.video.overlay.overlay import Overlay
from facetrack_cli.video.source import open_source

MIN_SIZE: Final = (640, 480)  # images are enlarged to fit this, so that the overlay can be read ...
MAX_SIZE: Final = (960, 720)  # ... and reduced to fit this
MAX_BYTES: Final = 220_000  # of one JPEG: twelve stay below 4 MB as text
_VIEW = 3.5  # an image shows this many times the target's size; larger clips are cut out around it
_TRAIL_S = 1.0
_TRAIL = 25  # frames of it that are drawn
_APART_S = 0.002  # a clip whose frames have other times than the run's is another clip
View: TypeAlias = tuple[int, int, int, int]  # left, top, width, height in the clip's pixels


class Image(NamedTuple):
    """Bytes of an image, its (width, height) in CSS pixels, its MIME type, and what of the clip it shows."""

    data: bytes
    size: tuple[int, int]
    mime: str = "image/jpeg"
    view: View = (0, 0, 0, 0)

    @property
    def uri(self) -> str:
        return f"data:{self.mime};base64,{base64.b64encode(self.data).decode('ascii')}"


@dataclass
class KeyImages:
    """The images that could be made, by frame, their origin, clip or annotated, and notes on what is missing."""

    found: dict[int, Image] = field(default_factory=dict)
    origin: str = ""
    notes: list[str] = field(default_factory=list)


def key_images(
    table: Trajectory, header: Header, wanted: Sequence[int], given: Path | None, annotated: Path | None, report: Report
) -> KeyImages:
    """Images of the `wanted` frames, from the clip `given` or the header's, else from the MP4 `annotated`. Raises
    InputError if the clip `given` is not the run's; what is wrong with the header's becomes a note.
    """
    maker = _Maker(table, header)
    best = maker.read(given or Path(header.source.path), wanted, report)
    if len(best.found) == len(wanted):
        return best
    if given is not None:
        raise InputError(best.notes[-1])
    if annotated is None:
        return best
    other = maker.read(annotated, wanted, report, annotated=True)
    first, second = (best, other) if len(best.found) > len(other.found) else (other, best)
    return KeyImages(first.found, first.origin, second.notes + first.notes)


class _Maker:
    """Makes images of frames: cut out, scaled, drawn on, encoded."""

    def __init__(self, table: Trajectory, header: Header) -> None:
        self._table, self._clip, self._title = table, header.source, header.recipe_name
        marked = [replace(part, by_hand=part.corrected) for part in table.parts]
        self._marked = joined(marked, diagnostics=table.diagnostics)
        self._clock = Clock(table, header.source.fps)
        boxes = [target.box for target in header.init.targets.values() if target.box]
        self._unit = max((max(width, height) for _, _, width, height in boxes), default=0) or self._typical()

    def read(self, path: Path, wanted: Sequence[int], report: Report, *, annotated: bool = False) -> KeyImages:
        """The images of one source. An `annotated` video counts from the run's first frame, and pads odd sizes."""
        done = KeyImages(origin="annotated" if annotated else "clip")
        if not annotated and (other := other_clip(self._table, path)) is not None:
            done.notes.append(f"{other}; name its clip with --clip")
            return done
        frames, (width, height) = self._clock.frames, self._clip.size
        place = {int(np.searchsorted(frames, index)) if annotated else index: index for index in wanted}
        size = (width + width % 2, height + height % 2) if annotated else (width, height)
        try:
            if annotated:
                check_belongs(path)
            stream = None if annotated else self._clip.stream
            for frame in _frames(path, size, self._clip.fps, sorted(place), report, stream):
                index = place[frame.index]
                then = self._clock.at(index)
                late = abs(frame.time_s - then) > _APART_S + 0.05 / self._clip.fps
                if late and not annotated and not done.notes:
                    times = f"is at {frame.time_s:.3f} s, in the run it was at {then:.3f} s"
                    done.notes.append(f"{path}: frame {index} {times}; is it the same clip?")
                view, out = self._layout(index)
                whole = _scaled(frame.bgr, view, out)
                drawn = whole if annotated else self.draw(Frame(index, then, whole, aspect=frame.aspect), view)
                done.found[index] = Image(_jpeg(drawn), out, view=view)
            missing = [index for index in wanted if index not in done.found]
            if missing:
                done.notes.append(f"{path}: has no frame {missing[0]}, which the run has; name its clip with --clip")
        except InputError as e:
            said = str(e)
            done.notes.append(said if annotated or "--clip" in said else f"{said}, or name the clip with --clip")
        return done

    def draw(self, frame: Frame, view: View) -> Pixels:
        """A scaled frame with the overlay of `facetrack run`."""
        overlay = Overlay(frame.size, title=self._title, trail_s=_TRAIL_S)
        last = int(np.searchsorted(self._clock.frames, frame.index))
        past = self._clock.frames[max(0, last - math.ceil(self._clip.fps * _TRAIL_S)) : last].tolist()
        past = [index for index in past if self._clock.at(index) >= frame.time_s - _TRAIL_S]
        for index in [*past[:: max(1, math.ceil(len(past) / _TRAIL))], frame.index]:  # the trail is of drawn frames
            now = Frame(index, self._clock.at(index), frame.bgr, aspect=frame.aspect)
            drawn = overlay.draw(self._result(now, view, frame.size[0] / view[2]))
        return drawn

    def _result(self, frame: Frame, view: View, zoom: float) -> FrameResult:
        """The rows of one frame, in the pixels of a view enlarged by `zoom`."""
        rows = self._marked.at(frame.index)
        columns = {name: getattr(rows, name) * zoom for name in ("std_x", "std_y")}
        columns |= {name: np.nan_to_num(getattr(rows, name)) * zoom for name in "wh"}
        columns |= {name: (getattr(rows, name) - at + 0.5) * zoom - 0.5 for name, at in zip("xy", view, strict=False)}
        shown = replace(rows, **columns, status=np.where(rows.status == "", "tracked", rows.status))
        # without diagnostics: their numbers stand in the plots
        targets = (one._replace(rows=replace(one.rows, diagnostics={})) for one in recorded(frame.index, shown))
        return FrameResult(frame, tuple(targets))

    def _typical(self) -> float:
        """The size of targets without a box: the median span of their windows."""
        parts = [one for one in self._table.parts if len(one) == len(self._table.parts[0])]
        spans = []
        for at, side in (("x", "w"), ("y", "h")):
            middle = np.stack([getattr(one, at) for one in parts])
            half = np.nan_to_num(np.stack([getattr(one, side) for one in parts])) / 2
            span = (middle + half).max(axis=0) - (middle - half).min(axis=0)
            spans += [float(np.median(span[np.isfinite(span)]))] if np.isfinite(span).any() else []
        return max(spans, default=0.0) or max(self._clip.size)

    def _layout(self, frame: int) -> tuple[View, tuple[int, int]]:
        """The part of the clip to show, and the size of its image."""
        width, height = self._clip.size
        rows = self._table.at(frame)
        rows = rows.take((rows.x >= 0) & (rows.x < width) & (rows.y >= 0) & (rows.y < height))  # nan is not
        shown = 1.25 * _VIEW * self._unit  # a little less than the whole is not worth a cut
        if max(width, height) <= shown or not len(rows):
            return (0, 0, width, height), _fit((width, height))
        x, y, half_w, half_h = rows.x, rows.y, np.nan_to_num(rows.w) / 2, np.nan_to_num(rows.h) / 2
        across, down = (x + half_w).max() - (x - half_w).min(), (y + half_h).max() - (y - half_h).min()
        wide = max(_VIEW * self._unit, 1.5 * np.ptp(x), 2 * np.ptp(y), 1.2 * across, 1.8 * down)
        w, h = min(width, math.ceil(wide)), min(height, math.ceil(0.75 * wide))
        left = round(min(max((x.min() + x.max() - w) / 2, 0), width - w))
        top = round(min(max((y.min() + y.max() - h) / 2, 0), height - h))
        return (left, top, w, h), _fit((w, h))


def _frames(
    path: Path, size: tuple[int, int], fps: float, wanted: Sequence[int], report: Report, stream: int | None
) -> Iterator[Frame]:
    """The wanted frames, in their order, in one pass. InputError if the clip is of another size."""
    rate = given_rate(path, fps)
    runs = [(n, n + 1) for n in wanted] if rate else [(wanted[0], wanted[-1] + 1)]
    total, done = sum(end - begin for begin, end in runs), 0
    for begin, end in runs:
        with open_source(path, fps=rate, start=begin, stop=end, stream=stream) as source:
            if source.size != size:
                is_, was = (f"{width}x{height}" for width, height in (source.size, size))
                raise InputError(f"{path}: is {is_}, not {was} pixels as in the run; name its clip with --clip")
            for frame in source:
                done += 1
                report(done, total)
                if frame.index in wanted:
                    yield frame


def _fit(size: tuple[int, int]) -> tuple[int, int]:
    """The size of an image: enlarged to `MIN_SIZE`, or reduced to `MAX_SIZE`, keeping its shape."""
    grow = min(MIN_SIZE[0] / size[0], MIN_SIZE[1] / size[1])
    zoom = grow if grow > 1 else min(1.0, MAX_SIZE[0] / size[0], MAX_SIZE[1] / size[1])
    return max(round(size[0] * zoom), 1), max(round(size[1] * zoom), 1)


def _scaled(image: Pixels, view: View, size: tuple[int, int]) -> Pixels:
    left, top, width, height = view
    part = np.ascontiguousarray(image[top : top + height, left : left + width])
    if size == (width, height):
        return part
    how = cv2.INTER_AREA if size[0] < width else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(part, size, interpolation=how), np.uint8)


def _jpeg(image: Pixels) -> bytes:
    """At the best quality with at most `MAX_BYTES`."""
    for quality in (88, 80, 70, 55, 40, 25):
        data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
        if len(data) <= MAX_BYTES:
            break
    return data
