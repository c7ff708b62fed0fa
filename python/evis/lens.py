"""Lenses: distortion models, and the way from points to pixels and back.

The models are OpenCV's. Camera space is that of glTF: x right, y up, looking along -z. Pixels grow right and
down, pixel centres lie at +0.5: OpenCV's `cx` and `cy` are 0.5 less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, TypeAlias

import numpy as np
import numpy.typing as npt

from . import _evis
from ._evis import ConfigError
from .motion import fields_of


class _Model:
    """Base of the distortion models: a name, and coefficients."""

    __slots__ = ()
    model: ClassVar[str]

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Coefficients in OpenCV's order."""
        return tuple(float(value) for value in fields_of(self).values())

    def table(self) -> dict[str, Any]:
        """Return the distortion as a scene file has it."""
        return {"model": self.model, **fields_of(self)}


@dataclass(frozen=True, kw_only=True, slots=True)
class RadialTangential(_Model):
    """OpenCV's radial-tangential model with its rational part, as ``cv2.projectPoints`` has it.

    Attributes
    ----------
    k1, k2 : float
        Radial coefficients of r^2 and r^4.
    p1, p2 : float
        Tangential coefficients.
    k3 : float
        Radial coefficient of r^6.
    k4, k5, k6 : float
        Radial coefficients of the denominator.
    """

    model: ClassVar[str] = "radtan"
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Fisheye(_Model):
    """Kannala and Brandt's model, as ``cv2.fisheye`` and Kalibr's ``equidistant`` have it.

    Attributes
    ----------
    k1, k2, k3, k4 : float
        Coefficients of theta^3, theta^5, theta^7 and theta^9.
    """

    model: ClassVar[str] = "fisheye"
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0


Distortion: TypeAlias = RadialTangential | Fisheye
"""How a lens departs from a pinhole."""


def distortion_of(model: str, coefficients: Sequence[float]) -> Distortion:
    """Make a distortion from OpenCV's list of coefficients.

    Parameters
    ----------
    model : {"radtan", "fisheye"}
        Its model.
    coefficients : sequence of float
        k1 k2 p1 p2 k3 k4 k5 k6, or k1 k2 k3 k4; missing ones at the end are 0.

    Raises
    ------
    ConfigError
        If the model does not exist or has fewer coefficients.
    """
    kinds: dict[str, type[RadialTangential] | type[Fisheye]] = {
        "radtan": RadialTangential,
        "fisheye": Fisheye,
    }
    if model not in kinds:
        raise ConfigError(f"the distortion model is {model!r}; it must be 'radtan' or 'fisheye'")
    kind = kinds[model]
    names = [field.name for field in fields(kind)]
    if len(coefficients) > len(names):
        raise ConfigError(f"{model} takes {len(names)} coefficients at most; there are {len(coefficients)}")
    return kind(**dict(zip(names, map(float, coefficients), strict=False)))


@dataclass(frozen=True, kw_only=True, slots=True)
class Lens:
    """A calibrated lens.

    Attributes
    ----------
    fx, fy : float
        Focal lengths in pixels.
    cx, cy : float
        Principal point in pixels, pixel centres at +0.5.
    distortion : RadialTangential or Fisheye, optional
        None for a pinhole.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Distortion | None = None

    def project(self, points: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return where the camera shows points.

        Parameters
        ----------
        points : array_like
            (N, 3), metres, in camera space (x right, y up, -z forward).

        Returns
        -------
        numpy.ndarray
            float64 (N, 2), pixels; NaN where the lens shows nothing: behind it, and beyond the radius up to
            which its model is one to one.

        Raises
        ------
        ConfigError
            If the shape is another, or the lens cannot be used.
        """
        return _evis.lens_project(self._intrinsics, self._distortion, _rows("points", points, 3))

    def unproject(self, pixels: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return the directions in which the camera sees pixels.

        Parameters
        ----------
        pixels : array_like
            (N, 2), pixel centres at +0.5.

        Returns
        -------
        numpy.ndarray
            float64 (N, 3), of length 1, in camera space; NaN where the lens sees nothing.

        Raises
        ------
        ConfigError
            If the shape is another, or the lens cannot be used.
        """
        return _evis.lens_unproject(self._intrinsics, self._distortion, _rows("pixels", pixels, 2))

    @property
    def _intrinsics(self) -> tuple[float, float, float, float]:
        return (float(self.fx), float(self.fy), float(self.cx), float(self.cy))

    @property
    def _distortion(self) -> tuple[str, list[float]] | None:
        if self.distortion is None:
            return None
        return (self.distortion.model, list(self.distortion.coefficients))


def _rows(what: str, values: npt.ArrayLike, width: int) -> npt.NDArray[np.float64]:
    array = np.ascontiguousarray(values, np.float64)
    if array.ndim != 2 or array.shape[1] != width:
        raise ConfigError(f"{what} has shape {array.shape}; it takes (N, {width})")
    return array
