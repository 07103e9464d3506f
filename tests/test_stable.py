"""What of Python is stable: the names and parameters in stable.txt, which are changed on purpose alone.

`python -m tests.test_stable` writes the list anew.
"""

import enum
import inspect
import re
from pathlib import Path

import facetrack_cli

LIST = Path(__file__).with_name("stable.txt")


def names_of(value):
    """The public names of a class, its fields, too, with what they are called with."""
    ours = [one for one in value.__mro__ if one.__module__.startswith("facetrack_cli")]
    for name in sorted({name for one in ours for name in (*inspect.get_annotations(one), *vars(one))}):
        if not name.startswith("_") or name == "_repr_html_":
            member = inspect.getattr_static(value, name, None)
            plain = getattr(member, "__func__", member)
            yield f".{name}{shown(plain) if inspect.isfunction(plain) else ''}"


def shown(value):
    """The parameters and their defaults, without types, which may become wider."""
    parameters = inspect.signature(value).parameters.values()
    bare = [one.replace(annotation=inspect.Parameter.empty) for one in parameters if one.name[0] != "_"]
    return re.sub(r"<(\S+) object at \w+>", r"<\1>", str(inspect.Signature(bare)))


def stable():
    lines = []
    for name in facetrack_cli.__all__:
        value = getattr(facetrack_cli, name)
        lines.append(
            f"{name}{'' if isinstance(value, type) and issubclass(value, (Exception, enum.Enum)) else shown(value)}"
        )
        if isinstance(value, type):
            lines += [f"    {line}" for line in names_of(value) if not issubclass(value, Exception)]
    return "\n".join(lines) + "\n"


def test_what_is_stable_is_as_it_was():
    assert stable() == LIST.read_text(encoding="utf-8"), (
        "on purpose? then: python -m tests.test_stable, and CHANGELOG.md"
    )


if __name__ == "__main__":
    LIST.write_text(stable(), encoding="utf-8")
