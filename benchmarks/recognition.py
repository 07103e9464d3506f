"""Who is who (Zhou et al. 2003): tables of docs/results.md, "Recognition".

    python benchmarks/recognition.py                                    zoom and lamp, with the sample gallery
    python benchmarks/recognition.py --clips clips --talkers            ten people: first part of a clip, second part
    python benchmarks/recognition.py --clips clips --talkers --none     the same, each also with a gallery without them
    python benchmarks/recognition.py --clips clips --alek               one person in two clips, with ten others
    python benchmarks/recognition.py --clips clips --alek --boxes       the same, both from true boxes

Galleries are made in a folder for the time of the run, by `facetrack gallery fit`; the seeds are 0 on. A row is a clip:

    right     runs that end with the right name; with --none, those that end with `none` too
    .9 after  frames until its posterior first passes .9, the most of the runs that do
    end       its posterior in the last frame, mean; and who is next, in the first run
    alone     share of frames whose patch at the estimate, without those before it, is most like the right person
    lead      by how many nats, in the median of the frames
    ground truth     alone, of patches at the true boxes, where the clip has them
    p_f       of the patches at the estimates, median
    AUC       success AUC with recognition and without, where the clip has a ground truth
    overlap   mean overlap of the two tracks
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from adaptive_runs import Run, clip_of, follow, overlap_of

from facetrack_cli.core.errors import FacetrackError
from facetrack_cli.core.types import Array, Frame, Start
from facetrack_cli.evaluation.compare import default_truth
from facetrack_cli.runs.plan import truth_start
from facetrack_cli.start.search import search_start
from facetrack_cli.trackers.appearance.gallery import NONE, load_gallery
from facetrack_cli.trackers.appearance.space import Patches
from facetrack_cli.trajectory.formats.read import read_truth
from facetrack_cli.video.source import open_source

GALLERY = Path(__file__).parent.parent / "sample_videos" / "gallery"
FIRST, SECOND = 30, 38  # frames of a talker up to the one are learned, and from the other on asked
PICTURES = 15
RECIPE = "adaptive_recognition"


def fit(folder: Path, out: Path, stop: int | None = None) -> Path:
    """A gallery of a folder of people."""
    words = [sys.executable, "-m", "facetrack_cli", "gallery", "fit", str(folder), "-o", str(out), "-q"]
    subprocess.run([*words, *(["--stop", str(stop)] if stop else [])], check=True)
    return out


def people(folder: Path, clips: Mapping[str, Path]) -> Path:
    """A folder with a folder for each person, with the person's clip in it."""
    for name, clip in clips.items():
        (folder / name).mkdir(parents=True)
        (folder / name / clip.name).symlink_to(clip.resolve())
    return folder


def boxed(folder: Path, clip: Path) -> None:
    """A person's images out of a folder of frames, each with its true box in an init file."""
    (truth,) = read_truth(default_truth(clip)).parts
    folder.mkdir(parents=True)
    wanted = {int(truth.frame[i]): truth.boxes[i] for i in np.linspace(0, len(truth) - 1, PICTURES).round().astype(int)}
    with open_source(clip) as source:
        for frame in source:
            if frame.index in wanted:
                cv2.imwrite(str(folder / f"{frame.index}.png"), frame.bgr)
                box = ", ".join(f"{value:g}" for value in wanted[frame.index])
                (folder / f"{frame.index}.init.yaml").write_text(f"frame: 0\nbox: [{box}]\n")


def found_face(clip: Path, first: int = 0) -> Start:
    with open_source(clip, start=first) as source:
        return search_start(source, (), clip=str(clip))


def row(name: str, clip: Path, start: Start | None, right: str, gallery: Path, given: argparse.Namespace) -> str:
    """`right` is who it is, or NONE."""
    more = [f"recognition.gallery={gallery}", *given.overrides]
    if given.none:
        more.append("recognition.none=true")
    runs, plain = follow(clip, RECIPE, given.seeds, start, more), follow(clip, "adaptive", given.seeds, start)
    ends, after, named = [], [], 0
    for run in runs:
        p = np.array([(told or {}).get(right, 0.0) for told in run.posterior])
        passed = np.flatnonzero(p > 0.9)
        after += [int(passed[0])] if len(passed) else []
        ends.append(p[-1])
        named += says(run) == right
    last = runs[0].posterior[-1] or {}
    rest = sorted((who for who in last if who != right), key=lambda who: -last[who])
    cells = [name, f"{named}/{len(runs)}"]
    if given.none:
        cells.append(f"{sum(says(run) == NONE for run in runs)}/{len(runs)}")
    cells += [
        f"{max(after)} ({len(after)})" if after else "never",
        f"{np.mean(ends):.3f}, {rest[0]} {last[rest[0]]:.3f}",
    ]
    alone, lead, frontal, second = evidence(clip, runs[0], runs[0].states, right, gallery)
    cells += [f"{100 * alone:.0f} %, {second}", f"{lead:.0f}"]
    known = np.isfinite(runs[0].truth).any()
    cells += [f"{100 * evidence(clip, runs[0], true_states(runs[0]), right, gallery)[0]:.0f} %" if known else ""]
    cells += [f"{frontal:.2f}"]
    if known:
        cells.append(" / ".join(f"{np.mean([run.auc for run in those]):.3f}" for those in (runs, plain)))
    else:
        cells.append("")
    cells.append(f"{np.mean([same(a, b) for a, b in zip(runs, plain, strict=True)]):.3f}")
    return " | ".join(cells)


