# mypy: allow-untyped-calls
"""The pictures of docs/ anew: `PYTHONPATH=. python tools/pictures.py [NAME ...]`, with the extras test and browser.

Frames of annotated videos, the page and the report in a Chromium, and the exports of docs/index.md; the sheet
takes LibreOffice Calc and pdftoppm, and is left out without them. Plots are those of the commands beside them.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import numpy as np

import facetrack_cli as facetrack

matplotlib.use("Agg")
import matplotlib.pyplot as plt

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
GAP = 6
# of each picture the width of a frame, and its rows: clip, arguments of run, frames
GRIDS: dict[str, tuple[int, list[tuple[str, list[str], list[int]]]]] = {
    "face.jpg": (384, [
        ("map", ["--config", "face", "--init", "haar"], [30, 75, 110]),
        ("signing", ["--config", "face", "--init", "haar"], [38, 92, 130]),
        ("passerby", ["--config", "face", "--init", "yunet"], [50, 90, 130]),
    ]),
    "skin-map.jpg": (360, [("map", ["--config", one], [30, 56, 76, 215]) for one in ("skin", "skin_ncc_robust")]),
    "signer.jpg": (360, [("signing", ["--config", "signer"], [20, 52, 92, 208])]),
    "signing.jpg": (360, [
        ("signing", ["--config", one], [38, 92, 112, 130]) for one in ("head_hands_cloud", "head_hands")
    ]),
    "regions-birch.jpg": (256, [
        ("textured", ["--config", one], [100, 120, 134, 150])
        for one in ("contour_correlation", "contour_histogram_correlation_robust")
    ]),
}  # fmt: skip
DRAGGED, AFTER = 102, 124  # where the guide corrects the lower lip, and a frame after it


def main(names: list[str]) -> None:
    for name, (width, rows) in GRIDS.items():
        if not names or name in names:
            grid(name, width, rows)
    for make in (moving, film, pick, app, report, cell, guide):
        if not names or make.__name__ in names:
            with tempfile.TemporaryDirectory() as folder:
                os.chdir(folder)
                Path("sample_videos").symlink_to(ROOT / "sample_videos")
                make()
                os.chdir(ROOT)


def command(*words: str) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-m", "facetrack_cli", *words], check=True, env=environment)


def save(image: Any, name: str, quality: int = 82) -> None:
    cv2.imwrite(str(DOCS / name), image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    print(name, image.shape, (DOCS / name).stat().st_size // 1000, "kB")


def moving() -> None:
    """The moving picture of README: three annotated videos, six seconds at eight frames per second."""
    from PIL import Image

    panels = []
    for clip, first, more in (
        ("occlusion", 38, []), ("film", 60, ["--faces", "all"]), ("signing", 38, ["--config", "signer"]),
    ):  # fmt: skip
        rate, frames = 3.125, list[Any]()
        command("run", f"sample_videos/{clip}.mp4", *more, "--stop", "240", "-q", "-o", clip)
        video, n = cv2.VideoCapture(f"{clip}/annotated.mp4"), 0
        while (read := video.read())[0]:
            if n == first + int(rate * len(frames)) and len(frames) < 48:
                frames.append(cv2.resize(read[1], (300, 225), interpolation=cv2.INTER_AREA))
            n += 1
        panels.append(frames)
    images = [Image.fromarray(joined(list(row), 1)[..., ::-1]) for row in zip(*panels, strict=True)]
    images[0].save(
        DOCS / "tracks.webp", save_all=True, append_images=images[1:], duration=125, loop=0, quality=50, method=6
    )
    print("tracks.webp", images[0].size, (DOCS / "tracks.webp").stat().st_size // 1000, "kB")


def grid(name: str, width: int, rows: list[tuple[str, list[str], list[int]]]) -> None:
    lines = []
    for clip, more, frames in rows:
        with tempfile.TemporaryDirectory() as out:
            stop = str(max(frames) + 1)
            command("run", f"sample_videos/{clip}.mp4", *more, "--stop", stop, "-q", "--overwrite", "-o", out)
            video, found, n = cv2.VideoCapture(f"{out}/annotated.mp4"), {}, 0
            while (read := video.read())[0]:
                image = read[1]
                if n in frames:
                    height = round(width * image.shape[0] / image.shape[1])
                    found[n] = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
                n += 1
        lines.append(joined([found[frame] for frame in frames], 1))
    save(joined(lines, 0), name)


def joined(images: list[Any], axis: int) -> Any:
    """Beside or below each other, with a white gap between."""
    shape = list(images[0].shape)
    shape[axis] = GAP
    white = np.full(shape, 255, np.uint8)
    return np.concatenate([part for image in images for part in (white, image)][1:], axis=axis)


@contextmanager
def browser(width: int = 1280, height: int = 800) -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    from tests.support import browser as support

    support.AT_MOST_S = 300.0
    program = os.environ.get("FACETRACK_CHROMIUM") or next(filter(None, map(shutil.which, support.PROGRAMS)))
    with sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=program, args=[*support.QUIET, "--no-sandbox"])
        page = chromium.new_context(viewport={"width": width, "height": height}).new_page()
        page.add_init_script(support.PREPARE)
        yield page
        chromium.close()


def shot(page: Any, name: str, quality: int = 82) -> None:
    page.wait_for_timeout(1000)  # until what moves has come to rest
    page.screenshot(path=str(DOCS / name), type="jpeg", quality=quality)
    print(name, (DOCS / name).stat().st_size // 1000, "kB")


def film() -> None:
    """The cast in the report, and the page that corrects it."""
    from tests.support.browser import Command

    command("run", "sample_videos/film.mp4", "--faces", "all", "-q", "-o", "film")
    command("people", "film", "--rename", "person_1=Eileen", "--rename", "person_2=Grace", "--no-video", "-q")
    command("report", "film", "-q")
    with browser(1000, 560) as page:
        page.goto(f"file://{Path.cwd()}/film/report.html")
        page.evaluate("document.getElementById('people').parentElement.scrollIntoView()")
        shot(page, "film.jpg")
    served = Command("people", "film", "--page")
    with browser(1140, 760) as page:
        page.goto(served.url)
        page.wait_for_selector("#people li")
        page.click('#timeline .row[data-name="Eileen"] svg', position={"x": 300, "y": 8})
        shot(page, "page-cast.jpg")
    served.close()


def pick() -> None:
    from tests.support.browser import Command, Window

    shutil.copy("sample_videos/expressions.mp4", "clip.mp4")
    with browser() as page:
        served = Command("init", "clip.mp4", "--pick")
        window = Window(page).go(served.url)
        page.wait_for_timeout(3000)  # until faces are found
        window.press("1")
        page.wait_for_timeout(1000)
        place = window.get("draft.targets.face.points.mouth_left")
        window.drag(place, (place[0] - 0.5, place[1] + 0.5), drop=False)
        shot(page, "page-pick.jpg")
        window.mouse.up()
        served.close()


def app() -> None:
    """The page of a project: a clip is done, one is tracked, others wait; on a phone, what was found."""
    from tests.support.browser import Command

    served = Command("app", "study", "--no-open")
    with browser(1200, 700) as page:
        page.goto(served.url)
        for name in ("expressions", "film", "signing", "hands"):
            shutil.copy(f"sample_videos/{name}.mp4", f"{name}.mp4")
            page.fill("#path", str(Path(f"{name}.mp4").absolute()))
            page.click("#add")
            page.wait_for_selector(f"#clips li:nth-child({len(list(Path().glob('*.mp4')))})")
        page.wait_for_selector("#clips li:nth-child(4) select:not([disabled])", timeout=60_000)
        page.select_option("[data-testid=what-4]", "box")
        page.click("#run-all")
        page.wait_for_selector("[data-testid=clip-2][data-state=running] progress[value]", timeout=300_000)
        shot(page, "page-app.jpg")
        page.set_viewport_size({"width": 390, "height": 844})
        page.click("[data-testid=look-1]")
        page.wait_for_selector("#curves path")
        page.evaluate("document.getElementById('movie').currentTime = 4.5")
        shot(page, "page-app-phone.jpg")
    served.close()


def report() -> None:
    """The first screen of a report, at a desk and on a phone."""
    command("run", "sample_videos/occlusion.mp4", "-q")
    command("report", "occlusion-face", "-q")
    at_both_widths(f"file://{Path.cwd()}/occlusion-face/report.html", "report", 620)


def cell() -> None:
    """What two cells of a notebook give, in a page as plain as a notebook's."""
    found = facetrack.track_video("sample_videos/expressions.mp4", report=lambda done, total: None)
    facetrack.plot(found).savefig("plot.png", dpi=75)
    path = "sample_videos/expressions.mp4"
    Path("cell.html").write_text(
        "<!doctype html><meta charset=utf-8><meta name=viewport content='width=device-width'><style>"
        "body{margin:12px;font:14px sans-serif} pre{padding:8px;background:#f4f4f4;border:1px solid #ddd;overflow:auto}"
        "table{border-collapse:collapse} td,th{padding:4px 8px;text-align:right} div{overflow:auto}"
        "tr:nth-child(even){background:#f4f4f4} img{max-width:100%}</style>"
        f'<pre>trajectory = facetrack.track_video("{path}")\ntrajectory</pre><div>{found._repr_html_()}</div>'
        "<pre>facetrack.plot(trajectory)</pre><img src=plot.png>",
        encoding="utf-8",
    )
    at_both_widths(f"file://{Path.cwd()}/cell.html", "notebook", 620)


