"""A trajectory in the formats of other programs, and as an annotated video."""

import base64
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.files import check_new, temporary_path, write_new
from facetrack_cli.run_folder.manifest import VIDEO
from facetrack_cli.runs.finished import repaint
from facetrack_cli.runs.plan import silent
from facetrack_cli.runs.signals import never
from facetrack_cli.trajectory.formats import ALIASES, EXPORTS, OF_MEDIA, load
from facetrack_cli.trajectory.formats.annotation import add_tiers
from facetrack_cli.trajectory.formats.tables import Clip
from facetrack_cli.trajectory.reader import clip_of, frame_size_of, is_there
from facetrack_cli.trajectory.trajectory import Trajectory, header_value, hide_outside
from facetrack_cli.trajectory.views import Around, enclose, has_windows
from facetrack_cli.video import images
from facetrack_cli.video.source import open_source


def export(
    trajectory: Trajectory,
    form: str,
    out: str | Path | None = None,
    *,
    media: str | Path | None = None,
    into: str | Path | None = None,
    drop_lost: bool = False,
    overwrite: bool = False,
) -> str | bytes | Path:
    """A trajectory as another program reads it: what `facetrack export --to FORM` writes.

    Parameters
    ----------
    form : the format, as `eaf`, `textgrid`, `mot`, `coco`, `dlc`, `cvat`, `csv-wide` or `events`.
    out : the file to write; None: nothing is written.
    media : the clip, where the trajectory does not say it.
    into : an .eaf that gets the tiers beside its own; it is written itself if it is `out`, with `overwrite`.
    drop_lost : write lost rows as not known, not with the estimate.
    overwrite : replace a file that is there.

    Returns
    -------
    str or bytes or Path : `out`, else the content of the file.

    Raises
    ------
    UsageError : for a format that there is not, or `drop_lost` where it has tiers for what was lost.
    InputError : for a trajectory that lacks what the format needs.
    OutputError : for a file that is there, or cannot be written.
    """
    if drop_lost and ALIASES.get(form, form) == "eaf":
        raise UsageError("drop_lost is not for eaf, which has a tier for what was lost; leave it out")
    path, clip = None if out is None else Path(out), None if media is None else Path(media)
    if path is not None:
        inputs = (trajectory.path, clip, clip_of(trajectory))
        check_new(path, overwrite=overwrite, inputs=[file for file in inputs if file != Path()])
    into = None if into is None else Path(into)
    made = content([named(trajectory, drop_lost=drop_lost)], form, path, media=clip, into=into)
    if path is None:
        return made
    write_new(path, encoded(made), overwrite=overwrite)
    return path


def named(table: Trajectory, *, drop_lost: bool) -> Clip:
    """A trajectory under the name of its clip, else of its folder; with `drop_lost` lost rows have no place or size."""
    clip, lost = clip_of(table), drop_lost & (table.status == "lost")
    columns: dict[str, Any] = {name: np.where(lost, np.nan, getattr(table, name)) for name in "xywh"}
    return Clip(clip.name if clip else table.path.parent.name, replace(table, **columns))


def encoded(made: str | bytes) -> bytes:
    """The bytes of a file."""
    return made.encode(errors="backslashreplace") if isinstance(made, str) else made


