"""Checks of arguments, so that an error names the argument, its value and what would work.

They check types and shapes; the engine checks which values are allowed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import is_dataclass
from difflib import get_close_matches
from functools import cache
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from ._evis import ConfigError

#: Beyond it, sums of times would not fit the engine's integers.
MOST_US = 2**62 - 1

_MOST_U32 = 2**32 - 1


def shown(value: object) -> str:
    """Return ``value`` as errors show it: on one line, and not much of what is long."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 100 else f"{text[:97]}..."


def one_of(names: Iterable[str]) -> str:
    """Return the names as errors list them."""
    return " or ".join(f"'{name}'" for name in names)


def did_you_mean(value: str, names: Iterable[str]) -> str:
    """Return what errors add where one of the names is near: " (did you mean 'x'?)", else nothing."""
    near = get_close_matches(value, list(names), 1)
    return f" (did you mean {near[0]!r}?)" if near else ""


def whole(what: str, value: Any, least: int = 0, most: int = _MOST_U32, unit: str = "") -> int:
    """Return an integer of any library's as Python's."""
    # A bool is an integer to Python, and a slip here.
    if isinstance(value, bool) or not hasattr(value, "__index__"):
        raise ConfigError(f"{what} is {shown(value)}; it must be a whole number{unit and ' of'}{unit}")
    try:
        number = int(value.__index__())
    except TypeError:
        raise ConfigError(f"{what} is {shown(value)}; it must be a single whole number") from None
    if not least <= number <= most:
        wanted = f"be between {_power(least)} and {_power(most)}{unit}"
        if (least, most) == (0, _MOST_U32):
            # The engine has closer limits, and zero may lie outside them.
            wanted = "not be negative" if number < 0 else "be below 2**32"
        raise ConfigError(f"{what} is {number}; it must {wanted}")
    return number


def time_us(what: str, value: Any) -> int:
    """Return a time in microseconds."""
    # Once per frame; the rest is for all other kinds and for errors.
    if type(value) is int and -MOST_US <= value <= MOST_US:
        return value
    return whole(what, value, -MOST_US, MOST_US, " microseconds")


def _power(limit: int) -> str:
    """Write limits of integer types so that they can be read."""
    bits = (abs(limit) + 1).bit_length() - 1
    if bits < 20 or abs(limit) + 1 != 1 << bits:
        return str(limit)
    return f"2**{bits} - 1" if limit > 0 else f"-2**{bits} + 1"


def number(what: str, value: Any, unit: str = "") -> float:
    """Return a number of any library's as Python's; it may be infinite or NaN."""
    if type(value) is float:
        return value
    if not isinstance(value, (bool, np.bool_, str, bytes)):
        # An array of many has no value, and the largest integers are no floats.
        with suppress(TypeError, ValueError, OverflowError):
            return float(value)
    raise ConfigError(f"{what} is {shown(value)}; it must be a number{unit and ' of'}{unit}")


def number_or_none(what: str, value: Any, unit: str = "") -> float | None:
    """Return a number, and None as it is."""
    return None if value is None else number(what, value, unit)


def whole_or_none(what: str, value: Any) -> int | None:
    """Return an integer, and None as it is."""
    return None if value is None else whole(what, value)


def micros(what: str, seconds: Any) -> int:
    """Round ``seconds`` to whole microseconds."""
    given = number(what, seconds, " seconds")
    if not math.isfinite(given) or abs(given) > 9e12:
        raise ConfigError(f"{what} is {given}; it must be a finite number of seconds, at most 9e12")
    return round(given * 1e6)


def duration_us(what: str, seconds: Any) -> int:
    """Round a length in ``seconds`` to whole microseconds, at least one."""
    rounded = micros(what, seconds)
    if rounded <= 0:
        raise ConfigError(f"{what} is {seconds}; it must be above 0 seconds, a microsecond at least")
    return rounded


def size(value: Any, most: int = _MOST_U32, what: str = "size") -> tuple[int, int]:
    """Return width and height."""
    sides: list[Any] = []
    # A text of two characters would come apart, too.
    if not isinstance(value, (str, bytes)):
        with suppress(TypeError):
            sides = list(value)
    if len(sides) != 2:
        raise ConfigError(
            f"{what} is {shown(value)}; it must be width and height in pixels, such as (640, 480)"
        )
    # Zero is for the engine to refuse, where it also has a limit of its own.
    least = 0 if most == _MOST_U32 else 1
    within = f"{what} is {shown(value)}: "
    return (
        whole(f"{within}width", sides[0], least, most, " pixels"),
        whole(f"{within}height", sides[1], least, most, " pixels"),
    )


def items(what: str, value: Any, such_as: str) -> list[Any]:
    """Return a sequence as a list; a text is none, though it has letters."""
    if isinstance(value, (str, bytes)):
        raise ConfigError(f"{what} is {value!r}; {what} are sequences: write [{value!r}], not {value!r}")
    try:
        return list(value)
    except TypeError:
        raise ConfigError(f"{what} is {shown(value)}; it must be a sequence, such as {such_as}") from None


def numbers(what: str, value: Any) -> list[float]:
    """Return a sequence of numbers as a list."""
    return [number(what, item) for item in items(what, value, "[500, 1000]")]


def wholes(what: str, value: Any) -> list[int]:
    """Return a sequence of integers as a list."""
    return [whole(what, item) for item in items(what, value, "[4, 16]")]


def names(what: str, value: Any) -> list[str]:
    """Return a sequence of names as a list."""
    return [str(item) for item in items(what, value, "['NAME']")]


@cache
def _hints(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind)


def plain(settings: Any, path: str = "") -> dict[str, Any]:
    """Return a dataclass of settings as JSON can say it, each value of the kind that its field is of.

    Its integers are unsigned of 32 bits in the engine. Sequences are left as they are.
    """
    return {
        name: _plain(f"{path}{name}", getattr(settings, name), hint)
        for name, hint in _hints(settings.__class__).items()
    }


def _plain(path: str, value: Any, hint: Any) -> Any:
    kinds = get_args(hint) if type(None) in get_args(hint) else (hint,)
    if value is None and len(kinds) > 1:
        return None
    kind, or_none = kinds[0], ", or None" if len(kinds) > 1 else ""
    if kind is float:
        if not math.isfinite(found := number(path, value)):
            raise ConfigError(f"{path} is {found}; it must be a finite number{or_none}")
        return found
    if kind is int:
        return whole(path, value)
    if kind is bool:
        if not isinstance(value, (bool, np.bool_)):
            raise ConfigError(f"{path} is {shown(value)}; it must be True or False")
        return bool(value)
    if get_origin(kind) is Literal:
        if not isinstance(value, str) or value not in get_args(kind):
            raise ConfigError(f"{path} is {shown(value)}; it must be {one_of(get_args(kind))}")
        return str(value)
    if isinstance(kind, type) and is_dataclass(kind):
        if not isinstance(value, kind):
            wanted = f"evis.sensors.{kind.__name__}"
            raise ConfigError(f"{path} is {shown(value)}; it must be an {wanted}{or_none}")
        return plain(value, f"{path}.")
    return value
