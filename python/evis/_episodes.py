"""Files of episodes, one per environment."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from types import TracebackType

import numpy as np
import numpy.typing as npt

from ._events import EventArray, EventCD
from ._evis import ConfigError
from ._files import save


class EpisodeRecorder:
    """Writes events to a file per environment and episode, with a group per camera.

    Files are recordings (``docs/hdf5.md``) named ``env0003_ep0007.h5``; times begin at 0 with an
    environment's first keyframe of the episode. An episode is held in memory until all cameras that write
    here have ended it (`EventPipeline.reset`); `close` writes what has not ended.

    Parameters
    ----------
    folder : path
        Made where it does not exist.
    overwrite : bool
        Replace files that exist.
    """

    def __init__(self, folder: str | PathLike[str], *, overwrite: bool = False) -> None:
        self._folder = Path(folder)
        self._overwrite = overwrite
        self._sizes: dict[str, tuple[int, int]] = {}
        self._parts: dict[tuple[int, str], list[npt.NDArray[np.void]]] = {}
        self._ended: dict[int, dict[str, EventArray]] = {}
        self._episodes: dict[int, int] = {}
        self._written: list[Path] = []

    @property
    def paths(self) -> tuple[Path, ...]:
        """The files that were written."""
        return tuple(self._written)

    def join(self, camera: str, size: tuple[int, int]) -> None:
        """Add a camera of ``size`` (width, height); `EventPipeline.record` does so.

        Raises
        ------
        ConfigError
            If there is one of this name.
        """
        if camera in self._sizes:
            raise ConfigError(f"camera is {camera!r}, which writes here already; give each its own name")
        self._sizes[camera] = size

    def add(self, camera: str, environment: int, events: EventArray, start_us: int) -> None:
        """Append events of an episode that began at ``start_us``."""
        part = events.to_numpy().copy()
        part["t"] -= start_us
        self._parts.setdefault((environment, camera), []).append(part)

    def end(self, camera: str, environment: int) -> None:
        """End a camera's episode; the file is written when all cameras have.

        Raises
        ------
        OSError
            If the file exists, or the disk refuses.
        """
        ended = self._ended.setdefault(environment, {})
        if camera in ended:
            # Another camera did not follow the environment's episodes: its group stays empty.
            self._write(environment)
            ended = self._ended.setdefault(environment, {})
        parts = self._parts.pop((environment, camera), [])
        width, height = self._sizes[camera]
        events = np.concatenate(parts) if parts else np.empty(0, EventCD)
        ended[camera] = EventArray(events, width=width, height=height)
        if len(ended) == len(self._sizes):
            self._write(environment)

    def _write(self, environment: int) -> None:
        ended = self._ended.pop(environment)
        nothing = np.empty(0, EventCD)
        cameras = {
            name: ended.get(name, EventArray(nothing, width=size[0], height=size[1]))
            for name, size in self._sizes.items()
        }
        episode = self._episodes.get(environment, 0)
        self._folder.mkdir(parents=True, exist_ok=True)
        path = self._folder / f"env{environment:04d}_ep{episode:04d}.h5"
        save(path, cameras, overwrite=self._overwrite)
        self._episodes[environment] = episode + 1
        self._written.append(path)

    def close(self) -> None:
        """Write the episodes that have not ended."""
        for environment, camera in sorted(self._parts):
            self.end(camera, environment)
        for environment in sorted(self._ended):
            self._write(environment)

    def __enter__(self) -> EpisodeRecorder:
        """Return the recorder."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Write the episodes that have not ended."""
        self.close()
