"""Is the exported mesh a body? Are all files the same one, of the right size?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from magiclens.contract.artifacts import FloatArray, Lens, Solid
from magiclens.meshing.intersections import cannot_cut_itself, faces_that_cut
from magiclens.meshing.validation import Findings, check_areas, check_topology, check_volume
from magiclens.preflight.exported import Exported, read_exported
from magiclens.preflight.finding import Facets, Finding, first_of

SAME = 1e-4
"""Share by which volumes and extents of two files may differ."""


def soundness(file: Exported, lens: Lens, eye_mm: FloatArray | None) -> list[Finding]:
    """Watertight, one body, without self-intersection: by the file alone, its equal corners joined."""
    solid = file.solid(eye_mm)
    topology = check_topology(solid)
    found = topology if topology.flaws else topology + check_areas(solid)
    if not found.flaws:
        found += check_volume(solid)
    return [*_body(found, solid, lens, file.name), _cuts(found, solid, lens)]


def as_found(metrics: Mapping[str, Any], name: str) -> list[Finding] | None:
    """The same of a file that holds just the solid which the finisher has checked; None if it has not."""
    if not {"watertight", "bodies", "outward_normals", "self_intersections"} <= set(metrics):
        return None
    return [*_body(Findings(metrics, ()), None, None, name), _cuts(Findings(metrics, ()), None, None)]


def size(file: Exported, lens: Lens) -> Finding:
    """The file is in millimetres."""
    low, high = file.extent_mm
    wide = float(max(high[0] - low[0], high[1] - low[1]))
    extent = "{:.4g} x {:.4g} x {:.4g} mm".format(*(high - low))
    if not 0.9 * lens.size_mm <= wide <= 5 * lens.size_mm:
        return Finding("size", "red", f"{file.name} is {extent}, but the lens is {lens.size_mm:g} mm wide: wrong unit?")
    return Finding("size", "green", f"{file.name} is {extent}")


def alike(file: Exported, others: Sequence[Path]) -> Finding:
    """All files hold the same body."""
    for path in others:
        try:
            other = read_exported(path)
        except Exception as error:  # readers of broken files raise anything
            return Finding("files", "red", f"{path.name} cannot be read: {error}")
        if not _alike(file, other):
            return Finding("files", "red", f"{path.name} holds another body than {file.name}")
    return Finding("files", "green", f"{', '.join([file.name, *(path.name for path in others)])} hold the same body")


def _alike(one: Exported, other: Exported) -> bool:
    same = np.isclose(one.volume_mm3, other.volume_mm3, rtol=SAME, atol=0)
    placed = other.extent_mm - other.extent_mm[0] + one.extent_mm[0]  # 3MF moves the body to the bed's corner
    return bool(same and np.allclose(one.extent_mm, placed, atol=SAME * np.ptp(one.extent_mm)))


def _body(found: Findings, solid: Solid | None, lens: Lens | None, name: str) -> list[Finding]:
    metrics, flaws = found.metrics, found.flaws
    facets = _facets([flaw.vertex for flaw in flaws], solid, lens)
    bodies = int(metrics["bodies"])
    wrong = [f"{flaw.what} ({flaw.count})" for flaw in flaws if flaw.what != "separate bodies"]
    text = f"{name} has {'; '.join(wrong)}{first_of(facets)}" if wrong else f"{name} is closed, its faces look outward"
    one = "one body" if bodies == 1 else f"{bodies} separate bodies"
    return [
        Finding("watertight", "red" if wrong else "green", text, facets),
        Finding("one body", "green" if bodies == 1 else "red", one),
    ]


def _cuts(found: Findings, solid: Solid | None, lens: Lens | None) -> Finding:
    """No face cuts another one: proved from the structure, else searched for."""
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
    facets = _facets([int(solid.faces[face].min()) for face in cut], solid, lens)
    text = f"{len(cut)} faces cut others{first_of(facets)}" if len(cut) else "no face cuts another, by search"
    return Finding(check, "red" if len(cut) else "green", text, facets)


def _facets(vertices: Sequence[int | None], solid: Solid | None, lens: Lens | None) -> Facets:
    """The facets that vertices stand in, each once."""
    if solid is None or lens is None:
        return ()
    points = solid.vertices[[v for v in vertices if v is not None]]
    places = np.stack([lens.size_mm / 2 - points[:, 1], points[:, 0] + lens.size_mm / 2], axis=-1) / lens.pitch_mm
    cells = np.clip(places.astype(int), 0, lens.facets - 1)
    return tuple(dict.fromkeys((int(row), int(column)) for row, column in cells))
