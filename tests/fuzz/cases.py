"""A case from its name: the kind of input, and the seed of the damage to it."""

from __future__ import annotations

import io
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from random import Random

import click
import numpy as np

from facetrack_cli.cli.app import COMMANDS, cli
from tests.fuzz import hostile
from tests.fuzz.bench import RECIPES, TRUTHS, Bench
from tests.fuzz.judge import Case
from tests.fuzz.named import NAMED

BOX = ["--box", "115,58,113,113"]
RUN = ["-o", "out", "--no-video", "-q", "--threads", "1", "--stop", "3"]
TO = ("mot", "otb", "got10k", "vot", "coco", "dlc", "eaf")

Build = Callable[[Random, Bench, Case], list[str]]


def build(name: str, bench: Bench, folder: Path) -> Case:
    """The case of a name such as `init-17`, its files written into `folder`. KeyError for a kind that there is not."""
    case = Case(name, folder)
    make = NAMED.get(name) or KINDS[name.rpartition("-")[0]]
    case.argv = make(Random(name), bench, case)
    return case


def names(count: int, first: int = 0) -> list[str]:
    """The names of `count` cases, of all kinds in turn, from the seed `first` on."""
    kinds = list(KINDS)
    return [f"{kinds[i % len(kinds)]}-{first + i // len(kinds)}" for i in range(count)]


def _damaged(rng: Random, bench: Bench, name: str) -> bytes:
    """A text file that is a tree too, damaged as one or the other."""
    if rng.random() < 0.6:
        return hostile.text(rng, bench.text(name))
    return hostile.tree(rng, bench.tree(name))


def _init(rng: Random, bench: Bench, case: Case) -> list[str]:
    file = case.put(rng.choice(("x.init.yaml", "x.init.json")), _damaged(rng, bench, "corrected.init.yaml"))
    if rng.random() < 0.3:
        shutil.copytree(bench.path("run"), case.folder / "run")
        return ["fix", "run", "--init", file, "--no-video", "-q"]
    config = rng.choice(("factorized", "factorized_robust", "histogram", "mosse", "head_hands", "signer"))
    return ["run", str(bench.path("frames")), "--init", file, "--config", config, *RUN]


def _recipe(rng: Random, bench: Bench, case: Case) -> list[str]:
    file = case.put("x.yaml", _damaged(rng, bench, f"{rng.choice(list(RECIPES))}.yaml"))
    if rng.random() < 0.8:
        return ["recipes", "check", file]
    case.named = (file, "--gallery", "--box")
    return ["run", str(bench.path("frames")), "--config", file, *BOX, *RUN, "--stop", "2"]


def _override(rng: Random, bench: Bench, case: Case) -> list[str]:
    keys = "filter.particles motion.sigma likelihood.sigma confidence.calibration prior.file seed x.y "
    key = rng.choice(keys.split(" "))
    given = f"{key}={rng.choice(hostile.NUMBERS + hostile.WORDS)}".replace("\x00", "")
    return ["recipes", "check", rng.choice(list(RECIPES)), "--set", given]


def _trajectory(rng: Random, bench: Bench, case: Case) -> list[str]:
    kind = rng.choice(("csv", "json", "jsonl"))
    of = rng.choice(("run", "run", "box", "box2"))
    text = bench.text(f"{of}/trajectory.{'json' if kind == 'jsonl' and of != 'run' else kind}")
    if kind == "json" and rng.random() < 0.5:
        content = hostile.tree(rng, bench.tree(f"{of}/trajectory.json"))
    else:
        content = hostile.text(rng, text)
    file = case.put(f"trajectory.{kind}", content)
    return _read(rng, bench, case, file)


def _read(rng: Random, bench: Bench, case: Case, file: str) -> list[str]:
    """A command that reads a trajectory."""
    truth = ["--truth", str(bench.path("truth.csv"))]
    how = rng.randrange(10)
    if 5 <= how < 8:
        case.named = (file, "truth.csv")
    elif how < 5:
        case.named = (file, "--target")
    if how < 5:
        return ["export", file, "--to", rng.choice(TO), "-o", rng.choice(("-", "out.txt"))]
    if how < 8:
        return ["eval", file, *truth, *rng.choice(([], ["--partial"], ["--json", "out.json"], ["--csv", "-"]))]
    return ["plot", file, "-o", "out.png", "--dpi", "40"]


