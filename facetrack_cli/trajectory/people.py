"""people.json: who is in a film, when, and how sure that is; and rows under the names that it gives."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeAlias

import numpy as np
from pydantic import AfterValidator, BaseModel, Field, ValidationError, model_validator

from facetrack_cli.core.errors import InputError, UsageError, reading
from facetrack_cli.core.files import read_bounded
from facetrack_cli.core.numbers import union
from facetrack_cli.core.types import checked_name
from facetrack_cli.trajectory.reader import MAX_FRAME, PEOPLE, STILLS, not_as_written
from facetrack_cli.trajectory.trajectory import Trajectory, successive
from facetrack_cli.trajectory.views import Clock, choose

PERSON: Final = "person_"
NOBODY: Final = "unknown"  # begins the names of those whose face could not be told again: also unknown_2, unknown_3
_MAX_STILL_BYTES: Final = 1 << 20
_P: TypeAlias = Annotated[float, Field(ge=0, le=1)]
_Name: TypeAlias = Annotated[str, AfterValidator(checked_name)]
_Frame: TypeAlias = Annotated[int, Field(ge=0, le=MAX_FRAME)]
_Seconds: TypeAlias = Annotated[float, Field(allow_inf_nan=False)]
_Still: TypeAlias = Annotated[str, Field(pattern=rf"^({STILLS}/[^/\\\x00.][^/\\\x00]*)?$")]  # a file of that folder


class ShotRecord(BaseModel, extra="forbid", defer_build=True):
    """Frames [first, stop) of one shot; stop None: the end of the clip."""

    first: _Frame
    stop: _Frame | None


class TrackRecord(BaseModel, extra="forbid", defer_build=True):
    """One track: whose it is, in which frames [first, stop), and with which probability.

    `other` (None: somebody new) has `p_other`, where that is in doubt; `still` is then its picture. `given`: by hand.
    Rows that are not under the name of the person yet are those of the target `of`; no file says it.
    """

    person: _Name
    first: _Frame
    stop: _Frame
    p: _P
    doubt: bool = False
    other: _Name | None = None
    p_other: _P = 0.0
    still: _Still = ""
    given: bool = False
    of: Annotated[str, Field(exclude=True)] = ""

    @property
    def target(self) -> str:
        """Whose rows it has."""
        return self.of or self.person


Tracks: TypeAlias = Sequence[TrackRecord]
Change: TypeAlias = tuple[str, Callable[[Tracks], Tracks]]  # in words, and what it makes of tracks


class PersonRecord(BaseModel, extra="forbid", defer_build=True):
    """A person: `seconds` on the screen, the intervals [first, stop) of frames, the mean probability of its tracks.

    `times` are the intervals in s. `still` is the picture; `photograph`: it never moves.
    """

    name: _Name
    seconds: Annotated[float, Field(ge=0, allow_inf_nan=False)]
    p: _P
    intervals: Annotated[tuple[tuple[_Frame, _Frame], ...], Field(min_length=1)]
    times: tuple[tuple[_Seconds, _Seconds], ...]
    still: _Still = ""
    photograph: bool = False


class People(BaseModel, extra="forbid", defer_build=True):
    """Who is in a film of `fps` frames per second, in order of first appearance, by which `tracks`."""

    format: Literal["facetrack-people"] = "facetrack-people"
    version: Literal[1] = 1
    fps: Annotated[float, Field(gt=0, le=1e6)]
    shots: Annotated[tuple[ShotRecord, ...], Field(min_length=1)]
    people: Annotated[tuple[PersonRecord, ...], Field(min_length=1)]
    tracks: tuple[TrackRecord, ...]
    corrections: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _whole(self) -> "People":
        spans = [span for person in self.people for span in person.intervals]
        spans += [(track.first, track.stop) for track in self.tracks]
        timed = all(len(person.times) == len(person.intervals) for person in self.people)
        same = sorted(self.names) == sorted({track.person for track in self.tracks})
        if not (all(first < stop for first, stop in spans) and timed and same):
            raise ValueError("its people, tracks, intervals and times do not fit together")
        return self

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(person.name for person in self.people)

    @property
    def doubts(self) -> tuple[TrackRecord, ...]:
        """Tracks whose person is in doubt, the least sure first."""
        tracks = (track for track in self.tracks if track.doubt and not track.given)
        return tuple(sorted(tracks, key=lambda track: track.p))

    def text(self) -> bytes:
        return self.model_dump_json(indent=1).encode() + b"\n"

    def seconds_together(self) -> Mapping[tuple[str, str], float]:
        """How long two people are on the screen at the same time, where they ever are."""
        together = {
            (a.name, b.name): sum(max(min(x[1], y[1]) - max(x[0], y[0]), 0) for x in a.times for y in b.times)
            for a, b in combinations(self.people, 2)
        }
        return {both: round(seconds, 3) for both, seconds in together.items() if seconds}


def read_people(path: Path) -> People | None:
    """The people.json of a run's folder; None without. InputError for a file that is not as we write it."""
    file = path if path.name == PEOPLE else path / PEOPLE
    try:
        with reading(file), suppress(FileNotFoundError):
            return People.model_validate_json(read_bounded(file))
    except ValidationError as e:
        raise not_as_written(file, e) from None
    return None


