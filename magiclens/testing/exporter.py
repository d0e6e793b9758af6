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
from magiclens.testing.stage import Made, StageContract

Mesh = tuple[FloatArray, IntArray]
MESHES = (".stl", ".ply", ".obj", ".off", ".3mf", ".glb", ".gltf")


class ExporterContract(StageContract):
    """Equal solids give equal files, and a file that is a mesh holds the solid, in millimetres.

    ``size_share``, ``volume_share``: by how much a mesh in a file may differ.
    """

    stage: Exporter
    size_share = 1e-4
    volume_share = 1e-3

    def given(self, scene: Scene) -> tuple[Any, ...]:
        """See StageContract."""
        return scene, bumpy_solid(scene)

    def work(self, given: tuple[Any, ...], rng: np.random.Generator, progress: Progress) -> dict[str, bytes]:
        """See StageContract. What is written, by file name."""
        scene, solid = given
        with TemporaryDirectory() as folder:
            self.stage.export(scene, solid, Path(folder, self.file_name))
            return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(Path(folder).rglob("*")) if p.is_file()}

    def check(self, given: tuple[Any, ...], artifact: Any) -> None:
        """See StageContract."""
        with TemporaryDirectory() as folder:
            check_file(_put(artifact, folder) / self.file_name)
        strangers = [name for name in artifact if not name.startswith("lens")]
        if strangers:
            raise BadArtifact(f"it has written {', '.join(strangers)}; names start as the asked one's")

    @property
    def file_name(self) -> str:
        """As in a run folder."""
        return f"lens{self.stage.suffix}"

    def read_mesh(self, path: Path) -> Mesh | None:
        """Vertices (V, 3), mm, and faces (F, 3) in a file; None if it is no mesh. By trimesh, if the suffix says so.

        Override it for formats that trimesh does not read, or that have other units or axes.
        """
        import trimesh

        if self.stage.suffix not in MESHES:
            return None
        mesh = trimesh.load_mesh(path, process=False)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)

    @pytest.fixture(scope="class")
    @classmethod
    def mesh(cls, made: Made) -> Mesh | None:
        """What is read from the file."""
        contract = cls()
        with TemporaryDirectory() as folder:
            return contract.read_mesh(_put(made.artifact, folder) / contract.file_name)

    def test_a_mesh_in_the_file_is_closed(self, mesh: Mesh | None) -> None:
        """And its normals point outward."""
        if mesh:
            assert_closed(*mesh)

    def test_a_mesh_in_the_file_is_as_large_as_the_solid(self, mesh: Mesh | None, made: Made) -> None:
        """The same box and volume: units, axes and signs are right."""
        if mesh is None:
            return
        solid: Solid = made.given[1]
        (low, high), (found_low, found_high) = ((v.min(axis=0), v.max(axis=0)) for v in (solid.vertices, mesh[0]))
        off = max(np.abs(low - found_low).max(), np.abs(high - found_high).max()) / np.ptp(solid.vertices)
        assert off <= self.size_share, f"the file's mesh reaches from {found_low} to {found_high}, not {low} to {high}"
        wanted, found = volume_mm3(solid.vertices, solid.faces), volume_mm3(*mesh)
        assert abs(found / wanted - 1) <= self.volume_share, f"its volume is {found:.6g} mm^3 instead of {wanted:.6g}"


def _put(files: dict[str, bytes], folder: str) -> Path:
    for name, content in files.items():
        path = Path(folder, name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return Path(folder)
