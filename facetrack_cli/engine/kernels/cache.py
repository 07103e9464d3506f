"""The folder of compiled kernels.

numba keeps them in the package's folder or the user's cache, and fails if it can write to neither: then this file names
a third folder, for this process alone. numba reads NUMBA_CACHE_DIR when it is imported, so the package sets it first.
"""

import os
from os import path


def provide_cache() -> None:
    """Set NUMBA_CACHE_DIR, if needed, to a temporary folder of this process: the next one compiles again."""
    package = path.dirname(path.abspath(__file__))  # noqa: PTH100, PTH120 -- pathlib takes longer to load than --help
    if "NUMBA_CACHE_DIR" in os.environ or _writable(path.join(package, "__pycache__")):  # noqa: PTH118
        return
    user = os.environ.get("XDG_CACHE_HOME") or path.expanduser("~/.cache")  # noqa: PTH111
    if path.isabs(user) and _writable(user):  # noqa: PTH117
        return
    import atexit
    import shutil
    import tempfile

    os.environ["NUMBA_CACHE_DIR"] = folder = tempfile.mkdtemp(prefix="facetrack-kernels-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)


def _writable(folder: str) -> bool:
    """Whether a file can be put into the folder, or the folder be made."""
    while not path.lexists(folder) and path.dirname(folder) != folder:  # noqa: PTH120
        folder = path.dirname(folder)  # noqa: PTH120
    return path.isdir(folder) and os.access(folder, os.W_OK | os.X_OK)  # noqa: PTH112
