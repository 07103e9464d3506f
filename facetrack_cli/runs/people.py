"""A film that was tracked, named: who each track is of, a picture of each person, and the run's files under names."""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import cv2
import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.files import check_plain, make_folder, remove_folders
from facetrack_cli.core.types import BOX, Frame, Image
from facetrack_cli.run_folder.lease import IN_A_COPY, FolderLease
from facetrack_cli.run_folder.manifest import VIDEO, check_run, other_clip, read_manifest, read_run
from facetrack_cli.runs.finished import rewrite
from facetrack_cli.runs.plan import Job, Report, frames_of, silent
from facetrack_cli.runs.signals import Stop, Stopped, StoppedError, never
from facetrack_cli.trackers.face.detectors import detector
from facetrack_cli.trackers.people.descriptor import (
    AT_ONCE_S,
    SURE,
    UNKNOWN,
    Cast,
    Describer,
    TrackSummary,
    cast_of,
    load_people,
    places,
    save_people,
    still,
    views_of,
)
from facetrack_cli.trajectory.people import (
    NOBODY,
    People,
    ShotRecord,
    TrackRecord,
    Tracks,
    new_name,
    people_of,
    photographs,
    read_people,
    read_still,
    under_names,
)
from facetrack_cli.trajectory.reader import PEOPLE, STILLS, clip_of
from facetrack_cli.trajectory.trajectory import Trajectory, header_value
from facetrack_cli.trajectory.views import Clock
from facetrack_cli.trajectory.writers import summary_of
from facetrack_cli.video.shots import Shot, find_cuts, shots_of
from facetrack_cli.video.source import Source, given_rate, open_source

ORIGIN: Final = "--faces all"
MIN_FRAMES: Final = 5  # of a track in which its face is seen; of fewer nothing is kept
FIRST_VIEWS: Final = 2  # of a track that dlib's network sees, where nothing is in doubt
STILL_CHANGE: Final = 2.5  # grey levels; a face that changes by less is of a photograph


class NamedFilm(NamedTuple):
    """The people of a film, their tracks, and their pictures by `still`, the bytes of JPEG files."""

    people: People
    tracks: Tracks
    stills: Mapping[str, bytes]


def film_shots(job: Job, stop: Stopped, looked: Report) -> list[Shot]:
    """The shots of a clip, from the first frame that is asked for, until `stop` says so."""
    first = job.first
    with job.open(first) as source:
        frames = frames_of(source, first, "the film", stop)
        total = source.frames_hint
        cuts = list(find_cuts(frames, lambda done: looked(done, total, "finding shots"), float(source.fps)))
    return shots_of(cuts, first, job.stop)


def looks_in(boxes: Mapping[str, Trajectory], source: Source, looked: Report, stop: Stopped) -> dict[str, Describer]:
    """What the frames of `source` show of each of these boxes. Raises StoppedError once `stop` says so."""
    readers, wanted = {name: Describer(detector()) for name in boxes}, defaultdict(list)
    for name, box in boxes.items():
        for view in views_of(box):
            wanted[view.frame].append((name, view))
    last = max(wanted, default=-1)
    for done, frame in enumerate(source if wanted else ()):
        if stop():
            raise StoppedError
        for name, view in wanted.get(frame.index, ()):
            readers[name].see(frame, view)
        looked(done, source.frames_hint, "looking at people")
        if frame.index >= last:
            break
    return readers


def save_looks(folder: Path, path: Path, clip: Path | None, report: Report, stop: Stopped) -> tuple[str, ...]:
    """Save what the people of a run look like, so that other films know them; their names.

    Raises InputError where the clip is gone, OutputError, and StoppedError.
    """
    people, rows = people_in(folder), read_run(folder)
    where, how = film_of(people, rows, clip)
    if where is None:
        raise InputError(f"{rows.path}: does not name its clip; give it with --clip")
    with open_source(where, start=people.shots[0].first, **how) as source:
        readers = looks_in(_boxes(rows), source, report, stop)
    names = tuple(name for name in people.names if not name.startswith(NOBODY))
    save_people(path, {name: readers[name].looks() for name in names})
    return names