def _truth(rng: Random, bench: Bench, case: Case) -> list[str]:
    kind = rng.choice(list(TRUTHS))
    form = rng.choice(([], ["--truth-format", kind], ["--truth-format", rng.choice(list(TRUTHS))]))
    name = TRUTHS[kind]
    if kind == "pts":
        shutil.copytree(bench.path("pts"), case.folder / "pts")
        file = f"pts/{rng.choice(('000001', '000003', '0', '99999999999999999999', 'x'))}.pts"
        case.put(file, hostile.text(rng, bench.text("pts/000001.pts")))
        case.named = (*case.named, "pts")
        file = rng.choice((file, "pts"))
    else:
        file = case.put(name, hostile.text(rng, bench.text(name)))
    if kind == "facetrack" and rng.random() < 0.4:
        return ["prior", "fit", file, "-o", "out.npz", *rng.choice(([], ["-q"]))]
    ours = str(bench.path("run" if kind in ("facetrack", "pts") else "box"))
    return ["eval", ours, "--truth", file, *form, *rng.choice(([], ["--partial"], ["--shift", "1"]))]


def _results(rng: Random, bench: Bench, case: Case) -> list[str]:
    """Of another tracker."""
    kind = rng.choice(("otb", "got10k", "mot", "vot", "boxes"))
    file = case.put("results.txt", hostile.text(rng, bench.text(TRUTHS[kind])))
    case.named = (file, "boxes.csv")
    return ["eval", file, "--truth", str(bench.path("boxes.csv")), *rng.choice(([], ["--format", kind]))]


def _gallery(rng: Random, bench: Bench, case: Case) -> list[str]:
    file = case.put("x.npz", hostile.arrays(rng, bench.arrays("gallery.npz")))
    if rng.random() < 0.15:
        return ["gallery", "show", file, "-o", "out.png"]
    return ["run", str(bench.path("frames")), "--config", "adaptive_recognition", "--gallery", file, *BOX, *RUN]


def _prior(rng: Random, bench: Bench, case: Case) -> list[str]:
    file = case.put("x.npz", hostile.arrays(rng, bench.arrays("prior.npz")))
    if rng.random() < 0.3:
        return ["prior", "show", file, "-o", "out.png"]
    return ["run", str(bench.path("frames")), "--config", "factorized", "--set", f"prior.file={file}", *RUN]


def _calibration(rng: Random, bench: Bench, case: Case) -> list[str]:
    file = case.put("x.json", _damaged(rng, bench, "calibration.json"))
    return ["run", str(bench.path("frames")), "--config", "factorized", "--set", f"confidence.calibration={file}", *RUN]


def _run_folder(rng: Random, bench: Bench, case: Case) -> list[str]:
    shutil.copytree(bench.path("run"), case.folder / "run")
    name = rng.choice(("trajectory.json", "trajectory.json", "trajectory.csv", "annotated.mp4"))
    if rng.random() < 0.15:
        (case.folder / "run" / name).unlink()
    elif name == "annotated.mp4":
        case.put(f"run/{name}", hostile.data(rng, bench.path(f"run/{name}").read_bytes()))
    elif name == "trajectory.json" and rng.random() < 0.5:
        case.put(f"run/{name}", hostile.tree(rng, bench.tree(f"run/{name}")))
    else:
        case.put(f"run/{name}", hostile.text(rng, bench.text(f"run/{name}")))
    case.named = (*case.named, "run", "x.init.yaml", *(("clip.mp4",) if name == "trajectory.json" else ()))
    if rng.random() < 0.8:
        (case.folder / "x.init.yaml").write_text(bench.text("corrected.init.yaml"))
        return ["fix", "run", "--init", "x.init.yaml", "--no-video", "-q"]
    return ["report", "run", "-o", "out.html", "-q"]


def _people(rng: Random, bench: Bench, case: Case) -> list[str]:
    shutil.copytree(bench.path("run"), case.folder / "run")
    case.put("run/people.json", _damaged(rng, bench, "people.json"))
    case.named = (*case.named, "run", "--rename", "--merge", "--split")
    more = (["--json"], ["--csv"], ["--rename", "face=Ann"], ["--merge", "face=face"], ["--split", "face@2f"])
    if rng.random() < 0.3:
        return ["report", "run", "-o", "out.html", "-q"]
    words = rng.choice((*more, []))
    case.files = {} if words and words[0].startswith(("--re", "--me", "--sp")) else case.files  # which it corrects
    return ["people", "run", "--no-video", "-q", *words]


