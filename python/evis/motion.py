"""How things move and flicker: the vocabulary of scene files, as values.

Times are seconds of scene time, lengths metres, angles degrees; axes are glTF's (+Y up). Values are checked
when the scene is built.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from os import PathLike
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from . import _check
from ._evis import ConfigError
from ._short import ShortRepr

Vector: TypeAlias = Sequence[float] | npt.NDArray[np.floating[Any]]
Interpolation: TypeAlias = Literal["linear", "catmull_rom", "hermite"]


class _Motion:
    """Base of the motions: a table with a kind."""

    __slots__ = ()
    kind: ClassVar[str]

    def table(self) -> dict[str, Any]:
        """Return the motion as a scene file has it."""
        return {"kind": self.kind, **fields_of(self)}


def fields_of(value: Any) -> dict[str, Any]:
    """Return a dataclass's fields by name, without a copy and without those that are None."""
    found = {field.name: getattr(value, field.name) for field in fields(value)}
    return {name: item for name, item in found.items() if item is not None}


@dataclass(frozen=True, kw_only=True, slots=True)
class ConstantVelocity(_Motion):
    """Straight on.

    Attributes
    ----------
    velocity : sequence of float
        Metres per second, (x, y, z).
    """

    kind: ClassVar[str] = "constant_velocity"
    velocity: Vector


