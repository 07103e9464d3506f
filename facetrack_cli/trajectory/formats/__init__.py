"""Trajectories and ground truth as other tools write and read them: each format is declared here, and here alone.

The functions of a format `x` are `read_x` and `write_x` of its module, which is loaded when they are called.
"""

from collections.abc import Callable
from importlib import import_module
from typing import Any, Final, Literal, NamedTuple

READERS: Final = {
    **dict.fromkeys(("facetrack", "boxes", "otb", "got10k", "mot", "vot", "pts"), "boxes"),
    "cvat": "annotation",
}
"""The formats of ground truth, and the module of each: `read_x(path, shift=0)`."""
TRUTH_FORMATS: Final = ("auto", *READERS)


class Export(NamedTuple):
    """A format that is written: its module, the ending of its files, and its line in the help.

    `takes` names the arguments of its function, as `content` of `runs/export.py` makes them: what a format needs of the
    clip, and which options it has, follow from them.
    """

    module: str
    ending: str
    takes: str
    about: str


EXPORTS: Final = {
    "csv-wide": Export("tables", "wide.csv", "table", "CSV with one row a frame, for spreadsheets"),
    "pose": Export("tables", "pose.csv", "table", "CSV of the head's pitch, yaw and roll, with their spread"),
    "measures": Export("tables", "measures.csv", "clips many", "CSV of mouth, brows, lids, pose, hands, with spreads"),
    "events": Export("tables", "events.csv", "clips", "CSV of when mouths open, eyes blink, heads nod, hands move"),
    "boris": Export("tables", "boris", "clips written", "the same as a project of BORIS 8, a clip an observation"),
    "srt": Export("tables", "srt", "table", "the same as subtitles (SubRip), of one run"),
    "vtt": Export("tables", "vtt", "table", "the same as subtitles (WebVTT), of one run"),
    "textgrid": Export("tables", "TextGrid", "table", "the same as a TextGrid of Praat, of one run"),
    "openface": Export("tables", "openface.csv", "table size", "OpenFace's CSV: confidence, pose, landmarks"),
    "mot": Export("boxes", "mot.txt", "boxes", "MOTChallenge: frame, id, box, confidence; all from 1"),
    "otb": Export("boxes", "otb.txt", "box", "OTB boxes, one a line, pixels from 1; one target"),
    "got10k": Export("boxes", "got10k.txt", "box", "GOT-10k boxes, one a line, pixels from 1; one target"),
    "vot": Export("boxes", "vot.txt", "box", "VOT result, one region a line, pixels from 0; one target"),
    "coco": Export("tables", "coco.json", "table frame_size file_name around", "COCO: boxes and keypoints"),
    "dlc": Export("tables", "dlc.csv", "table scorer", "DeepLabCut CSV: x, y, likelihood of every point"),
    "dlc-h5": Export("tables", "dlc.h5", "table scorer", "the same as DeepLabCut's HDF5; needs pandas and PyTables"),
    "eaf": Export("annotation", "eaf", "table video folder written", "ELAN: what was lost, what head, face, hands did"),
    "cvat": Export("annotation", "cvat.xml", "table size name", "CVAT for video 1.1: a track a part, to correct"),
    "labelstudio": Export("annotation", "labelstudio.json", "table frame_size fps name", "Label Studio's rectangles"),
}
"""The formats that are written, in the order of the help."""
ALIASES: Final = {"elan": "eaf"}
_SIZED = {"size", "frame_size", "video"}
OF_MEDIA: Final = tuple(form for form, export in EXPORTS.items() if _SIZED & {*export.takes.split()})
"""The formats whose function asks for something of the clip."""


def load(verb: Literal["read", "write"], form: str) -> Callable[..., Any]:
    """The function that reads or writes a format, one of READERS, or of EXPORTS.

    A reader takes a path and `shift`, which is added to every frame number. It returns a Trajectory, in frames and
    pixels from 0, whose `header["read_as"]` says how it was read. A writer takes what `Export.takes` names, and returns
    text or bytes. Both raise InputError, with the line if there is one, for what has no room.
    """
    module = import_module(f"{__name__}.{READERS[form] if verb == 'read' else EXPORTS[form].module}")
    function: Callable[..., Any] = getattr(module, f"{verb}_{form.replace('-', '_')}")
    return function
