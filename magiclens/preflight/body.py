"""Checks of the exported mesh as a body: closed, in one piece, of the right size, the same in all files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from magiclens.contract.artifacts import FloatArray, Lens, Solid
from magiclens.meshing.intersections import cannot_cut_itself, faces_that_cut
from magiclens.meshing.validation import Validation, check_areas, check_topology, check_volume
from magiclens.preflight.finding import FacetIndices, Finding, worst_facet_text
from magiclens.preflight.mesh_file import MeshFile, read_mesh_file

_TOLERANCE = 1e-4
"""Share by which volumes and extents of two files may differ, since they round differently."""


def check_body(file: MeshFile, lens: Lens, eye_mm: FloatArray | None) -> list[Finding]:
    """Check that a file holds one closed body that does not intersect itself.

    Args:
        file: The mesh file; equal corners of its triangles are joined.
        lens: The lens, to name the facets at fault.
        eye_mm: (3,) eye along whose rays the top was cut, lens frame; None for vertical cells.
    """
    solid = file.solid(eye_mm)
    # each check relies on what those before have found: only a closed mesh has a volume
    topology = check_topology(solid)
    found = topology if topology.flaws else topology + check_areas(solid)
    if not found.flaws:
        found += check_volume(solid)
    return [*_closed_and_whole(found, solid, lens, file.name), _self_intersection(found, solid, lens)]


def body_checked_by_finisher(metrics: Mapping[str, Any], name: str) -> list[Finding] | None:
    """The same findings, for a file of this name that holds the very solid which the finisher has checked.

    They are made from the metrics of the run; None if its finisher has not checked everything, or has found a flaw.
    """
    sound = {"watertight": 1, "bodies": 1, "outward_normals": 1, "self_intersections": 0}
    if any(metrics.get(name) != value for name, value in sound.items()):
        return None
    found = Validation(metrics, ())
    return [*_closed_and_whole(found, None, None, name), _self_intersection(found, None, None)]


def check_size(file: MeshFile, lens: Lens) -> Finding:
    """Compare the file's size with the lens's: files in inches or metres are far off."""
    low, high = file.extent_mm
    wide = float(max(high[0] - low[0], high[1] - low[1]))
    extent = "{:.4g} x {:.4g} x {:.4g} mm".format(*(high - low))
    # the sides lean out to a flat bottom that may be much wider than the lens
    if not 0.9 * lens.size_mm <= wide <= 5 * lens.size_mm:
        return Finding("size", "red", f"{file.name} is {extent}, but the lens is {lens.size_mm:g} mm wide: wrong unit?")
    return Finding("size", "green", f"{file.name} is {extent}")


def check_same_body(file: MeshFile, others: Sequence[Path]) -> Finding:
    """Check that other mesh files hold the same body."""
    for path in others:
        try:
            other = read_mesh_file(path)
        except Exception as error:  # readers of broken files raise anything
            return Finding("files", "red", f"{path.name} cannot be read: {error}")
        if not _same_body(file, other):
            return Finding("files", "red", f"{path.name} holds another body than {file.name}")
    return Finding("files", "green", f"{', '.join([file.name, *(path.name for path in others)])} hold the same body")


def _same_body(one: MeshFile, other: MeshFile) -> bool:
    same = np.isclose(one.volume_mm3, other.volume_mm3, rtol=_TOLERANCE, atol=0)
    moved = other.extent_mm - other.extent_mm[0] + one.extent_mm[0]  # 3MF moves the body to the bed's corner
    return bool(same and np.allclose(one.extent_mm, moved, atol=_TOLERANCE * np.ptp(one.extent_mm)))


def _closed_and_whole(found: Validation, solid: Solid | None, lens: Lens | None, name: str) -> list[Finding]:
    metrics, flaws = found.metrics, found.flaws
    facets = _facets_at([flaw.vertex for flaw in flaws], solid, lens)
    bodies = int(metrics["bodies"])
    wrong = [f"{flaw.what} ({flaw.count})" for flaw in flaws if flaw.what != "separate bodies"]
    sound = f"{name} is closed, its faces look outward"
    text = f"{name} has {'; '.join(wrong)}{worst_facet_text(facets)}" if wrong else sound
    one = "one body" if bodies == 1 else f"{bodies} separate bodies"
    return [
        Finding("watertight", "red" if wrong else "green", text, facets),
        Finding("one body", "green" if bodies == 1 else "red", one),
    ]


def _self_intersection(found: Validation, solid: Solid | None, lens: Lens | None) -> Finding:
    """Whether faces cut others: excluded by the structure of the mesh if possible, else searched for."""
    check = "self-intersection"
    if found.flaws:
        return Finding(check, "amber", "not looked for: that needs a closed body")
    if solid is None:
        count = int(found.metrics["self_intersections"])
        text = f"{count} faces cut others" if count else "no face cuts another"
        return Finding(check, "red" if count else "green", text)
    if cannot_cut_itself(solid):
        return Finding(check, "green", "no face cuts another: the top covers its outline once, as seen along its walls")
    cut = faces_that_cut(solid)
    facets = _facets_at([int(solid.faces[face].min()) for face in cut], solid, lens)
    text = f"{len(cut)} faces cut others{worst_facet_text(facets)}" if len(cut) else "no face cuts another, by search"
    return Finding(check, "red" if len(cut) else "green", text, facets)


def _facets_at(vertices: Sequence[int | None], solid: Solid | None, lens: Lens | None) -> FacetIndices:
    """The facets in which vertices lie, each once."""
    if solid is None or lens is None:
        return ()
    points = solid.vertices[[v for v in vertices if v is not None]]
    rows_columns = np.stack([lens.size_mm / 2 - points[:, 1], points[:, 0] + lens.size_mm / 2], axis=-1) / lens.pitch_mm
    cells = np.clip(rows_columns.astype(int), 0, lens.facets - 1)
    return tuple(dict.fromkeys((int(row), int(column)) for row, column in cells))