def at_both_widths(address: str, name: str, height: int) -> None:
    with browser(1200, height) as page:
        page.goto(address)
        shot(page, f"page-{name}.jpg", 60)
        page.set_viewport_size({"width": 390, "height": 844})
        shot(page, f"page-{name}-phone.jpg", 60)


def guide() -> None:
    from tests.support.browser import Command, Window, go_to

    command("run", "sample_videos/occlusion.mp4", "-q")
    shutil.copytree("occlusion-face", "before")
    part = "lip_lower"
    truth = facetrack.read_truth("sample_videos/occlusion.truth.csv").find("face", part)
    was = facetrack.read_trajectory("occlusion-face").find("face", part)
    assert truth is not None and was is not None
    truth, was = truth.at(DRAGGED), was.at(DRAGGED)
    with browser() as page:
        served = Command("fix", "occlusion-face")
        window = Window(page).go(served.url)
        go_to(window, DRAGGED)
        window.drag((was.x[0], was.y[0]), (truth.x[0], truth.y[0]), drop=False)
        shot(page, "page-fix.jpg")
        window.mouse.up()
        window.mouse.move(5, 400)
        window.click_on("track")
        window.until("window.facetrack.rowsRevision === 1 && !window.facetrack.busy && !window.facetrack.job")
        go_to(window, AFTER)
        shot(page, "first_track-after.jpg")
        window.save()
        shot(page, "first_track-saved.jpg")
        served.ended()
    for form in ("csv-wide", "cvat", "eaf"):
        command("export", "occlusion-face", "--to", form)
    sheet()
    tiers()
    cvat()
    notebook()


