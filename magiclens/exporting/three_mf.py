"""3MF: a mesh with its unit, for printers (3MF Core Specification 1.3)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar
from zipfile import ZipFile

from magiclens.contract.artifacts import Scene, Solid
from magiclens.exporting.archive import entry
from magiclens.exporting.mesh_files import MeshExporter

MODEL = "3D/3dmodel.model"
"""Where the package has its mesh."""
_NANOMETRE = 6
"""Number of decimals of coordinates in mm, so that they are exact to the nanometre."""

_TYPES = """<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">
<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>
</Types>
"""
_RELATIONS = """<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Id="rel0" Target="/3D/3dmodel.model" \
Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
</Relationships>
"""
_HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<model unit="millimeter" xml:lang="en-US" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">
<metadata name="Title">Magic lens, {size:g} x {size:g} mm, index of refraction {ior:g}</metadata>
<metadata name="Designer">magiclens</metadata>
<metadata name="Application">magiclens</metadata>
<resources>
<object id="1" name="lens" type="model">
<mesh>
<vertices>
"""
_TAIL = """</triangles>
</mesh>
</object>
</resources>
<build>
<item objectid="1" transform="1 0 0 0 1 0 0 0 1 {}"/>
</build>
</model>
"""
VERTEX = (b'<vertex x="', b'" y="', b'" z="', b'"/>\n')
TRIANGLE = (b'<triangle v1="', b'" v2="', b'" v3="', b'"/>\n')
"""What is written around the numbers of each vertex and triangle."""


class ThreeMf(MeshExporter):
    """3MF: the mesh in millimetres, to the nanometre, with shared vertices; placed at the corner of the print bed.

    Vertices are those of the other mesh files; the build item moves them to where no coordinate is negative.
    """

    type: ClassVar[str] = "3mf"
    suffix: ClassVar[str] = ".3mf"
    triangle_bytes: ClassVar[float] = 13

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        """Write the package, its mesh in pieces."""
        mesh = self.mesh(scene, solid)
        # an archive must be told beforehand whether an entry may exceed 2 GiB; a row of XML has at most 120 characters
        large = 120 * (len(mesh.vertices) + len(mesh.faces)) > 1 << 31
        with ZipFile(path, "w") as archive:
            archive.writestr(entry("[Content_Types].xml"), _TYPES)
            archive.writestr(entry("_rels/.rels"), _RELATIONS)
            with archive.open(entry(MODEL), "w", force_zip64=large) as model:
                for part in _model(scene, mesh):
                    model.write(part)


def _model(scene: Scene, solid: Solid) -> Iterator[bytes]:
    """The XML of the model, in pieces."""
    from magiclens.exporting.digits import rounded_rows

    yield _HEAD.format(size=scene.lens.size_mm, ior=scene.lens.ior).encode()
    yield from rounded_rows(solid.vertices, VERTEX, _NANOMETRE)
    yield b"</vertices>\n<triangles>\n"
    yield from rounded_rows(solid.faces, TRIANGLE)
    # + 0.0 turns -0.0 into 0.0, which is written without a sign
    moved = (f"{-low + 0.0:.6f}" for low in solid.vertices.min(axis=0))
    yield _TAIL.format(" ".join(moved)).encode()
