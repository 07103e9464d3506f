"""The annotated video painted anew from the rows; the particles are not in them, and are not drawn."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.editor.retrack import Report, StoppedError
from facetrack_cli.editor.run_folder import Run
from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory, recorded
from facetrack_cli.video.overlay.overlay import Overlay
from facetrack_cli.video.source import open_source
from facetrack_cli.video.writer import VideoWriter


def repaint(
    run: Run,
    rows: Trajectory,
    to: Path,
    *,
    report: Report = lambda done, total: None,
    stop: Callable[[], bool] = lambda: False,
) -> tuple[str, ...]:
    """Write the MP4 `to`, as a run paints it, and say what could not be kept of it, a line each.

    Raises StoppedError once `stop` says so, InputError if the clip lacks frames of the run; nothing is written then.
    """
    total = run.last - run.first + 1
    done = 0
    with open_source(run.clip, fps=run.fps, start=run.first, stop=run.last + 1) as source:
        overlay = Overlay(source.size, fps=float(source.fps), title=run.recipe.name)
        video = VideoWriter(to, source.size, source.fps, audio_from=source.path if source.is_video else None)
        try:
            for frame in source:
                if stop():
                    raise StoppedError
                video.write(overlay.draw(FrameResult(frame, recorded(frame.index, rows.at(frame.index)))), frame.time_s)
                done += 1
                report(done, total)
            if done < total:
                missing = run.first + done
                raise InputError(f"{run.clip}: has no frame {missing}, which the run has; name its clip with --clip")
        except BaseException:
            video.discard()
            raise
        video.close()
        return tuple(video.warnings)


def cells(rows: Trajectory, frame: int) -> list[list[Any]]:
    """The rows of one frame as the page has them: x, y, w, h, angle, confidence, status, by hand, corners."""
    found = []
    for target in recorded(frame, rows.at(frame)):
        one = target.rows
        numbers = np.stack([getattr(one, name) for name in ("x", "y", "w", "h", "angle", "confidence")], axis=1)
        outlines = [None] * len(one) if one.corners is None else np.round(one.corners, 2).tolist()
        for values, status, by_hand, outline in zip(
            numbers.tolist(), one.status.tolist(), one.by_hand.tolist(), outlines, strict=True
        ):
            known = [None if math.isnan(value) else value for value in values]
            found.append([*known, status, by_hand, None if outline is None or math.isnan(outline[0][0]) else outline])
    return found
