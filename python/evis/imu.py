"""Inertial measurement units: what an accelerometer and a gyroscope on a node of a scene measure.

Derivatives are central differences of fourth order of the exact poses, 1 ms apart. Near the ends of a
recorded trajectory, within 2 ms, they meet its rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _check, _evis
from ._builder import SceneBuilder
from ._evis import ConfigError
from ._rotations import difference, interpolated, turned_back
from ._scene import Scene, raw_of

GRAVITY = (0.0, -9.80665, 0.0)
"""Standard gravity in the world, m/s^2; +Y is up."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ImuNoise:
    """White noise, and biases that walk, with the names and units of Kalibr's ``imu.yaml``.

    Attributes
    ----------
    accelerometer_noise_density : float
        m/s^2/sqrt(Hz).
    accelerometer_random_walk : float
        m/s^3/sqrt(Hz).
    gyroscope_noise_density : float
        rad/s/sqrt(Hz).
    gyroscope_random_walk : float
        rad/s^2/sqrt(Hz).
    """

    accelerometer_noise_density: float = 0.0
    accelerometer_random_walk: float = 0.0
    gyroscope_noise_density: float = 0.0
    gyroscope_random_walk: float = 0.0


@dataclass(frozen=True, slots=True)
class ImuSamples:
    """Samples of an inertial measurement unit, in the axes of its node.

    Attributes
    ----------
    t_us : numpy.ndarray
        int64 (N,), stream time in microseconds: round(k 10^6 / rate).
    accelerometer : numpy.ndarray
        float64 (N, 3), specific force in m/s^2: acceleration less gravity. At rest it points up.
    gyroscope : numpy.ndarray
        float64 (N, 3), angular rate in rad/s.
    """

    t_us: npt.NDArray[np.int64]
    accelerometer: npt.NDArray[np.float64]
    gyroscope: npt.NDArray[np.float64]

    def __len__(self) -> int:
        """Count the samples."""
        return len(self.t_us)


def simulate(
    scene: Scene,
    node: str,
    *,
    duration: float,
    rate_hz: float = 200.0,
    noise: ImuNoise | None = None,
    gravity: tuple[float, float, float] = GRAVITY,
    seed: int = 0,
    start: float = 0.0,
    environment: int = 0,
) -> ImuSamples:
    """Return what an inertial measurement unit on a node measures.

    Parameters
    ----------
    scene : Scene
        The scene; nothing of it is rendered. Of a `Simulator` with ``poses`` it knows nothing of where a host
        has moved nodes: `from_poses` does.
    node : str
        Name of a node, such as a rig's body, or of a camera. The unit has its axes: glTF's, so that the unit
        of a camera has x right, y up and z back.
    duration : float
        Seconds.
    rate_hz : float
        Samples per second.
    noise : ImuNoise, optional
        None where not given. The biases begin at 0.
    gravity : (float, float, float)
        Of the world, m/s^2.
    seed : int
        Of the noise. The samples of a time do not depend on the duration.
    start : float
        Scene time in seconds at which the stream begins, as of a `Simulator`.
    environment : int
        Index of the environment in its batch.

    Returns
    -------
    ImuSamples
        Those with ``t < duration``.

    Raises
    ------
    ConfigError
        If the node does not exist, or a value cannot be used.

    Examples
    --------
    >>> import evis
    >>> samples = evis.imu.simulate(evis.Scene.builtin("spinner"), "camera", duration=0.02)
    >>> samples.accelerometer.shape
    (4, 3)
    """
    noise = ImuNoise() if noise is None else noise
    x, y, z = gravity
    columns = _evis.simulate_imu(
        raw_of(scene),
        str(node),
        _check.whole("environment", environment),
        _check.number("rate_hz", rate_hz),
        (
            _check.number("accelerometer_noise_density", noise.accelerometer_noise_density),
            _check.number("accelerometer_random_walk", noise.accelerometer_random_walk),
            _check.number("gyroscope_noise_density", noise.gyroscope_noise_density),
            _check.number("gyroscope_random_walk", noise.gyroscope_random_walk),
        ),
        (float(x), float(y), float(z)),
        _check.whole("seed", seed, 0, 2**64 - 1),
        _check.time_us("start", round(_check.number("start", start) * 1e6)),
        _check.time_us("duration", round(_check.number("duration", duration) * 1e6)),
    )
    return ImuSamples(*columns)


