"""The ffmpeg program of imageio-ffmpeg, which writes MP4."""

import contextlib
import re
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import imageio_ffmpeg

_CAUSE = re.compile(
    "No space left on device|Disk quota exceeded|File too large|Read-only file system|Input/output error|"
    "Permission denied"
)
_PREFIX = re.compile(r"^(?:\[[^\]]*\] )+")


def source_argument(path: Path) -> str:
    """The path as ffmpeg must be given it: absolute, so that no name reads as an option or a protocol."""
    return str(path.absolute())


def cause(text: str) -> str:
    """The cause of a failure in ffmpeg's messages: the error of the system if there is one, else their last line."""
    system = _CAUSE.search(text)
    lines = [_PREFIX.sub("", line).strip() for line in text.splitlines()]
    lines = [line for line in lines if line and not line.startswith(("Last message repeated", "Conversion failed"))]
    return system.group() if system else "".join(lines[-1:])


class Program(contextlib.AbstractContextManager["Program"]):
    """A running ffmpeg, which the terminal's Ctrl-C does not reach. OSError or RuntimeError if it cannot be started."""

    def __init__(self, arguments: Sequence[str], *, stdin: int = subprocess.DEVNULL, stdout: int = subprocess.DEVNULL):
        words = [imageio_ffmpeg.get_ffmpeg_exe(), "-nostdin", "-hide_banner", *arguments]
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - a file and not a pipe, which somebody would have to empty
        try:
            self.child = subprocess.Popen(words, stdin=stdin, stdout=stdout, stderr=self._said, start_new_session=True)
        except BaseException:
            self._said.close()
            raise

    def messages(self) -> str:
        """What it has printed to stderr, once it has ended."""
        self.child.wait()
        self._said.seek(0)
        return self._said.read().decode("utf-8", "replace")

    def __exit__(self, *_: object) -> None:
        self.child.kill()  # harmless where it has ended
        with contextlib.suppress(OSError):  # what a pipe still held is lost
            self.child.__exit__(None, None, None)  # closes the pipes and waits
        self._said.close()


def run(arguments: Sequence[str]) -> tuple[int, str]:
    """Run ffmpeg to its end: exit code and messages."""
    with Program(arguments) as program:
        return program.child.wait(), program.messages()
