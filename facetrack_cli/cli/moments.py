"""Somebody at a moment of a film, as command lines say it: person_2@1:23."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from facetrack_cli.core.errors import UsageError

if TYPE_CHECKING:
    from facetrack_cli.trajectory.clock import Clock


def at_moment(value: str) -> tuple[str, str]:
    """The name and the time of `NAME@TIME`."""
    name, at, when = value.rpartition("@")
    if not (at and name.strip() and when.strip()):
        raise click.BadParameter(f"{value!r}: give a name and a time, as person_2@1:23 or person_2@2075f")
    return name.strip(), when.strip()


def frame_at(moment: str, clock: Clock) -> int:
    """The frame of a moment: 2075f, 83, 1:23 or 0:01:23.5. UsageError for anything else."""
    try:
        if moment[-1:].lower() == "f":
            return int(moment[:-1])
        seconds = 0.0
        for part in moment.split(":"):
            seconds = 60 * seconds + float(part)
        return clock.frame(seconds)
    except (ValueError, OverflowError):
        raise UsageError(f"@{moment}: is no time; give 1:23, 83 (seconds) or 2075f (a frame)") from None
