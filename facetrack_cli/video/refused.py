"""Why a file is no video: what can be told before it is opened, and after it gave no frame."""

from pathlib import Path

from facetrack_cli.core.errors import InputError, reason
from facetrack_cli.video import ffmpeg
from facetrack_cli.video.playlists import is_playlist

AGAIN = "copy or download it again"


def check_file(path: Path) -> None:
    """Raise InputError for what can be told without looking for a video in it."""
    try:
        str(path).encode()
        if not path.exists():
            hint = "a pipe cannot be read, save the clip to a file" if str(path) == "-" else "check the name"
            raise InputError(f"{path}: no such file or folder; {hint}")
        if not path.is_file():
            raise InputError(f"{path}: neither a file nor a folder; save the clip to a file")
        with path.open("rb") as file:
            if not file.read(1):
                raise InputError(f"{path}: the file is empty; {AGAIN}")
        if is_playlist(path):
            raise InputError(f"{path}: a playlist, which names other files; give the videos that it names")
    except UnicodeEncodeError:  # OpenCV would end the process over it
        raise InputError(f"{path}: the name holds bytes that are no UTF-8 text; rename the file") from None
    except OSError as error:
        raise InputError(f"{path}: {reason(error)}; check the name and the permissions") from error


def why_not(path: Path) -> InputError:
    """Why a file gave no frame."""
    try:
        video, audio, messages = ffmpeg.contents(path)
    except (OSError, RuntimeError):
        return InputError(f"{path}: no video that can be decoded; convert it to MP4 (H.264)")
    # ffmpeg guesses MP4 from the name alone, so that any text called .mp4 lacks its moov
    video = video.replace("ansi", "")
    if "moov atom not found" in messages and "low score" not in messages:
        why = f"the index of this MP4 (moov) is missing, its recording or download was cut off; {AGAIN}"
    elif video and not ffmpeg.ending(path)[-1]:
        why = "the video cannot be decoded; convert it to MP4 (H.264)"
    elif audio and not video:
        why = "holds sound but no video; give a video"
    elif video or ffmpeg.container(path) in ("mp4", "avi", "matroska"):
        why = f"cut short or damaged before its first frame; {AGAIN}"
    else:
        why = "not a video; give a video file or a folder of images"
    return InputError(f"{path}: {why}")
