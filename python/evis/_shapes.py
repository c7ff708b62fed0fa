"""Triangles of simple shapes, with normals and texture coordinates, +Z up as in robotics."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: Of each face of a cube map, in OpenGL's order: the axis that it lies on, and the ways in which its rows and
#: columns run (OpenGL 4.6, table 8.19).
_CUBE_FACES = (
    ((1, 0, 0), (0, 0, -1), (0, -1, 0)),
    ((-1, 0, 0), (0, 0, 1), (0, -1, 0)),
    ((0, 1, 0), (1, 0, 0), (0, 0, 1)),
    ((0, -1, 0), (1, 0, 0), (0, 0, -1)),
    ((0, 0, 1), (1, 0, 0), (0, -1, 0)),
    ((0, 0, -1), (-1, 0, 0), (0, -1, 0)),
)

#: Where two faces of a cube map meet.
_CUBE_EDGES = ((1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1))


@dataclass(frozen=True)
class Triangles:
    """Triangles that share no vertices, counter-clockwise from the front.

    Attributes
    ----------
    positions, normals : array
        float64 (n, 3, 3): triangle, corner, axis.
    uvs : array
        float64 (n, 3, 2), v down.
    """

    positions: Array
    normals: Array
    uvs: Array

    def scaled(self, size: npt.ArrayLike) -> Triangles:
        """Return them stretched along the axes."""
        factors = np.asarray(size, np.float64)
        return replace(self, positions=self.positions * factors, normals=_unit(self.normals / factors))

    def moved(self, by: npt.ArrayLike) -> Triangles:
        """Return them elsewhere."""
        return replace(self, positions=self.positions + np.asarray(by, np.float64))


def joined(parts: list[Triangles]) -> Triangles:
    """Return all of them as one."""
    return Triangles(
        np.concatenate([part.positions for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.uvs for part in parts]),
    )


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300))


def _grid(points: Array, normals: Array, uvs: Array) -> Triangles:
    """Two triangles per cell of a grid (rows, columns, axis), but for those without area."""

    def corners(values: Array) -> Array:
        a, b, c, d = values[:-1, :-1], values[:-1, 1:], values[1:, 1:], values[1:, :-1]
        pairs = np.stack([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)], axis=2)
        return pairs.reshape(-1, 3, values.shape[-1])

    made = corners(points)
    area = np.linalg.norm(np.cross(made[:, 1] - made[:, 0], made[:, 2] - made[:, 0]), axis=-1)
    keep = area > 1e-12 * max(float(area.max(initial=0.0)), 1e-300)
    return Triangles(made[keep], corners(normals)[keep], corners(uvs)[keep])


def _around(slices: int) -> Array:
    return np.linspace(0.0, 2.0 * np.pi, slices + 1)


def sphere(slices: int, stacks: int, bottom: float = -1.0, top: float = 1.0) -> Triangles:
    """Return the unit sphere, or half of it: between the latitudes `bottom` and `top` in quarter turns."""
    azimuth, elevation = _around(slices)[None, :], np.linspace(bottom, top, stacks + 1)[:, None] * np.pi / 2
    points = np.stack(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation) + 0.0 * azimuth,
        ],
        axis=-1,
    )
    u, v = np.meshgrid(np.linspace(0, 1, slices + 1), np.linspace(1, 0, stacks + 1))
    return _grid(points, points, np.stack([u, v], axis=-1))


def tube(slices: int, stacks: int) -> Triangles:
    """Return the side of a cylinder of radius 1 from z = -1 to 1."""
    azimuth, z = np.meshgrid(_around(slices), np.linspace(-1, 1, stacks + 1))
    normals = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(z)], axis=-1)
    points = normals + z[..., None] * [0, 0, 1]
    return _grid(points, normals, np.stack([azimuth / (2 * np.pi), (1 - z) / 2], axis=-1))


def disk(slices: int, rings: int, side: int) -> Triangles:
    """Return a disk of radius 1 at z = `side` that faces that way (1 or -1)."""
    azimuth, radius = np.meshgrid(_around(slices)[::side], np.linspace(1, 0, rings + 1))
    x, y = radius * np.cos(azimuth), radius * np.sin(azimuth)
    points = np.stack([x, y, np.full_like(x, side)], axis=-1)
    normals = np.broadcast_to(np.array([0.0, 0.0, side]), points.shape)
    return _grid(points, normals, np.stack([0.5 + 0.5 * x, 0.5 + 0.5 * y], axis=-1))


def cylinder(slices: int, stacks: int, rings: int) -> Triangles:
    """Return a closed cylinder of radius 1 from z = -1 to 1."""
    return joined([disk(slices, rings, -1), tube(slices, stacks), disk(slices, rings, 1)])


def capsule(radius: float, half: float, slices: int, stacks: int, along: int) -> Triangles:
    """Return a capsule along z; `half`: half its length without the ends, which have `stacks` each."""
    scale = (radius, radius, radius)
    return joined(
        [
            tube(slices, along).scaled((radius, radius, max(half, 1e-9))),
            sphere(slices, stacks, 0, 1).scaled(scale).moved((0, 0, half)),
            sphere(slices, stacks, -1, 0).scaled(scale).moved((0, 0, -half)),
        ]
    )


def square(cells: int) -> Triangles:
    """Return the square from -1 to 1 at z = 0, facing +Z, with the picture's top at +y."""
    x, y = np.meshgrid(np.linspace(-1, 1, cells + 1), np.linspace(-1, 1, cells + 1))
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    normals = np.broadcast_to(np.array([0.0, 0.0, 1.0]), points.shape)
    return _grid(points, normals, np.stack([0.5 + 0.5 * x, 0.5 - 0.5 * y], axis=-1))


