"""JSON Schema of a scenario file, for editors: Even Better TOML and others check and complete by it.

It takes every file that the loader takes. What it cannot say, such as that a name is one of the components, the loader
refuses all the same.
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, Final, cast

from pydantic import TypeAdapter

from estimator import METHODS
from estimator.methods import FORMER_METHODS, method_named

from .reference import docstrings, tables_in
from .scenario import Scenario
from .schema.estimation import LoopSettings
from .schema.table import Table

URL: Final = "https://raw.githubusercontent.com/fmu-retune/fmu-retune/main/docs/scenario.schema.json"
"""Where editors find the schema: the first line of a scenario names it."""
_LIMITS: Final = {"gt": "exclusiveMinimum", "lt": "exclusiveMaximum", "ge": "minimum", "le": "maximum"}
"""Limits in the metadata of a dataclass, and their names in JSON Schema."""


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema, draft 2020-12, of a scenario file."""
    schema: dict[str, Any] = Scenario.model_json_schema()
    defined: dict[str, Any] = schema["$defs"]
    tables = {table.__name__: table for table in _all_tables()}
    for key in set(Scenario.model_fields) - Scenario.known_keys():
        del schema["properties"][key]
    schema["$defs"] = defined = {name: definition for name, definition in defined.items() if name in tables}
    for name, definition in [("Scenario", schema), *defined.items()]:
        _complete(definition, tables[name])
    estimation = defined["EstimationSettings"]
    del estimation["properties"]["methods"]
    loop = TypeAdapter(LoopSettings).json_schema()
    _complete(loop, LoopSettings)
    for name in (*METHODS, *FORMER_METHODS):
        estimation["properties"][name] = _method(name, loop, defined)
    estimation["patternProperties"] = {":": {"type": "object", "description": "Settings of an estimator of yours."}}
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "$id": URL, "title": "Scenario of fmu-retune"}
    return head | {key: value for key, value in schema.items() if key != "title"}


def _all_tables() -> list[type[Any]]:
    """Return the tables and dataclasses of the schema, each once."""
    return [Scenario, *dict.fromkeys(table for _, table in tables_in(Scenario, ""))]


def _complete(definition: dict[str, Any], table: type[Any]) -> None:
    """Add to a table's definition what pydantic leaves out: descriptions, limits and former names of keys."""
    properties: dict[str, Any] = definition.get("properties", {})
    texts = docstrings(table)
    for key, schema in properties.items():
        if key in texts:
            schema["description"] = texts[key]
    definition["additionalProperties"] = False
    if "const" in properties.get("kind", ()):  # by which the loader tells it from others
        definition["required"] = sorted({"kind", *definition.get("required", ())})
    if is_dataclass(table):
        _add_limits(properties, table)
    if issubclass(table, Table):
        for former, now in table.former_keys.items():
            old, new = former.rpartition(".")[2], now.rpartition(".")[2]
            properties[old] = properties[new] | {"deprecated": True, "description": f"Now {new}."}


def _add_limits(properties: dict[str, Any], table: Any) -> None:
    for field in fields(table):
        metadata = cast(Mapping[str, Any], field.metadata)
        properties[field.name] |= {_LIMITS[key]: value for key, value in metadata.items() if key in _LIMITS}


def _method(name: str, loop: dict[str, Any], defined: dict[str, Any]) -> dict[str, Any]:
    """Return the definition of an estimator's table: its settings, and those of the loop that it replaces."""
    method = method_named(name)
    own: dict[str, Any] = TypeAdapter(method.settings).json_schema()
    _complete(own, method.settings)
    for inner in (own, loop):
        for key, definition in inner.pop("$defs", {}).items():
            defined.setdefault(key, definition)
    properties = {**loop["properties"], **own.get("properties", {})}
    return {"type": "object", "properties": properties, "additionalProperties": False}
