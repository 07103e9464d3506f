"""The documentation holds: generated pages are fresh, links lead somewhere, command lines parse, examples are valid."""

import inspect
import os
import re
import shlex
from pathlib import Path

import click
import pytest

from facetrack_cli.cli.app import cli
from facetrack_cli.core.models import shipped_recipes
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.seeds import variant
from facetrack_cli.start.init_file import read_init
from tests.support.samples import from_tools

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
FENCE = re.compile(r"^( *)```(\w*)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)


def blocks(page, *languages):
    text = page.read_text(encoding="utf-8")
    return [body for _, language, body in FENCE.findall(text) if language in languages]


def command_lines(text):
    """The arguments of every call of facetrack in a block of shell, and whether xargs adds to them."""
    for line in text.replace("\\\n", " ").splitlines():
        lexer = shlex.shlex(line, posix=True, punctuation_chars=True)
        lexer.whitespace_split = True
        try:
            words = list(lexer)
        except ValueError:  # a quotation that goes on in the next line, as awk programs do: what stands before counts
            words = line.split("'")[0].split()
        while any(is_facetrack(word) for word in words):
            at = next(i for i, word in enumerate(words) if is_facetrack(word))
            end = next((i for i in range(at + 1, len(words)) if set(words[i]) <= set("|&;<>()")), len(words))
            yield words[at + 1 : end], "xargs" in words[:at]
            words = words[end:]


def is_facetrack(word):
    return word == "facetrack" or word.endswith("/facetrack")


def parse(arguments, more=()):
    """Parse a command line as click does, without running it; returns the parameters of its command."""
    context = cli.make_context("facetrack", [*arguments, *more])
    command, rest = cli, words_left(context)
    while isinstance(command, click.Group) and rest:
        _, command, rest = command.resolve_command(context, rest)
        context = command.make_context(command.name, list(rest), parent=context)
        rest = words_left(context)
    return context.params


def words_left(context):
    return [*getattr(context, "_protected_args", []), *context.args]  # a group keeps its command's name apart


def slug(heading):
    """The anchor that forges give a heading."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


def shell_lines():
    """Those of the pages, and the examples in the help of commands."""
    texts = [(page.name, block) for page in PAGES for block in blocks(page, "sh", "bash", "console", "")]
    for one in from_tools("commands_doc").commands():
        lines = inspect.cleandoc(one.command.help).splitlines()
        texts.append((one.command_path, "\n".join(line for line in lines if line.startswith("  "))))
    return [(name, *found) for name, text in texts for found in command_lines(text)]


def test_the_pages_that_the_site_makes_have_all_commands_and_keys():
    tool = from_tools("commands_doc")
    page = tool.commands_page()
    assert page.count("\n## facetrack") == len([*tool.commands()]) > 20
    run = page.partition("\n## facetrack run\n")[2].partition("\n## ")[0]
    assert "\n  --cluster WHERE " in run and "facetrack run 0 --live\n" in run and "Many clips and long clips:\n" in run
    assert [line for line in run.splitlines() if len(line) > 100] == []
    assert "| `filter.particles` |" in tool.keys_page()


def links():
    for page in (*PAGES, ROOT / "CONTRIBUTING.md"):
        text = FENCE.sub("", page.read_text(encoding="utf-8"))
        yield from ((page, link) for link in re.findall(r"\]\(([^)\s]+)\)", text) if not re.match(r"[a-z]+:", link))


def test_links_and_images_are_there():
    for page, link in links():
        name, _, anchor = link.partition("#")
        path = (page.parent / name).resolve() if name else page
        assert path.exists(), f"{page.name}: {link}"
        if anchor:
            headings = re.findall(r"^#+ (.*)$", FENCE.sub("", path.read_text(encoding="utf-8")), re.MULTILINE)
            assert anchor in map(slug, headings), f"{page.name}: {link}"


def test_what_the_map_names_stands_in_the_file_that_it_names():
    """A file that stands "beside" another is not looked up."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = re.findall(r"`(\w+)` (?:of|in) `([\w/]+\.py)`", text)
    named += [(name, file) for file, name in re.findall(r"^\d+\. `([\w/]+\.py)`: `(\w+)`", text, re.MULTILINE)]
    assert len(named) > 30
    for name, file in named:
        paths = [path for path in (ROOT / file, ROOT / "facetrack_cli" / file) if path.exists()]
        found = [re.search(rf"(?:def|class) {name}\b|^{name}\b.*=", one.read_text("utf-8"), re.M) for one in paths]
        assert not paths or any(found), f"{name} in {file}"


def test_command_lines_are_found():
    text = "find . | xargs -0 facetrack run -j 2 && a/facetrack init x.mp4 -o - > y\nls facetracks"
    found = list(command_lines(text))
    assert found == [(["run", "-j", "2"], True), (["init", "x.mp4", "-o", "-"], False)]
    assert len(shell_lines()) > 40


def test_command_lines_parse():
    recipes = {path.stem for path in shipped_recipes()}
    for page, arguments, xargs in shell_lines():
        usage = {"...", "COMMAND", "SHELL", "MODEL"} & {*arguments}
        if usage or any(word.startswith("[") for word in arguments):
            continue
        # a variable of the shell, or what GNU parallel puts in
        arguments = [re.sub(r"\$\w+|\{\}", "1", word) for word in arguments]
        try:
            params = parse(arguments, ["clip.mp4"] if xargs else [])
        except click.exceptions.Exit as left:  # --help
            assert left.exit_code == 0, (page, arguments)
            continue
        except click.ClickException as error:
            pytest.fail(f"{page}: facetrack {' '.join(arguments)}: {error.format_message()}")
        configs = params.get("config") or ()
        for name, own in map(variant, (configs,) if isinstance(configs, str) else configs):
            if name.removesuffix(".yaml") in recipes:
                load_recipe(name, [text for text in (*params.get("overrides", ()), *own) if text != "KEY=VALUE"])


def test_scripts_named_are_there_and_every_benchmark_and_picture_is_shown():
    """A benchmark that no page, check or other script names has no figure; a picture that no page shows is weight."""
    beside = [ROOT / "CONTRIBUTING.md", ROOT / ".ci" / "run", *(ROOT / "tools").glob("*.py")]
    scripts = sorted((ROOT / "benchmarks").glob("*.py"))
    said = "\n".join(path.read_text(encoding="utf-8") for path in [*PAGES, *beside])
    for script in re.findall(r"\b(?:benchmarks|tests|tools)/[\w/]+\.py", said):
        assert (ROOT / script).exists(), script
    imported = "\n".join(path.read_text(encoding="utf-8") for path in [*scripts, *beside])
    for script in scripts:
        named = f"benchmarks/{script.name}" in said
        assert named or re.search(rf"^(from|import) {script.stem}\b", imported, re.MULTILINE), script.name
    for picture in (ROOT / "docs").iterdir():
        assert picture.suffix not in (".png", ".jpg", ".webp") or f"{picture.name})" in said, picture.name


def test_every_recipe_is_documented():
    text = (ROOT / "docs" / "recipes.md").read_text(encoding="utf-8")
    for path in shipped_recipes():
        assert f"| `{path.stem}` |" in text, path.stem


def test_examples_of_recipes_and_init_files_are_valid(tmp_path):
    recipes = inits = 0
    for page in PAGES:
        for block in blocks(page, "yaml"):
            path = tmp_path / "example.yaml"
            path.write_text(block, encoding="utf-8")
            if re.search(r"^description:", block, re.MULTILINE):
                load_recipe(str(path))
                recipes += 1
            elif re.search(r"^frame:", block, re.MULTILINE):
                read_init(path)
                inits += 1
    assert recipes >= 3 and inits >= 3


def test_the_annotated_recipe_is_the_shipped_one(tmp_path):
    path = tmp_path / "example.yaml"
    path.write_text(blocks(ROOT / "docs" / "recipes.md", "yaml")[0], encoding="utf-8")
    written, own = (load_recipe(name).model_dump(exclude={"description"}) for name in (str(path), "factorized"))
    assert written == own


def test_findings_stand_in_their_table_and_pin_what_they_install():
    rows = re.findall(r"^\| `([a-z0-9-]+)` \|", (ROOT / "docs/findings.md").read_text(encoding="utf-8"), re.MULTILINE)
    scripts = sorted((ROOT / "findings").glob("*.sh"))
    assert sorted(rows) == [one.stem for one in scripts]
    for one in scripts:
        text = one.read_text(encoding="utf-8")
        installs = [line.split()[2:] for line in text.splitlines() if "pip install" in line]
        assert installs and all("==" in word for words in installs for word in words if not word.startswith("-")), one
        assert os.access(one, os.X_OK) or os.name == "nt", one
        assert "mktemp -d" in text and "# Found: " in text and "# Output seen:" in text, one
