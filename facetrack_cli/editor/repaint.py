"""The annotated video painted anew from the rows; the particles are not in them, and are not drawn."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.editor.retrack import Report, StoppedError
from facetrack_cli.editor.run_folder import Run
from facetrack_cli.trajectory.diagnostics import outlines
from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory, by_frame, recorded
from facetrack_cli.video.overlay.overlay import Overlay
from facetrack_cli.video.source import open_source
from facetrack_cli.video.writer import VideoWriter


def repaint(
    run: Run,
    rows: Trajectory,
    *,
    report: Report = lambda done, total: None,
    stop: Callable[[], bool] = lambda: False,
) -> tuple[str, ...]:
    """Write the video of a run `beside` the one that it has, and say what could not be kept of it, a line each.

    Raises StoppedError once `stop` says so, InputError if the clip lacks frames of the run; nothing is written then.
    """
    total = run.last - run.first + 1
    done = 0
    with open_source(run.clip, fps=run.fps, start=run.first, stop=run.last + 1) as source:
        overlay = Overlay(source.size, fps=float(source.fps), title=run.recipe.name)
        sound = source.path if source.is_video else None
        assert run.video is not None
        video = VideoWriter(run.video, source.size, source.fps, audio_from=sound, replace=False)
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


def cells(rows: Trajectory, first: int, stop: int) -> list[list[list[Any]]]:
    """The rows of the frames from `first` to before `stop` as the page has them.

    Of each frame and part: x, y, w, h, angle, confidence, status, whether it is by hand, corners.
    """
    some = rows.between(first, stop)
    numbers = np.stack([getattr(some, name) for name in ("x", "y", "w", "h", "angle", "confidence")], axis=1).tolist()
    found = outlines(some)
    shapes: list[Any] = [None] * len(some)
    if found is not None:
        shapes = [None if math.isnan(shape[0][0]) else shape for shape in np.round(found, 2).tolist()]
    lines = [
        [*(None if math.isnan(value) else value for value in row), *others]
        for row, *others in zip(numbers, some.status.tolist(), some.by_hand.tolist(), shapes, strict=True)
    ]
    return [[lines[i] for i in at] for _, at in by_frame(some)]
