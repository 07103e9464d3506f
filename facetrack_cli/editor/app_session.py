"""The page of `facetrack app`: clips are added, tracked, looked at, corrected and exported."""

import re
import threading
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext, suppress
from functools import lru_cache
from pathlib import Path
from typing import Annotated, ClassVar, Final, Literal

import numpy as np
from pydantic import Field

from facetrack_cli.core.errors import FacetrackError, InputError, UsageError, flat
from facetrack_cli.core.files import make_folder, write_new, writing
from facetrack_cli.core.types import Array, checked_name
from facetrack_cli.editor.fix_session import CastSession, FixSession
from facetrack_cli.editor.pick_session import NOTHING, PickSession, Proposer
from facetrack_cli.editor.project import RECIPES, Clip, Project, What, free
from facetrack_cli.editor.save import open_track
from facetrack_cli.editor.session import Answer, Json, Page, jpeg
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.run_folder.finished import open_run, stamp
from facetrack_cli.run_folder.manifest import NAME as MANIFEST
from facetrack_cli.run_folder.manifest import VIDEO, read_run
from facetrack_cli.run_folder.status import ClipStatus
from facetrack_cli.runs.batch import expand
from facetrack_cli.runs.export import content, encoded, named
from facetrack_cli.start.init_file import read_init
from facetrack_cli.trajectory.formats import EXPORTS
from facetrack_cli.video.source import Frames

LOOKS: Final = 5  # frames of a clip in which faces are sought, in its first seconds
LOOKS_WITHIN: Final = 250  # frames
THUMB_PIXELS: Final = 240  # about, along the longer side
BINS: Final = 400  # of a curve
CURVES: Final = 24  # targets of which they are sent
EVENTS: Final = 20_000  # that are sent
Ids = Annotated[list[int], Field(max_length=2000)]


PROGRAMS: Final = {
    "csv-wide": "Excel: a row for each frame",
    "measures": "Excel: measures of faces and hands",
    "events": "Excel: events",
    "eaf": "ELAN",
    "cvat": "CVAT",
    "labelstudio": "Label Studio",
    "boris": "BORIS",
    "srt": "Subtitles",
    "dlc": "DeepLabCut",
    "openface": "OpenFace",
    "coco": "COCO",
}
"""What a file is for, by its format."""
OF_MANY: Final = tuple(form for form in PROGRAMS if "clips" in EXPORTS[form].takes)  # files of many clips
BOM: Final = b"\xef\xbb\xbf"  # by which Excel knows that a CSV is UTF-8