def read_still(run: Path, still: str) -> bytes:
    """The picture of a person in a run's folder; b"" where it is none of that folder's own files."""
    with suppress(OSError, InputError):
        if still and not (run / still).is_symlink() and not (run / STILLS).is_symlink():
            return read_bounded(run / still, _MAX_STILL_BYTES)
    return b""


def people_of(
    clock: Clock,
    shots: Sequence[ShotRecord],
    tracks: Tracks,
    stills: Mapping[str, str],
    photographs: Iterable[str] = (),
    corrections: Sequence[str] = (),
) -> People:
    """The people of these tracks, in the order of their first frames."""
    ordered = tuple(sorted(tracks, key=lambda track: (track.first, track.stop)))
    people: list[PersonRecord] = []
    for name in dict.fromkeys(track.person for track in ordered):
        theirs = [track for track in ordered if track.person == name]
        spans = tuple(union((track.first, track.stop) for track in theirs))
        times = tuple((round(clock.at(first), 4), round(clock.at(stop), 4)) for first, stop in spans)
        seconds = round(sum(stop - first for first, stop in times), 3)
        p = round(float(np.average([row.p for row in theirs], weights=[row.stop - row.first for row in theirs])), 4)
        picture: dict[str, Any] = {"still": stills.get(name, ""), "photograph": name in photographs}
        people.append(PersonRecord(name=name, seconds=seconds, p=p, intervals=spans, times=times, **picture))
    shown, words = tuple(people), tuple(corrections)
    return People(fps=clock.fps, shots=tuple(shots), people=shown, tracks=ordered, corrections=words)


def merge(tracks: Tracks, name: str, into: str) -> Tracks:
    """With the tracks of the person `name` given to another. UsageError where both are seen in one frame."""
    both = _shared(_of(tracks, name), _of(tracks, into))
    if name == into or both:
        why = f"{name} and {into} are both seen in frame {both[0]}" if name != into else "that is one person already"
        raise UsageError(f"--merge {name}={into}: {why}; give two people that are never seen together")
    return [_given(track, into) if track.person == name else track for track in tracks]


def rename(tracks: Tracks, name: str, to: str) -> Tracks:
    """With another name of a person. UsageError for a name that somebody has, that is none, or that no option takes."""
    own = _of(tracks, name)
    try:
        checked_name(to)
        if {"=", "@"} & {*to}:
            raise ValueError(f"{to!r} has = or @, by which options end a name; leave them out")
    except ValueError as e:
        raise UsageError(f"--rename {name}={to}: {e}") from None
    if any(track.person == to for track in tracks):
        raise UsageError(f"--rename {name}={to}: {to} is there; --merge {name}={to} makes them one person")
    return [track.model_copy(update={"person": to, "of": track.target}) if track in own else track for track in tracks]


