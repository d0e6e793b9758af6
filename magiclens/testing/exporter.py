"""The contract of exporters."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from magiclens.contract.artifacts import FloatArray, IntArray, Scene, Solid
from magiclens.contract.checks import BadArtifact, check_file
from magiclens.contract.stages import Exporter, Progress
from magiclens.testing.meshes import assert_closed, volume_mm3
from magiclens.testing.scenes import bumpy_solid
from magiclens.testing.stage import StageCall, StageContract

Mesh = tuple[FloatArray, IntArray]
"""Vertices (V, 3), mm, lens frame, and faces (F, 3)."""

_MESH_SUFFIXES = (".stl", ".ply", ".obj", ".off", ".3mf", ".glb", ".gltf")
"""Suffixes of mesh files that trimesh reads."""


class ExporterContract(StageContract):
    """Checks that equal solids give equal files, and that a file of a mesh holds the solid.

    Attributes:
        size_tolerance: Largest difference between the boxes of the mesh in the file and of the solid, as a share.
        volume_tolerance: Largest difference between their volumes, as a share.
    """

    stage: Exporter
    size_tolerance = 1e-4
    volume_tolerance = 1e-3

    def inputs(self, scene: Scene) -> tuple[Any, ...]:
        """See StageContract."""
        return scene, bumpy_solid(scene)

    def call(self, inputs: tuple[Any, ...], rng: np.random.Generator, progress: Progress) -> dict[str, bytes]:
        """See StageContract. The artifact is the contents of the files, by name."""
        scene, solid = inputs
        with TemporaryDirectory() as folder:
            self.stage.export(scene, solid, Path(folder, self.file_name))
            return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(Path(folder).rglob("*")) if p.is_file()}

    def check(self, inputs: tuple[Any, ...], artifact: Any) -> None:
        """See StageContract."""
        with TemporaryDirectory() as folder:
            check_file(_put(artifact, folder) / self.file_name)
        misnamed = [name for name in artifact if not name.startswith("lens")]
        if misnamed:
            raise BadArtifact(f"it has written {', '.join(misnamed)}; names must start as that of the file asked for")

    @property
    def file_name(self) -> str:
        """The name of the file, as in a run folder."""
        return f"lens{self.stage.suffix}"

    def read_mesh(self, path: Path) -> Mesh | None:
        """The mesh in a file, read by trimesh if the suffix is that of a mesh; None if the file holds no mesh.

        Override it for formats that trimesh does not read, or that have other units or axes.
        """
        import trimesh

        if self.stage.suffix not in _MESH_SUFFIXES:
            return None
        mesh = trimesh.load_mesh(path, process=False)
        # STL repeats the vertices of every triangle, and glTF those with several normals
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)

    @pytest.fixture(scope="class")
    @classmethod
    def mesh(cls, outcome: StageCall) -> Mesh | None:
        """The mesh that is read from the file."""
        contract = cls()
        with TemporaryDirectory() as folder:
            return contract.read_mesh(_put(outcome.artifact, folder) / contract.file_name)

    def test_a_mesh_in_the_file_is_closed(self, mesh: Mesh | None) -> None:
        """It is closed, and its normals point outward; checked if the file holds a mesh."""
        if mesh:
            assert_closed(*mesh)

    def test_a_mesh_in_the_file_is_as_large_as_the_solid(self, mesh: Mesh | None, outcome: StageCall) -> None:
        """Box and volume are the same, so units, axes and signs are right."""
        if mesh is None:
            return
        solid: Solid = outcome.inputs[1]
        (low, high), (found_low, found_high) = ((v.min(axis=0), v.max(axis=0)) for v in (solid.vertices, mesh[0]))
        off = max(np.abs(low - found_low).max(), np.abs(high - found_high).max()) / np.ptp(solid.vertices)
        assert off <= self.size_tolerance, f"its mesh reaches from {found_low} to {found_high}, not {low} to {high}"
        wanted, found = volume_mm3(solid.vertices, solid.faces), volume_mm3(*mesh)
        change = abs(found / wanted - 1)
        assert change <= self.volume_tolerance, f"its volume is {found:.6g} mm^3 instead of {wanted:.6g}"


def _put(files: dict[str, bytes], folder: str) -> Path:
    for name, content in files.items():
        path = Path(folder, name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return Path(folder)
