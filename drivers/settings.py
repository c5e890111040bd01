"""The base of every settings class: frozen, strict, finite, and closed to unknown keys."""

from pydantic import BaseModel, ConfigDict


class Settings(BaseModel):
    """Validated settings; each subclass sits beside the class that it configures.

    Numbers are finite, integers are accepted where a float is asked for, nothing else is converted,
    and an unknown key is an error. A field's description says what it is, its unit and its source.
    """

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        strict=True,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
        validate_default=True,
    )
