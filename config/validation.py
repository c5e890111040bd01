"""From the refusal of a settings class to one line with the place and the remedy."""

import inspect
import json
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from itertools import compress
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from config.hints import did_you_mean, unknown_key
from config.source import KeyPath, ProfileError, Table
from controller.scales import si_unit

S = TypeVar("S", bound=BaseModel)

NONE = "none"
"""How a profile writes None, which TOML does not have; only where a setting can be None."""

Where = Callable[[KeyPath], str]
"""Gives, for a place in a table (empty: the table itself), where it was written."""


def validated(model: type[S], table: Mapping[str, Any], where: Where) -> S:
    """Settings from a table.

    Args:
        table: Keys and values as TOML gives them.
        where: Gives the place where a key was written, or is missing.

    Raises:
        ProfileError: one line for each thing that is wrong.
    """
    given = _with_none(model, table)
    try:
        # As JSON, because only from JSON do strict settings take a list for a tuple and text for an Enum. A date
        # is text then, which no number is made of.
        return model.model_validate_json(json.dumps(given, default=str))
    except ValidationError as error:
        # An unknown key explains a missing one, so it comes first.
        found = sorted(error.errors(include_url=False), key=lambda found: found["type"] == "missing")
    places = [tuple(str(part) for part in each["loc"]) for each in found]
    # A list whose every item is refused counts as empty: that is no mistake of its own.
    kept = [
        not (each["type"] == "too_short" and any(place == other[:-1] for other in places))
        for place, each in zip(places, found, strict=True)
    ]
    places, found = list(compress(places, kept)), list(compress(found, kept))
    raise ProfileError(
        [f"{where(place)}{_reason(model, place, each)}" for place, each in zip(places, found, strict=True)]
    )


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


def may_be_none(model: type[BaseModel], key: str) -> bool:
    """Whether a profile may write "none" for a setting."""
    field = model.model_fields.get(key)
    return field is not None and type(None) in get_args(field.annotation)


def _reason(model: type[BaseModel], place: KeyPath, found: Mapping[str, Any]) -> str:
    """What pydantic found, with the unit or the key that was probably meant."""
    kind, value, key = found["type"], found["input"], place[-1] if place else ""
    table = _table(model, place[:-1])
    if kind == "missing":
        return f" is missing{_described(table, key)}"
    has = "" if not place or isinstance(value, dict) else f" = {shown(value)}"
    if kind == "extra_forbidden":
        return (
            f" = {shown(value)}: unknown key; {unknown_key(key, value, table.model_fields if table else ())}"
        )
    message = found["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
    message = f"{message[:1].lower()}{message[1:]}".replace("be an object", "be a table")
    message = re.sub("^tuple should have at least (\\d+) items?.*", r"needs \1 or more items", message)
    unit = si_unit(key) if message.startswith("must be") else ""
    hint = did_you_mean(value, re.findall("'(.*?)'", message)) if isinstance(value, str) else ""
    return f"{has}: {message}" + (f", in {unit}" if unit else "") + (f"; {hint}" if hint else "")


def _with_none(model: type[BaseModel] | None, table: Mapping[str, Any]) -> Table:
    """A table, and the settings in it, with None where "none" is written for it."""
    given: Table = {}
    for key, value in table.items():
        given[key] = value
        if isinstance(value, Mapping):
            field = model.model_fields.get(key) if model else None  # a key of a dict of settings has none
            given[key] = _with_none(_settings_in(field.annotation) if field else model, value)
        elif value == NONE and model is not None and may_be_none(model, key):
            given[key] = None
    return given


def _table(model: type[BaseModel], place: KeyPath) -> type[BaseModel] | None:
    """The settings class of the table at a place, through nested settings."""
    here: type[BaseModel] | None = model
    for part in place:
        field = here.model_fields.get(part) if here else None
        if field is not None:
            here = _settings_in(field.annotation)
    return here


def _settings_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for part in get_args(annotation) if (found := _settings_in(part))), None)


def _described(table: type[BaseModel] | None, key: str) -> str:
    """The first sentence below a field, read from its source: for all fields at every start that takes 0.1 s."""
    field = rf'^    {key}:.*\n(?:    [ )].*\n)*    """((?:.|\n)*?)(\.\s|\.?""")'
    for known in inspect.getmro(table) if table else ():
        if key in vars(known).get("__annotations__", ()):
            with suppress(OSError):  # a class without a file
                text = re.search(field, inspect.getsource(known), re.MULTILINE)
                return f": {' '.join(text[1].split())}" if text else ""
    return ""


def shown(value: object) -> str:
    """A value as TOML writes it, cut where it is long."""
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 60 else f"{text[:57]}..."