def box(cells: int) -> Triangles:
    """Return the cube from -1 to 1, with the whole picture on each face."""
    face = square(cells)
    faces = []
    for axis in range(3):
        for side in (1.0, -1.0):
            normal = np.eye(3)[axis] * side
            along = np.eye(3)[1 if axis == 0 else 0]
            up = np.eye(3)[1 if axis == 2 else 2]
            if np.cross(along, up) @ normal < 0:
                # From behind the picture is turned over, as its sides would meet through the box.
                along, up = (along, -up)
            turn = np.stack([along, up, normal])
            moved = face.positions @ turn + normal
            faces.append(Triangles(moved, face.normals @ turn, face.uvs))
    return joined(faces)


def height_field(heights: Array, size: npt.ArrayLike, cells: int) -> Triangles:
    """Return a height field with its sides and its floor.

    `heights` in [0, 1] has rows along y; `size` is half the extent along x, along y, the height of 1, and the
    depth of the floor below 0.
    """
    half_x, half_y, high, deep = (float(v) for v in np.asarray(size))
    rows, columns = heights.shape
    x, y = np.meshgrid(np.linspace(-half_x, half_x, columns), np.linspace(-half_y, half_y, rows))
    top = np.stack([x, y, heights * high], axis=-1)
    a, b, c, d = top[:-1, :-1], top[:-1, 1:], top[1:, 1:], top[1:, :-1]
    surface = np.stack([np.stack([d, a, c], axis=2), np.stack([a, b, c], axis=2)], axis=2).reshape(-1, 3, 3)

    def wall(edge: Array) -> Array:
        """From the floor to an edge of the field, which runs to the right as seen from outside."""
        floor = edge * [1, 1, 0] - [0, 0, deep]
        low, right, up, left = floor[:-1], floor[1:], edge[1:], edge[:-1]
        return np.stack([np.stack([low, right, up], axis=1), np.stack([low, up, left], axis=1)], axis=1)

    walls = [wall(edge) for edge in (top[0], top[::-1, 0], top[-1, ::-1], top[:, -1])]
    floor = square(cells).scaled((half_x, half_y, 1)).positions[:, ::-1] - [0, 0, deep]
    positions = np.concatenate([surface, *(w.reshape(-1, 3, 3) for w in walls), floor])
    return flat(positions)


def flat(positions: Array) -> Triangles:
    """Return triangles with a normal each, and no texture coordinates."""
    normals = np.repeat(face_normals(positions)[:, None], 3, axis=1)
    return Triangles(positions, normals, np.zeros((*positions.shape[:2], 2)))


