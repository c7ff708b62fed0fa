"""What has a part for each camera."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TypeVar

from . import _check
from ._evis import ConfigError

Part = TypeVar("Part")


class ByCamera(Mapping[str, Part]):
    """A mapping from camera names to parts, which are in `_views`."""

    __slots__ = ()

    _views: dict[str, Part]

    def __getitem__(self, camera: str) -> Part:
        """Return the part of ``camera``."""
        try:
            return self._views[camera]
        except KeyError:
            hint = _check.did_you_mean(str(camera), self._views)
            raise ConfigError(
                f"no camera named '{camera}'; there is {', '.join(self._views)}{hint}"
            ) from None

    def __contains__(self, camera: object) -> bool:
        """Tell whether there is a camera of this name."""
        return camera in self._views

    def __iter__(self) -> Iterator[str]:
        """Iterate over camera names."""
        return iter(self._views)

    def __len__(self) -> int:
        """Count the cameras."""
        return len(self._views)
