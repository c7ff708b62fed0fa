"""What files may cost."""

from __future__ import annotations

from dataclasses import dataclass

from . import _check, _evis


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of this process.

    Attributes
    ----------
    memory : int
        Memory in bytes that one use of a file may take: what is decoded at once, or stays after it was read.
    """

    memory: int


def limits() -> Limits:
    """Return the limits of this process.

    Examples
    --------
    >>> import evis
    >>> evis.limits().memory <= 4 * 2**30
    True
    """
    return Limits(memory=_evis.limits())


def set_limits(*, memory: int | None = None) -> Limits:
    """Set limits of this process; those that are not given stay.

    A file that would take more is refused, with what it would take. No limit changes a result.

    Parameters
    ----------
    memory : int, optional
        Memory in bytes that one use of a file may take, at least 2**20; 4 GiB until it is set, or half of the
        machine's memory where that is less.

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
    return Limits(memory=_evis.limits(memory))