def says(run: Run) -> str:
    last = run.posterior[-1] or {}
    return max(last, key=lambda one: last[one])


def same(a: Run, b: Run) -> float:
    return float(np.mean([overlap_of(p, q) for p, q in zip(a.corners, b.corners, strict=True)]))


def true_states(run: Run) -> Array:
    """(T, 6) of the true boxes, rolled where the ground truth is."""
    turn, scale = np.radians(np.nan_to_num(run.true_angle)), run.truth[:, 2:] / run.boxes[0, 2:]
    c, s = np.cos(turn), np.sin(turn)
    maps = [c * scale[:, 0], -s * scale[:, 1], s * scale[:, 0], c * scale[:, 1]]
    return np.column_stack([run.truth[:, :2] + (run.truth[:, 2:] - 1) / 2, *maps])


def evidence(clip: Path, run: Run, at: Array, right: str, path: Path) -> tuple[float, float, float, str]:
    """Of patches at (T, 6): share that names the right one by itself, medians of lead in nats and p_f, who is next."""
    gallery = load_gallery(path)
    patches = Patches((float(run.boxes[0, 2]), float(run.boxes[0, 3])), gallery.shape)
    states = dict(zip(run.frame.astype(int).tolist(), at, strict=True))
    leads, frontal, next_ = [], [], []
    with open_source(clip, start=int(run.frame[0])) as source:
        for frame in source:
            x = states[frame.index][None, None]
            if not np.isfinite(x).all():
                continue
            y = patches.read(Frame(frame.index, frame.time_s, frame.bgr), x, patches.factor(x[0]))
            p_f, log_n = gallery.log_scores(y, none=False)
            frontal.append(float(p_f[0]))
            scores = dict(zip(gallery.names, log_n[0].tolist(), strict=True))
            own = scores.pop(right, np.nan)
            best = max(scores, key=lambda one: scores[one])
            leads.append(own - scores[best])
            next_.append(best)
    second = max(set(next_), key=next_.count)
    return float(np.mean(np.array(leads) > 0)), float(np.median(leads)), float(np.median(frontal)), second


def heading(given: argparse.Namespace) -> None:
    columns = [
        "",
        "right",
        *(["none"] if given.none else []),
        ".9 after",
        "end, next",
        "alone, next",
        "lead",
        "truth",
        "p_f",
    ]
    columns += ["AUC with / without", "overlap"]
    print(f"\n{given.seeds} seeds\n\n| {' | '.join(columns)} |\n{'|---' * len(columns)}|", flush=True)


def talkers(given: argparse.Namespace, scratch: Path) -> None:
    clips = {path.stem: path for path in sorted((given.clips / "talkers").glob("*.mpg"))}
    gallery = fit(people(scratch / "all", clips), scratch / "all.npz", FIRST)
    heading(given)
    for name, clip in clips.items():
        start = found_face(clip, SECOND)
        print(f"| {row(name, clip, start, name, gallery, given)} |", flush=True)
        if given.none:
            others = {who: path for who, path in clips.items() if who != name}
            without = fit(people(scratch / f"no_{name}", others), scratch / f"no_{name}.npz", FIRST)
            print(f"| {row(f'{name}, a stranger', clip, start, NONE, without, given)} |", flush=True)


def alek(given: argparse.Namespace, scratch: Path) -> None:
    """alek_wek_1 in the gallery and alek_wek_4 asked, and the other way round."""
    heading(given)
    for known, asked in (("alek_wek_1", "alek_wek_4"), ("alek_wek_4", "alek_wek_1")):
        folder = scratch / known
        people(folder, {path.stem: path for path in sorted((given.clips / "talkers").glob("*.mpg"))})
        for name in ("albert_brooks", known):
            clip, who = clip_of(name, given.clips), "alek_wek" if name == known else name
            if given.boxes:
                boxed(folder / who, clip)
            else:
                people(folder, {who: clip})
        gallery, clip = fit(folder, scratch / f"{known}.npz"), clip_of(asked, given.clips)
        start = truth_start(read_truth(default_truth(clip)), ()) if given.boxes else found_face(clip)
        print(f"| {row(f'{asked}, learned from {known}', clip, start, 'alek_wek', gallery, given)} |", flush=True)


def samples(given: argparse.Namespace, scratch: Path) -> None:
    gallery = fit(GALLERY, scratch / "samples.npz")
    heading(given)
    for name, who in (("zoom", "hopper"), ("lamp", "collins")):
        print(f"| {row(name, clip_of(name, None), None, who, gallery, given)} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=Path, metavar="FOLDER")
    parser.add_argument("--talkers", action="store_true")
    parser.add_argument("--alek", action="store_true")
    parser.add_argument("--boxes", action="store_true")
    parser.add_argument("--none", action="store_true")
    parser.add_argument("--set", dest="overrides", action="append", default=[])
    parser.add_argument("--seeds", type=int, default=10)
    given = parser.parse_args()
    if (given.talkers or given.alek) and given.clips is None:
        raise SystemExit("say where the clips are with --clips")
    with tempfile.TemporaryDirectory() as scratch:
        what: Sequence[bool] = (given.talkers, given.alek)
        for wanted, table in zip((*what, not any(what)), (talkers, alek, samples), strict=True):
            if wanted:
                table(given, Path(scratch))


if __name__ == "__main__":
    try:
        main()
    except FacetrackError as e:
        raise SystemExit(str(e)) from None
