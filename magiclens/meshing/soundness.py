"""What finishers ask of a solid, and how they say where it fails."""

from __future__ import annotations

from collections.abc import Mapping

from magiclens.contract.artifacts import Lens, Solid
from magiclens.contract.errors import StageError
from magiclens.meshing.validation import FaceSearch, Flaw, Search, validate


def require_sound(lens: Lens, solid: Solid, search: Search, find: FaceSearch) -> Mapping[str, float]:
    """What the checks have measured; arguments are those of ``validate``.

    Raises:
        StageError: The solid cannot be made; the message names the first bad facets.
    """
    found = validate(solid, search, find)
    if found.flaws:
        raise StageError(f"the solid cannot be made: {_listed(lens, solid, found.flaws)}")
    return found.metrics


def lines_of_grid(lens: Lens) -> int:
    """Lines along each side of the lens's grid: one of the rim, microfacets + 1 for each facet, one of the rim."""
    return lens.facets * (lens.microfacets + 1) + 2


def _listed(lens: Lens, solid: Solid, flaws: tuple[Flaw, ...]) -> str:
    """All flaws, each with how often it occurs and where it does first."""
    texts = []
    for flaw in flaws:
        where = f", the first at {_location(lens, solid, flaw.vertex)}" if flaw.vertex is not None else ""
        texts.append(f"{flaw.what} ({flaw.count}{where})")
    return "; ".join(texts)


def _location(lens: Lens, solid: Solid, vertex: int) -> str:
    """The facet (row 0 at +y, column 0 at -x) that a vertex belongs to, or its position if it belongs to none."""
    lines = lines_of_grid(lens)
    if solid.grid == (lines, lines) and vertex < lines**2:
        row, column = (_facet(lens, line) for line in divmod(vertex, lines))
        return f"facet row {row}, column {column}"
    x, y, z = solid.vertices[vertex]
    return f"x = {x:.4g}, y = {y:.4g}, z = {z:.4g} mm"


def _facet(lens: Lens, line: int) -> int:
    """The facet that a grid line belongs to; the rim belongs to its neighbour."""
    return min(max(line - 1, 0) // (lens.microfacets + 1), lens.facets - 1)
