"""facetrack people: who is in a film, and corrections of that."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.moments import at_moment, frame_at
from facetrack_cli.cli.options import FILE, Page, argument, flag, group, option, say, verb
from facetrack_cli.core.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from facetrack_cli.trajectory.clock import Clock
    from facetrack_cli.trajectory.people import People, Tracks


def _pair(value: str) -> tuple[str, str]:
    name, equals, other = value.partition("=")
    if not (equals and name.strip() and other.strip()):
        raise click.BadParameter(f"{value!r}: give two names, as person_3=person_1")
    return name.strip(), other.strip()


def _gift(value: str) -> tuple[str, str]:
    name, at, rest = value.rpartition("@")
    moment, equals, to = rest.partition("=")
    if not (at and equals and name.strip() and moment.strip() and to.strip()):
        raise click.BadParameter(f"{value!r}: give a name, a time and a name, as person_2@1:23=person_1")
    return name.strip(), f"{moment.strip()}={to.strip()}"


class Cast:
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

    folder: Path = argument("RUN_DIR")
    merge: tuple[tuple[str, str], ...] = option(
        "--merge A=B", "A is B: both are one person, under the name of B.", type=_pair, multiple=True
    )
    split: tuple[tuple[str, str], ...] = option(
        "--split A@TIME", "From that time on (1:23, or 2075f) A is somebody else.", type=at_moment, multiple=True
    )
    rename: tuple[tuple[str, str], ...] = option("--rename A=NAME", "The name of A.", type=_pair, multiple=True)
    save: Path | None = option(
        "--save FILE.npz", "Save what these people look like, for run --faces all --gallery FILE.npz.", type=FILE
    )
    give: tuple[tuple[str, str], ...] = option(
        "--give A@TIME=B",
        "The track of A at that time is of B; B may be A, which settles a doubt.",
        type=_gift,
        multiple=True,
    )
    edit: bool = flag("--page", "Correct the cast on a page in the browser.")
    page: Page = group(Page)
    clip: Path | None = options.CLIP
    no_video: bool = flag("--no-video", "Do not draw annotated.mp4 again.")
    as_json: bool = flag("--json", "Print people.json.")
    as_csv: bool = flag("--csv", "Print when each person is seen, a row an interval.")
    quiet: bool = options.QUIET

    def run(self) -> int:
        from facetrack_cli.runs.people import people_in, recast, rows_in, save_looks
        from facetrack_cli.runs.progress import progress
        from facetrack_cli.runs.signals import Stop, StoppedError
        from facetrack_cli.trajectory.clock import Clock

        if self.as_json and self.as_csv:
            raise UsageError("--json and --csv both go to standard output; give one of them")
        people = people_in(self.folder)
        changes = self._changes(Clock(rows_in(self.folder) if self.split or self.give else None, people.fps))
        if self.edit:
            return self._serve()
        self.page.refuse("give --page")
        if changes or self.save is not None:
            with Stop().listening() as stop, progress(self.quiet) as shown:
                shown.begin(self.folder.name or str(self.folder))
                written = "nothing was written"
                try:
                    if changes:
                        video = not self.no_video
                        people = recast(
                            self.folder, changes, clip=self.clip, video=video, report=shown.looked, stop=stop
                        )
                        written = "the changes are written"
                    if self.save is not None:
                        names = save_looks(self.folder, self.save, self.clip, shown.looked, stop)
                        shown.say(f"{self.save}: {', '.join(names)}")
                except StoppedError:
                    shown.say(f"{self.folder}: stopped, {written}")
                    return stop.code or 0
        if self.as_json or self.as_csv:
            click.echo(people.text().decode() if self.as_json else _intervals(people), nl=False)
        else:
            _show(people, Clock(rows_in(self.folder), people.fps))
        return 0

    def _serve(self) -> int:
        """Serve the page until it is saved or stopped; the exit code."""
        from facetrack_cli.editor.web.cast_session import CastSession
        from facetrack_cli.runs.people import film_of, people_in, rows_in
        from facetrack_cli.runs.signals import Stop
        from facetrack_cli.video.seek import Frames

        clip, how = film_of(people_in(self.folder), rows_in(self.folder), self.clip)
        if clip is None:
            raise UsageError(f"{self.folder}: does not name its clip; give it with --clip")
        with Frames(clip, **how) as frames, Stop().listening() as stop:
            session = CastSession(self.folder, frames, clip, video=not self.no_video)
            if self.page.serve(session, stop):
                return 0
            say(f"facetrack: {stop.reason}; {'what was saved stays' if session.saved else 'nothing was written'}")
            return stop.code or ExitCode.FAULT

    def _changes(self, clock: Clock) -> list[tuple[str, Callable[[Tracks], Tracks]]]:
        from facetrack_cli.trajectory import people as edits

        found: list[tuple[str, Callable[[Tracks], Tracks]]] = []
        for name, moment in self.split:
            found.append((f"split {name}@{moment}", partial(edits.split, name=name, frame=frame_at(moment, clock))))
        for name, gift in self.give:
            moment, _, to = gift.partition("=")
            frame = frame_at(moment, clock)
            found.append((f"give {name}@{gift}", partial(edits.give, name=name, frame=frame, to=to)))
        found += [(f"merge {a}={b}", partial(edits.merge, name=a, into=b)) for a, b in self.merge]
        return found + [(f"rename {a}={b}", partial(edits.rename, name=a, to=b)) for a, b in self.rename]


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


command = verb(Cast, "people")
