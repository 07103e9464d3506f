"""Track faces and facial features in video with particle filters."""

__version__ = "0.1.0"
