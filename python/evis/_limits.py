"""What files may cost."""

from __future__ import annotations

import stat
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from . import _check, _evis


@dataclass(frozen=True)
class Limits:
    """Limits of this process.

    Attributes
    ----------
    memory : int
        Memory in bytes that one use of a file may take: what is decoded at once, or stays after it was read.
    allow_outside : bool
        Whether glTF files may refer to files outside of their folder.
    """

    memory: int
    allow_outside: bool


def limits() -> Limits:
    """Return the limits of this process.

    Examples
    --------
    >>> import evis
    >>> evis.limits().memory <= 4 * 2**30
    True
    """
    return Limits(*_evis.limits())


def set_limits(*, memory: int | None = None, allow_outside: bool | None = None) -> Limits:
    """Set limits of this process; those that are not given stay.

    A file that would take more is refused, with what it would take. No limit changes a result.

    Parameters
    ----------
    memory : int, optional
        Memory in bytes that one use of a file may take, at least 2**20; 4 GiB until it is set, or half of the
        machine's memory where that is less.
    allow_outside : bool, optional
        Whether glTF files may refer to files outside of their folder; False until it is set.

    Returns
    -------
    Limits
        What holds from now on.

    Raises
    ------
    ConfigError
        If a limit is no whole number, or too small.
    """
    if memory is not None:
        memory = _check.whole("memory", memory, 2**20, 2**63 - 1, " bytes")
    return Limits(*_evis.limits(memory, allow_outside))


def readable(path: str | PathLike[str]) -> Path:
    """Return the path of a file that is about to be read whole.

    Raises
    ------
    OSError
        If there is none, or it is a device, a pipe or a socket, which may be endless or never answer.
    FormatError
        If it is larger than the limit of memory.
    """
    file = Path(path)
    found = file.stat()
    if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
        raise OSError(f"{file}: it is a device, a pipe or a socket, and only regular files are read")
    most = limits().memory
    if stat.S_ISREG(found.st_mode) and found.st_size > most:
        raise _evis.FormatError(
            f"{file} has {found.st_size} bytes, and a file may take {most} bytes of memory; "
            "a larger limit, evis.set_limits(memory=...), allows more"
        )
    return file


def text_of(path: str | PathLike[str]) -> str:
    """Return the text of a file.

    Raises
    ------
    OSError
        If it cannot be read.
    FormatError
        If it is no text in UTF-8, or larger than the limit of memory.
    """
    file = readable(path)
    try:
        return file.read_text("utf-8")
    except UnicodeDecodeError as error:
        raise _evis.FormatError(f"{file} is no UTF-8 text ({error}); choose another file") from None
