"""Representations that fit a line: what a value has beyond its defaults."""

from __future__ import annotations

from dataclasses import MISSING, Field, fields
from typing import Any


class ShortRepr:
    """Shows the fields of a data class that differ from their defaults; the text makes the value again."""

    __slots__ = ()

    def __repr__(self) -> str:
        """Name what differs."""
        values = ((field, getattr(self, field.name)) for field in fields(self))  # type: ignore[arg-type]
        shown = (f"{field.name}={value!r}" for field, value in values if not _same(value, default_of(field)))
        return f"{type(self).__name__}({', '.join(shown)})"


def default_of(field: Field[Any]) -> Any:
    """Return the default of a field; `dataclasses.MISSING` where it has none."""
    return field.default if field.default_factory is MISSING else field.default_factory()


def _same(value: Any, default: Any) -> bool:
    try:
        return bool(value == default)
    except ValueError:
        # Arrays of several elements.
        return False
