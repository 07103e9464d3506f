"""The valid inputs that cases damage: a clip of a few frames, a run of it, and a file of every kind."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from ruamel.yaml import YAML

from facetrack_cli.__main__ import main
from facetrack_cli.core.models import shipped_recipes
from tests.support.media import write_video
from tests.support.samples import FOLDER, read_pictures

FRAMES = 5
RECIPES = {path.stem: path.read_text(encoding="utf-8") for path in shipped_recipes()}
# the formats that ground truth comes in, by the name of --truth-format
TRUTHS = {"facetrack": "truth.csv", "boxes": "boxes.csv", "pts": "pts"}
TRUTHS |= {name: f"{name}.txt" for name in ("otb", "got10k", "mot", "vot")}
CORRECTED = """\
frame: 0
face:
  box: [115, 58, 113, 113]
  points: {nose: [171.32, 128.93], mouth_left: [149.43, 153.19], mouth_right: [194.57, 152.28], lip_upper: [170.86, 149.45], lip_lower: [171.32, 160.40]}
corrections:
  - frame: 2
    face:
      points: {nose: [171.5, 129]}
      kept: [mouth_left, mouth_right]
      absent: [lip_upper]
      learn: false
"""  # noqa: E501


PEOPLE = {
    "format": "facetrack-people",
    "version": 1,
    "fps": 25.0,
    "shots": [{"first": 0, "stop": None}],
    "people": [{"name": "face", "seconds": 0.2, "p": 0.9, "intervals": [[0, FRAMES]], "still": "people/1.jpg"}],
    "tracks": [{"person": "face", "first": 0, "stop": FRAMES, "p": 0.9, "doubt": True, "still": "people/2.jpg"}],
    "corrections": ["rename person_1=face"],
}


class Bench(NamedTuple):
    """Files that are as they should be."""

    folder: Path

    def path(self, name: str) -> Path:
        return self.folder / name

    def text(self, name: str) -> str:
        return self.path(name).read_text(encoding="utf-8")

    def tree(self, name: str) -> Any:
        return YAML(typ="safe", pure=True).load(self.text(name))

    def arrays(self, name: str) -> dict[str, np.ndarray]:
        with np.load(self.path(name)) as file:
            return {key: file[key] for key in file.files}


def make(folder: Path, *, warm: bool) -> Bench:
    """Write the files. The commands that do so run here, so that what they load is loaded, and compiled, once; if
    `warm`, those of every family of recipes do.
    """
    pictures = read_pictures("occlusion")[:FRAMES]
    (folder / "frames").mkdir()
    for index, picture in enumerate(pictures):
        assert cv2.imwrite(str(folder / "frames" / f"{index}.png"), picture)
    write_video(folder / "clip.mp4", frames=pictures)
    for name in ("clip", "frames"):
        shutil.copy(FOLDER / "occlusion.init.yaml", folder / f"{name}.init.yaml")
    (folder / "corrected.init.yaml").write_text(CORRECTED, encoding="utf-8")
    for name, text in RECIPES.items():
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    lines = (FOLDER / "occlusion.truth.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    (folder / "truth.csv").write_text("".join(lines[: 1 + 5 * FRAMES]), encoding="utf-8")
    shutil.copy(FOLDER / "people.npz", folder / "gallery.npz")
    shutil.copy(FOLDER.parent / "configs" / "mouth_prior.npz", folder / "prior.npz")
    shutil.copy(FOLDER.parent / "configs" / "calibration" / "factorized_robust.json", folder / "calibration.json")
    clip, run, box = str(folder / "clip.mp4"), str(folder / "run"), str(folder / "box")
    shared = ["--threads", "1", "-q"]
    kept = ["--format", "csv,json,jsonl", "--smooth"]
    done(["run", clip, "--config", "factorized_robust", "-o", run, *kept, *shared])
    done(["run", clip, "--config", "histogram", "--box", "115,58,113,113", "-o", box, "--no-video", *shared])
    done(["run", clip, "--config", "adaptive", "--box", "115,58,113,113", "-o", f"{box}2", "--no-video", *shared])
    for kind in ("otb", "got10k", "mot", "vot"):
        done(["export", box, "--to", kind, "-o", str(folder / f"{kind}.txt")])
    (folder / "people.json").write_text(json.dumps(PEOPLE), encoding="utf-8")
    left = "\n".join(f"{t},115,58,113,113" for t in range(FRAMES))
    (folder / "boxes.csv").write_text(f"frame,x,y,w,h\n{left}\n", encoding="utf-8")
    (folder / "pts").mkdir()
    points = "\n".join(f"{100 + i}.5 {100 + 2 * i}.25" for i in range(68))
    for t in range(FRAMES):
        text = f"version: 1\nn_points: 68\n{{\n{points}\n}}\n"
        (folder / "pts" / f"{t + 1:06d}.pts").write_text(text, encoding="utf-8")
    (folder / "people").mkdir()
    for person in ("anna", "ben"):
        (folder / "people" / person).mkdir()
        for index in range(2):
            shutil.copy(FOLDER / "gallery" / "ines" / f"{index + 1}.jpg", folder / "people" / person)
    (folder / "goldens").mkdir()
    shutil.copy(FOLDER / "goldens" / "occlusion.factorized.json", folder / "goldens")
    if warm:
        warm_up(folder)
    return Bench(folder)


def warm_up(folder: Path) -> None:
    """Load what the commands load when they are called: in each case that is taken from here."""
    out = folder / "warm"
    out.mkdir()
    done(["eval", str(folder / "run"), "--truth", str(folder / "truth.csv"), "--csv", str(out / "x.csv")])
    done(["plot", str(folder / "run"), "-o", str(out / "x.png"), "--truth", str(folder / "truth.csv")])
    done(["report", str(folder / "run"), "-o", str(out / "x.html"), "-q"])
    done(["prior", "show", str(folder / "prior.npz"), "-o", str(out / "prior.png")])
    # of every family of recipes, or the first case of each would take as long as its kernels take to compile
    once = ["run", str(folder / "frames"), "--no-video", "-q", "--threads", "1", "--stop", "3"]
    for name in ("face", "independent", "sir", "auxiliary_prior"):
        done([*once, "--config", name, "-o", str(out / name)])
    of_boxes = ("contour_histogram_correlation_robust", "contour_correlation", "skin_ncc_robust", "correlation_filter")
    for name in (*of_boxes, "adaptive_recognition"):
        more = ["--gallery", str(folder / "gallery.npz")] if name == "adaptive_recognition" else []
        done([*once, "--config", name, "--box", "115,58,113,113", "-o", str(out / name), *more])


def done(argv: list[str]) -> None:
    assert main(argv) == 0, argv
