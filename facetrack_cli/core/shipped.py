"""Where the shipped recipes are. Nothing is loaded, so that a shell can complete their names."""

from pathlib import Path


def shipped_folder() -> Path:
    """Where the shipped recipes are: in the installed package, or beside it in a working copy."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "configs"
    return inside if inside.is_dir() else package.parent / "configs"


def shipped_recipes() -> list[Path]:
    """The files of the shipped recipes, by name."""
    return sorted(shipped_folder().glob("*.yaml"))
