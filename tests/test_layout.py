"""Imports point down only, read off the syntax trees. LAYERS is the map; CONTRIBUTING.md says why."""

import ast
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

import facetrack_cli

PACKAGE = Path(facetrack_cli.__file__).parent

# lowest first; a unit imports only from the layers below its own. A folder is one unit.
LAYERS = [
    {"digits", "errors", "types", "kernels", "kernel_cache", "options", "recipe_base"},
    {"told"},
    {"exclusion", "patches", "resampling", "skin", "spaces", "stopping", "sinks", "trajectory", "video", "yaml_text"},
    {"calibration", "plain_arrays", "subspaces"},
    {"differences", "gallery"},
    {"confidence", "filters", "formats", "likelihoods", "motion", "priors", "recipe_messages", "start"},
    {"guide"},
    {
        "evaluation",
        "gallery_people",
        "gallery_picture",
        "lengths",
        "opencv",
        "prior_fit",
        "particle_target",
        "prior_picture",
        "track",
    },
    {
        "corrected",
        "gallery_fit",
        "gallery_learn",
        "pipeline",
        "plots",
        "recipe_adaptive",
        "recipe_regions",
        "recipe_skin",
    },
    {"recipe_sections"},
    {"recipe_filter"},
    {"recipe"},
    {"recipe_gallery"},
    {"build_corrections"},
    {"build"},
    {"outputs", "progress"},
    {"job"},
    {"batch"},
    {"experiments", "report"},
    {"fixing", "regression"},
    {"page"},
    {"commands"},
    {"cli"},
    {"__main__"},
]
RECIPE = {unit for layer in LAYERS for unit in layer if unit.startswith("recipe")} | {"lengths", "yaml_text"}
PARTS = {"filters", "likelihoods", "motion", "priors"}
NUMERICS = {"numpy", "numba", "cv2", "scipy", "imageio", "imageio_ffmpeg"}


class Import(NamedTuple):
    name: str  # as in facetrack_cli.video.source, or numpy.typing
    line: int
    for_types: bool  # under `if TYPE_CHECKING:`

    @property
    def unit(self):
        """The part of the package that it names; empty for a library or the package itself."""
        return self.name.split(".")[1] if self.name.startswith("facetrack_cli.") else ""

    @property
    def library(self):
        return self.name.split(".")[0]


def imports(source, module, is_package=False):
    """Every import of a module's source, also inside functions, with relative names made whole."""
    tree = ast.parse(source)
    typed = {
        id(below)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING")
        for statement in node.body
        for below in ast.walk(statement)
    }
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = module.split(".")[: None if is_package and node.level == 1 else -node.level + is_package]
                base = ".".join([*above, *filter(None, [node.module])])
            # `from package import module` names the module; a name that is none of ours is a value of the base
            names = [f"{base}.{alias.name}" if base == "facetrack_cli" else base for alias in node.names]
        else:
            continue
        found += [Import(name, node.lineno, id(node) in typed) for name in names]
    return [one for one in found if one.name != "facetrack_cli.__version__"]


def modules():
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        is_package = parts[-1] == "__init__"
        name = ".".join(["facetrack_cli", *(parts[:-1] if is_package else parts)])
        yield name, imports(path.read_text(encoding="utf-8"), name, is_package)


MODULES = dict(modules())


def unit(module):
    return module.split(".")[1] if "." in module else ""


def imported(*units, types=True):
    """(module, import) for every import in these units."""
    return [
        (module, one) for module, all_ in MODULES.items() if unit(module) in units for one in all_
        if types or not one.for_types
    ]  # fmt: skip


def test_imports_are_read_whole():
    source = (
        "import numpy.typing\nfrom facetrack_cli import kernels, __version__\nfrom facetrack_cli.video.source import x"
        "\nfrom typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from ..types import Frame\n"
        "def f():\n    from . import marks\n    from .text import Font\n"
    )
    found = {(one.name, one.unit, one.for_types) for one in imports(source, "facetrack_cli.video.draw")}
    assert found == {
        ("numpy.typing", "", False),
        ("facetrack_cli.kernels", "kernels", False),
        ("facetrack_cli.video.source", "video", False),
        ("typing", "", False),
        ("facetrack_cli.types", "types", True),
        ("facetrack_cli.video", "video", False),
        ("facetrack_cli.video.text", "video", False),
    }
    inside = imports("from .haar import x\nfrom ..types import y", "facetrack_cli.start", is_package=True)
    assert [one.name for one in inside] == ["facetrack_cli.start.haar", "facetrack_cli.types"]


def test_every_module_has_a_layer():
    known = set.union(*LAYERS)
    unknown = {unit(module) for module in MODULES} - known - {""}
    assert not unknown, f"give {sorted(unknown)} a layer in tests/test_layout.py"
    assert sum(map(len, LAYERS)) == len(known)


@pytest.mark.parametrize("module", MODULES)
def test_imports_point_down(module):
    height = {name: level for level, names in enumerate(LAYERS) for name in names}
    mine = unit(module)
    if mine not in height:
        return  # the package itself; a module without a layer fails above
    for one in MODULES[module]:
        if one.unit and one.unit != mine and not one.for_types:
            assert height.get(one.unit, 99) < height[mine], (
                f"{module}:{one.line} imports {one.name}, which is not below"
            )


def test_kernels_import_nothing_of_ours():
    found = [(module, one.name) for module, one in imported("kernels") if one.unit]
    assert not [pair for pair in found if pair[1].split(".")[1] != "kernels"]
    libraries = {one.library for _, one in imported("kernels")} - set(sys.stdlib_module_names)
    assert libraries <= {"numba", "numpy", "facetrack_cli", "__future__"}


def test_filters_and_likelihoods_never_meet():
    assert not [pair for pair in imported("filters") if pair[1].unit == "likelihoods"]
    assert not [pair for pair in imported("likelihoods") if pair[1].unit == "filters"]
    assert "cv2" not in {one.library for _, one in imported("filters")}, "filters never see an image"


def test_recipes_know_no_numerics():
    for module, one in imported(*RECIPE):
        assert one.library not in NUMERICS, f"{module}:{one.line}"
        assert one.unit in RECIPE | {"errors", ""}, f"{module}:{one.line} imports {one.name}"


def test_commands_are_imported_by_the_lazy_loader_alone():
    assert not [(module, one) for module, all_ in MODULES.items() for one in all_ if one.unit == "commands"]


def test_build_alone_knows_recipes_and_parts():
    both = [
        module for module, all_ in MODULES.items()
        if "recipe" in {one.unit for one in all_} and PARTS & {one.unit for one in all_}
    ]  # fmt: skip
    assert both in ([], ["facetrack_cli.build"])


@pytest.mark.parametrize("name", ["", "errors", "cli", "__main__"])
def test_what_help_needs_is_light(name):
    allowed = {*sys.stdlib_module_names, "click", "facetrack_cli"}
    found = imported(name, types=False)
    assert {one.library for _, one in found} <= allowed
    assert {one.unit for _, one in found} <= {"", "cli", "errors", "kernel_cache"}