class AppSession(Page):
    """The page of a project. Pages that correct a run, or choose a start, are opened below it."""

    index: ClassVar[str] = "home.html"

    def __init__(self, project: Project) -> None:
        super().__init__()
        self.project = project
        self._look = lru_cache(4)(looked)
        self._exporting = threading.Lock()
        self._looks = ThreadPoolExecutor(1, "looks")  # at clips, as they come
        self._look_at([clip for clip in project.clips.values() if not clip.frames])

    def close(self) -> None:
        super().close()
        self.project.close()
        self._looks.shutdown(cancel_futures=True)
        for page in [*self.opened.values()]:
            page.close()  # what was corrected and not saved is kept beside the run

    def get_state(self) -> Json:
        self._shut_of()
        project = self.project
        with project.lock:
            clips = [self._shown(clip) for clip in project.clips.values()]
            return {
                "folder": str(project.folder),
                "clips": clips,
                "paused": project.paused,
                "running": None if project.running is None else project.running.id,
                "programs": {form: {"name": name, "many": form in OF_MANY} for form, name in PROGRAMS.items()},
                "ended": self.ended,
            }

    def _shown(self, clip: Clip) -> Json:
        """A clip as the page shows it."""
        project, progress, rate = self.project, self.project.progress, None
        try:
            status = project.status(clip)
        except FacetrackError as e:
            status = ClipStatus(clip.name, clip.name, "failed", error=str(e))
        state, done, error = str(status.state), status.frames, clip.error or status.error
        start = project.start_of(clip).is_file()
        if clip is project.running:
            state, done = "running", 0
            if progress.get("doing") == "":  # else it does something before or after
                done, rate = int(progress.get("done") or 0), progress.get("frames_per_s")
        elif clip.wanted and state != "running":
            state = "paused" if project.paused else "queued"
        elif error:
            state = "failed"
        elif state == "not begun":
            state = "needs box" if clip.what == "box" and not start else "ready"
        more = {"doing": progress.get("doing", "starting"), "rate": rate, "look": status.look}
        movie = stamp(project.run_of(clip) / VIDEO)
        more |= {"movie": movie and str(movie)}  # changes when it is drawn again
        more |= {"state": state, "done": done, "error": error, "start": start}
        shown = clip.model_dump(include={"id", "what", "likely", "size", "seconds", "frames"})
        return {**shown, "name": project.place(clip).name, "path": str(project.place(clip)), **more}

    def post_quit(self) -> Json:
        return self.end([], None)

    # adding

    def put_upload(self, data: bytes, name: str, offset: int, total: int) -> Json:
        """A piece of a file that is dropped; the last one adds it."""
        try:
            name = re.sub(r'[<>:"|?*]', "_", checked_name(name.strip(" ."), "file"))
        except ValueError as e:
            raise UsageError(str(e)) from None
        folder = self.project.folder / "clips"
        make_folder(folder, "name another folder")
        part = folder / f".{name}.part"
        with writing(part, "free some space"), part.open("r+b" if offset and part.exists() else "wb") as file:
            if file.seek(0, 2) < offset:
                raise UsageError(f"{name}: a piece is missing; drop the file again")
            file.seek(offset)
            file.write(data)
            file.truncate()
            if file.tell() < total:
                return {"offset": file.tell()}
        with self.project.lock, writing(part, "choose another folder"):
            name = free(Path(name).stem, (file.name for file in folder.iterdir()), Path(name).suffix)
            part.rename(path := folder / name)
        return self._added([path])

    def post_add(self, path: str) -> Json:
        """The clips that a path names: a file, or a folder of clips or images."""
        if not path.strip() or path.startswith("@"):
            raise UsageError("name a video, or a folder with videos or images")
        place = Path(path.strip().strip("\"'")).expanduser()
        if not place.is_absolute():
            raise UsageError(f"{place}: give the whole path, as {Path.home() / 'clips'}")
        if not place.exists():
            raise UsageError(f"{place}: there is nothing of this name")
        return self._added(expand([place])[0])

    def _added(self, paths: Sequence[Path]) -> Json:
        added = self.project.add(paths)
        self._look_at(added)
        return {"added": [clip.id for clip in added]}

    def _look_at(self, clips: Iterable[Clip]) -> None:
        """Look at clips in a thread: a picture, how long they are, and what is likely to be tracked."""

        def look(clip: Clip) -> None:
            try:
                with Frames(self.project.place(clip)) as frames:
                    thumb = self._thumb(clip.id)
                    make_folder(thumb.parent)
                    write_new(thumb, jpeg(frames, 0, max(round(max(frames.size) / THUMB_PIXELS), 1)), overwrite=True)
                    likely, size, count = likely_in(frames), frames.size, frames.count
                with self.project.lock:
                    clip.size, clip.frames, clip.likely, clip.what = size, max(count, 1), likely, likely
                    clip.seconds = round(count / float(frames.fps), 2)
                    self.project.save()
            except FacetrackError as e:
                clip.error = flat(str(e))
            except Exception as e:
                clip.error = self.record(e)

        for clip in clips:
            self._looks.submit(look, clip)

    def get_thumb(self, clip: int) -> Answer:
        return Answer(self._thumb(clip), kind="image/jpeg")

    def _thumb(self, clip: int) -> Path:
        return self.project.folder / "thumbs" / f"{clip}.jpg"

    # running

    def post_choose(self, clips: Ids, what: What) -> Json:
        with self.project.lock:
            for clip in map(self.project.find, clips):
                if clip.wanted:
                    raise UsageError(f"{clip.name} is being tracked; stop it first")
                clip.what, clip.error = what, None
            self.project.save()
        return self.get_state()

    def post_want(self, clips: Ids, wanted: bool, again: bool = False) -> Json:
        """Have clips tracked, `again` from the start, or stop them."""
        for clip in clips if wanted else ():
            self._shut_of(clip)
        self.project.want([*map(self.project.find, clips)], wanted, again=again)
        return self.get_state()

    def post_pause(self, paused: bool) -> Json:
        self.project.pause(paused)
        return self.get_state()

    def post_remove(self, clip: int) -> Json:
        self._shut_of(clip)
        self.project.remove(self.project.find(clip))
        return self.get_state()

    # looking

    def get_video(self, clip: int, v: str = "") -> Answer:
        return Answer(self.project.run_of(self.project.find(clip)) / VIDEO, kind="video/mp4")

    def get_look(self, clip: int) -> Json:
        folder = self.project.run_of(self.project.find(clip))
        return self._look(folder, str(stamp(folder / MANIFEST)))

    # correcting

    def post_open(
        self, clip: int, page: Literal["fix", "people", "start"], person: str | None = None, frame: int = 0
    ) -> Json:
        """Open the page that corrects a run, or a `person` of a film, or who is who in it, or that chooses a start."""
        name = f"{page}-{clip}" + ("" if person is None else f"-{frame}")
        with self.lock:
            self._shut_of()
            chosen = self.project.find(clip)
            if chosen.wanted:
                raise UsageError(f"{chosen.name} is being tracked; stop it first")
            if name not in self.opened:
                folder = self.project.run_of(chosen)
                if page == "start":
                    self.opened[name] = self._start_page(chosen)
                elif page == "people":
                    self.opened[name] = CastSession(folder)
                else:
                    run = open_run(folder) if person is None else open_track(folder, person, frame)
                    self.opened[name] = FixSession(run)
        return {"url": f"{name}/"}

    def _start_page(self, clip: Clip) -> Page:
        place, out = self.project.place(clip), self.project.start_of(clip)
        make_folder(out.parent)
        previous = read_init(out) if out.is_file() else NOTHING
        return PickSession(place, out=out, overwrite=True, recipe=load_recipe(RECIPES[clip.what]), previous=previous)

    def _shut_of(self, clip: int | None = None) -> None:
        """Close the pages of a clip, or those that have ended."""
        for name, page in [*self.opened.items()]:
            if (name.split("-")[1] == str(clip) or page.over()) and self.opened.pop(name, None) is not None:
                page.close()

    # exporting

    def get_export(self, program: str, clip: int | None = None) -> Answer:
        """A file for a program, of one clip or of all; it stays in exports/."""
        known = OF_MANY if clip is None else (*PROGRAMS,)
        if program not in known:
            raise UsageError(f"{program}: choose among {', '.join(known)}")
        project = self.project
        name, runs = project.folder.name, sorted({path.parent for path in project.folder.glob("runs/*/trajectory.*")})
        if clip is not None:
            chosen = project.find(clip)
            name, runs = chosen.name, [project.run_of(chosen)]
        path = project.folder / "exports" / f"{name}.{EXPORTS[program].ending}"
        make_folder(path.parent, "free some space")
        clips = []
        for run in runs:
            with suppress(InputError) if clip is None else nullcontext():  # of many, those that can be read
                clips.append(named(read_run(run), drop_lost=False))
        if not clips:
            raise InputError("no run can be read yet")
        data = encoded(content(clips, program, path, box="points", many=clip is None))
        with self._exporting, writing(path, "close what uses it"):
            path.write_bytes(BOM * PROGRAMS[program].startswith("Excel") + data)
        saved_as = re.sub(r'[^ -~]|["\\]', "_", path.name)
        headers = (("Content-Disposition", f'attachment; filename="{saved_as}"'),)
        return Answer(path, kind="application/octet-stream", headers=headers)


