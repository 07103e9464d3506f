"""Track faces, facial features, heads and hands in video with particle filters.

    import facetrack_cli as facetrack

    nose = facetrack.track_video("clip.mp4", "factorized").find("face", "nose")
    nose.frame, nose.x, nose.y, nose.confidence             # NumPy arrays, a row a frame
    recipe = facetrack.load_recipe("sir", {"filter.particles": 500})
    with facetrack.Recording("out", recipe) as out:         # the files that `facetrack run` writes
        for result in facetrack.track_frames(images, recipe):   # any iterable of images, as a webcam
            out.write(result)
            image = facetrack.draw(result)                  # a new image with what the tracker says
    tracker = facetrack.Tracker("face")                     # one image at a time, as in a service
    result = tracker.update(image, time_s)                  # None until a face is found
    facetrack.read_trajectory("clip-sir").to_pandas()       # what `facetrack run` wrote
    facetrack.plot(facetrack.read_trajectory("clip-sir"))   # a figure of matplotlib
    facetrack.export(facetrack.read_trajectory("clip-sir"), "eaf", "clip.eaf")  # as other programs read it

docs/python.md has the whole of it.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from facetrack_cli.core import __version__ as __version__
from facetrack_cli.engine.kernels.cache import provide_cache

if TYPE_CHECKING:
    from facetrack_cli.core.errors import FacetrackError, InputError, RecipeError
    from facetrack_cli.core.types import Frame, Start, TargetStart
    from facetrack_cli.recipe.load import load_recipe
    from facetrack_cli.report.figures.page import page_figure as plot
    from facetrack_cli.run_folder.manifest import read_run as read_trajectory
    from facetrack_cli.runs.api import Recording, Tracker, draw, track_frames, track_video
    from facetrack_cli.runs.export import annotated_video, export
    from facetrack_cli.trajectory.formats.boxes import read_truth
    from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory
    from facetrack_cli.video.overlay import Overlay

__all__ = [
    "FacetrackError",
    "Frame",
    "FrameResult",
    "InputError",
    "Overlay",
    "RecipeError",
    "Recording",
    "Start",
    "TargetStart",
    "Tracker",
    "Trajectory",
    "annotated_video",
    "draw",
    "export",
    "load_recipe",
    "plot",
    "read_trajectory",
    "read_truth",
    "track_frames",
    "track_video",
]

_PLACES = {
    "core.errors": ("FacetrackError", "InputError", "RecipeError"),
    "core.types": ("Frame", "Start", "TargetStart"),
    "recipe.load": ("load_recipe",),
    "report.figures.page": ("page_figure",),
    "run_folder.manifest": ("read_run",),
    "runs.api": ("Recording", "Tracker", "draw", "track_frames", "track_video"),
    "runs.export": ("annotated_video", "export"),
    "trajectory.formats.boxes": ("read_truth",),
    "trajectory.trajectory": ("FrameResult", "Trajectory"),
    "video.overlay": ("Overlay",),
}


def __getattr__(name: str) -> Any:
    """The public names, imported when they are first used: numba and OpenCV take half a second."""
    own_name = {"read_trajectory": "read_run", "plot": "page_figure"}.get(name, name)
    for module, names in _PLACES.items():
        if own_name in names:
            return getattr(import_module(f"facetrack_cli.{module}"), own_name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


provide_cache()