def _image(rng: Random, bench: Bench, case: Case) -> list[str]:
    content = bench.path("frames/1.png").read_bytes()
    if rng.random() < 0.4:
        import cv2

        picture = cv2.imread(str(bench.path("frames/1.png")))
        changed = rng.choice(
            (picture[:1, :1], picture[:, :7], picture[..., 0], picture.astype(np.uint16) * 257, picture * 0)
        )
        content = cv2.imencode(rng.choice((".png", ".jpg", ".bmp", ".tiff")), changed)[1].tobytes()
    if rng.random() < 0.2:
        file = io.BytesIO()
        np.save(file, np.zeros(3))
        content = file.getvalue()
    content = hostile.data(rng, content) if rng.random() < 0.7 else content
    if rng.random() < 0.3:
        shutil.copytree(bench.path("people"), case.folder / "people")
        case.put(f"people/anna/{rng.choice(('1.jpg', 'z.png', '..jpg'))}", content)
        case.named = (*case.named, "people")
        return ["gallery", "fit", "people", "-o", "out.npz", "-q"]
    shutil.copytree(bench.path("frames"), case.folder / "frames")
    case.put(f"frames/{rng.choice(('0', '1', '1', '00', '-1', '9' * 30, 'x', '1.2'))}.png", content)
    case.named = (*case.named, "frames")
    return ["run", "frames", "--init", str(bench.path("frames.init.yaml")), "--config", "factorized", *RUN]


def _video(rng: Random, bench: Bench, case: Case) -> list[str]:
    """Tiny files that are no video; damaged ones have a corpus of their own."""
    suffix = rng.choice(("mp4", "avi", "mkv", "png", "txt", "npz", ""))
    name = case.put(f"clip.{suffix}", hostile.data(rng, b"\0\0\0\x20ftypisom" * 9))
    return rng.choice((["run", name, *BOX, *RUN], ["init", name, "-o", "out.yaml"]))


def _golden(rng: Random, bench: Bench, case: Case) -> list[str]:
    (case.folder / "clips").mkdir()
    shutil.copy(bench.path("clip.mp4"), case.folder / "clips" / "occlusion.mp4")
    file = "goldens/occlusion.factorized.json"
    case.put(f"clips/{file}", _damaged(rng, bench, file))
    case.named = (*case.named, "clips", "occlusion")
    return ["regress", "clips", "-q"]


def _place(rng: Random, bench: Bench, case: Case) -> list[str]:
    """Something else stands where a file is to be."""
    name = "x" + rng.choice((".yaml", ".json", ".csv", ".npz", ".txt", ".mp4", ".png", ".jsonl", ""))
    path, how = case.folder / name, rng.randrange(8)
    case.named = (name,)
    if how == 0:
        path.mkdir()
    elif how == 1:
        path.symlink_to(name)
    elif how == 2:
        path.symlink_to("nowhere")
    elif how == 3:
        path.write_bytes(b"")
    elif how == 4:
        path.write_text("x")
        path.chmod(0)
    elif how == 5:
        long = ("x" * 300 + ".csv", "x/" * 3000 + "x.csv")
        name = rng.choice((*long, "", " ", "\udcff.csv", "x\ny.csv", "\x1b[31m.csv", "~", "/proc/self/mem"))
        case.named = ()
    elif how == 6:
        name = "x/y/z" + path.suffix
        path.with_name("x").write_text("a file")
        case.named = ("x/y",)
    else:
        case.named = (name,)  # nothing
    if os.sep not in name and how == 5 and rng.random() < 0.5 and 0 < len(name) < 99:
        (case.folder / name).write_text("frame,x,y\n")
    return _reading(rng, bench, name)


