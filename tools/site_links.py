"""A hook of mkdocs.yml: pages of the project that stand outside of docs/ are pages of the site, and so is the help.

Their links, and those to them, are written for the files as they lie in the repository, and changed here. The keys of
recipes are written for the site alone, from the settings.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tools")]  # the package need not be installed: its help takes Click alone

from commands_doc import commands_page, keys_page  # noqa: E402

KEYS = "recipe_keys.md"
PAGES = {
    "CONTRIBUTING.md": "CONTRIBUTING.md",
    "SECURITY.md": "SECURITY.md",
    "CHANGELOG.md": "CHANGELOG.md",
    "sample_videos/README.md": "sample_clips.md",
}


def on_files(files: Any, config: Any) -> Any:
    for source, name in PAGES.items():
        files.append(File.generated(config, name, content=(ROOT / source).read_text(encoding="utf-8")))
    files.append(File.generated(config, "commands.md", content=commands_page()))
    files.append(File.generated(config, KEYS, content=keys_page()))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    sources = {name: source for source, name in PAGES.items()}
    own = page.file.src_uri
    folder = (ROOT / sources[own]).parent if own in sources else ROOT / "docs"

    def moved(link: re.Match[str]) -> str:
        target = (folder / link[1]).resolve()
        name = target.relative_to(ROOT).as_posix() if target.is_relative_to(ROOT) else ""
        name = "index.md" if name == "README.md" else PAGES.get(name, name.removeprefix("docs/"))
        return f"]({name}{link[2] or ''})"

    return re.sub(r"\]\((?![a-z]+:|#)([^)\s#]+)(#[^)\s]*)?\)", moved, markdown)
