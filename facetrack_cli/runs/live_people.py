"""Everybody in a film that is still shown: followed shot by shot, named when looks allow it, cast at the end (ours).

A frame comes out up to eight frames late: so many take a cut and a look of the detector.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain, groupby
from typing import Final

from facetrack_cli.core.face_points import DetectorName
from facetrack_cli.core.types import BOX, Frame
from facetrack_cli.engine.loop import TrackState
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.start.presence import LOOK_FRAMES, MultiFaceTracker
from facetrack_cli.trackers.face.detectors import detector
from facetrack_cli.trackers.people.descriptor import VIEWS, Describer, FaceDescriptor, together, views_of
from facetrack_cli.trackers.people.identity import UNKNOWN, TrackSummary, cast_of
from facetrack_cli.trajectory.people import new_name
from facetrack_cli.trajectory.trajectory import FrameResult
from facetrack_cli.video.shots import Shot, passing_shots

LEAST_VIEWS: Final = 3  # of a face before it is named
KEPT: Final = 500  # tracks, the last ones, that the cast at the end is made of


@dataclass
class _Followed:
    """A track that goes on; the looks of `track` are those that `reader` has."""

    reader: Describer
    track: TrackSummary
    looked: int  # the frame of the last view

    @property
    def seen(self) -> TrackSummary:
        return self.track._replace(looks=self.reader.looks())


class LiveCast:
    """Who the tracks of a film are of, of `known` people and others; `names` has the last ones that are named."""

    def __init__(self, by: DetectorName | None, fps: float, known: Mapping[str, FaceDescriptor]) -> None:
        self.names: dict[str, str] = {}
        self._detector, self._fps = detector(by), fps
        self._given, self._looks = dict(known), dict(known)  # of each person
        self._now: dict[str, _Followed] = {}
        self._past = deque[TrackSummary](maxlen=KEPT)

    def follow(self, frames: Iterator[Frame], recipe: Recipe) -> Iterator[FrameResult]:
        """A result for each frame, in which every face is a target; no track is carried over a cut."""
        at = TrackState()
        for number, passed in groupby(passing_shots(frames), key=lambda one: one[0]):
            first = next(passed)[1]
            shot = Shot(first.index, None, first.index, None)
            film = MultiFaceTracker(recipe, [shot], self._detector, first.size, self._fps, recipe.seed)
            for result in film.follow(chain([first], (frame for _, frame in passed)), at):
                self._see(result, number)
                yield result

    def cast(self) -> dict[str, str]:
        """Who the last tracks are of, by the looks of all of them together; people keep the names that they had."""
        for name in [*self._now]:
            self._end(name)
        tracks, called = [*self._past], dict(enumerate(self._given))
        found = cast_of(tracks, [*self._given.values()], self._fps).person.tolist()
        for person in sorted({*found} - {UNKNOWN} - {*called}):
            had = [self.names.get(one.name, "") for one, of in zip(tracks, found, strict=True) if of == person]
            called[person] = next((name for name in had if name and name not in called.values()), "") or new_name(
                [*self._looks, *called.values()]
            )
        return {one.name: called[of] for one, of in zip(tracks, found, strict=True) if of != UNKNOWN}

    def _see(self, result: FrameResult, shot: int) -> None:
        """Take in one frame more: where its tracks are, and now and then what they look like."""
        for name in self._now.keys() - {one.rows.target for one in result.targets}:
            self._end(name)
        at = result.frame.index
        for rows in (one.rows for one in result.targets):
            box = rows.find(rows.target, BOX)
            if box is None or not (views := views_of(box)):
                continue
            place = tuple(box.boxes[0].tolist())
            one = self._now.get(rows.target)
            if one is None:
                nothing = TrackSummary(rows.target, at, at + 1, place, place, shot, FaceDescriptor(*[box.x[:0]] * 6))
                one = self._now[rows.target] = _Followed(Describer(self._detector), nothing, at - LOOK_FRAMES)
            one.track = one.track._replace(stop=at + 1, ends=place)
            if at >= one.looked + LOOK_FRAMES and len(one.reader.scores) < VIEWS:
                one.looked = at
                one.reader.see(result.frame, views[0])
                if rows.target not in self.names and len(one.reader.scores) >= LEAST_VIEWS:
                    self._name(rows.target)

    def _name(self, track: str) -> None:
        """Name a track by its looks beside those of the tracks that are there; not yet, where that is in doubt."""
        there = [one for one in self._now.values() if one.reader.is_face]
        which = next((i for i, one in enumerate(there) if one.track.name == track), None)
        if which is None:
            return
        found = cast_of([one.seen for one in there], [*self._looks.values()], self._fps)
        person = int(found.person[which])
        if person == UNKNOWN or (
            any(one.track == which for one in found.doubts) and len(there[which].reader.scores) < VIEWS
        ):
            return
        name = next(iter([*self._looks][person : person + 1]), "") or new_name(self._looks)
        if all(self.names.get(other) != name for other in self._now):  # nobody is there twice
            self.names[track] = name
            self._looks.setdefault(name, there[which].reader.looks())

    def _end(self, track: str) -> None:
        ended = self._now.pop(track)
        if not ended.reader.is_face:
            return
        if len(self._past) == KEPT:
            self.names.pop(self._past[0].name, None)
        self._past.append(ended.seen)
        if (name := self.names.get(track)) is not None:
            both = together([self._looks[name], ended.reader.looks()])
            self._looks[name] = FaceDescriptor(*(one[-4 * VIEWS :] for one in both))