def _boxes(rows: Trajectory) -> dict[str, Trajectory]:
    return {name: box for name in rows.targets if (box := rows.find(name, BOX)) is not None}


def film_of(people: People, rows: Trajectory, clip: Path | None) -> tuple[Path | None, Any]:
    """The clip of a run, if it is known, and how it is read: its rate if the clip brings none, and its stream.

    Raises InputError for a `clip` that is not the run's.
    """
    if clip is not None and (other := other_clip(rows, clip)) is not None:
        raise InputError(f"{other}; name its clip with --clip")
    place = clip or clip_of(rows)
    return place, {"fps": place and given_rate(place, people.fps), "stream": header_value(rows, "source", "stream")}


def cast_in(job: Job, rows: Trajectory, stop: Stopped, looked: Report) -> NamedFilm:
    """Who the tracks of a job's `rows` are of. InputError where the film shows nobody; raises StoppedError."""
    first, stored = int(rows.frame.min()), rows.header.get("shots")
    shots = [Shot(*shot) for shot in stored] if stored else film_shots(job, stop, looked)
    gallery = {} if job.gallery is None else load_people(job.gallery)
    least, tracks = min(MIN_FRAMES, len(rows.frames)), list[TrackSummary]()
    boxes = {name: box for name, box in _boxes(rows).items() if (~box.unseen).sum() >= least}
    with job.open(first) as source:
        fps, readers = float(source.fps), looks_in(boxes, source, looked, stop)
    begins = np.array([shot.first for shot in shots])
    for name, box in sorted(boxes.items(), key=lambda item: int(item[1].frame[0])):
        if readers[name].is_face:
            start, ended = int(box.frame[0]), int(box.frame[-1]) + 1
            ends: Any = [tuple(place) for place in box.take(~box.unseen).boxes[[0, -1]].tolist()]
            shot, looks = int(np.searchsorted(begins, start, "right")), readers[name].looks(FIRST_VIEWS)
            tracks.append(TrackSummary(name, start, ended, ends[0], ends[1], shot, looks))
    if not tracks:
        raise InputError(f"{job.clip}: no face is seen in {least} frames; is this the right film?")
    cast, names = cast_of(tracks, list(gallery.values()), fps), [*gallery]
    if cast.doubts:
        tracks = [track._replace(looks=readers[track.name].looks()) for track in tracks]
        cast = cast_of(tracks, list(gallery.values()), fps)
    while len(names) <= cast.person.max(initial=-1):
        names.append(new_name(names))
    return _named(tracks, cast, names, readers, shots, Clock(rows, fps))


def _named(
    tracks: Sequence[TrackSummary],
    cast: Cast,
    persons: Sequence[str],
    readers: Mapping[str, Describer],
    shots: Sequence[Shot],
    clock: Clock,
) -> NamedFilm:
    """The film in which each track is of the one of these persons that the cast says."""
    names, lanes = list[str](), list[int]()  # until when each of those is seen whose face cannot be told again
    for track, person in zip(tracks, cast.person.tolist(), strict=True):
        lane = next((n for n, until in enumerate(lanes) if until <= track.first), len(lanes))
        if person == UNKNOWN:
            lanes[lane : lane + 1] = [track.stop]
        names.append(persons[person] if person != UNKNOWN else NOBODY if not lane else f"{NOBODY}_{lane + 1}")
    doubts = {doubt.track: doubt for doubt in cast.doubts}
    records = list[TrackRecord]()
    pictures: dict[tuple[str, bool], tuple[float, Image]] = {}  # of a person, or of a track in doubt
    moving = {name for name, track in zip(names, tracks, strict=True) if readers[track.name].change() >= STILL_CHANGE}
    shown = [*((name, False) for name in dict.fromkeys(names)), *((tracks[i].name, True) for i in doubts)]
    paths = {key: f"{STILLS}/{number}.jpg" for number, key in enumerate(shown, 1)}
    for i, (track, name) in enumerate(zip(tracks, names, strict=True)):
        p = round(float(cast.p[i]), 4)
        record = TrackRecord(person=name, first=track.first, stop=track.stop, p=p, of=track.name)
        keys = [(name, False)]
        if (doubt := doubts.get(i)) is not None:
            keys.append((track.name, True))
            other = None if doubt.other is None else persons[doubt.other]
            unsure = {"doubt": True, "other": other, "p_other": round(doubt.p, 4), "still": paths[keys[1]]}
            record = record.model_copy(update=unsure)
        records.append(record)
        best = readers[track.name].best
        assert best is not None
        for key in keys:
            pictures[key] = max(pictures.get(key, best), best, key=lambda still: still[0])
    kept = [ShotRecord(first=shot.first, stop=shot.stop) for shot in _true(shots, tracks, names, clock.fps)]
    stills = {name: paths[name, False] for name in names}
    people = people_of(clock, kept, records, stills, {*names} - moving)
    return NamedFilm(people, records, {paths[key]: _jpeg(image) for key, (_, image) in pictures.items()})


