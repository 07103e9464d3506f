"""The rooms of the package, and which of them each one may import. CONTRIBUTING.md draws the same map."""

import ast
import sys
from functools import cache
from pathlib import Path

import facetrack_cli

PACKAGE = Path(facetrack_cli.__file__).parent
NUMERICS = {"numpy", "numba", "cv2", "scipy", "imageio", "imageio_ffmpeg", "av"}
ROOMS = {
    "core": "",
    "recipe": "core",
    "trajectory": "core",
    "video": "core trajectory",
    "engine": "core recipe video trajectory",
    "trackers": "core recipe video trajectory engine",
    "start": "core recipe video trajectory engine trackers",
    "run_folder": "core recipe video trajectory engine trackers start",
    "runs": "core recipe video trajectory engine trackers start run_folder",
    "evaluation": "core recipe video trajectory engine trackers start run_folder runs",
    "report": "core recipe video trajectory engine trackers start run_folder runs evaluation",
    "editor": "core recipe video trajectory engine trackers start run_folder runs evaluation report",
    "cli": "core recipe video trajectory engine trackers start run_folder runs evaluation report editor",
}
NO_FILE_IS_LONGER = 600


def is_module(name):
    path = PACKAGE.parent / name.replace(".", "/")
    return path.with_suffix(".py").is_file() or path.is_dir()


def imports(source):
    """(module, line, whether it is executed on import) of every import, `from facetrack_cli import x` as module x."""
    yield from imports_of(ast.parse(source), True)


def imports_of(node, at_once):
    if isinstance(node, ast.Import):
        yield from ((alias.name, node.lineno, at_once) for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        assert not node.level, "imports are absolute"
        base = node.module or ""
        named = [f"{base}.{alias.name}" for alias in node.names] if base.startswith("facetrack_cli") else []
        names = {name if base == "facetrack_cli" or is_module(name) else base for name in named} or [base]
        yield from ((name, node.lineno, at_once) for name in names)
    elif not isinstance(node, ast.expr):
        if isinstance(node, ast.FunctionDef) or (
            isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        ):
            at_once = False
        for below in ast.iter_child_nodes(node):
            yield from imports_of(below, at_once)


FILES = {path.relative_to(PACKAGE): path.read_text(encoding="utf-8") for path in sorted(PACKAGE.rglob("*.py"))}


@cache
def every_import():
    return [(path, *one) for path, text in FILES.items() for one in imports(text)]


def room_of(module):
    """Settings of a tracker stand in its folder, and belong to recipes: these are made of them."""
    room = module.split(".")[1] if module.startswith("facetrack_cli.") else ""
    return "recipe" if room == "trackers" and module.endswith(".settings") else room


def name_of(path):
    return "facetrack_cli." + path.as_posix().removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def wrong(allowed, those):
    """`file:line imports module` for each import whose module is not `allowed`."""
    return [f"{path}:{line} imports {module}" for path, module, line, _ in those if not allowed(path, module)]


def test_imports_between_rooms_point_down():
    assert {path.parts[0] for path in FILES if len(path.parts) > 1} == set(ROOMS)

    def allowed(path, module):
        room, other = room_of(name_of(path)), room_of(module)
        return len(path.parts) == 1 or not other or other in (room, *ROOMS[room].split())

    assert not wrong(allowed, every_import())


def test_no_two_modules_import_each_other():
    """Each may be the first one: who imports a module imports the packages that it is in."""
    graph = {name_of(path): set() for path in FILES}
    for path, module, _, at_once in every_import():
        if at_once and module in graph:
            name = name_of(path)
            around = {module.rsplit(".", deep)[0] for deep in range(1, module.count(".") + 1)}
            graph[name] |= {module} | {one for one in around if not f"{name}.".startswith(f"{one}.")}
    while ends := [module for module, needs in graph.items() if not needs & set(graph)]:
        for module in ends:
            del graph[module]
    assert not graph


def test_kernels_take_arrays_and_know_nothing_else():
    libraries = {"numba", "llvmlite", "numpy", *sys.stdlib_module_names}
    kernels = [one for one in every_import() if "kernels" in one[0].parts or one[0].stem.endswith("_kernels")]
    ours = ("facetrack_cli.engine.kernels.", "facetrack_cli.core.errors")
    assert kernels
    assert not wrong(lambda _, module: module.startswith(ours) or module.split(".")[0] in libraries, kernels)


def test_filters_and_likelihoods_never_meet():
    filters = [one for one in every_import() if one[0].stem == "filters"]
    assert filters
    assert not wrong(lambda _, module: module != "cv2" and ".video." not in module, filters)
    likelihoods = [
        one for one in every_import() if FILES[one[0]].count("(Likelihood):") and "settings" not in one[0].stem
    ]
    assert len({path for path, *_ in likelihoods}) > 5
    assert not wrong(lambda _, module: not module.endswith(".filters"), likelihoods)


def test_recipes_know_no_numerics():
    recipes = [one for one in every_import() if room_of(name_of(one[0])) == "recipe"]
    assert not wrong(lambda _, module: module.split(".")[0] not in NUMERICS, recipes)
    light = {f"facetrack_cli.core.{name}" for name in ("errors", "face_points", "models", "yaml_tree")}
    assert not wrong(lambda _, module: room_of(module) != "core" or module in light, recipes)


def test_commands_are_imported_by_the_lazy_loader_alone():
    assert not wrong(lambda _, module: not module.startswith("facetrack_cli.cli.commands"), every_import())


def test_what_help_needs_is_light():
    commands = {path.as_posix() for path in FILES if path.parts[:2] == ("cli", "commands")}
    needed = {"__init__.py", "__main__.py", "cli/app.py", "cli/options.py", "core/errors.py", "core/models.py"}
    needed |= {"core/__init__.py", "runs/signals.py", "engine/kernels/cache.py", "trajectory/formats/__init__.py"}
    needed |= commands
    allowed = {name_of(Path(name)) for name in needed} | {"facetrack_cli.cli"}
    those = [one for one in every_import() if one[0].as_posix() in needed and one[3]]
    others = {*sys.stdlib_module_names, "click"}
    assert not wrong(lambda _, module: module in allowed or module.split(".")[0] in others, those)


def test_no_file_is_long():
    assert not [str(path) for path, text in FILES.items() if text.count("\n") > NO_FILE_IS_LONGER]
