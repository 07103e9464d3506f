"""Who is in a film, for the report: pictures, a timeline, who is on the screen with whom, and what is in doubt."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from facetrack_cli.report.events import Stretch
from facetrack_cli.report.frames import Image
from facetrack_cli.trajectory.people import People, PersonRecord, TrackRecord, read_people, read_still

_PX = 120  # sides of a picture on the page


class Member(NamedTuple):
    """A person, the picture if there is one, and the frames in which the person is seen."""

    person: PersonRecord
    picture: Image | None
    seen: Sequence[Stretch]


class Doubt(NamedTuple):
    """A track in doubt, with its picture and those of the person that it has and of the other."""

    track: TrackRecord
    pictures: tuple[Image | None, ...]


class CastSection(NamedTuple):
    """The people of a film, the longest seen first, its shots, and the doubts, the least sure first."""

    people: People
    members: tuple[Member, ...]
    cuts: tuple[Mapping[str, int], ...]
    together: tuple[tuple[str, str, float], ...]
    doubts: tuple[Doubt, ...]


def cast_section(run: Path) -> CastSection | None:
    """Of a run's folder; None where it is of no film."""
    people = read_people(run)
    if people is None:
        return None
    stills = {one.name: _picture(run, one.still) for one in people.people}
    members = (
        Member(one, stills[one.name], [Stretch(first, stop - 1) for first, stop in one.intervals])
        for one in people.people
    )
    together = sorted(people.seconds_together().items(), key=lambda one: -one[1])
    return CastSection(
        people,
        tuple(sorted(members, key=lambda one: -one.person.seconds)),
        tuple({"frame": one.first} for one in people.shots[1:]),
        tuple((a, b, seconds) for (a, b), seconds in together),
        tuple(
            Doubt(one, (_picture(run, one.still), stills[one.person], stills.get(one.other or "")))
            for one in people.doubts
        ),
    )


def _picture(run: Path, still: str) -> Image | None:
    found = read_still(run, still)
    return Image(found, (_PX, _PX)) if found else None