def content(
    clips: Sequence[Clip],
    form: str,
    path: Path | None,
    *,
    media: Path | None = None,
    into: Path | None = None,
    box: Around | None = None,
    many: bool = False,
    say: Callable[[str], None] = lambda line: None,
) -> str | bytes:
    """What the file `path` has in a format, of a clip or of `many`; `say` takes warnings."""
    form, table = ALIASES.get(form, form), clips[0].table
    if not any(np.isfinite(rows.x).any() for _, rows in clips):
        raise InputError("no row has a place, x and y; there is nothing to export")
    if form not in EXPORTS:
        raise UsageError(f"{form} is no format; there are {', '.join(sorted(EXPORTS))}")
    takes, around, recipe = EXPORTS[form].takes.split(), box or "windows", header_value(table, "recipe", "name")
    if "box" in takes and len(table.targets) > 1:
        raise UsageError(f"{form} holds one target; choose with --target among {', '.join(table.targets)}")
    scorer, folder = f"facetrack-{recipe}" if recipe else "facetrack", path.parent if path else Path.cwd()
    values: dict[str, Any] = {"clips": clips, "many": many, "written": datetime.now(), "around": around}
    values |= {"folder": folder, "scorer": scorer}
    if "video" in takes:
        values["video"] = _playable(table, media, say)
    elif form in OF_MEDIA:
        clip, size, fps = _media(table, media)
        if "frame_size" in takes and (clip is None or not size or ("fps" in takes and not fps > 0)):
            why = "does not say how large and how fast its frames are, only a trajectory.json does"
            raise InputError(f"{why}; name the clip: --media")
        values |= {"size": size, "frame_size": size, "fps": fps, "name": clip.name if clip else ""}
        if clip is not None and "file_name" in takes:
            values["file_name"] = _image_names(clip, table)
        if "fps" in takes:
            say(f'{values["name"]}: give the Video of the labelling configuration framerate="{fps:.10g}"')
            if bare := ", ".join(part.part for part in table.parts if not has_windows(part)):
                say(f"facetrack: warning: Label Studio has no points, and these have no windows; left out: {bare}")
    if {"size", "frame_size", "boxes"} & {*takes} and (size := values.get("size") or frame_size_of(table)):
        table = hide_outside(table, size)
    if {"box", "boxes"} & {*takes}:
        values["boxes"] = [enclose(table.of_target(target), around) for target in table.targets]
        values["box"] = values["boxes"][0]
    values["table"] = table
    if into is None or "video" not in values:
        written: str | bytes = load("write", form)(*(values[name] for name in takes))
        return written
    video = values["video"].name
    text, tiers, linked = add_tiers(into, table, video)
    if not linked:
        say(f"facetrack: warning: {into} does not link to {video}; its times are taken for those of that clip")
    say(f"{into}: {', '.join(tiers) or 'no tier'} added")
    return text


def _playable(table: Trajectory, media: Path | None, say: Callable[[str], None]) -> Path:
    """The video that an .eaf links to. It need not be there: ELAN asks for a file that it does not find."""
    clip = media or clip_of(table)
    if clip is None:
        raise InputError("does not name its video, only a trajectory.json does; give it with --media")
    if is_there(clip) and clip.is_dir():
        raise InputError(f"{clip} is a folder of images, which ELAN cannot play; name a video of it with --media")
    if not is_there(clip):
        if media is not None:
            raise InputError(f"{clip}: no such file; correct --media")
        say(f"facetrack: warning: {clip} is not there; ELAN will ask for it, or give it with --media")
    return clip


def _media(table: Trajectory, media: Path | None) -> tuple[Path | None, tuple[int, int] | None, float]:
    """The clip, the size of its frames and its frames per second (0), as far as `media` or the header says them."""
    size, fps = frame_size_of(table), header_value(table, "source", "fps")
    if media is None:
        return clip_of(table), size, float(fps) if isinstance(fps, int | float) else 0.0
    with open_source(media) as opened:
        if size and size != opened.size:
            its, ours = (f"{width}x{height}" for width, height in (opened.size, size))
            raise InputError(f"{media}: is {its}, but the track is of a clip of {ours}; correct --media")
        return media, opened.size, float(opened.fps)


def _image_names(clip: Path, table: Trajectory) -> Callable[[int], str]:
    """The name of each frame's image: of a folder its file's name, of a video a name by the frame's number."""
    files = images.listing(clip) if is_there(clip) else None
    if files is None:
        return lambda frame: f"{clip.stem}/{frame:06d}.png"
    if (last := int(table.frames[-1])) >= len(files):
        there = f"has {len(files)} images, and the track a frame {last}"
        raise InputError(f"{clip}: {there}; name its folder with --media")
    return lambda frame: files[frame].name


@dataclass(frozen=True)
class Video:
    """An MP4, which notebooks show; `data` are its bytes."""

    data: bytes

    def _repr_html_(self) -> str:
        src = base64.b64encode(self.data).decode("ascii")
        return f'<video controls style="max-width: 100%" src="data:video/mp4;base64,{src}"></video>'


def annotated_video(trajectory: Trajectory, *, media: str | Path | None = None) -> Video:
    """The clip with its trajectory: the run's own annotated video, or one that is drawn from the rows.

    Parameters
    ----------
    media : the clip, where the trajectory does not say it.

    Raises
    ------
    InputError : for a trajectory that does not name its clip, and a clip that lacks its frames.
    """
    own = trajectory.path.parent / VIDEO
    if media is None and trajectory.path.stem == "trajectory" and own.is_file():
        return Video(own.read_bytes())
    clip = clip_of(trajectory) if media is None else Path(media)
    if clip is None:
        raise InputError("the trajectory does not name its clip; give it with media")
    with TemporaryDirectory() as folder:
        repaint(trajectory, clip, path=Path(folder, VIDEO), report=silent, stop=never)
        return Video(temporary_path(Path(folder, VIDEO)).read_bytes())
