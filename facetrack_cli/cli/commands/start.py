"""facetrack app, init and status: the page of all clips; where a track begins; how far a batch is."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FILE_OR_DASH, FRAME, Page, flag, option, page_options, refuse, say
from facetrack_cli.core.errors import ExitCode, InputError, OutputError, flat

if TYPE_CHECKING:
    from facetrack_cli.core.types import Box
    from facetrack_cli.recipe.model import Recipe


@click.command()
@click.argument("project", type=options.PROJECT, required=False, default=lambda: Path.home() / "facetrack")
@options.port
@flag("--no-open", help="Do not open the page in the browser.")
def app_command(project: Path, port: int | None, no_open: bool) -> int:
    """Track, look, correct and export on one page.

    The page opens in the browser and stays open. Drop clips on it, or name a folder; choose what is tracked in each;
    run them; look at them, correct them, and export them for other programs. PROJECT is the folder where all of that is
    kept [default: facetrack, in your home]; the same command again shows it, and goes on with what was not finished.

    It is served to this machine alone, and ends with Quit on the page, or with Ctrl-C.

    \b
    Examples:
      facetrack app study/ --port 8800 --no-open
    """
    from facetrack_cli.editor.app_session import AppSession
    from facetrack_cli.editor.server import run_page
    from facetrack_cli.runs.signals import Stop

    refuse((project.is_file(), f"{project}: is a file; name a folder for the project, and add clips on its page"))
    with Stop().listening() as stop:
        run_page(AppSession(project), stop, say, port=port or 0, browse=not no_open)
    return stop.code or 0


@click.command()
@click.argument("results", type=options.FOLDER, metavar="RESULTS")
@flag("--json", "as_json", help="Print JSON.")
def status_command(results: Path, as_json: bool) -> None:
    """Tell how far a batch is, and how long it still takes.

    RESULTS is the folder that --out of facetrack run named, or that of a single run. A table names the clips to look
    at, the worst first: clips that failed, with the reason; incomplete clips; clips in which a part is lost most. What
    runs is told with its machine, since when, and how far it is. Nothing is written.

    \b
    Examples:
      watch -n 60 facetrack status results
      facetrack status results --json | jq .counts
    """
    from facetrack_cli.run_folder.status import survey

    batch = survey(results)
    click.echo(batch.json() if as_json else "\n".join(map(flat, batch.lines())), nl=not as_json)


@click.command()
@click.argument("clip", type=options.INPUT)
@option("-o", "--out", type=FILE_OR_DASH, help="File to write [default: <clip>.init.yaml beside the clip]; - stdout.")
@option("--init-frame", type=FRAME, help="Frame where the search begins, of --box, or shown first on the page.")
@option(
    "--faces", type=click.Choice(["one", "all"]), metavar="WHICH", default="one", show_default=False,
    help="`one`, the largest face that stays, or `all` that are there with it [default: one].",
)  # fmt: skip
@option("--box", type=options.BOX, help="The face's box in that frame: place the points in it.")
@option(
    "--config", type=options.RECIPE,
    help="Write what this recipe begins with: its points, or a head and hands; without, a face and five points.",
)  # fmt: skip
@option("--preview", type=options.PNG, help="Also draw the result on its frame.")
@flag("--pick", help="Choose on a page in the browser: boxes and points are drawn on the frame.")
@page_options
@flag("--overwrite", help="Replace files that are there already; --pick begins with what they hold.")
def init_command(
    clip: Path, out: str | None, init_frame: int | None, faces: Literal["one", "all"], box: Box | None,
    config: str | None, preview: Path | None, pick: bool, page: Page, overwrite: bool,
) -> int:  # fmt: skip
    """Write where the track of a clip begins, as a file to edit.

    INPUT is a video or a folder of images. The first face that is found, and five points of it (nose,
    corners of the mouth, lips), become an init file, which `facetrack run` takes from beside the clip. Nothing that is
    there already is replaced without --overwrite.

    Recipes of regions need no points: to follow a head or hands, write boxes alone into such a file, or give --box to
    `facetrack run`. Of a recipe that follows a head and hands, --config finds the hands too, as the largest regions of
    the face's skin colour apart from it.

    With --pick you choose yourself, on a page that is served to this machine alone: its address is printed, and Save
    there writes the file and ends the command. On a machine far away, forward the port by ssh -L, as is printed too.

    \b
    Examples:
      facetrack init clip.mp4 --init-frame 120 --box 310,96,140,140
      facetrack init clip.mp4 --config signer --preview look.png
      facetrack init clip.mp4 --pick --open
      facetrack init frames/ -o - > start.yaml
    """
    from facetrack_cli.core.files import check_new
    from facetrack_cli.recipe.load import load_recipe
    from facetrack_cli.runs.plan import ClipRequest
    from facetrack_cli.runs.progress import progress
    from facetrack_cli.start.init_file import SUFFIXES, default_path, read_init, write_init
    from facetrack_cli.trackers.face.detectors import detector
    from facetrack_cli.video.overlay import write_preview

    refuse(
        (faces == "all" and (box is not None or pick), "--faces all is of a search; leave out --box and --pick"),
        (pick and box is not None, "--pick is of a page, where you draw the box; leave out --box"),
    )
    path = None if out == "-" else Path(out) if out else default_path(clip)
    if path is not None and path.suffix.lower() not in SUFFIXES:
        raise OutputError(f"{path}: an init file ends in {', '.join(SUFFIXES)}; name it so")
    for file in filter(None, (path, preview)):  # before the search what would be refused after it
        check_new(file, overwrite=overwrite)
    if preview is not None and clip.is_dir() and preview.parent.resolve() == clip.resolve():
        raise OutputError(f"{preview}: would be one more frame of the clip; write it outside {clip}")
    recipe = None if config is None else load_recipe(config)
    if pick:
        from facetrack_cli.editor.session import NOTHING, PickSession

        previous = NOTHING
        if path is not None and path.is_file():
            try:
                previous = read_init(path)
            except InputError as e:  # it will be replaced in any case
                say(f"facetrack: warning: {e}; the page begins without it")
        session = PickSession(
            clip, recipe or load_recipe("face"), out=path, overwrite=overwrite, frame=init_frame,
            previous=previous, preview=preview, next_=_run_with(path, clip, config, recipe),
        )  # fmt: skip
        code = page.serve(session)
        if path is None and session.saved is not None:
            write_init(sys.stdout, session.saved, clip=clip.name)
        return code
    by = None if box is not None else detector().name
    request = ClipRequest(clip, init=by, faces=faces, box=box, init_frame=init_frame)
    with progress(path is None) as shown:
        shown.begin(f"{clip.name}: looking for a face")
        start = request.find(recipe or load_recipe("factorized"), looked=shown.update)
    if preview is not None:
        write_preview(preview, request.frame(start.frame), start, overwrite=overwrite)
        say(f"{preview}: the start drawn on frame {start.frame}")
    if path is None:
        write_init(sys.stdout, start, clip=clip.name)
    else:
        write_init(path, start, clip=clip.name, overwrite=overwrite)
        what = ", ".join(start.targets) if len(start.targets) > 1 else "a face"
        say(f"{path}: {what} in frame {start.frame}; edit it, then: {_run_with(path, clip, config, recipe)}")
    return ExitCode.DONE


def _run_with(path: Path | None, clip: Path, config: str | None, recipe: Recipe | None) -> str:
    """The command that begins with the file, once it is there."""
    from facetrack_cli.recipe.load import wants_gallery
    from facetrack_cli.start.init_file import default_path, find_init

    beside = (find_init(clip) or default_path(clip)) == path
    words = "" if beside else f" --init {'FILE' if path is None else path}"
    if recipe is not None:
        words += f" --config {config}" + " --gallery FILE" * wants_gallery(recipe)
    return f"facetrack run {clip}{words}"
