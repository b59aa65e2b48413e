"""JSON Schemas for editors: of a scenario, with parts by reference as `load` takes them, and of a campaign."""

from __future__ import annotations

import ast
import inspect
from functools import cache
from itertools import pairwise
from textwrap import dedent
from typing import Any

from pydantic import BaseModel, TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from lidar_emu.scenario.campaign import Campaign
from lidar_emu.scenario.parts import PART_FOLDERS, shipped
from lidar_emu.scenario.schema import BenchScenario, FlightScenario

Node = dict[str, Any]

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_DEFINITIONS = "#/$defs/"


class _Generator(GenerateJsonSchema):
    """Generates the schema as an author writes it, without titles that only repeat the keys."""

    def field_title_should_be_set(self, schema: object) -> bool:  # noqa: ARG002
        return False

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        node = super().model_schema(schema)
        for model in schema["cls"].__mro__:
            for key, text in _attribute_docstrings(model).items():
                if key in node["properties"]:
                    node["properties"][key].setdefault("description", text)
        kind = node["properties"].get("kind", {})
        if "const" in kind:
            kind.setdefault("description", "Chooses this kind.")
        return node

    def function_before_schema(self, schema: core_schema.BeforeValidatorFunctionSchema) -> JsonSchemaValue:
        if schema["schema"]["type"] == "bool":
            return {"enum": [True, False, "on", "off", "yes", "no"]}
        return super().function_before_schema(schema)

    def tagged_union_schema(self, schema: core_schema.TaggedUnionSchema) -> JsonSchemaValue:
        node = super().tagged_union_schema(schema)
        # An OpenAPI keyword, unknown to JSON Schema: each choice already fixes its `kind`.
        node.pop("discriminator", None)
        return node


@cache
def _attribute_docstrings(model: type[BaseModel]) -> dict[str, str]:
    """Docstrings of the attributes that a model itself declares.

    pydantic reads them when a model is made, which takes every start a tenth of a second.
    """
    if not issubclass(model, BaseModel) or model is BaseModel:
        return {}
    declared = ast.parse(dedent(inspect.getsource(model))).body[0]
    return {
        ast.unparse(attribute.target): inspect.cleandoc(text)
        for attribute, below in pairwise(ast.iter_child_nodes(declared))
        if isinstance(attribute, ast.AnnAssign) and (text := _text(below)) is not None
    }


def _text(statement: ast.AST) -> str | None:
    value = statement.value if isinstance(statement, ast.Expr) else None
    return value.value if isinstance(value, ast.Constant) and isinstance(value.value, str) else None


def models_schema(models: Any = FlightScenario | BenchScenario) -> Node:
    """JSON Schema of a file with its references resolved: `anyOf` the models, and `$defs` of all below them."""
    adapter: TypeAdapter[Any] = TypeAdapter(models)
    return adapter.json_schema(schema_generator=_Generator)


def json_schema() -> Node:
    """JSON Schema (draft 2020-12) of a scenario file as its author writes it.

    In place of a part, the name of a file and a mapping with `base` and the keys that differ are allowed too.
    Conditions between several keys are left to `load`.
    """
    schema = models_schema()
    definitions = schema["$defs"]
    for scenario in (FlightScenario, BenchScenario):
        properties = definitions[scenario.__name__]["properties"]
        for part in (part for part in PART_FOLDERS if part in properties):
            properties[part] = _or_reference(part, properties[part], definitions)
    return {"$schema": _DIALECT, "title": "lidar-emu scenario", **schema}


def campaign_schema() -> Node:
    """JSON Schema (draft 2020-12) of a campaign's file. The keys that it sets and draws are checked with the
    scenario."""
    return {**models_schema(Campaign), "$schema": _DIALECT, "title": "lidar-emu campaign"}


def shipped_parts(part: str) -> list[str]:
    """Names of the shipped files of a part, e.g. the instruments."""
    return sorted(path.stem for path in shipped(PART_FOLDERS[part]).glob("*.yaml"))


def target(node: Node) -> str:
    """The name of the definition that a `$ref` points to."""
    return str(node["$ref"]).removeprefix(_DEFINITIONS)


def choices(node: Node) -> list[Node]:
    """The alternatives of a union, nested ones included, or the node alone."""
    alternatives: list[Node] = node.get("anyOf") or node.get("oneOf") or []
    return [choice for alternative in alternatives for choice in choices(alternative)] or [node]


def _or_reference(part: str, node: Node, definitions: Node) -> Node:
    """The schema of a part given in place, by name, or as a `base` with other values."""
    name = {
        "type": "string",
        "description": "A YAML file beside the scenario, or one that is shipped.",
        "examples": shipped_parts(part),
    }
    inline = [{"$ref": choice["$ref"]} for choice in choices(node)]
    based = [_with_base(name, target(choice), definitions) for choice in inline]
    return {"description": node["description"], "anyOf": [name, *inline, *based]}


def _with_base(name: Node, model: str, definitions: Node) -> Node:
    overrides = definitions[target(_overrides(model, definitions))]
    definitions[f"{model}WithBase"] = {
        **overrides,
        "title": f"{model} with base",
        "properties": {"base": name, **overrides["properties"]},
        "required": ["base"],
    }
    return {"$ref": f"{_DEFINITIONS}{model}WithBase"}


def _overrides(model: str, definitions: Node) -> Node:
    """A reference to the model with no key required: what is left out comes from the base file."""
    name = f"{model}Overrides"
    if name not in definitions:
        full = {key: value for key, value in definitions[model].items() if key != "required"}
        properties = {key: _relaxed(node, definitions) for key, node in full["properties"].items()}
        definitions[name] = {**full, "title": f"{model} overrides", "properties": properties}
    return {"$ref": _DEFINITIONS + name}


def _relaxed(node: Node, definitions: Node) -> Node:
    """A key below a `base`: mappings are merged key by key, anything else is replaced as a whole."""
    own = {key: value for key, value in node.items() if key not in ("default", "$ref", "anyOf", "oneOf")}
    alternatives = [
        _overrides(target(choice), definitions) if "$ref" in choice else choice for choice in choices(node)
    ]
    if alternatives == [node]:
        return own
    return {**own, "anyOf": alternatives}
