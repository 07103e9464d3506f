"""facetrack people: who is in a film, and corrections of that."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import Command, Page, flag, option, page_options, say
from facetrack_cli.cli.types import FILE, RUN, Text, frame_at, words
from facetrack_cli.cli.types import moment as at_moment
from facetrack_cli.core.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from facetrack_cli.trajectory.clock import Clock
    from facetrack_cli.trajectory.people import People, Tracks

Words: TypeAlias = tuple[tuple[str, ...], ...]


_OTHER = words("A=B", "([^=]*)=(.*)", "give two names, as person_3=person_1")
_NAME = words("A=NAME", "([^=]*)=(.*)", "give two names, as person_3=person_1")
_GIFT = words("A@TIME=B", "(.*)@([^@=]*)=([^@]*)", "give a name, a time and a name, as person_2@1:23=person_1")


@click.command(cls=Command, basic="merge split rename give save edit clip no_video as_json as_csv quiet")
@click.argument("folder", type=RUN)
@option("--merge", type=_OTHER, multiple=True, help="A is B: both are one person, under the name of B.")
@option(
    "--split", type=at_moment("A@TIME"), multiple=True, help="From that time on (1:23, or 2075f) A is somebody else."
)
@option("--rename", type=_NAME, multiple=True, help="The name of A.")
@option(
    "--save", type=Text("FILE.npz", Path, FILE.complete),
    help="Save what these people look like, for run --faces all --gallery FILE.npz.",
)  # fmt: skip
@option(
    "--give", type=_GIFT, multiple=True,
    help="The track of A at that time is of B; B may be A, which settles a doubt.",
)  # fmt: skip
@flag("--page", "edit", help="Correct the cast on a page in the browser.")
@page_options
@options.clip
@flag("--no-video", help="Do not draw annotated.mp4 again.")
@flag("--json", "as_json", help="Print people.json.")
@flag("--csv", "as_csv", help="Print when each person is seen, a row an interval.")
@options.quiet
def command(
    folder: Path, merge: Words, split: Words, rename: Words, save: Path | None, give: Words, edit: bool, page: Page,
    clip: Path | None, no_video: bool, as_json: bool, as_csv: bool, quiet: bool,
) -> int:  # fmt: skip
    """Show who is in a film, and correct it.

    RUN_DIR is a folder that facetrack run --faces all wrote. For each person it says how long, in how many tracks, and
    how sure. A correction writes the rows, the pictures and the video of the run again.

    \b
    Examples:
      facetrack people out
      facetrack people out --rename person_1=Anna --rename person_2=Ben
      facetrack people out --merge person_3=person_1
      facetrack people out --page --open
      facetrack people out --split person_2@1:23
      facetrack people out --json | jq '.people[].name'
      facetrack people out --csv > intervals.csv
      facetrack people out --save people.npz

    \b
    Exit codes: 0 done, 2 usage or output, 3 input, 130 interrupted,
    143 terminated.
    """
    from facetrack_cli.runs.people import people_in, recast, rows_in, save_looks
    from facetrack_cli.runs.progress import progress
    from facetrack_cli.runs.signals import Stop, StoppedError
    from facetrack_cli.trajectory.clock import Clock

    if as_json and as_csv:
        raise UsageError("--json and --csv both go to standard output; give one of them")
    people = people_in(folder)
    clock = Clock(rows_in(folder) if split or give else None, people.fps)
    changes = _changes(clock, split, give, merge, rename)
    if edit:
        return _serve(folder, clip, page, video=not no_video)
    page.refuse("give --page")
    if changes or save is not None:
        with Stop().listening() as stop, progress(quiet) as shown:
            shown.begin(folder.name or str(folder))
            written = "nothing was written"
            try:
                if changes:
                    report = shown.looked
                    people = recast(folder, changes, clip=clip, video=not no_video, report=report, stop=stop)
                    written = "the changes are written"
                if save is not None:
                    names = save_looks(folder, save, clip, shown.looked, stop)
                    shown.say(f"{save}: {', '.join(names)}")
            except StoppedError:
                shown.say(f"{folder}: stopped, {written}")
                return stop.code or 0
    if as_json or as_csv:
        click.echo(people.text().decode() if as_json else _intervals(people), nl=False)
    else:
        _show(people, Clock(rows_in(folder), people.fps))
    return 0


def _serve(folder: Path, elsewhere: Path | None, page: Page, *, video: bool) -> int:
    """Serve the page until it is saved or stopped; the exit code."""
    from facetrack_cli.editor.web.cast_session import CastSession
    from facetrack_cli.runs.people import film_of, people_in, rows_in
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.video.seek import Frames

    clip, how = film_of(people_in(folder), rows_in(folder), elsewhere)
    if clip is None:
        raise UsageError(f"{folder}: does not name its clip; give it with --clip")
    with Frames(clip, **how) as frames, Stop().listening() as stop:
        session = CastSession(folder, frames, clip, video=video)
        if page.serve(session, stop):
            return 0
        say(f"facetrack: {stop.reason}; {'what was saved stays' if session.saved else 'nothing was written'}")
        return stop.code or ExitCode.FAULT


def _changes(
    clock: Clock, split: Words, give: Words, merge: Words, rename: Words
) -> list[tuple[str, Callable[[Tracks], Tracks]]]:
    from facetrack_cli.trajectory import people as edits

    found: list[tuple[str, Callable[[Tracks], Tracks]]] = []
    for name, moment in split:
        found.append((f"split {name}@{moment}", partial(edits.split, name=name, frame=frame_at(moment, clock))))
    for name, moment, to in give:
        frame = frame_at(moment, clock)
        found.append((f"give {name}@{moment}={to}", partial(edits.give, name=name, frame=frame, to=to)))
    found += [(f"merge {a}={b}", partial(edits.merge, name=a, into=b)) for a, b in merge]
    return found + [(f"rename {a}={b}", partial(edits.rename, name=a, to=b)) for a, b in rename]


def _intervals(people: People) -> str:
    """The frames in which people are seen, and their times in s, in the order of time."""
    from facetrack_cli.core.numbers import csv_text

    each = ((one.name, zip(one.intervals, people.times_of(one), strict=True)) for one in people.people)
    spans = sorted((*frames, name, *times) for name, both in each for frames, times in both)
    rows = ([name, first, stop - 1, f"{begin:.3f}", f"{end:.3f}"] for first, stop, name, begin, end in spans)
    return csv_text(["person", "first_frame", "last_frame", "begin_s", "end_s"], rows)


def _show(people: People, seconds: Clock) -> None:
    """The cast as a table, and what is in doubt."""
    from facetrack_cli.core.numbers import clock
    from facetrack_cli.evaluation.sheet import Sheet

    tracks = [one.person for one in people.tracks]
    rows = tuple(
        (
            one.name, f"{one.seconds:.1f}", str(len(one.intervals)), str(tracks.count(one.name)),
            clock(seconds.at(one.intervals[0][0])), f"{one.p:.2f}", "photograph" if one.photograph else "",
        )
        for one in people.people
    )  # fmt: skip
    notes = [
        f"{clock(seconds.at(one.first))} (frame {one.first}): {one.person} with P = {one.p:.2f}, "
        f"{one.other or 'somebody new'} with {one.p_other:.2f}"
        for one in people.doubts
    ]
    title = f"{len(people.people)} people in {len(people.shots)} shots" + ("; in doubt:" if notes else "")
    heads = ("person", "seconds", "times", "tracks", "first seen", "P", "")
    Sheet(title, heads, rows, tuple(notes), left=(0, 6)).show()
