# SPDX-License-Identifier: Apache-2.0
"""Settings files: YAML that is validated against a frozen dataclass, whose fields declare keys, types and bounds.

A field is declared as ``spool_radius: Annotated[float, key("spool_radius_m", gt=0.0)]``. Values are validated
as strictly as in JSON: a boolean is not a number, numbers are finite, and an unknown key is an error. The same
declaration yields the JSON Schema, with which an editor completes and checks the file.

The functions import pydantic, because this takes a fifth of a second, and --help needs none of it.
"""

from __future__ import annotations

import difflib
import json
import re
import reprlib
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from worm_msgs.yaml_file import SettingsFileError, read_yaml, unknown_name

if TYPE_CHECKING:
    from pydantic import ConfigDict, GetCoreSchemaHandler, TypeAdapter
    from pydantic_core import ErrorDetails, core_schema

T = TypeVar("T")
_CONFIG: ConfigDict = {"strict": True, "extra": "forbid", "allow_inf_nan": False}
#: ``__pydantic_config__`` of a dataclass for files of other programs, whose unknown keys are ignored.
FOREIGN: ConfigDict = {"strict": True, "extra": "ignore", "allow_inf_nan": False}
_BOUNDS = ("greater_than", "greater_than_equal", "less_than", "less_than_equal")
_YAML_TERMS = {"an object": "a mapping", "valid array": "list", " after validation": ""}


def key(name: str | None = None, **bounds: Any) -> Any:
    """Return the annotation of a field.

    Args:
        name: key in the file; None: the name of the field.
        bounds: arguments of pydantic.Field, such as gt and le.
    """
    from pydantic import Field

    return Field(alias=name, **bounds)


class OneOf(Generic[T]):
    """Annotation of a field that allows only certain values.

    If the choices are a mapping, the file contains one of its keys, and the field stores the value of that key.
    """

    def __init__(self, choices: Iterable[str | int] | Mapping[str, T]) -> None:
        self._choices = choices

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Return the schema, as pydantic requires."""
        from pydantic_core import core_schema

        schema = core_schema.literal_schema(list(self._choices))
        if not isinstance(self._choices, Mapping):
            return core_schema.no_info_before_validator_function(_reject_boolean, schema)
        return core_schema.no_info_after_validator_function(self._choices.__getitem__, schema)


def _reject_boolean(value: Any) -> Any:
    if isinstance(value, bool):  # Python compares True and False equal to 1 and 0.
        raise ValueError(f"must not be {value}")
    return value


class Converted:
    """Annotation of a field whose value is validated as the type ``kind`` and then converted by ``function``."""

    def __init__(self, kind: Any, function: Callable[[Any], Any]) -> None:
        self._kind, self._function = kind, function

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Return the schema, as pydantic requires."""
        from pydantic_core import core_schema

        schema = handler.generate_schema(self._kind)
        return core_schema.no_info_after_validator_function(self._function, schema)


def read_settings(path: Path, kind: type[T], error: type[Exception] = SettingsFileError) -> T:
    """Return the content of a YAML file as an instance of the dataclass ``kind``.

    Raises:
        error: The file is unreadable or invalid. The message begins with the path.
    """
    content = read_yaml(path, error)
    try:
        return settings_of(content, kind)
    except SettingsFileError as problem:
        raise error(f"{path}: {problem}") from None


def settings_of(content: Any, kind: type[T]) -> T:
    """Return the parsed content of a file as an instance of the dataclass ``kind``. Raises SettingsFileError."""
    from pydantic import ValidationError

    try:
        text = json.dumps([content], default=str)
    except (TypeError, ValueError, RecursionError) as error:
        raise SettingsFileError(f"has keys or values that settings cannot have: {error}") from None
    try:
        return _adapter(kind).validate_json(text)[0]  # type: ignore[arg-type] # for mypy no type is hashable
    except ValidationError as error:
        raise SettingsFileError(_message(error.errors(include_url=False), kind)) from None


