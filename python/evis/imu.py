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
        The scene; nothing of it is rendered.
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
