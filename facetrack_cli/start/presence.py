"""Everybody in a film: in each shot every face is a track of its own, from where it comes in to where it leaves (ours).

A detector of faces looks at every few frames. A face that it sees in two frames near each other, and that no track has,
begins a track; the track is followed back over the frames since the last look. Whether a track is still of a face is a
probability: looks that find it or not, and what the tracker says of itself, are its evidence (a Bernoulli filter of
existence, as in Mahler 2007). A track ends where that is small, where the face leaves the picture, and at every cut: no
motion is carried over it. Two tracks of one face are one too many, and the later one ends. Who it is is decided later,
of the whole film (`trackers/people/descriptor.py`).
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.random import Generator

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import inside, overlap, share_inside
from facetrack_cli.core.npz import STORED
from facetrack_cli.core.types import BOX, Box, Frame, Start, TargetStart, own_frame
from facetrack_cli.engine.corrected import CorrectedTarget
from facetrack_cli.engine.loop import Target, TrackState
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.start.assembly import tracker_for
from facetrack_cli.trackers.face import detectors
from facetrack_cli.trackers.face.detectors import Detection, Detector, everywhere, named, near, righted
from facetrack_cli.trackers.face.target import FaceTarget
from facetrack_cli.trajectory.trajectory import UNSEEN, FrameResult, TargetResult
from facetrack_cli.video.shots import Shot

LOOK_FRAMES: Final = 5  # frames from one look of the detector to the next
TWICE_FRAMES: Final = 2  # frames before a look, in which a new face is seen too
MIN_FACE_PX: Final = 20  # pixels of a face's box; smaller faces have no features to track
CLOSER: Final = 5  # looks from one closer look for anybody to the next, where nobody is
MAX_FACES: Final = 12  # tracks at a time; of more faces the largest are followed
SAME_FACE: Final = 0.3  # overlap of a detection with the track of that face
INSIDE: Final = 0.9  # share of what lies between eyes and mouth that is in the picture at least
ONE_FACE: Final = 0.5  # overlap of two tracks of one face
STREAM: Final = "track_"
_Results: TypeAlias = "dict[int, dict[str, TargetResult]]"  # by frame and track
# the log odds that a track is of a face: at its start, at most, by a look that finds it, by a look that does not while
# the tracker sees it and while it does not; a track below the last ends
_BEGINS, _MOST, _FOUND, _UNFOUND, _LOST, _ENDS = 2.0, 4.0, 3.0, -1.0, -2.0, -3.0


@dataclass
class Track:
    """One face in one shot: where it began, the state of its tracker and its log odds of being there."""

    name: str
    start: Start
    rng: Generator
    state: Any
    odds: float = _BEGINS
    closer: Detection | None = None  # as it was found, where that took a closer look
    target: FaceTarget | None = field(default=None, metadata={STORED: False})  # what tracks it, built once
    box: Box | None = None  # where it is; None while it is lost

    def see(self, rows: TargetResult) -> None:
        all_parts = rows.rows
        at = int(np.searchsorted(all_parts.which, [part for _, part in all_parts.names].index(BOX)))
        self.box = None if all_parts.status[at] in UNSEEN else tuple(all_parts.boxes[at].tolist())


@dataclass
class FilmState:
    """The state after a frame: the tracks that go on, and the `count` of all that began."""

    tracks: list[Track] = field(default_factory=list)
    count: int = 0
    crowd: int | None = None  # the first frame with more than MAX_FACES


@dataclass(frozen=True)
class MultiFaceTracker:
    """What is followed: faces by a recipe that has a head, in the `shots` of a film of this size."""

    recipe: Recipe
    shots: Sequence[Shot]
    detector: Detector
    size: tuple[int, int]
    seed: int

    def follow(self, frames: Iterable[Frame], at: TrackState) -> Iterator[FrameResult]:
        """A result for each frame, of all faces that are in it. `at` holds an `FilmState` where it can be resumed."""
        film: FilmState = at.states[0] if at.states else FilmState()
        shots, waiting = iter(self.shots), list[Frame]()
        shot = next(shots)
        for frame in frames:
            while shot.stop is not None and frame.index >= shot.stop:
                yield from self._block(film, waiting, shot, at)
                shot = next(shots)
            if frame.index == shot.first:  # no track is carried over a cut
                film.tracks = []
            waiting.append(frame)
            if len(waiting) >= LOOK_FRAMES and frame.index >= shot.clear + LOOK_FRAMES - 1:
                yield from self._block(film, waiting, shot, at)
        yield from self._block(film, waiting, shot, at)

    def _block(self, film: FilmState, frames: list[Frame], shot: Shot, at: TrackState) -> Iterator[FrameResult]:
        """The results of successive frames of one shot, of which the detector looks at the last."""
        if frames:
            at.states = []  # what is between two blocks can be resumed
            by_frame: _Results = {frame.index: {} for frame in frames}
            tracks, left = film.tracks, list[Track]()
            for track, results in [(track, self._advance(track, frames)) for track in tracks]:
                for frame, result in zip(frames, results, strict=False):
                    by_frame[frame.index][track.name] = result
                if len(results) < len(frames):  # it leaves the picture
                    left.append(track)
            film.tracks = [track for track in tracks if track not in left]
            self._look(film, frames, by_frame, left, shot)
            *earlier, last = [FrameResult(frame, tuple(by_frame[frame.index].values())) for frame in frames]
            frames.clear()
            yield from earlier
            at.states = [film]
            yield last

    def _advance(self, track: Track, frames: Iterable[Frame], *, back: bool = False) -> list[TargetResult]:
        """The results of one track in further frames, while it is in the picture; going `back`, while it is seen."""
        track.target = target = track.target or self._target(track.start)
        results = list[TargetResult]()
        for frame in frames:
            track.state, result = target.advance(track.rng, track.state, own_frame(frame))
            before = track.box
            track.see(result)
            at = track.box or before
            if (back and track.box is None) or (at is not None and not in_view(at, self.size)):
                break
            results.append(result)
        return results

    def _target(self, start: Start) -> FaceTarget:
        [target] = tracker_for(self.recipe, start, self.size)
        face_target = among_others(target)
        assert isinstance(face_target, FaceTarget)
        return face_target

    def _look(self, film: FilmState, frames: list[Frame], results: _Results, left: list[Track], shot: Shot) -> None:
        """Look at the last frame: which tracks go on, and which faces are new."""
        frame = frames[-1]
        free, age = self.detector.find(frame), (frame.index - shot.clear) // LOOK_FRAMES
        nobody = not free and not film.tracks
        if age == 0 or (nobody and age % CLOSER == 0):
            free += [face for face in everywhere(self.detector, frame) if not _taken(face, free)]
        for track in sorted(film.tracks, key=lambda track: -track.odds):
            mine = max(free, key=lambda face: 0 if track.box is None else overlap(track.box, face.box), default=None)
            if mine is not None and track.box is not None and overlap(track.box, mine.box) >= SAME_FACE:
                free.remove(mine)
                track.odds = min(track.odds + _FOUND, _MOST)
            elif track.box and (it := track.closer) and near(self.detector, frame, track.box, it.turn):
                track.odds = min(track.odds + _FOUND, _MOST)
            else:
                track.odds += _LOST if track.box is None else _UNFOUND
        kept: list[Track] = []
        for track in film.tracks:  # in the order of their age
            twice = any(track.box and other.box and overlap(track.box, other.box) >= ONE_FACE for other in kept)
            if track.odds > _ENDS and not twice:
                kept.append(track)
        film.tracks = kept
        # a face that comes in when a shot ends is left out, and so is a face that another shot shows
        able = shot.is_clear(frame.index) and (len(frames) > TWICE_FRAMES or frames[0].index == shot.first)
        new = [face for face in free if able and self._is_new(face, [*kept, *left], frames, nobody=nobody)]
        room = MAX_FACES - len(kept)
        if len(new) > room and film.crowd is None:
            film.crowd = frame.index
        new_tracks = [new_track for face in new[:room] if (new_track := self._new_track(film, face, frame)) is not None]
        for track, first in new_tracks:
            rng = np.random.default_rng(track.rng.bit_generator.random_raw())
            ordered = [*reversed(self._advance(replace(track, rng=rng), frames[-2::-1], back=True)), first]
            for at, result in zip(frames[len(frames) - len(ordered) :], ordered, strict=True):
                rows, how = result.rows, "init" if result is ordered[0] else "tracked"
                status = np.where(rows.unseen, rows.status, how)
                results[at.index][track.name] = result._replace(rows=replace(rows, status=status))
            track.see(first)
            film.tracks.append(track)

    def _is_new(self, face: Detection, kept: Sequence[Track], frames: Sequence[Frame], *, nobody: bool) -> bool:
        """Whether a face in the picture is of no track, and seen in an earlier frame, too, if there is one.

        Where `nobody` else is seen it may be small.
        """
        taken = any(track.box is not None and overlap(track.box, face.box) >= SAME_FACE for track in kept)
        least = max(MIN_FACE_PX, 0 if nobody else detectors.MIN_FACE_SHARE * min(self.size))
        if taken or not in_view(face.box, self.size) or face.box[2] < least:
            return False
        if len(frames) <= TWICE_FRAMES:
            return True
        before = frames[-1 - TWICE_FRAMES]
        if face.closer:
            return near(self.detector, before, face.box, face.turn) is not None
        return _taken(face, self.detector.find(before))

    def _new_track(self, film: FilmState, face: Detection, frame: Frame) -> tuple[Track, TargetResult] | None:
        """A track that begins with a face; None where its points are not in the picture."""
        face = righted(self.detector, frame, face)
        points = named(face.placed(frame))
        if not all(inside(points[part], self.size) for part in self.recipe.points):
            return None
        name = f"{STREAM}{film.count + 1}"
        start = Start(frame.index, {name: TargetStart(face.box, points)}, self.detector.name)
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(1, film.count)))
        target = self._target(start)
        try:
            state, result = target.begin(rng, own_frame(frame))
        except InputError:  # too small, or beyond the border
            return None
        film.count += 1
        return Track(name, start, rng, state, closer=face if face.closer else None, target=target), result


def among_others(target: Target) -> Target:
    """A face, corrected or not, that is one of several: while it is lost, not any face is taken for it."""
    if isinstance(target, CorrectedTarget):
        head, build = among_others(target.target), target.build
        return replace(target, target=head, build=lambda frame, given: among_others(build(frame, given)))
    return replace(target, alone=False) if isinstance(target, FaceTarget) else target


def in_view(face: Box, size: tuple[int, int]) -> bool:
    """Whether eyes, nose and mouth of the face in a box are in a picture of that size, whatever the border cuts off."""
    (x, y, w, h), ((left, top), (right, _)) = face, detectors.EYES_IN_BOX
    down = detectors.MOUTH_Y * (right - left)
    return share_inside((x + left * w, y + top * h, (right - left) * w, down * h), size) >= INSIDE


def _taken(face: Detection, others: Sequence[Detection]) -> bool:
    return any(overlap(other.box, face.box) >= SAME_FACE for other in others)