def face_normals(positions: Array) -> Array:
    """Return the unit normal of each triangle."""
    return _unit(np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0]))


def cube_mapped(shape: Triangles, directions: Array) -> list[tuple[int, Triangles]]:
    """Return `shape` cut where the faces of a cube map meet, as `directions` (n, 3, 3) read it: by face.

    Within a triangle the picture runs evenly, where a cube map has a perspective: exact on a cube's faces.
    """
    values = np.concatenate([shape.positions, shape.normals, directions], axis=-1)
    for edge in _CUBE_EDGES:
        values = _split(values, values[..., 6:] @ np.array(edge, np.float64))
    middle = values[..., 6:].mean(axis=1)
    axis = np.abs(middle).argmax(axis=-1)
    face = 2 * axis + (np.take_along_axis(middle, axis[:, None], axis=-1)[:, 0] < 0)
    parts = []
    for index, (major, across, down) in enumerate(_CUBE_FACES):
        own = values[face == index]
        if len(own):
            depth = np.maximum(own[..., 6:] @ np.array(major, np.float64), 1e-12)
            uv = own[..., 6:] @ np.array([across, down], np.float64).T / depth[..., None]
            parts.append((index, Triangles(own[..., :3], _unit(own[..., 3:6]), 0.5 + 0.5 * uv.clip(-1, 1))))
    return parts


def cube_directions(face: int, size: int) -> Array:
    """Return the direction of each texel of a face of a cube map, (size, size, 3)."""
    major, across, down = (np.array(way, np.float64) for way in _CUBE_FACES[face])
    at = (np.arange(size) + 0.5) / size * 2 - 1
    return np.asarray(major + at[None, :, None] * across + at[:, None, None] * down)


def cube_texels(directions: Array) -> tuple[npt.NDArray[np.int64], Array]:
    """Return the face of a cube map that each direction reads, and where on it, u and v in [0, 1]."""
    axis = np.abs(directions).argmax(axis=-1)
    face = 2 * axis + (np.take_along_axis(directions, axis[..., None], axis=-1)[..., 0] < 0)
    table = np.array(_CUBE_FACES, np.float64)[face]
    depth, u, v = (np.einsum("...i,...i->...", table[..., i, :], directions) for i in range(3))
    return face, 0.5 + 0.5 * np.stack([u / depth, v / depth], axis=-1)


def _split(values: Array, side: Array) -> Array:
    """Cut the triangles (n, 3, columns) whose corners lie on both sides of a plane, at `side` (n, 3) = 0."""
    side = np.where(np.abs(side) < 1e-9 * np.abs(values[..., 6:]).max(initial=1e-300), 0.0, side)
    crossing = (side.min(axis=1) < 0) & (side.max(axis=1) > 0)
    if not crossing.any():
        return values
    own, at = values[crossing], side[crossing]
    # The corner that is alone on its side comes first; one on the plane counts to either side.
    signs = np.sign(at)
    on_plane = signs == 0
    alone = np.where(
        on_plane.any(axis=1),
        (on_plane.argmax(axis=1) + 1) % 3,
        (signs == -np.sign(signs.sum(axis=1))[:, None]).argmax(axis=1),
    )
    order = (alone[:, None] + np.arange(3)) % 3
    own = np.take_along_axis(own, order[..., None], axis=1)
    at = np.take_along_axis(at, order, axis=1)

    def cut(i: int, j: int) -> Array:
        share = at[:, i] / np.where(at[:, i] == at[:, j], 1.0, at[:, i] - at[:, j])
        return np.asarray(own[:, i] + share.clip(0, 1)[:, None] * (own[:, j] - own[:, i]))

    first, second = cut(0, 1), cut(0, 2)
    pieces = np.concatenate(
        [
            np.stack([own[:, 0], first, second], axis=1),
            np.stack([first, own[:, 1], own[:, 2]], axis=1),
            np.stack([first, own[:, 2], second], axis=1),
        ]
    )
    edges = pieces[:, 1:, :3] - pieces[:, :1, :3]
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=-1)
    return np.concatenate([values[~crossing], pieces[area > 1e-15]])
