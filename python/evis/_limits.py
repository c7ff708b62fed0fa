"""What files may cost."""

from __future__ import annotations

from dataclasses import dataclass

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