def _reading(rng: Random, bench: Bench, name: str) -> list[str]:
    """Any command, told to read `name`."""
    run, clip, truth = (str(bench.path(one)) for one in ("run", "frames", "truth.csv"))
    one = f"run {clip} --config factorized --no-video -q --threads 1 --stop 3"
    every = f"""
        {one} --init @
        {one} --set prior.file=@
        {one} --set confidence.calibration=@
        {one} --gallery @
        run {clip} --no-video -q --stop 3 --config @
        run {clip} --no-video -q --stop 3 --config adaptive_recognition --box 115,58,113,113 --gallery @
        run @ --no-video -q --stop 3
        recipes check @
        recipes show @
        init @
        prior show @
        prior fit @
        gallery show @
        gallery fit @
        eval @ --truth {truth}
        eval {run} --truth @
        export @ --to mot
        export {run} --to coco -o out.json --media @
        plot @
        plot {run} -o out.png --truth @
        report @
        report {run} -o out.html --clip @
        fix @ --init {truth}
        fix {run} --init @
        regress @
        compare @ --config sir
        compare {clip} --config mil --stop 2 --truth @
    """
    return [word.replace("@", name) for word in rng.choice(every.strip().splitlines()).split()]


_PAGE = {"pick", "browse", "debug", "help", "version"}
_WORK = {"seeds", "jobs"}  # to ask for a million runs is no fault


def _arguments(rng: Random, bench: Bench, case: Case) -> list[str]:
    """A command that is right, and options of it that are not."""
    run, clip, truth = (str(bench.path(one)) for one in ("run", "frames", "truth.csv"))
    begins = f"""
        run {clip} --no-video -q --threads 1 --stop 3 -o out
        run {clip} --box 115,58,113,113 --no-video -q --threads 1 --stop 3 -o out
        init {clip} --box 115,58,113,113 -o out.yaml
        eval {run} --truth {truth}
        plot run
        export run --to {rng.choice(TO)}
        report run
        fix run --init {bench.path("corrected.init.yaml")}
        recipes check sir
        regress {bench.folder}
        prior fit {truth}
        prior show {bench.path("prior.npz")} -o out.png
        gallery fit {bench.path("people")}
        gallery show {bench.path("gallery.npz")} -o out.png
        compare {clip} --stop 2 --seeds 2
    """
    argv = rng.choice(begins.strip().splitlines()).split()
    if argv[1] == "run":  # what is written goes into the case's folder
        shutil.copytree(bench.path("run"), case.folder / "run")
    known = cli.get_command(click.Context(cli), argv[0])
    if isinstance(known, click.Group):
        known = known.get_command(click.Context(known), argv[1])
    assert known is not None
    options = [one for one in known.params if isinstance(one, click.Option) and not _PAGE & {one.name}]
    for one in rng.choices(options, k=rng.choice((1, 1, 2, 4))):
        argv = [*argv, rng.choice(one.opts)]
        if not one.is_flag and rng.random() < 0.97:
            argv.append(_value(rng, one))
    if rng.random() < 0.1:
        argv = [one for one in argv if rng.random() < 0.8] or ["x"]
    return argv


def _value(rng: Random, one: click.Option) -> str:
    if one.name == "out":  # within the case's folder
        odd = ("", "-", "/dev/null", "/dev/full", ".", "x" * 300, "x/" * 3000, "\udcff", "x\ny", "\x1b[31m")
        return rng.choice((*odd, "out", "a/b/c", "x.png", "x.npz", "x.yaml"))
    if one.name in _WORK:
        return rng.choice(("0", "-1", "nan", "", "1.5", "x", "9" * 400, "2"))
    numbers = ("1e9", "0.1", "1/0", "1/3000", "3", "-1,-1,5,5", "1,2,3,4", "0,0,0,0", "1,2,nan,4", "1,2,3")
    return rng.choice((*numbers, *hostile.NUMBERS, *hostile.WORDS)).replace("\x00", "")


def _nothing(rng: Random, bench: Bench, case: Case) -> list[str]:
    """Words that are no command line."""
    words = [*hostile.WORDS, *COMMANDS, "fit", "show", "check", "--set", "-o", "--", "-j"]
    given = [rng.choice(words).replace("\x00", "") for _ in range(rng.randrange(1, 6))]
    return [one for one in given if one not in ("--help", "-h")]


KINDS: dict[str, Build] = {
    "init": _init, "recipe": _recipe, "set": _override, "trajectory": _trajectory, "truth": _truth, "results": _results,
    "gallery": _gallery, "prior": _prior, "calibration": _calibration, "run": _run_folder,
    "people": _people,
    "image": _image, "video": _video, "golden": _golden, "place": _place, "arguments": _arguments, "words": _nothing,
}  # fmt: skip
