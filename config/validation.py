"""From the refusal of a settings class to one line with the place and the remedy."""

from __future__ import annotations

import ast
import inspect
import json
from collections.abc import Callable, Mapping
from itertools import pairwise
from textwrap import dedent
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from config.hints import did_you_mean, unknown_key
from config.source import KeyPath
from controller.scales import si_unit

S = TypeVar("S", bound=BaseModel)

NONE = "none"
"""How a profile writes None, which TOML does not have; only where a setting can be None."""

Where = Callable[[KeyPath, KeyPath], str]
"""Gives, for the path of a table and a place in it (empty: the table itself), where it was written."""

_TYPES = {
    "float": "a number",
    "int": "a whole number",
    "string": "a text",
    "bool": "true or false",
    "tuple": "a list",
    "list": "a list",
    "dict": "a table",
    "model": "a table",
}
_BOUNDS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}


def validated(
    model: type[S], table: Mapping[str, Any], path: KeyPath, where: Where, problems: list[str]
) -> S | None:
    """Settings from a table.

    Args:
        model: The settings class.
        table: Keys and values as TOML gives them.
        path: Where the table stands in the profile, for `where`.
        where: Gives the place where a key was written, or is missing.
        problems: Grows by one line for each thing that is wrong.

    Returns:
        The settings, or None where something is wrong.
    """
    given = {
        key: None if value == NONE and _may_be_none(model, key) else value for key, value in table.items()
    }
    try:
        # As JSON, because only from JSON do strict settings take a list for a tuple and text for an Enum.
        return model.model_validate_json(json.dumps(given))
    except ValidationError as error:
        # An unknown key explains a missing one, so it comes first.
        for found in sorted(error.errors(include_url=False), key=lambda found: found["type"] == "missing"):
            location = tuple(str(part) for part in found["loc"])
            problems.append(f"{where(path, location)}{_reason(model, location, found)}")
        return None


def as_table(settings: BaseModel) -> dict[str, Any]:
    """The other way: keys and values as TOML and JSON hold them, defaults included."""
    return {
        key: NONE if value is None else _without_none(value)
        for key, value in settings.model_dump(mode="json").items()
    }


def _without_none(value: Any) -> Any:
    """A table in a table leaves out what is None: there it is the default, and TOML has no null."""
    if not isinstance(value, dict):
        return value
    return {key: _without_none(leaf) for key, leaf in value.items() if leaf is not None}


def _may_be_none(model: type[BaseModel], key: str) -> bool:
    field = model.model_fields.get(key)
    return field is not None and type(None) in get_args(field.annotation)


def _reason(model: type[BaseModel], location: KeyPath, found: Mapping[str, Any]) -> str:
    kind, value, context = found["type"], found["input"], found.get("ctx", {})
    key = location[-1] if location else ""
    fields = _fields(model, location[:-1])
    field = fields.get(key)
    if kind == "extra_forbidden":
        return f" = {shown(value)}: unknown key; {unknown_key(key, value, fields)}"
    if kind == "missing":
        return f" is missing{_described(model, location)}"
    if kind in ("literal_error", "enum"):
        allowed = [part.strip(" '") for part in context["expected"].replace(" or ", ",").split(",")]
        hint = did_you_mean(value, allowed) if isinstance(value, str) else ""
        return f" = {shown(value)}: must be {context['expected']}" + (f"; {hint}" if hint else "")
    if field and any(name in context for name in _BOUNDS):
        unit = si_unit(key)
        return f" = {shown(value)}: must be {_bounds(field, context)}" + (f" {unit}" if unit else "")
    wanted = "a whole number" if kind == "int_from_float" else _TYPES.get(kind.removesuffix("_type"))
    if wanted:
        unit = si_unit(key) if wanted == "a number" else ""
        return f" = {shown(value)}: must be {wanted}" + (f", in {unit}" if unit else "")
    message = str(found["msg"]).removeprefix("Value error, ").removeprefix("Assertion failed, ")
    return f" = {shown(value)}: {message[:1].lower()}{message[1:]}" if location else f": {message}"


def _bounds(field: FieldInfo, context: Mapping[str, Any]) -> str:
    """Both ends of the range, not only the one that was passed."""
    rules = [(sign, getattr(rule, name, None)) for rule in field.metadata for name, sign in _BOUNDS.items()]
    bounds = [f"{sign} {bound:g}" for sign, bound in rules if bound is not None]
    return " and ".join(
        bounds or [f"{sign} {context[name]:g}" for name, sign in _BOUNDS.items() if name in context]
    )


def _fields(model: type[BaseModel], location: KeyPath) -> Mapping[str, FieldInfo]:
    """The fields of the table at a location, through nested settings."""
    here = _table(model, location)
    return here.model_fields if here else {}


def _table(model: type[BaseModel], location: KeyPath) -> type[BaseModel] | None:
    """The settings class of the table at a location."""
    here: type[BaseModel] | None = model
    for part in location:
        field = here.model_fields.get(part) if here else None
        if field is not None:
            here = _settings_in(field.annotation)
    return here


def _described(model: type[BaseModel], location: KeyPath) -> str:
    """The text below a field, read from its source: for all fields at every start that takes 0.1 s."""
    here = _table(model, location[:-1])
    for known in here.__mro__ if here else ():
        if text := _texts(known).get(location[-1]):
            return f": {_first_sentence(text)}"
    return ""


def _texts(known: type) -> Mapping[str, str]:
    """The text below each field of a class; none where there is no source."""
    try:
        (written,) = ast.parse(dedent(inspect.getsource(known))).body
    except (OSError, TypeError):
        return {}
    assert isinstance(written, ast.ClassDef)
    return {
        ast.unparse(field.target): str(text.value.value)
        for field, text in pairwise(written.body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
    }


def _settings_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for part in get_args(annotation) if (found := _settings_in(part))), None)


def _first_sentence(text: str) -> str:
    return " ".join(text.split()).split(". ")[0].rstrip(".")


def shown(value: object) -> str:
    """A value as TOML writes it, cut where it is long."""
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 60 else f"{text[:57]}..."
