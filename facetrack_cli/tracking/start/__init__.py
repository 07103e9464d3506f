"""Where a track begins: an init file, a box, or a face that a detector finds."""

from facetrack_cli.tracking.start.checks import check_size, check_start
from facetrack_cli.tracking.start.detectors import PARTS
from facetrack_cli.tracking.start.init_file import default_path, find_init, read_init, write_init
from facetrack_cli.tracking.start.search import box_start, search_start
from facetrack_cli.tracking.start.targets import name_targets

__all__ = ["PARTS", "box_start", "check_size", "check_start", "default_path", "find_init", "search_start"]
__all__ += ["name_targets", "read_init", "write_init"]
