"""The usual finisher: bounded smoothing, then the checks that a solid must pass before it is made."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from magiclens.config.model import FREE_FINISHER
from magiclens.config.optional import PYMESHLAB, is_installed
from magiclens.contract.artifacts import Scene, Solid
from magiclens.contract.errors import StageError
from magiclens.contract.stages import Finisher, Progress, silent
from magiclens.contract.units import Length
from magiclens.meshing.intersections import faces_by_pymeshlab
from magiclens.meshing.smoothing import smoothed
from magiclens.meshing.soundness import lines_of_grid, require_sound
from magiclens.meshing.validation import Search


class Pymeshlab(Finisher):
    """Smooths inside the facets, within a bound, and checks that the solid can be made."""

    type: ClassVar[str] = "pymeshlab"

    smoothing: Length = Field(
        "0mm",
        validate_default=True,
        ge=0,
        le=10,
        description="how far smoothing may move a vertex along its ray; 0mm: not at all",
    )
    iterations: int = Field(10, ge=1, le=1000, description="passes of Taubin smoothing")
    check: bool = Field(True, description="whether a solid that cannot be made is an error")
    self_intersections: Search = Field(
        "auto", description="`auto`: searched for unless the solid's structure excludes them; `always`; `never`"
    )

    def lacks(self) -> str | None:
        """See Stage."""
        if is_installed(PYMESHLAB):
            return None
        free = f"{{type: {FREE_FINISHER}}}, which checks the same and does not smooth"
        return f"pymeshlab is not installed: pip install pymeshlab, or write {free}"

    def finish(self, scene: Scene, solid: Solid, progress: Progress = silent) -> Solid:
        """The smoothed solid, with what the checks found as metrics. Raises StageError naming the first bad facets."""
        metrics = dict(solid.metrics)
        if self.smoothing > 0:
            if solid.grid != (lines_of_grid(scene.lens),) * 2:
                raise StageError("smoothing needs the grid of facets that the lens has; this solid has another one")
            solid, metrics["smoothing_mm"] = smoothed(solid, scene.lens, self.smoothing, self.iterations)
            progress(0.5)
        if self.check:
            metrics |= require_sound(scene.lens, solid, self.self_intersections, faces_by_pymeshlab)
        progress(1.0)
        return Solid(solid.vertices, solid.faces, solid.grid, solid.eye_mm, metrics)
