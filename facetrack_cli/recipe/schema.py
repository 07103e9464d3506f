"""The JSON Schema of recipes, whose fields are described by the docstrings below them.

They are read from the source when a command asks for the schema: pydantic's `use_attribute_docstrings` reads them
whenever the models are imported, at the start of every command.
"""

import ast
import inspect
import textwrap
from functools import cache
from itertools import pairwise
from typing import Any

from pydantic import BaseModel, TypeAdapter
from pydantic.json_schema import GenerateJsonSchema

from facetrack_cli.recipe.model import OpenCvRecipe, ParticleRecipe, ParticlesRecipe
from facetrack_cli.recipe.sections import Length, type_of


def json_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a recipe."""
    schema = TypeAdapter(ParticleRecipe | ParticlesRecipe | OpenCvRecipe).json_schema(schema_generator=_Described)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "Recipe", **schema}


class _Described(GenerateJsonSchema):
    """Fields get the docstrings below them, `type` by default that of its class; lengths are written as in recipes."""

    def encode_default(self, dft: Any) -> Any:
        return super().encode_default(dft.written() if isinstance(dft, Length) else dft)

    def model_schema(self, schema: Any) -> dict[str, Any]:
        found = super().model_schema(schema)
        cls = schema["cls"]
        said = {name: text for base in reversed(cls.__mro__) for name, text in _docstrings(base).items()}
        if type_of(cls):
            said.setdefault("type", (inspect.getdoc(cls) or "").partition("\n\n")[0])
        for name, field in found.get("properties", {}).items():
            if name in said:
                field.setdefault("description", said[name])
        return found


@cache
def _docstrings(model: type) -> dict[str, str]:
    """The attributes of a model's own body and the docstrings below them; none without its source."""
    if not issubclass(model, BaseModel) or model is BaseModel:
        return {}
    try:
        source = inspect.getsource(model)
    except (OSError, TypeError):
        return {}
    body = ast.parse(textwrap.dedent(source)).body[0]
    assert isinstance(body, ast.ClassDef)
    found = {}
    for field, below in pairwise(body.body):
        match field, below:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                found[name] = inspect.cleandoc(text)
    return found