def _true(shots: Sequence[Shot], tracks: Sequence[TrackSummary], names: Sequence[str], fps: float) -> list[Shot]:
    """The shots without cuts after which the same faces go on in the same places, as after a flash."""
    kept, goes_on = list(shots[:1]), places(tracks, fps)[1]
    for shot in shots[1:]:
        before = [i for i, track in enumerate(tracks) if track.stop == shot.first]
        after = [j for j, track in enumerate(tracks) if shot.first <= track.first <= shot.first + AT_ONCE_S * fps]
        pairs = [(i, j) for i in before for j in after if goes_on[i, j] and names[i] == names[j]]
        if before and len(before) == len(after) == len(pairs):
            kept[-1] = kept[-1]._replace(stop=shot.stop, until=shot.until)
        else:
            kept.append(shot)
    return kept


def name_run(job: Job, stop: Stop, looked: Report) -> str:
    """Name everyone in a run that was tracked, and write its files again under their names; who is in it, in one line.

    Raises InputError where the film shows nobody, StoppedError once `stop` says so; the files stay as they are.
    """
    assert job.out is not None
    rows = read_run(job.out)
    film = cast_in(job, rows, stop, looked)
    drawing, clip = (lambda n, of: looked(n, of, "drawing")), job.clip if job.video else None
    write_people(job.out, under_names(rows, film.tracks), film.people, film.stills, clip, drawing, stop)
    return cast_line(film.people)


def write_people(
    folder: Path,
    rows: Trajectory,
    people: People,
    stills: Mapping[str, bytes],
    clip: Path | None,
    report: Report,
    stop: Stopped,
    lock: FolderLease | None = None,
) -> list[str]:
    """Write the rows of a run under the names of people, people.json and pictures, all or none; warnings.

    The video is drawn again on the `clip`, if there is one.
    """
    counted, first, run = summary_of(rows), people.shots[0].first, read_manifest(folder)
    header = {**rows.header, "lost_frames": counted.lost_frames, "evidence": counted.evidence}
    files: dict[Path, Any] = {folder / PEOPLE: lambda write: write(people.text())}
    files |= {folder / still: lambda write, data=data: write(data) for still, data in stills.items()}
    check_plain(folder / STILLS)
    made = make_folder(folder / STILLS, IN_A_COPY)
    gone = [path for path in (folder / STILLS).iterdir() if path not in files and not path.is_dir()]
    span, clip = (None, None) if run is None else ((first, first + run.frames - 1), clip)
    how: Any = {"report": report, "stop": stop, "order": people.names, "lock": lock}
    try:
        return rewrite(folder, replace(rows, header=header), files, gone, clip, span, **how)[1]
    finally:
        remove_folders(made)


def _jpeg(image: Image) -> bytes:
    return cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, 92))[1].tobytes()


