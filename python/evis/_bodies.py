"""Objects and cameras by name, and where they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from . import _check, _evis
from ._evis import ConfigError
from ._packets import Poses

BodyRow: TypeAlias = tuple[str, int, int, str, list[list[float]]]
"""Name, instance id, semantic id and name, lowest and highest corner: what the engine takes and gives."""


@dataclass(frozen=True, slots=True)
class Instance:
    """An object of a scene, as images of labels number it.

    Attributes
    ----------
    id : int
        Its value in images of the label ``instance``; above 0.
    name : str
        Its name in the scene.
    semantic_id : int
        Its value in images of the label ``semantic``; 0 where it has no class.
    semantic_name : str
        Name of its class; empty where it has no class, or the class no name.
    """

    id: int
    name: str
    semantic_id: int
    semantic_name: str = ""


@dataclass(frozen=True, slots=True, repr=False)
class Bodies:
    """Objects and cameras by name: their boxes, and their poses and velocities over time.

    N bodies, objects first, at T times; the world is right-handed with +Y up, in metres. Poses are
    ``world_from_body``; cameras look along their -Z.

    Attributes
    ----------
    names : tuple of str
        Names in the scene, N.
    instance_id, semantic_id : numpy.ndarray
        uint32 (N,): values in images of labels; 0 for cameras, and where there is no class.
    semantic_names : tuple of str
        Names of the classes, N; empty where there is no class, or it has no name.
    box : numpy.ndarray
        float64 (N, 2, 3): lowest and highest corner of what is drawn, in metres in the body's axes,
        undeformed where it is skinned or morphs; NaN for cameras.
    t_us : numpy.ndarray
        int64 (T,), microseconds since the stream's start.
    position : numpy.ndarray
        float64 (T, N, 3), metres.
    rotation : numpy.ndarray
        float64 (T, N, 4), unit quaternions (x, y, z, w).
    linear_velocity : numpy.ndarray
        float64 (T, N, 3), metres per second of the body's origin, in world axes.
    angular_velocity : numpy.ndarray
        float64 (T, N, 3), radians per second, in world axes.
    """

    names: tuple[str, ...]
    instance_id: npt.NDArray[np.uint32]
    semantic_id: npt.NDArray[np.uint32]
    semantic_names: tuple[str, ...]
    box: npt.NDArray[np.float64]
    t_us: npt.NDArray[np.int64]
    position: npt.NDArray[np.float64]
    rotation: npt.NDArray[np.float64]
    linear_velocity: npt.NDArray[np.float64]
    angular_velocity: npt.NDArray[np.float64]

    @classmethod
    def _of(cls, raw: tuple[Any, ...]) -> Bodies:
        infos, *columns = raw
        return cls(
            tuple(info[0] for info in infos),
            np.array([info[1] for info in infos], np.uint32),
            np.array([info[2] for info in infos], np.uint32),
            tuple(info[3] for info in infos),
            np.array([info[4] for info in infos], np.float64).reshape(-1, 2, 3),
            *columns,
        )

    def _infos(self) -> list[BodyRow]:
        ids = self.instance_id.tolist(), self.semantic_id.tolist()
        return list(zip(self.names, *ids, self.semantic_names, self.box.tolist(), strict=True))

    @property
    def instances(self) -> tuple[Instance, ...]:
        """The objects, by id; the first node names an id that several share."""
        ids = self.instance_id.tolist(), self.semantic_id.tolist()
        found: dict[int, Instance] = {}
        for name, number, semantic, semantic_name in zip(self.names, *ids, self.semantic_names, strict=True):
            if number:
                found.setdefault(number, Instance(number, name, semantic, semantic_name))
        return tuple(found[number] for number in sorted(found))

    @property
    def classes(self) -> dict[int, str]:
        """The semantic classes that have a name, by their ids in images of the label ``semantic``."""
        named = zip(self.semantic_id.tolist(), self.semantic_names, strict=True)
        return {number: name for number, name in sorted(named) if name}

    def index(self, name: str) -> int:
        """Return the place of the first body of this name.

        Raises
        ------
        ConfigError
            If there is none; lists those that exist.
        """
        if name not in self.names:
            raise ConfigError(f"no body is named {_check.shown(name)}; there is {', '.join(self.names)}")
        return self.names.index(name)

    def poses(self, name: str) -> Poses:
        """Return the poses of the first body of this name.

        Raises
        ------
        ConfigError
            If there is none.
        """
        at = self.index(name)
        return Poses(self.t_us, self.position[:, at], self.rotation[:, at])

    def corners(self) -> npt.NDArray[np.float64]:
        """Return the corners of all boxes in the world, float64 (T, N, 8, 3), metres; NaN for cameras.

        Corner k has the low x where k & 1 is 0, the low y where k & 2 is 0, and the low z where k & 4 is 0.
        """
        sides = [[k >> axis & 1 for axis in range(3)] for k in range(8)]
        local = np.stack([self.box[:, side, range(3)] for side in sides], axis=1)
        vector, w = self.rotation[..., np.newaxis, :3], self.rotation[..., np.newaxis, 3:]
        # Rodrigues' formula for unit quaternions.
        twice = 2.0 * np.cross(vector, local[np.newaxis])
        turned: npt.NDArray[np.float64] = local + w * twice + np.cross(vector, twice)
        return turned + self.position[..., np.newaxis, :]

    def __repr__(self) -> str:
        """Count bodies and times."""
        when = f", t_us {self.t_us[0]} to {self.t_us[-1]}" if len(self.t_us) else ""
        return f"Bodies({len(self.names)} bodies, {len(self.t_us)} times{when})"


def bodies_of(
    raw: _evis.Scene, cameras: Sequence[str], environment: int, start_us: int, t_us: list[int]
) -> Bodies:
    """Return the bodies of a scene at stream times."""
    return Bodies._of(_evis.scene_bodies(raw, list(cameras), environment, start_us, t_us))
