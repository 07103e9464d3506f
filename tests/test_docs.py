"""The documentation holds: generated pages are fresh, links lead somewhere, command lines parse, examples are valid."""

import importlib.util
import re
import shlex
from pathlib import Path

import click
import pytest

from facetrack_cli.cli import cli
from facetrack_cli.recipe import load_recipe, shipped_recipes
from facetrack_cli.start import read_init

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
FENCE = re.compile(r"^( *)```(\w*)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)
OPERATORS = {"|", "||", "&&", "&", ";", ">", ">>", "<", "2>", "(", ")", "<(", "then", "do"}


def load_tool():
    spec = importlib.util.spec_from_file_location("commands_doc", ROOT / "tools" / "commands_doc.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


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
    return [
        pytest.param(arguments, xargs, id=f"{page.name}: {' '.join(arguments)}")
        for page in PAGES
        for block in blocks(page, "sh", "bash", "console", "")
        for arguments, xargs in command_lines(block)
    ]


def test_generated_pages_are_fresh(capsys):
    assert load_tool().main(["--check"]) == 0, capsys.readouterr().out


def test_a_stale_page_is_told(tmp_path, monkeypatch, capsys):
    tool = load_tool()
    monkeypatch.setattr(tool, "DOCS", tmp_path)
    (tmp_path / "recipes.md").write_text(f"# Recipes\n\n{tool.BEGIN}\nold\n{tool.END}\n\nkept\n")
    assert tool.main(["--check"]) == 1
    assert capsys.readouterr().out.count("is stale") == 2 and not (tmp_path / "commands.md").exists()
    assert tool.main([]) == 0
    assert tool.main(["--check"]) == 0
    text = (tmp_path / "recipes.md").read_text()
    assert "\nold\n" not in text and text.endswith("kept\n") and "| `filter.particles` |" in text


def test_every_command_and_option_is_in_the_reference():
    text = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    for name, command in load_tool().commands():
        assert f"\n## {name}\n" in text
        for option in command.params:
            assert all(word in text for word in option.opts if word.startswith("-")), (name, option.opts)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_and_pictures_are_there(page):
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", link):
            continue
        name, _, anchor = link.partition("#")
        path = (page.parent / name).resolve() if name else page
        assert path.exists(), f"{page.name}: {link}"
        if anchor:
            headings = re.findall(r"^#+ (.*)$", FENCE.sub("", path.read_text(encoding="utf-8")), re.MULTILINE)
            assert anchor in map(slug, headings), f"{page.name}: {link}"


def test_command_lines_are_found():
    found = list(
        command_lines("find . | xargs -0 facetrack run -j 2 && a/facetrack init x.mp4 -o - > y\nls facetracks")
    )
    assert found == [(["run", "-j", "2"], True), (["init", "x.mp4", "-o", "-"], False)]
    assert len(shell_lines()) > 40


@pytest.mark.parametrize(("arguments", "xargs"), shell_lines())
def test_command_lines_parse(arguments, xargs):
    if "..." in arguments or "COMMAND" in arguments or any(word.startswith("[") for word in arguments):
        return  # a usage line
    try:
        params = parse(arguments, ["clip.mp4"] if xargs else [])
    except click.exceptions.Exit as left:  # --help
        assert left.exit_code == 0
        return
    config = params.get("config")
    if config is not None and config.removesuffix(".yaml") in {path.stem for path in shipped_recipes()}:
        load_recipe(config, [text for text in params["overrides"] if text != "KEY=VALUE"])


@pytest.mark.parametrize("wrong", [["run", "a.mp4", "--colour"], ["rnu"], ["run"], ["recipes", "shwo", "sir"]])
def test_command_lines_that_do_not_parse_are_refused(wrong):
    with pytest.raises(click.UsageError):
        parse(wrong)


def test_scripts_named_are_there():
    for page in PAGES:
        for block in blocks(page, "sh", "bash"):
            for script in re.findall(r"python3? ((?:benchmarks|tools|sample_videos)/\S+\.py)", block):
                assert (ROOT / script).exists(), f"{page.name}: {script}"


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
    [block, *_] = blocks(ROOT / "docs" / "recipes.md", "yaml")
    path = tmp_path / "example.yaml"
    path.write_text(block, encoding="utf-8")
    assert load_recipe(str(path)).model_dump(exclude={"description"}) == load_recipe("factorized").model_dump(
        exclude={"description"}
    )
