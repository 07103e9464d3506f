"""Track faces, facial features, heads and hands in video with particle filters."""

from facetrack_cli.tracking.kernels.cache import provide_cache

__version__ = "0.1.0"

provide_cache()
