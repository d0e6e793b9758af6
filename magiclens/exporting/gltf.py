"""Binary glTF (Khronos glTF 2.0 specification): for web pages and viewers, which show the lens as clear plastic."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray, Lens, Scene, Solid
from magiclens.exporting.mesh_files import MeshExporter

_FLOAT, _UNSIGNED, _VERTICES, _INDICES = 5126, 5125, 34962, 34963
"""Numbers of glTF 2.0 for float32, uint32 and the two kinds of buffers."""


class Glb(MeshExporter):
    """Binary glTF in metres with +y up, as the standard demands: the viewer of the lens looks down from above.

    It has no normals, so facets are shaded flat, as they are.
    """

    type: ClassVar[str] = "glb"
    suffix: ClassVar[str] = ".glb"
    triangle_bytes: ClassVar[float] = 18

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        """Write a JSON head, 12 V + 12 F bytes."""
        mesh = self.mesh(scene, solid)
        points = _upright(mesh.vertices)
        faces = np.ascontiguousarray(mesh.faces, "<u4")
        head = json.dumps(_asset(scene.lens, points, faces), separators=(",", ":")).encode()
        # chunks are multiples of 4 bytes: JSON is padded with blanks, the body has 12 bytes for every vertex and face
        head += b" " * (-len(head) % 4)
        body = points.tobytes() + faces.tobytes()
        with path.open("wb") as file:
            # the length of the whole file: 12 bytes here, 8 at the head of each chunk
            file.write(struct.pack("<4sII", b"glTF", 2, 28 + len(head) + len(body)))
            file.write(struct.pack("<I4s", len(head), b"JSON") + head)
            file.write(struct.pack("<I4s", len(body), b"BIN\0") + body)


def _upright(vertices: FloatArray) -> FloatArray:
    """(V, 3) float32, metres: x stays right, z becomes glTF's up, -y its z, which points toward the viewer."""
    x, y, z = vertices.T / 1000
    return np.column_stack([x, z, -y]).astype("<f4")


def _asset(lens: Lens, points: FloatArray, faces: IntArray) -> dict[str, Any]:
    """The description of one mesh of clear plastic.

    Args:
        lens: Tells index of refraction and thickness.
        points: (V, 3) float32 vertices in glTF's frame, metres.
        faces: (F, 3) uint32 indices of vertices.
    """
    # glTF demands the extent of positions
    extent = {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
    glass = {
        "KHR_materials_transmission": {"transmissionFactor": 1.0},
        "KHR_materials_ior": {"ior": lens.ior},
        "KHR_materials_volume": {"thicknessFactor": lens.thickness_mm / 1000},
    }
    return {
        "asset": {"version": "2.0", "generator": "magiclens"},
        "extensionsUsed": list(glass),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "lens", "mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.0}, "extensions": glass}],
        "accessors": [
            {"bufferView": 0, "componentType": _FLOAT, "count": len(points), "type": "VEC3", **extent},
            {"bufferView": 1, "componentType": _UNSIGNED, "count": faces.size, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": points.nbytes, "target": _VERTICES},
            {"buffer": 0, "byteOffset": points.nbytes, "byteLength": faces.nbytes, "target": _INDICES},
        ],
        "buffers": [{"byteLength": points.nbytes + faces.nbytes}],
    }
