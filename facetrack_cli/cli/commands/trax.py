"""facetrack trax: a tracker for the VOT toolkit."""

from __future__ import annotations

import sys

from facetrack_cli.cli import options
from facetrack_cli.cli.options import Whole, option, verb


class Trax:
    """Speak TraX, the protocol of the VOT toolkit.

    A program such as the VOT toolkit starts this command, speaks to it on standard input and output, gives it a region
    in a first image, and asks where it is in the next ones. Recipes of a box can be taken. Images are files; of a
    polygon the upright box around it is followed. What goes wrong is said in the message that ends the session, too.

    \b
    Examples:
      facetrack trax
      facetrack trax --config adaptive_robust --seed 3

    \b
    In the trackers.ini of a workspace of vot-toolkit:
      [facetrack]
      protocol = trax
      command = facetrack trax --config correlation_filter

    \b
    Exit codes: 0 done, 2 usage or recipe, 3 input, or messages that are wrong.
    """

    config: str | None = option("--config RECIPE", "Recipe of a box: a file, or a name [default: correlation_filter].")
    set: tuple[str, ...] = options.OVERRIDES
    seed: int | None = option("--seed N", "Seed of the random numbers, instead of the recipe's.", type=Whole(min=0))

    def run(self) -> None:
        from facetrack_cli.core.files import StreamSink
        from facetrack_cli.recipe.files import default_recipe
        from facetrack_cli.runs.seeds import load_recipes
        from facetrack_cli.runs.trax import serve

        seed = () if self.seed is None else (f"seed={self.seed}",)
        [recipe] = load_recipes([(self.config or default_recipe(box=True), (*self.set, *seed))], None)
        lines = (line.decode(errors="surrogateescape") for line in sys.stdin.buffer)
        sink = StreamSink(sys.stdout.buffer)
        serve(lines, lambda text: sink.write(text + "\n"), recipe)


command = verb(Trax)
