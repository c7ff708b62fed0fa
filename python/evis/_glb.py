"""Binary glTF 2.0 of meshes that are arrays: what the engine loads."""

from __future__ import annotations

import json
import struct
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt

from ._shapes import Triangles

_FLOAT, _U32, _U16 = 5126, 5125, 5123
_ARRAY, _INDICES = 34962, 34963
_REPEAT, _CLAMP = 10497, 33071
_LINEAR, _MIPMAPS = 9729, 9987
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


def png(pixels: npt.NDArray[np.uint8]) -> bytes:
    """Return RGB pixels (H, W, 3) as a PNG file (RFC 2083)."""
    height, width, _ = pixels.shape
    # Filter 0 in front of each row.
    rows = np.zeros((height, 1 + 3 * width), np.uint8)
    rows[:, 1:] = pixels.reshape(height, -1)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    parts = [b"\x89PNG\r\n\x1a\n"]
    for kind, data in ((b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), 1)), (b"IEND", b"")):
        parts.append(struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)))
    return b"".join(parts)


class Glb:
    """Puts a file together; every `add` returns the index by which others refer to it."""

    def __init__(self) -> None:
        self._lists: dict[str, list[dict[str, Any]]] = {}
        self._chunks: list[bytes] = []
        self._length = 0
        self._extensions: set[str] = set()

    def _append(self, what: str, item: dict[str, Any]) -> int:
        items = self._lists.setdefault(what, [])
        items.append(item)
        return len(items) - 1

    def _view(self, data: bytes, target: int | None = None) -> int:
        view: dict[str, Any] = {"buffer": 0, "byteOffset": self._length, "byteLength": len(data)}
        if target is not None:
            view["target"] = target
        self._chunks.append(data + bytes(-len(data) % 4))
        self._length += len(self._chunks[-1])
        return self._append("bufferViews", view)

    def _accessor(self, values: npt.NDArray[Any], kind: int, target: int | None) -> int:
        width = 1 if values.ndim == 1 else values.shape[1]
        accessor: dict[str, Any] = {
            "bufferView": self._view(values.tobytes(), target),
            "componentType": kind,
            "count": len(values),
            "type": _TYPES[width],
        }
        if width == 3:
            # The format wants the bounds of positions.
            accessor["min"], accessor["max"] = values.min(axis=0).tolist(), values.max(axis=0).tolist()
        return self._append("accessors", accessor)

    def add_texture(self, pixels: npt.NDArray[np.uint8], *, clamp: bool = False) -> int:
        """Add a picture, uint8 (H, W, 3), sRGB, from the top, that repeats or ends at its edges."""
        image = self._append("images", {"bufferView": self._view(png(pixels)), "mimeType": "image/png"})
        wrap = _CLAMP if clamp else _REPEAT
        sampler = {"wrapS": wrap, "wrapT": wrap, "magFilter": _LINEAR, "minFilter": _MIPMAPS}
        return self._append("textures", {"source": image, "sampler": self._append("samplers", sampler)})

    def add_material(self, material: dict[str, Any]) -> int:
        """Add a material as glTF has it."""
        self._extensions.update(material.get("extensions", {}))
        return self._append("materials", material)

    def add_mesh(self, name: str, parts: list[tuple[Triangles, int]], *, two_joints: bool = False) -> int:
        """Add a mesh: triangles, each with a material; with `two_joints`, those below z = 0 follow the first.

        Vertices above follow the second joint of the skin.
        """
        primitives = []
        for triangles, material in parts:
            columns = [triangles.positions, triangles.normals, triangles.uvs]
            rows = np.concatenate([column.reshape(-1, column.shape[-1]) for column in columns], axis=1)
            # Corners that are the same to the last bit are one vertex.
            packed = np.ascontiguousarray(rows, np.float32) + np.float32(0)
            key = packed.view(np.dtype((np.void, packed.itemsize * packed.shape[1]))).ravel()
            _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
            unique = packed[first]
            attributes = {
                name: self._accessor(np.ascontiguousarray(unique[:, low:high]), _FLOAT, _ARRAY)
                for name, low, high in (("POSITION", 0, 3), ("NORMAL", 3, 6), ("TEXCOORD_0", 6, 8))
            }
            if two_joints:
                joints = np.zeros((len(unique), 4), np.uint16)
                joints[:, 0] = unique[:, 2] > 0
                weights = np.zeros((len(unique), 4), np.float32)
                weights[:, 0] = 1.0
                attributes["JOINTS_0"] = self._accessor(joints, _U16, _ARRAY)
                attributes["WEIGHTS_0"] = self._accessor(weights, _FLOAT, _ARRAY)
            indices = self._accessor(inverse.reshape(-1).astype(np.uint32), _U32, _INDICES)
            primitives.append({"attributes": attributes, "indices": indices, "material": material})
        return self._append("meshes", {"name": name, "primitives": primitives})

    def add_node(
        self,
        name: str,
        position: npt.ArrayLike = (0, 0, 0),
        rotation: npt.ArrayLike = (0, 0, 0, 1),
        *,
        mesh: int | None = None,
        skin: int | None = None,
        parent: int | None = None,
    ) -> int:
        """Add a node; `rotation` is x, y, z, w."""
        node: dict[str, Any] = {
            "name": name,
            "translation": np.asarray(position, np.float64).tolist(),
            "rotation": np.asarray(rotation, np.float64).tolist(),
        }
        if mesh is not None:
            node["mesh"] = mesh
        if skin is not None:
            node["skin"] = skin
        index = self._append("nodes", node)
        if parent is not None:
            self._lists["nodes"][parent].setdefault("children", []).append(index)
        return index

    def add_skin(self, joints: list[int], places: npt.NDArray[np.floating[Any]]) -> int:
        """Add a skin: nodes that are its joints, and where each is in the mesh, (N, 3)."""
        # Matrices lie column by column.
        inverse = np.tile(np.eye(4, dtype=np.float32), (len(joints), 1, 1))
        inverse[:, 3, :3] = -np.asarray(places)
        matrices = self._accessor(inverse.reshape(len(joints), 16), _FLOAT, None)
        return self._append("skins", {"joints": joints, "inverseBindMatrices": matrices})

    def to_bytes(self) -> bytes:
        """Return the file."""
        children = {child for node in self._lists.get("nodes", []) for child in node.get("children", [])}
        roots = [i for i in range(len(self._lists.get("nodes", []))) if i not in children]
        document: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "evis"},
            "scene": 0,
            "scenes": [{"nodes": roots}],
            **self._lists,
        }
        if self._extensions:
            document["extensionsUsed"] = sorted(self._extensions)
        if self._length:
            document["buffers"] = [{"byteLength": self._length}]
        text = json.dumps(document, allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        binary = b"".join(self._chunks)
        parts = [(b"JSON", text), (b"BIN\0", binary)] if binary else [(b"JSON", text)]
        length = 12 + sum(8 + len(data) for _, data in parts)
        head = b"glTF" + struct.pack("<II", 2, length)
        return head + b"".join(struct.pack("<I", len(data)) + kind + data for kind, data in parts)
