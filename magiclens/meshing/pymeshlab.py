"""The built-in finisher: bounded smoothing, then the checks that a solid must pass before it is made."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from magiclens.contract.artifacts import Lens, Scene, Solid
from magiclens.contract.errors import StageError
from magiclens.contract.stages import Finisher, Progress, silent
from magiclens.contract.units import Length
from magiclens.meshing.smoothing import smoothed
from magiclens.meshing.validation import Flaw, Search, validate


class Pymeshlab(Finisher):
    """Smooths inside the facets, within a bound, and checks that the solid can be made."""

    type: ClassVar[str] = "pymeshlab"

    smoothing: Length = Field(
        "0mm",
        validate_default=True,
        ge=0,
        description="how far smoothing may move a vertex along its ray; 0mm: not at all",
    )
    iterations: int = Field(10, ge=1, description="passes of Taubin smoothing")
    check: bool = Field(True, description="whether a solid that cannot be made is an error")
    self_intersections: Search = Field(
        "auto", description="`auto`: searched for unless the solid's structure excludes them; `always`; `never`"
    )

    def finish(self, scene: Scene, solid: Solid, progress: Progress = silent) -> Solid:
        """The smoothed solid, with what the checks found as metrics. Raises StageError naming the first bad facets."""
        metrics = dict(solid.metrics)
        if self.smoothing > 0:
            if solid.grid != (_grid_lines(scene.lens),) * 2:
                raise StageError("smoothing needs the grid of facets that the lens has; this solid has another one")
            solid, metrics["smoothing_mm"] = smoothed(solid, scene.lens, self.smoothing, self.iterations)
            progress(0.5)
        if self.check:
            found = validate(solid, self.self_intersections)
            if found.flaws:
                raise StageError(f"the solid cannot be made: {_listed(scene.lens, solid, found.flaws)}")
            metrics |= found.metrics
        progress(1.0)
        return Solid(solid.vertices, solid.faces, solid.grid, solid.eye_mm, metrics)


def _grid_lines(lens: Lens) -> int:
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
    lines = _grid_lines(lens)
    if solid.grid == (lines, lines) and vertex < lines**2:
        row, column = (_facet(lens, line) for line in divmod(vertex, lines))
        return f"facet row {row}, column {column}"
    x, y, z = solid.vertices[vertex]
    return f"x = {x:.4g}, y = {y:.4g}, z = {z:.4g} mm"


def _facet(lens: Lens, line: int) -> int:
    """The facet that a grid line belongs to; the rim belongs to its neighbour."""
    return min(max(line - 1, 0) // (lens.microfacets + 1), lens.facets - 1)
