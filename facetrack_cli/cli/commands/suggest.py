"""facetrack suggest: which recipe a clip asks for."""

import json
import shlex
from pathlib import Path

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FRAME, Extent, Whole, argument, flag, group, option, verb
from facetrack_cli.core.errors import ExitCode, InputError


class Suggest:
    """Try recipes on the start of a clip; say which to take.

    Without ground truth: each recipe tracks the first frames forwards, then backwards from where it ended. Recipes
    are ranked by how well both tracks agree, times the share of frames in which the target is not called lost. For a
    face that is searched for these are face, correlation_filter and skin_ncc_robust; for a --box, all but face.
    The first one is taken unless another one is better by .05. --config tries others. The log evidence is shown, and
    is not comparable between recipes. Where a face is searched for, hands of its colour are looked for, too.

    \b
    Examples:
      facetrack suggest clip.mp4
      facetrack suggest clip.mp4 --box 110,93,56,64 --frames 200
      facetrack suggest clip.mp4 --config ncc --config skin_ncc_robust --json

    \b
    Exit codes: 0 done, 2 usage or recipe, 3 input, 130 interrupted,
    143 terminated.
    """

    clip: Path = argument("INPUT")
    config: tuple[str, ...] = option(
        "--config RECIPE", "A recipe to try, in place of the usual ones; may be repeated.", multiple=True
    )
    frames: int = option("--frames N", "Frames to try them on.", type=Whole(2, 5000), default=100)
    init_frame: int | None = option("--init-frame N", "Frame of --box, or where the search begins.", type=FRAME)
    extent: Extent = group(Extent)
    json: bool = flag("--json", "Print JSON in place of a table.")
    quiet: bool = options.QUIET

    def run(self) -> int:
        from facetrack_cli.evaluation.experiments.suggest import (
            ANY,
            FACE,
            HANDS,
            NO_SKIN,
            SIGNER,
            as_json,
            hands_seen,
            is_grey,
            piece,
            sheet_of,
            suggest,
        )
        from facetrack_cli.recipe.load import load_recipe
        from facetrack_cli.runs.progress import progress
        from facetrack_cli.runs.seeds import labels, variant
        from facetrack_cli.runs.signals import Stop
        from facetrack_cli.runs.start import Begin

        self.extent.check(self.clip)
        names = list(self.config or (ANY if self.extent.box is not None else FACE))
        labels(names)
        with Stop().listening() as stop, progress(self.quiet) as shown:
            begin = Begin(self.clip, init_frame=self.init_frame, **vars(self.extent))
            start = begin.find(load_recipe(*variant(names[0])), stopped=stop)
            frames = piece(begin, start, self.frames)
            if not self.config and is_grey(frames[0]):
                names = [f"{one}:{NO_SKIN}" if one == "skin_ncc_robust" else one for one in names]
            recipes = [(name, load_recipe(*variant(name))) for name in names]

            def report(recipe: str, done: int) -> None:
                if stop():
                    raise InputError(f"{self.clip}: stopped before all recipes were tried")
                shown.begin(f"trying {recipe}", "recipes", len(recipes))
                shown.update(done, len(recipes))

            try:
                trials = suggest(recipes, frames, start, str(self.clip), report)
            except InputError:
                if not stop():
                    raise
                return stop.code or ExitCode.FAULT
            searched = not self.config and self.extent.box is None
            hands = hands_seen(frames, start, str(self.clip)) if searched else None
        command = self._command(trials[0].recipe)
        if self.json:
            click.echo(json.dumps(as_json(str(self.clip), frames, trials, command, hands), indent=2))
        else:
            where = f"{self.clip.name}, frames {frames[0].index} to {frames[-1].index}"
            sheet_of(where, trials).show()
            click.echo(f"take: {command}")
            if hands is None:
                click.echo("hands: not looked for" + (", as they are by their colour" if searched else ""))
            elif hands < HANDS:
                click.echo(f"hands: too few to follow, {hands:.0%} of both are seen")
            else:
                click.echo(f"hands: {hands:.0%} of both are seen; with hands: {self._command(SIGNER)}")
        return ExitCode.DONE

    def _command(self, recipe: str) -> str:
        """The command to run next."""
        from facetrack_cli.runs.seeds import variant

        name, settings = variant(recipe)
        words = ["facetrack", "run", str(self.clip), "--config", name]
        words += [word for one in settings for word in ("--set", one)]
        if self.extent.box is not None:
            words += ["--box", ",".join(f"{value:g}" for value in self.extent.box)]
        if self.init_frame is not None:
            words += ["--init-frame", str(self.init_frame)]
        return shlex.join(words)


command = verb(Suggest)
