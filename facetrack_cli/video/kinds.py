"""What a file is by its name, and where that does not say it by its first bytes: a clip of its own, or an image."""

from pathlib import Path
from typing import Final

from facetrack_cli.video import images
from facetrack_cli.video.archive import holds_images, is_archive

_KINDS: Final = (
    "3g2 3gp apng asf avi divx dv f4v flv gif m2ts m2v m4v mj2 mjpeg mjpg mkv mov mp4 mpe mpeg mpg mts mxf ogm ogv qt "
    "rm rmvb ts vob webm wmv y4m"
)
_VIDEOS: Final = frozenset(f".{kind}" for kind in _KINDS.split())


def is_clip(path: Path) -> bool:
    """Whether a file that is found in a folder is a clip: a video, an animation, or an archive of images."""
    suffix = path.suffix.lower()
    named = suffix in _VIDEOS or (suffix == ".zip" and holds_images(path)) or images.is_animated(path)
    return named and path.is_file()


def is_image(path: Path) -> bool:
    """Whether a file is a single image."""
    return path.suffix.lower() in images.SUFFIXES and not images.is_animated(path)


def brings_rate(clip: Path) -> bool:
    """Whether a clip has a frame rate of its own, as all have but images: of a folder, a glob, an archive, or alone."""
    several = clip.is_dir() or images.listing(clip) is not None or is_archive(clip)
    return not several and not is_image(clip)