def sheet() -> None:
    """The table as LibreOffice Calc shows it, of its first page some rows and columns."""
    if shutil.which("soffice") is None or shutil.which("pdftoppm") is None:
        return
    table = Path("occlusion-face/trajectory.wide.csv")
    subprocess.run(["soffice", "--headless", "--convert-to", "pdf", str(table)], check=True)
    subprocess.run(["pdftoppm", "-png", "-r", "110", "-f", "1", "-l", "1", "trajectory.wide.pdf", "sheet"], check=True)
    [picture] = Path().glob("sheet*.png")
    image = cv2.imread(str(picture))
    assert image is not None
    inked = np.argwhere(image.min(axis=2) < 250)
    top, left = inked.min(axis=0) - 10
    save(image[top + 30 : top + 397, left : inked.max(axis=0)[1] + 10], "first_track-sheet.jpg", 90)


def tiers() -> None:
    root = ET.parse("occlusion-face/trajectory.eaf").getroot()
    times = {one.attrib["TIME_SLOT_ID"]: int(one.attrib["TIME_VALUE"]) / 1000 for one in root.iter("TIME_SLOT")}
    names = [tier.attrib["TIER_ID"] for tier in root.iter("TIER")]
    figure, axes = plt.subplots(figsize=(9, 0.4 * len(names) + 0.8), layout="constrained")
    for k, tier in enumerate(root.iter("TIER")):
        for one in tier.iter("ALIGNABLE_ANNOTATION"):
            begin, end = times[one.attrib["TIME_SLOT_REF1"]], times[one.attrib["TIME_SLOT_REF2"]]
            axes.barh(k, end - begin, left=begin, height=0.7, color="#cfe0ec", edgecolor="#0b6e99", linewidth=0.8)
            words = one.findtext("ANNOTATION_VALUE") or ""
            if end - begin > 0.06 * len(words):
                axes.text(begin + 0.03, k, words, va="center", fontsize=8, clip_on=True)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlabel("seconds")
    figure.savefig(DOCS / "first_track-tiers.png", dpi=100)


def cvat() -> None:
    """A frame with the points that the XML has of it."""
    video = cv2.VideoCapture("sample_videos/occlusion.mp4")
    for _ in range(AFTER + 1):
        image = video.read()[1]
    image = cv2.resize(image, None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
    for track in ET.parse("occlusion-face/trajectory.cvat.xml").getroot().iter("track"):
        for one in track.iter("points"):
            if int(one.attrib["frame"]) == AFTER and one.attrib["outside"] == "0":
                x, y = (round(3 * float(value)) for value in one.attrib["points"].split(","))
                cv2.circle(image, (x, y), 6, (60, 220, 60), -1, cv2.LINE_AA)
                cv2.circle(image, (x, y), 6, (0, 0, 0), 1, cv2.LINE_AA)
                words, up = track.attrib["label"], 10 if "upper" in track.attrib["label"] else 0
                cv2.putText(
                    image, words, (x + 9, y + 4 - up), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255,) * 3, 1, cv2.LINE_AA
                )
    save(image[300:540, 250:850], "first_track-cvat.jpg")


def notebook() -> None:
    """What the cell of the guide draws."""
    text = (DOCS / "index.md").read_text(encoding="utf-8")
    cell = text.split("```python\n")[1].split("```")[0]
    plt.figure(figsize=(7, 3.5), layout="constrained")
    exec(compile(cell, "index.md", "exec"), {})
    plt.savefig(DOCS / "first_track-notebook.png", dpi=100)


if __name__ == "__main__":
    main(sys.argv[1:])