def recast(
    folder: Path,
    changes: Sequence[tuple[str, Callable[[Tracks], Tracks]]],
    *,
    clip: Path | None = None,
    video: bool = True,
    report: Report = silent,
    stop: Stopped = never,
) -> People:
    """Correct who is who in a run: each of `changes` has its words, and gives other tracks.

    Rows, people.json, pictures and, with `video`, the video are written again. Raises UsageError for a change that
    cannot be, InputError for a run that is of no film or whose clip is gone; nothing is written then.
    """
    check_run(folder)  # which ends what a kill left, before the folder is ours
    with FolderLease(folder) as lock:
        people, rows = people_in(folder), read_run(folder)
        tracks: Tracks = people.tracks
        for _, change in changes:
            tracks = change(tracks)
        before = {person.name: person.still for person in people.people}
        old = {track.person: track.target for track in reversed(tracks)}  # the target of each one's first track
        named, (where, how) = under_names(rows, tracks), film_of(people, rows, clip)
        pictures, end = dict[str, bytes](), int(rows.frame.max()) + 1

        def read(index: int) -> Frame:
            if where is None:
                raise InputError(f"{rows.path}: has no picture of {name}; name the clip with --clip")
            with open_source(where, start=index, stop=index + 1, **how) as source:
                return next(iter(source))

        def numbered(picture: bytes) -> str:
            still = f"{STILLS}/{len(pictures) + 1}.jpg"
            pictures[still] = picture
            return still

        stills = {}
        for name, of in old.items():
            kept = read_still(folder, before.get(of, "")) if name == of or of not in old else b""
            stills[name] = numbered(kept or still_of(named, name, 0, end, read))
        records = [
            track.model_copy(update={"still": numbered(shown) if (shown := read_still(folder, track.still)) else ""})
            for track in tracks
        ]
        words = (*people.corrections, *(word for word, _ in changes))
        after = people_of(Clock(rows, people.fps), people.shots, records, stills, photographs(people, tracks), words)
        where = where if video and (folder / VIDEO).is_file() else None
        write_people(folder, named, after, pictures, where, report, stop, lock)
    return after


def people_in(folder: Path) -> People:
    """The people of a run. InputError for a run that is of no film."""
    check_run(folder)
    people = read_people(folder)
    if people is None:
        wrote = "facetrack run --faces all writes it at its end; the same command goes on with one that was interrupted"
        raise InputError(f"{folder}: has no {PEOPLE}; {wrote}")
    return people


def still_of(rows: Trajectory, target: str, first: int, stop: int, read: Callable[[int], Frame]) -> bytes:
    """The JPEG of the best view of a target in the frames [first, stop). InputError without any."""
    box = rows.find(target, BOX)
    best = max(views_of(box.between(first, stop)) if box else [], key=lambda view: view.quality, default=None)
    if best is None:
        raise InputError(f"{rows.path}: {target} is seen in none of the frames {first} to {stop - 1}")
    return _jpeg(still(read(best.frame), best.face))


def cast_line(people: People) -> str:
    """Who is in a film, in one line."""
    known = [person for person in people.people if not person.name.startswith(NOBODY)]
    longest = sorted(known, key=lambda person: -person.seconds)[:6]
    shown, more = ", ".join(f"{person.name} {person.seconds:.1f} s" for person in longest), len(known) - 6
    doubts, unknown = len(people.doubts), sum(track.person.startswith(NOBODY) for track in people.tracks)
    unsure = f"; {doubts} of {len(people.tracks)} tracks are in doubt (P < {SURE:g})" if doubts else ""
    unsure += f"; {unknown} show{'s' * (unknown == 1)} no face that could be told again ({NOBODY})" if unknown else ""
    shots = len(people.shots)
    return (
        f"{len(known)} {'people' if len(known) != 1 else 'person'} in {shots} shot{'s' * (shots > 1)}: "
        f"{shown}{f' and {more} more' if more > 0 else ''}{unsure}"
    )