def json_schema(kind: type[Any]) -> dict[str, Any]:
    """Return the JSON Schema of the files whose content is the dataclass ``kind``."""
    schema = _adapter(kind).json_schema()  # type: ignore[arg-type]
    definitions = schema["$defs"]
    whole = definitions.pop(schema["prefixItems"][0]["$ref"].split("/")[-1])
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **whole,
        **({"$defs": definitions} if definitions else {}),
    }


@cache
def _adapter(kind: type[T]) -> TypeAdapter[tuple[T]]:
    from pydantic import TypeAdapter

    # Pydantic rejects a configuration for a plain dataclass, but accepts it for a tuple that contains one.
    return TypeAdapter(tuple[kind], config=_CONFIG)  # type: ignore[arg-type, valid-type]


def _message(errors: list[ErrorDetails], kind: type[Any]) -> str:
    """Return a message about one of the errors.

    An unknown key has priority over other errors: a misspelt key causes a missing key, too, and the unknown one shows
    the misspelling.
    """
    first = min(errors, key=lambda error: error["type"] != "unexpected_keyword_argument")
    path, value, words = first["loc"][1:], first["input"], first["msg"]
    if first["type"] == "unexpected_keyword_argument":
        unknown = unknown_name("key", str(path[-1]), _known_keys(kind, path[:-1]))
        return f"{_place(path[:-1])}: {unknown}" if path[:-1] else unknown
    if first["type"] == "json_invalid":
        return f"{_place(path)} contains text that is not valid Unicode"
    if first["type"] == "missing":
        return f"{_place(path)} is missing"
    if first["type"] == "value_error":
        return f"{_place(path)}: {first['ctx']['error']}" if path else str(first["ctx"]["error"])
    if path[-1:] == ("[key]",):
        path = (*path[:-2], "a key")
    if first["type"] == "literal_error" and isinstance(value, str):
        choices = re.findall("'([^']*)'", first["ctx"]["expected"])
        if difflib.get_close_matches(value, choices, n=1):
            is_key = path[-1] == "a key"
            unknown = unknown_name("key" if is_key else "value", value, choices)
            return f"{_place(path[:-1] if is_key else path)}: {unknown}"
    for term, ours in _YAML_TERMS.items():
        words = words.replace(term, ours)
    must = words.partition(" should ")[2].partition(", not ")[0]
    return f"{_place(path)} must {must}, not {reprlib.repr(value)}{_hint(first, kind)}"


def _place(path: Iterable[str | int]) -> str:
    """Return the keys and indices that lead to a value as text, for example ``servos: [0]: sign``."""
    parts = [f"[{part}]" if isinstance(part, int) else part for part in path]
    return ": ".join(parts) or "the file"


def _hint(error: ErrorDetails, kind: type[Any]) -> str:
    """Return a likely reason for a wrong value, to be appended to the message; empty if none is known."""
    if error["type"] in _BOUNDS and any(error["ctx"].values()):
        unit = _schema_at(kind, error["loc"][1:]).get("description")
        return f"; is it in another unit?{f' (expected: {unit})' if unit else ''}"
    if error["type"] == "float_type" and isinstance(error["input"], str) and "e" in error["input"]:
        return " (YAML reads 1e-3 as text: write 1.0e-3)"
    return ""


def _known_keys(kind: type[Any], path: Iterable[str | int]) -> list[str]:
    """Return the keys of the mapping at a path."""
    return list(_schema_at(kind, path)["properties"])


def _schema_at(kind: type[Any], path: Iterable[str | int]) -> dict[str, Any]:
    """Return the part of the JSON Schema that describes the value at a path."""
    top = json_schema(kind)
    part: dict[str, Any] = top
    for step in path:
        items = part.get("prefixItems", ())
        if isinstance(step, int):
            part = items[step] if step < len(items) else part["items"]
        else:
            part = part.get("properties", {}).get(step) or part["additionalProperties"]
        part = part.get("anyOf", [part])[0]
        if "$ref" in part:
            part = top["$defs"][part["$ref"].split("/")[-1]]
    return part
