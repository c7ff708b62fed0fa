"""Poses as seven numbers, x, y, z and a unit quaternion (x, y, z, w): what lies between two of them."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]

#: Products of quaternions (x, y, z, w) by one, or its conjugate, from the right, as matrices of its numbers.
_NUMBERS = np.array([[3, 2, 1, 0], [2, 3, 0, 1], [1, 0, 3, 2], [0, 1, 2, 3]])
_PRODUCT = np.array([[1.0, 1, -1, 1], [-1, 1, 1, 1], [1, -1, 1, 1], [-1, -1, -1, 1]])
_CONJUGATE = np.array([[1.0, -1, 1, -1], [1, 1, -1, -1], [-1, 1, 1, -1], [1, 1, 1, 1]])


def _multiplied(a: Array, b: Array, signs: Array = _PRODUCT) -> Array:
    """Product of quaternions (x, y, z, w); with `_CONJUGATE` by the conjugate of `b`."""
    return np.asarray((b.take(_NUMBERS, axis=-1) * signs @ a[..., None])[..., 0])


def turn(first: Array, last: Array) -> Array:
    """Rotation vector in the world from one quaternion (x, y, z, w) to another, by the short way."""
    between = _multiplied(last, first, _CONJUGATE)
    vector, cosine = between[..., :3], between[..., 3:]
    sine = np.sqrt(np.einsum("...i,...i->...", vector, vector))[..., None]
    angle = 2 * np.arctan2(sine, np.abs(cosine))
    length = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-300), 2.0)
    return np.asarray(vector * np.copysign(length, cosine))


def difference(first: Array, last: Array) -> Array:
    """Metres and rotation vector from one pose to another, (…, 6)."""
    return np.concatenate([last[..., :3] - first[..., :3], turn(first[..., 3:], last[..., 3:])], axis=-1)


def interpolated(first: Array, last: Array, share: float | Array) -> Array:
    """Pose between two: straight on, and an even turn. `share` is of the way, (…, 1) as an array."""
    way = share * turn(first[..., 3:], last[..., 3:])
    angle = np.sqrt(np.einsum("...i,...i->...", way, way))[..., None]
    half = np.where(angle > 1e-12, np.sin(angle / 2) / np.maximum(angle, 1e-300), 0.5)
    turned = np.concatenate([half * way, np.cos(angle / 2)], axis=-1)
    position = first[..., :3] + share * (last[..., :3] - first[..., :3])
    return np.concatenate([position, _multiplied(turned, first[..., 3:])], axis=-1)


def turned_back(turn: Array, vectors: Array) -> Array:
    """Vectors of the world, (..., 3), in the axes of bodies with these quaternions, (..., 4)."""
    axis, w = -turn[..., :3], turn[..., 3:]
    across = 2.0 * np.cross(axis, vectors)
    return np.asarray(vectors + w * across + np.cross(axis, across))