def columns_of(
    samples: Any,
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return the columns of samples as files take them."""
    return (
        np.ascontiguousarray(samples.t_us, np.int64),
        np.ascontiguousarray(samples.accelerometer, np.float64),
        np.ascontiguousarray(samples.gyroscope, np.float64),
    )


def from_poses(
    t_us: npt.ArrayLike,
    poses: npt.ArrayLike,
    *,
    velocities: npt.ArrayLike | None = None,
    rate_hz: float = 200.0,
    noise: ImuNoise | None = None,
    gravity: tuple[float, float, float] = GRAVITY,
    seed: int = 0,
) -> ImuSamples:
    """Return what an inertial measurement unit measures on a body that a host has moved.

    The scene of a `Simulator` with ``poses`` knows nothing of where a host has put its nodes, so `simulate`
    measures a body at rest there. Between two poses positions are cubics with the velocities at both ends,
    given or those of the cubic spline through all poses, and the rotation has one rate.

    Parameters
    ----------
    t_us : array_like
        int (N,), stream time in microseconds, ascending, from 0 on; N at least 3.
    poses : array_like
        float (N, 7): x, y, z in metres and the quaternion qx, qy, qz, qw of the unit in the world, as
        `Simulator.step` takes them.
    velocities : array_like, optional
        float (N, 3), m/s in the world. Accelerations within an interval are then linear, and exact where the
        host's are.
    rate_hz : float
        Samples per second.
    noise : ImuNoise, optional
        None where not given. The biases begin at 0 with stream time 0.
    gravity : (float, float, float)
        Of the world, m/s^2.
    seed : int
        Of the noise.

    Returns
    -------
    ImuSamples
        Those with ``t_us[0] <= t < t_us[-1]``, at round(k 10^6 / rate).

    Raises
    ------
    ConfigError
        If a shape, a time or a value cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> import evis
    >>> t_us = np.arange(0, 100_001, 2000)
    >>> poses = np.zeros((len(t_us), 7))
    >>> poses[:, 6] = 1.0
    >>> poses[:, 0] = 0.5 * 3.0 * (t_us * 1e-6) ** 2  # 3 m/s^2 along x
    >>> samples = evis.imu.from_poses(t_us, poses, gravity=(0, 0, 0))
    >>> np.allclose(samples.accelerometer, [3.0, 0.0, 0.0], atol=1e-6)
    True
    """
    times = np.asarray(t_us)
    if times.ndim != 1 or len(times) < 3 or times.dtype.kind not in "iu" or (np.diff(times) <= 0).any():
        raise ConfigError(
            f"t_us is {_check.shown(t_us)}; it must be at least three ascending whole numbers of microseconds"
        )
    if times[0] < 0:
        raise ConfigError(f"t_us begins at {times[0]}; it must be 0 or more")
    places = _rows("poses", poses, (len(times), 7))
    lengths = np.linalg.norm(places[:, 3:], axis=1)
    if (np.abs(lengths - 1.0) > 1e-3).any():
        bad = int(np.argmax(np.abs(lengths - 1.0)))
        raise ConfigError(f"poses has a quaternion of length {lengths[bad]:.6g} in row {bad}; it must be 1")
    ends_s = times * 1e-6
    if velocities is None:
        speeds = _spline_velocities(ends_s, places[:, :3])
    else:
        speeds = _rows("velocities", velocities, (len(times), 3))
    # On a body at rest, without gravity, noise is all that is measured.
    still = SceneBuilder("still")
    still.material("plain")
    still.box("unit", size=(1, 1, 1), material="plain")
    measured = simulate(
        still.build(),
        "unit",
        duration=float(ends_s[-1]),
        rate_hz=rate_hz,
        noise=noise,
        gravity=(0.0, 0.0, 0.0),
        seed=seed,
    )
    begun = measured.t_us >= times[0]
    at_us = measured.t_us[begun]
    acceleration, turn, rate = _motion_at(at_us * 1e-6, ends_s, places, speeds)
    pull = np.array([_check.number("gravity", value) for value in gravity])
    force = turned_back(turn, acceleration - pull)
    return ImuSamples(at_us, force + measured.accelerometer[begun], rate + measured.gyroscope[begun])


def _rows(what: str, values: npt.ArrayLike, shape: tuple[int, int]) -> npt.NDArray[np.float64]:
    try:
        rows = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        raise ConfigError(f"{what} is {_check.shown(values)}; it must be numbers, {shape}") from None
    if rows.shape != shape or not np.isfinite(rows).all():
        raise ConfigError(f"{what} has shape {rows.shape}; it must be finite numbers, {shape}")
    return rows


def _spline_velocities(
    ends_s: npt.NDArray[np.float64], positions: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Velocities at which a cubic spline has no jump of acceleration; at its ends those of parabolas."""
    parabolas = np.gradient(positions, ends_s, axis=0, edge_order=2)
    inverse = 1.0 / np.diff(ends_s)
    slopes = np.diff(positions, axis=0) * inverse[:, None]
    # Per inner pose: inverse[i-1] v[i-1] + 2 (inverse[i-1] + inverse[i]) v[i] + inverse[i] v[i+1] = right[i].
    right = 3.0 * (slopes[:-1] * inverse[:-1, None] + slopes[1:] * inverse[1:, None])
    right[0] -= inverse[0] * parabolas[0]
    right[-1] -= inverse[-1] * parabolas[-1]
    diagonal = 2.0 * (inverse[:-1] + inverse[1:])
    for i in range(1, len(diagonal)):  # Thomas's algorithm
        part = inverse[i] / diagonal[i - 1]
        diagonal[i] -= part * inverse[i]
        right[i] -= part * right[i - 1]
    velocities = parabolas
    for i in range(len(diagonal) - 1, -1, -1):
        after = 0.0 if i + 1 == len(diagonal) else inverse[i + 1] * velocities[i + 2]
        velocities[i + 1] = (right[i] - after) / diagonal[i]
    return velocities


def _motion_at(
    at_s: npt.NDArray[np.float64],
    ends_s: npt.NDArray[np.float64],
    places: npt.NDArray[np.float64],
    speeds: npt.NDArray[np.float64],
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Acceleration in the world, orientation (x, y, z, w) and angular rate in the body's axes at times."""
    k = np.clip(np.searchsorted(ends_s, at_s, side="right") - 1, 0, len(ends_s) - 2)
    length = (ends_s[k + 1] - ends_s[k])[:, None]
    u = (at_s - ends_s[k])[:, None] / length
    # Second derivative of the cubic Hermite spline.
    acceleration = (12 * u - 6) * (places[k, :3] - places[k + 1, :3]) / length**2 + (
        (6 * u - 4) * speeds[k] + (6 * u - 2) * speeds[k + 1]
    ) / length
    turn = interpolated(places[k], places[k + 1], u)[:, 3:]
    return acceleration, turn, turned_back(turn, difference(places[k], places[k + 1])[:, 3:] / length)
