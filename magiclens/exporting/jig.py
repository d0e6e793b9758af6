"""The jig: printed parts that hold sheet, lens and eye where the design has them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from pydantic import Field

from magiclens.contract.artifacts import Scene, Solid
from magiclens.contract.stages import Exporter
from magiclens.contract.units import Length
from magiclens.exporting.mesh_files import write_stl

if TYPE_CHECKING:
    from manifold3d import Manifold


class Jig(Exporter):
    """A tray that holds sheet and lens in register, and a stand with a peephole at each eye, as STL files to print.

    The tray is ``lens.jig.stl``; ``lens.jig-inset.stl``, ``-column``, ``-arm`` and so on stand beside it. What is
    larger than the bed comes in parts. An arrow in the tray's wall points to the edge of the sheet that is up. If the
    lens has a mark, ``lens.mark``, the tray has a slot for it, and takes the lens only as it belongs.
    """

    type: ClassVar[str] = "jig"
    suffix: ClassVar[str] = ".jig.stl"

    clearance: Length = Field(
        "0.2mm", validate_default=True, ge=0, le=2, description="air on each side of sheet, lens and pegs"
    )
    sheet: Length = Field("0.15mm", validate_default=True, ge=0, le=10, description="thickness of the sheet")
    peephole: Length = Field("3mm", validate_default=True, ge=0.5, le=20, description="diameter of the peepholes")
    bed: Length = Field("220mm", validate_default=True, ge=60, le=2000, description="longest side of a part")
    stand: bool = Field(True, description="whether there are columns and arms, too")

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        """Write one file for each part. Raises InputError if no jig can hold the lens, or a part is too large."""
        from magiclens.exporting.jig_parts import JigShape, jig_parts

        shape = JigShape(self.clearance, self.sheet, self.peephole, self.bed, self.stand)
        for k, part in enumerate(jig_parts(scene, solid, shape)):
            _write(part.on_bed(), _beside(path, part.name) if k else path)


def _beside(path: Path, name: str) -> Path:
    return path.with_name(path.name.removesuffix(Jig.suffix) + f".jig-{name}.stl")


def _write(body: Manifold, path: Path) -> None:
    mesh = body.to_mesh()
    write_stl(mesh.vert_properties[:, :3], mesh.tri_verts, path)
