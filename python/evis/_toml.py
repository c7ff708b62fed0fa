"""Python values as TOML text, for scenes built in Python: they are parsed as scene files are."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from os import PathLike, fspath

import numpy as np

from ._evis import ConfigError


def document(tables: Mapping[str, object]) -> str:
    """Write top-level keys; sequences of mappings become arrays of inline tables. None is left out."""
    return "".join(f"{_key(key)} = {value(key, item)}\n" for key, item in tables.items() if item is not None)


def value(what: str, item: object) -> str:
    """Write one value; ``what`` names it in errors."""
    match item:
        case bool() | np.bool_():
            return "true" if item else "false"
        case str():
            return _string(item)
        case PathLike():
            return _string(str(fspath(item)))
        case int() | np.integer():
            return str(int(item))
        case float() | np.floating():
            return _float(float(item))
        case np.ndarray():
            return value(what, item.tolist())
        case Mapping():
            inner = (f"{_key(key)} = {value(key, part)}" for key, part in item.items() if part is not None)
            return "{ " + ", ".join(inner) + " }"
        case Sequence():
            return "[" + ", ".join(value(what, part) for part in item) + "]"
        case _:
            raise ConfigError(f"{what} is {item!r}; it must be a number, text, sequence or mapping")


def _float(number: float) -> str:
    if math.isfinite(number):
        return repr(number)
    return "nan" if math.isnan(number) else ("inf" if number > 0 else "-inf")


def _string(text: str) -> str:
    # JSON's escapes are TOML's, except that TOML also wants DEL escaped.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _key(key: str) -> str:
    return key if key.replace("_", "a").replace("-", "a").isalnum() and key.isascii() else _string(key)
