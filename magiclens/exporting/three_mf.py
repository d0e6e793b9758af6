"""3MF: what printers are fed with, a mesh with its unit (3MF Core Specification)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar
from zipfile import ZipFile

import numpy as np

from magiclens.contract.artifacts import Scene, Solid
from magiclens.contract.stages import Exporter
from magiclens.exporting.archive import entry

NANOMETRE = 6
"""Decimals of a millimetre."""
CHUNK = 1 << 16
"""Rows that are text at one time."""

TYPES = """<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">
<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>
</Types>
"""
RELATIONS = """<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Id="rel0" Target="/3D/3dmodel.model" \
Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
</Relationships>
"""
HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<model unit="millimeter" xml:lang="en-US" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">
<metadata name="Title">Magic lens, {size:g} x {size:g} mm, index of refraction {ior:g}</metadata>
<metadata name="Designer">magiclens</metadata>
<metadata name="Application">magiclens</metadata>
<resources>
<object id="1" name="lens" type="model">
<mesh>
<vertices>
"""
TAIL = """</triangles>
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


class ThreeMf(Exporter):
    """3MF: the mesh in millimetres, to the nanometre, with shared vertices; placed at the corner of the print bed.

    Vertices are those of the other mesh files; the build item moves them to where no coordinate is negative.
    """

    type: ClassVar[str] = "3mf"
    suffix: ClassVar[str] = ".3mf"

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        """Write the package, its mesh in pieces."""
        large = 120 * (len(solid.vertices) + len(solid.faces)) > 1 << 31
        with ZipFile(path, "w") as archive:
            archive.writestr(entry("[Content_Types].xml"), TYPES)
            archive.writestr(entry("_rels/.rels"), RELATIONS)
            with archive.open(entry("3D/3dmodel.model"), "w", force_zip64=large) as model:
                for part in _model(scene, solid):
                    model.write(part)


def _model(scene: Scene, solid: Solid) -> Iterator[bytes]:
    """The XML of the model, in pieces."""
    from magiclens.exporting.digits import text_rows

    yield HEAD.format(size=scene.lens.size_mm, ior=scene.lens.ior).encode()
    for k in range(0, len(solid.vertices), CHUNK):
        counts = np.rint(solid.vertices[k : k + CHUNK] * 10**NANOMETRE).astype(np.int64)
        yield text_rows(counts, VERTEX, NANOMETRE)
    yield b"</vertices>\n<triangles>\n"
    for k in range(0, len(solid.faces), CHUNK):
        yield text_rows(solid.faces[k : k + CHUNK].astype(np.int64), TRIANGLE)
    moved = (f"{-low + 0.0:.6f}" for low in solid.vertices.min(axis=0))
    yield TAIL.format(" ".join(moved)).encode()