def likely_in(frames: Frames) -> What:
    """What is likely to be tracked, by the faces and hands that a detector sees in some frames."""
    faces = hands = several = 0
    proposer = Proposer(frames, recipe := load_recipe("head_hands"), recipe.points)
    last = min(max(frames.count - 1, 0), LOOKS_WITHIN)
    for at in sorted({last * k // (LOOKS - 1) for k in range(LOOKS)}):
        with suppress(InputError):
            starts, _ = proposer(at)
            faces, several = faces + bool(starts), several + (len(starts) > 1)
            hands += len(starts) == 1 and len(starts[0].targets) > 1
    return "box" if not faces else "everybody" if several else "signer" if 2 * hands > LOOKS else "face"


def looked(folder: Path, _: str) -> Json:
    """Curves of a run, by target, as means of equal spans of time, and its events; times in s."""
    rows = read_run(folder)
    begins = np.linspace(float(rows.times[0]), float(rows.times[-1]), max(min(BINS, len(rows.times)), 1))
    targets = []
    for name in rows.targets[:CURVES]:
        parts, measures = rows.of_target(name), rows.measures[name].values()
        least = np.fmin.reduce([part.confidence for part in parts if len(part) == len(parts[0])])
        curves = [_curve(measure.name, measure.unit, measure.value, measure.time_s, begins) for measure in measures]
        sure = _curve("confidence", "", least, parts[0].time_s, begins)
        targets.append({"name": name, "curves": [sure, *curves]})
    keys = ("target", "tier", "value", "begin_s", "end_s")
    events = [{key: getattr(event, key) for key in keys} for event in rows.events[:EVENTS]]
    return {"begin": begins[0], "end": begins[-1], "targets": targets, "events": events}


def _curve(name: str, unit: str, values: Array, at: Array, begins: Array) -> Json:
    """The mean of the values from each time to the next, None where there are none."""
    finite = np.isfinite(values)
    bins = np.clip(np.searchsorted(begins, at[finite] + 1e-6, "right") - 1, 0, None)
    count, sums = (np.bincount(bins, weights, len(begins)) for weights in (None, values[finite]))
    means = [round(s / n, 4) if n else None for s, n in zip(sums.tolist(), count.tolist(), strict=True)]
    return {"name": name, "unit": unit, "values": means}