@dataclass(frozen=True, kw_only=True, slots=True)
class Spin(_Motion):
    """Turns in place.

    Attributes
    ----------
    degrees_per_s : float
        Rate, counter-clockwise about `axis`.
    axis : sequence of float
        In the parent's frame.
    """

    kind: ClassVar[str] = "spin"
    degrees_per_s: float
    axis: Vector = (0.0, 1.0, 0.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class FigureEight(_Motion):
    """Lemniscate of Gerono: x = a sin(wt), z = b sin(2wt).

    Attributes
    ----------
    size : sequence of float
        (a, b) in metres.
    period_s : float
        Seconds per round.
    look_at : sequence of float, optional
        Point to look at, in the parent's frame.
    """

    kind: ClassVar[str] = "figure_eight"
    size: Vector
    period_s: float
    look_at: Vector | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Ballistic(_Motion):
    """Thrown: free fall after a launch.

    Attributes
    ----------
    velocity : sequence of float
        At the launch, metres per second.
    gravity : sequence of float
        Metres per second squared.
    spin_axis : sequence of float
        Axis of the spin.
    spin_degrees_per_s : float
        Rate of the spin.
    launch_s : float
        When it starts to move.
    """

    kind: ClassVar[str] = "ballistic"
    velocity: Vector
    gravity: Vector = (0.0, -9.81, 0.0)
    spin_axis: Vector = (0.0, 1.0, 0.0)
    spin_degrees_per_s: float = 0.0
    launch_s: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Trajectory(_Motion):
    """Poses from a TUM or CSV file.

    Attributes
    ----------
    file : path
        The file.
    time_unit : {"s", "ms", "us", "ns"}, optional
        Unit of its times; what a line ``# unit: ns`` of the file says, else seconds. Poses more than 10 s
        apart on average are refused unless the unit is said.
    from_zero : bool
        Whether its first pose is taken as time 0.
    time_offset_s : float
        Added to its times.
    axes : {"opengl", "opencv"}
        Whether cameras look along -Z with +Y up, or along +Z with +Y down.
    interpolation : {"linear", "catmull_rom", "hermite"}
        Rule between poses.
    """

    kind: ClassVar[str] = "trajectory"
    file: str | PathLike[str]
    time_unit: Literal["s", "ms", "us", "ns"] | None = None
    from_zero: bool = True
    time_offset_s: float = 0.0
    axes: Literal["opengl", "opencv"] = "opengl"
    interpolation: Interpolation = "linear"


@dataclass(frozen=True, kw_only=True, slots=True)
class Keys(_Motion):
    """Through poses at given times; still before the first and after the last.

    Attributes
    ----------
    times_s : sequence of float
        (N,), strictly increasing.
    positions : sequence of sequence of float
        (N, 3), metres.
    rotations : sequence of sequence of float, optional
        (N, 4), unit quaternions (x, y, z, w).
    velocities : sequence of sequence of float, optional
        (N, 3), metres per second; for ``hermite`` only.
    interpolation : {"linear", "catmull_rom", "hermite"}
        Rule between positions; rotations are interpolated by slerp.
    """

    kind: ClassVar[str] = "keys"
    times_s: Vector
    positions: Sequence[Vector] | npt.NDArray[np.floating[Any]]
    rotations: Sequence[Vector] | npt.NDArray[np.floating[Any]] | None = None
    velocities: Sequence[Vector] | npt.NDArray[np.floating[Any]] | None = None
    interpolation: Interpolation = "linear"


@dataclass(frozen=True, kw_only=True, slots=True)
class Chain(_Motion):
    """One motion in the frame of the one before.

    Attributes
    ----------
    motions : sequence of Placement
        Outermost first; each with its own pose and motion.
    """

    kind: ClassVar[str] = "chain"
    motions: Sequence[Placement]

    def table(self) -> dict[str, Any]:
        """Return the motion as a scene file has it."""
        links = []
        for placement in self.motions:
            link = table_of("chain", placement)
            # A link of a chain has its motion's keys beside those of its pose.
            link |= link.pop("motion", {})
            links.append(link)
        return {"kind": self.kind, "motions": links}


Motion: TypeAlias = ConstantVelocity | Spin | FigureEight | Ballistic | Trajectory | Keys | Chain


@dataclass(frozen=True, kw_only=True, slots=True)
class RigidBody:
    """Falls, flies and collides; simulated when the scene is built or loaded.

    What is left out has the scene file's default. A fixed body takes none of the keys from `density` on.

    Attributes
    ----------
    fixed : bool
        Whether it stays where it is, and others hit it.
    shape : str, optional
        What it touches others with: ``box``, ``sphere``, ``cylinder``, ``capsule``, ``half_space``, ``hull``
        or ``mesh``; the object's own shape, or else the hull of its meshes, if not given.
    size : sequence of float, optional
        Edges (x, y, z) of a ``box``, metres.
    radius, height : float, optional
        Of the round shapes, metres.
    friction : float, optional
        Coefficient of Coulomb friction, 0 to 100; the mean of two bodies' counts.
    restitution : float, optional
        Part of the normal speed that a bounce leaves, 0 to 1; the larger one of two bodies' counts.
    density : float, optional
        Kilograms per cubic metre.
    mass : float, optional
        Kilograms, in place of `density`.
    velocity : sequence of float, optional
        Of the centre of mass at the launch, metres per second in the frame of the parent.
    spin_axis : sequence of float, optional
        Axis of the spin in the frame of the parent.
    spin_degrees_per_s : float, optional
        Rate of the spin.
    launch_s : float, optional
        When it starts to move; rounded up to a step.

    Examples
    --------
    >>> import evis
    >>> from evis.motion import Placement, RigidBody
    >>> builder = evis.SceneBuilder("drop", duration=0.5, ambient=(1, 1, 1))
    >>> builder.material("grey")
    >>> builder.plane("floor", size=(2, 2), material="grey", pose=Placement(rigid_body=RigidBody(fixed=True)))
    >>> start = Placement(position=(0, 1, 0), rigid_body=RigidBody(restitution=0.8))
    >>> builder.sphere("ball", radius=0.1, material="grey", pose=start)
    >>> scene = builder.build()
    >>> float(scene.bodies([400_000]).position[0, 1, 1].round(3))
    0.215
    """

    fixed: bool = False
    shape: Literal["box", "sphere", "cylinder", "capsule", "half_space", "hull", "mesh"] | None = None
    size: Vector | None = None
    radius: float | None = None
    height: float | None = None
    friction: float | None = None
    restitution: float | None = None
    density: float | None = None
    mass: float | None = None
    velocity: Vector | None = None
    spin_axis: Vector | None = None
    spin_degrees_per_s: float | None = None
    launch_s: float | None = None


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Placement(ShortRepr):
    """Where something is, what it hangs on, and how it moves.

    Attributes
    ----------
    position : sequence of float
        (x, y, z) in metres, in the frame of `parent`.
    rotation : sequence of float, optional
        Unit quaternion (x, y, z, w).
    rotation_degrees : sequence of float, optional
        Turns about x, then y, then z, in place of `rotation`.
    look_at : sequence of float, optional
        Point that -Z (where cameras look and lights shine) faces, in place of a rotation.
    up : sequence of float, optional
        Upright for `look_at`; +Y if not given.
    scale : float or sequence of float, optional
        Factor, or one per axis.
    parent : str, optional
        Name of the object that carries it; the world if not given.
    motion : Motion, optional
        How it moves, in the frame of the pose.
    rigid_body : RigidBody, optional
        The rigid body that it is, in place of a motion; the pose is where it starts.
    """

    position: Vector = (0.0, 0.0, 0.0)
    rotation: Vector | None = None
    rotation_degrees: Vector | None = None
    look_at: Vector | None = None
    up: Vector | None = None
    scale: float | Vector | None = None
    parent: str | None = None
    motion: Motion | None = None
    rigid_body: RigidBody | None = None

    def table(self) -> dict[str, Any]:
        """Return the placement as a scene file has it."""
        table = fields_of(self)
        if self.motion is not None:
            if not isinstance(self.motion, _Motion):
                raise ConfigError(
                    f"motion is {_check.shown(self.motion)}; it must be one of evis.motion, such as "
                    "evis.motion.Spin(degrees_per_s=90)"
                )
            table["motion"] = self.motion.table()
        if self.rigid_body is not None:
            if not isinstance(self.rigid_body, RigidBody):
                raise ConfigError(
                    f"rigid_body is {_check.shown(self.rigid_body)}; it must be an evis.motion.RigidBody, "
                    "such as evis.motion.RigidBody(velocity=(1, 2, 0))"
                )
            table["rigid_body"] = fields_of(self.rigid_body)
        return table


def table_of(name: str, pose: Any) -> dict[str, Any]:
    """Return the pose of the object ``name`` as a scene file has it."""
    if not isinstance(pose, Placement):
        raise ConfigError(
            f"pose of '{name}' is {_check.shown(pose)}; it must be an evis.motion.Placement, such as "
            "evis.motion.Placement(position=(0, 1, 0))"
        )
    return pose.table()


HERE = Placement()
"""At the origin of its parent, unturned and still."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Waveform:
    """Periodic factor on light or emission.

    Attributes
    ----------
    shape : {"sine", "square", "pwm"}
        Shape of a cycle.
    frequency_hz : float
        Cycles per second.
    phase : float
        Part of a cycle by which it is ahead, in [0, 1).
    duty : float, optional
        Part of a cycle during which ``pwm`` is high.
    low, high : float
        Factors at the two ends.
    """

    shape: Literal["sine", "square", "pwm"]
    frequency_hz: float
    phase: float = 0.0
    duty: float | None = None
    low: float = 0.0
    high: float = 1.0