def split(tracks: Tracks, name: str, frame: int) -> Tracks:
    """With the tracks of a person from a frame on given to somebody new. UsageError where that is all or nothing."""
    theirs = _of(tracks, name)
    if frame <= min(track.first for track in theirs) or frame >= max(track.stop for track in theirs):
        spans = ", ".join(f"{track.first} to {track.stop - 1}" for track in theirs[:4])
        remedy = f"{name} is seen in frames {spans}; give a frame between the first and the last"
        raise UsageError(f"--split {name}@{frame}f: {remedy}")
    new, changed = new_name({track.person for track in tracks}), list[TrackRecord]()
    for track in tracks:
        later = track.person == name and track.stop > frame
        if track.first < frame or not later:
            changed.append(track.model_copy(update={"stop": frame}) if later else track)
        if later:
            changed.append(_given(track, new).model_copy(update={"first": max(track.first, frame)}))
    return changed


def give(tracks: Tracks, name: str, frame: int, to: str | None) -> Tracks:
    """With the track of a person that is in a frame given to another one; `to` None: somebody new.

    `to` the person itself settles a doubt. UsageError without such a track, and where the other one is seen as well.
    """
    own = next((track for track in _of(tracks, name) if track.first <= frame < track.stop), None)
    if own is None:
        raise UsageError(f"--give {name}@{frame}f: {name} is not seen in frame {frame}; name one in which {name} is")
    others = [] if to in (None, name) else _of([track for track in tracks if track is not own], str(to))
    if at := _shared([own], others):
        raise UsageError(f"--give {name}@{frame}f={to}: {to} is seen in frame {at[0]}, too; give somebody else")
    person = to or new_name({track.person for track in tracks})
    return [_given(track, person) if track is own else track for track in tracks]


def photographs(before: People, tracks: Tracks) -> list[str]:
    """Those whose first track is of a photograph."""
    still = {person.name for person in before.people if person.photograph}
    first = {track.person: track.target for track in reversed(tracks)}
    return [name for name, of in first.items() if of in still]


def new_name(taken: Collection[str]) -> str:
    """A name that nobody has."""
    return next(f"{PERSON}{k}" for k in range(1, len(taken) + 2) if f"{PERSON}{k}" not in taken)


def _shared(tracks: Tracks, others: Tracks) -> list[int]:
    """The frames in which a track and another one begin to be seen together."""
    return [max(a.first, b.first) for a in tracks for b in others if a.first < b.stop and b.first < a.stop]


def _given(track: TrackRecord, person: str) -> TrackRecord:
    """The track, which somebody has said to be of a person."""
    return TrackRecord(person=person, first=track.first, stop=track.stop, p=1.0, given=True, of=track.target)


def _of(tracks: Tracks, name: str) -> Tracks:
    """The tracks of a person. UsageError for a name that nobody has."""
    own = [track for track in tracks if track.person == name]
    if not own:
        names = ", ".join(dict.fromkeys(track.person for track in tracks))
        raise UsageError(f"there is no {name}; there are {names}")
    return own


def under_names(rows: Trajectory, tracks: Tracks) -> Trajectory:
    """The rows of each track, which are those of its target and frames, under the name of its person.

    People come in the order of their first rows. Nothing was given to the tracker but a person's first row.
    """
    order = [*dict.fromkeys(track.person for track in tracks)]
    pieces: list[Trajectory] = []
    for track in sorted(tracks, key=lambda track: (order.index(track.person), track.first)):
        part = choose(rows, track.target).between(track.first, track.stop)
        names = tuple((track.person, name) for _, name in part.names)
        if pieces and pieces[-1].target == track.person:
            first = (part.status == "init") & ~part.by_hand
            part = replace(part, status=np.where(first, "tracked", part.status))
        diagnostics = dict(zip([track.person], part.diagnostics.values(), strict=False))
        pieces.append(replace(part, names=names, diagnostics=diagnostics))
    return replace(successive(pieces), header=rows.header, path=rows.path)
