"""facetrack export: a trajectory as other tools read it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FILE, argument, flag, option, say, verb
from facetrack_cli.core.errors import InputError, OutputError, UsageError

if TYPE_CHECKING:
    from facetrack_cli.trajectory.formats.events import Clip
    from facetrack_cli.trajectory.select import Around
    from facetrack_cli.trajectory.trajectory import Trajectory


ENDINGS = {
    "csv-wide": "wide.csv",
    "pose": "pose.csv",
    "measures": "measures.csv",
    "events": "events.csv",
    "boris": "boris",
    "srt": "srt",
    "vtt": "vtt",
    "textgrid": "TextGrid",
    "openface": "openface.csv",
    "mot": "mot.txt",
    "otb": "otb.txt",
    "got10k": "got10k.txt",
    "vot": "vot.txt",
    "coco": "coco.json",
    "dlc": "dlc.csv",
    "dlc-h5": "dlc.h5",
    "eaf": "eaf",
    "cvat": "cvat.xml",
    "labelstudio": "labelstudio.json",
}
"""How the file of each format is called, after the name of the trajectory."""
OF_RUNS = ("measures", "events", "boris")
"""Those that take the folder of many runs."""
ONE_TARGET = ("otb", "got10k", "vot")
OF_BOXES = ("mot", *ONE_TARGET, "coco")
OF_MEDIA = ("openface", "coco", "eaf", "cvat", "labelstudio")


class Export:
    """Write a trajectory as other tools read it.

    TRAJECTORY is a trajectory.csv, .json or .jsonl, or the folder of a run; for measures, events and boris also that of
    many runs. The file goes beside it, with the ending of its format, unless -o says otherwise.

    \b
    Formats:
      csv-wide  CSV with one row a frame, for spreadsheets
      pose      CSV of the head's pitch, yaw and roll, with their spread
      measures  CSV of mouth opening, smile, brows, lids, pose, and their spread
      events    CSV of when mouths open, eyes blink, heads nod, hands move
      boris     the same as a project of BORIS 8, a clip an observation
      srt, vtt  the same as subtitles, of one run
      textgrid  the same as a TextGrid of Praat, of one run
      openface  OpenFace's CSV: confidence, success, pose, landmarks
      mot       MOTChallenge: frame, id, box, confidence; all from 1
      otb       OTB boxes, one a line, pixels from 1; one target
      got10k    GOT-10k boxes, one a line, pixels from 1; one target
      vot       VOT result, one region a line, pixels from 0; one target
      coco      COCO keypoints JSON: boxes and points of every frame
      dlc       DeepLabCut CSV: x, y, likelihood of every point
      dlc-h5    the same as DeepLabCut's HDF5; needs pandas and PyTables
      eaf, elan ELAN annotations: what was lost, what head, face, hands did
      cvat      CVAT for video 1.1: a track for each part, to correct there
      labelstudio  Label Studio's video rectangles, to correct there

    In mot, otb, got10k, vot and coco, a target of several points has the box around the windows that the tracker
    compares; with --box points, around the points alone.

    Lost rows hold the tracker's estimate. mot, coco and dlc give its confidence, coco also the visibility 1 (2 is
    tracked). With --drop-lost they are as if nothing was found: no row in mot, no keypoint in coco, an empty cell in
    dlc and csv-wide, nan in otb, zeros in got10k, a failure in vot.

    cvat and labelstudio go to the annotation tool, and what is corrected there comes back by facetrack fix --import.
    A lost row is occluded in cvat, and not enabled in labelstudio; with --drop-lost it is outside in cvat, too.

    eaf has tiers for lost parts, motion to the left, right, up and down, tilt, size, nods and shakes, as seen in the
    image plane; for open mouths, blinks and nods of the pose. It needs the video; coco and openface's pose_T the size
    of the frames: both stand in a trajectory.json, else give --media.

    With --into an .eaf that is there gets these tiers: what is in it stays as it is, and a tier whose name is taken
    gets another. The result goes to -o, or with --overwrite into that file itself. What people change in the tiers
    seen and absent comes back by facetrack fix --import.

    \b
    Examples:
      facetrack export out/ --to mot
      facetrack export out/trajectory.csv --to dlc -o clip.csv
      facetrack export out/ --to otb --target face/nose -o -
      facetrack export out/trajectory.csv --to eaf --media clip.mp4
      facetrack export out/ --to elan --into session.eaf --overwrite

    \b
    Exit codes: 0 done, 2 usage or output, 3 input.
    """

    trajectory: Path = argument("TRAJECTORY")
    to: str = option("--to FORMAT", "Format, as above.", required=True, type=click.Choice([*ENDINGS, "elan"]))
    out: str | None = option("-o --out FILE", "File to write [default: beside TRAJECTORY]; - standard output.")
    target: str | None = options.TARGET
    media: Path | None = option("--media FILE", f"Clip it was tracked in ({', '.join(OF_MEDIA)}).", type=FILE)
    into: Path | None = option("--into FILE", "An .eaf to add the tiers to.", type=FILE)
    box: Around | None = option(
        "--box KIND",
        "What a box around points encloses: windows [default], or points, their centres alone.",
        type=click.Choice(["windows", "points"]),
    )
    drop_lost: bool = flag("--drop-lost", "Write lost rows as not known, not with the estimate.")
    overwrite: bool = options.OVERWRITE

    def run(self) -> None:
        from facetrack_cli.core.files import StreamSink, check_new, write_new
        from facetrack_cli.trajectory.header import clip_of

        self.to = "eaf" if self.to == "elan" else self.to
        if self.into is not None and self.to != "eaf":
            raise UsageError(f"--into adds the tiers of eaf to a file of ELAN; {self.to} has none")
        if self.media is not None and self.to not in OF_MEDIA:
            raise UsageError(f"--media is for {', '.join(OF_MEDIA)}; {self.to} does not name the clip")
        if self.box is not None and self.to not in OF_BOXES:
            raise UsageError(f"--box is for {', '.join(OF_BOXES)}; {self.to} has no boxes")
        if self.drop_lost and self.to == "eaf":
            raise UsageError("--drop-lost is not for eaf, which has a tier for what was lost; leave it out")
        if self.out == "":
            raise OutputError("--out is empty; name a file, or - for standard output")
        if self.out == "-" and self.to == "dlc-h5":
            raise OutputError("dlc-h5 is not text, and does not go to standard output; name a file with -o")
        clips, many = self._clips()
        table = clips[0].table
        beside = table.path.with_name(f"{table.path.stem}.{ENDINGS[self.to]}")
        beside = beside if not many else self.trajectory / f"{self.trajectory.resolve().name}.{ENDINGS[self.to]}"
        path = None if self.out == "-" else Path(self.out) if self.out else self.into or beside
        if path is not None:
            check_new(path, overwrite=self.overwrite, inputs=(table.path, self.media, clip_of(table)))
        try:
            content = self._content(clips, path, many)
        except InputError as e:
            # what is wrong within the table has no file's name yet
            known = str(e).startswith((str(table.path), str(self.media), str(self.into)))
            raise e if known else InputError(f"{table.path}: {e}") from None
        if path is None:
            StreamSink(sys.stdout.buffer).finish(lambda _: str(content))
            return
        data = content.encode(errors="backslashreplace") if isinstance(content, str) else content
        write_new(path, data, overwrite=self.overwrite)
        frames = table.frames
        begins = f"; line 1 is frame {frames[0]}" if self.to in ("otb", "got10k") and frames[0] else ""
        what = f"{len(frames)} frames of {', '.join(table.targets) or 'one target'}"
        say(f"{path}: {what if not many else f'{len(clips)} clips'}{begins}")

    def _clips(self) -> tuple[list[Clip], bool]:
        """The trajectory, or those of the many runs in a folder, less what cannot be read; whether there are many."""
        from facetrack_cli.run_folder.manifest import read_run
        from facetrack_cli.trajectory.formats.events import Clip
        from facetrack_cli.trajectory.header import clip_of
        from facetrack_cli.trajectory.select import blank_lost, choose

        paths = [] if any(self.trajectory.glob("trajectory.*")) else self.trajectory.glob("*/trajectory.*")
        folders = sorted({path.parent for path in paths})
        if (many := bool(folders)) and self.to not in OF_RUNS:
            raise UsageError(f"{self.trajectory}: is a folder of runs, and {self.to} takes one; name that of one run")
        found = []
        for path in folders or [self.trajectory]:
            try:
                table = choose(read_run(path), self.target)
            except (InputError, UsageError) as e:
                if not many:
                    raise
                say(f"facetrack: warning: {e}; it is left out")
                continue
            clip = clip_of(table)
            found.append(
                Clip(clip.name if clip else table.path.parent.name, blank_lost(table) if self.drop_lost else table)
            )
        if not found:
            raise InputError(f"{self.trajectory}: none of its runs can be read; look at facetrack status")
        return found, many

    def _content(self, clips: list[Clip], path: Path | None, many: bool) -> str | bytes:
        import numpy as np

        from facetrack_cli.trajectory.formats import boxes, cvat, eaf, events, keypoints, labelstudio, openface, tables
        from facetrack_cli.trajectory.header import frame_size_of, said
        from facetrack_cli.trajectory.select import enclose, hide_outside

        table = clips[0].table
        if not any(np.isfinite(one.x).any() for _, one in clips):
            raise InputError("no row has a place, x and y; there is nothing to export")
        if self.to in ONE_TARGET and len(table.targets) > 1:
            raise UsageError(f"{self.to} holds one target; choose with --target among {', '.join(table.targets)}")
        around, recipe = self.box or "windows", said(table, "recipe", "name")
        scorer = f"facetrack-{recipe}" if recipe else "facetrack"
        if self.to == "eaf":
            folder = path.parent if path else Path.cwd()
            video = self._playable(table)
            text = eaf.write_eaf(table, video, folder, written=datetime.now())
            return text if self.into is None else self._added(self.into, text, video.name)
        clip, size, fps = self._media(table) if self.to in OF_MEDIA else (None, None, 0.0)
        name = "" if clip is None else clip.name
        if self.to in (*OF_MEDIA, "mot") and (sides := size or frame_size_of(table)):
            table = hide_outside(table, sides)
        writers: dict[str, Callable[[], str | bytes]] = {
            "csv-wide": lambda: tables.write_wide(table),
            "pose": lambda: tables.write_pose(table),
            "measures": lambda: tables.write_measures(
                *(one for _, one in clips), clips=[name for name, _ in clips if many]
            ),
            "events": lambda: events.write_events(clips),
            "boris": lambda: events.write_boris(clips, written=datetime.now()),
            "srt": lambda: events.write_subtitles(table, "srt"),
            "vtt": lambda: events.write_subtitles(table, "vtt"),
            "textgrid": lambda: events.write_textgrid(table),
            "openface": lambda: openface.write_openface(table, size),
            "cvat": lambda: cvat.write_cvat(table, size, name),
            "dlc": lambda: keypoints.write_dlc(table, scorer),
            "dlc-h5": lambda: keypoints.write_dlc_h5(table, scorer),
        }
        if self.to in writers:
            return writers[self.to]()
        if self.to in ("coco", "labelstudio"):
            if clip is None or not size or (self.to == "labelstudio" and not fps > 0):
                why = "does not say how large and how fast its frames are, only a trajectory.json does"
                raise InputError(f"{why}; name the clip: --media")
            if self.to == "labelstudio":
                say(f'{name}: give the Video of the labelling configuration framerate="{fps:.10g}"')
                return labelstudio.write_labelstudio(table, size, fps, name)
            return keypoints.write_coco(table, size, self._image_names(clip, table), around=around)
        chosen = [enclose(table.of_target(target), around) for target in table.targets]
        if self.to == "mot":
            return boxes.write_mot(chosen)
        write = {"vot": boxes.write_vot, "otb": boxes.write_otb, "got10k": boxes.write_got10k}[self.to]
        return write(chosen[0])

    def _added(self, into: Path, text: str, clip: str) -> str:
        from facetrack_cli.trajectory.formats.eaf_session import add_tiers

        data, tiers, linked = add_tiers(into, text, clip)
        if not linked:
            say(f"facetrack: warning: {into} does not link to {clip}; its times are taken for those of that clip")
        say(f"{into}: {', '.join(tiers) or 'no tier'} added")
        return data.decode()

    def _playable(self, table: Trajectory) -> Path:
        """The video that an .eaf links to. It need not be there: ELAN asks for a file that it does not find."""
        from facetrack_cli.trajectory.header import clip_of, is_there

        clip = self.media or clip_of(table)
        if clip is None:
            raise InputError("does not name its video, only a trajectory.json does; give it with --media")
        if is_there(clip) and clip.is_dir():
            raise InputError(f"{clip} is a folder of images, which ELAN cannot play; name a video of it with --media")
        if not is_there(clip):
            if self.media is not None:
                raise InputError(f"{clip}: no such file; correct --media")
            say(f"facetrack: warning: {clip} is not there; ELAN will ask for it, or give it with --media")
        return clip

    def _media(self, table: Trajectory) -> tuple[Path | None, tuple[int, int] | None, float]:
        """The clip, the size of its frames and its frames per second (0), as far as --media or the header says them."""
        from facetrack_cli.trajectory.header import clip_of, frame_size_of, said
        from facetrack_cli.video.source import open_source

        size, fps = frame_size_of(table), said(table, "source", "fps")
        if self.media is None:
            return clip_of(table), size, float(fps) if isinstance(fps, int | float) else 0.0
        with open_source(self.media) as opened:
            if size and size != opened.size:
                its, ours = (f"{width}x{height}" for width, height in (opened.size, size))
                raise InputError(f"{self.media}: is {its}, but the track is of a clip of {ours}; correct --media")
            return self.media, opened.size, float(opened.fps)

    def _image_names(self, clip: Path, table: Trajectory) -> Callable[[int], str]:
        """The name of each frame's image: of a folder its file's name, of a video a name by the frame's number."""
        from facetrack_cli.trajectory.header import is_there
        from facetrack_cli.video import images

        files = images.listing(clip) if is_there(clip) else None
        if files is None:
            return lambda frame: f"{clip.stem}/{frame:06d}.png"
        if (last := int(table.frames[-1])) >= len(files):
            there = f"has {len(files)} images, and the track a frame {last}"
            raise InputError(f"{clip}: {there}; name its folder with --media")
        return lambda frame: files[frame].name


command = verb(Export)
