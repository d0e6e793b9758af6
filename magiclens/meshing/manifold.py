"""The finisher for those who do without pymeshlab: the same checks, with the search of manifold3d and trimesh."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from magiclens.contract.artifacts import Scene, Solid
from magiclens.contract.stages import Finisher, Progress, silent
from magiclens.meshing.intersections import faces_by_manifold
from magiclens.meshing.soundness import require_sound
from magiclens.meshing.validation import Search


class ManifoldFinisher(Finisher):
    """Checks that the solid can be made, and leaves it as it is."""

    type: ClassVar[str] = "manifold"

    check: bool = Field(True, description="whether a solid that cannot be made is an error")
    self_intersections: Search = Field(
        "auto", description="`auto`: searched for unless the solid's structure excludes them; `always`; `never`"
    )

    def finish(self, scene: Scene, solid: Solid, progress: Progress = silent) -> Solid:
        """The same solid, with what the checks found as metrics. Raises StageError naming the first bad facets."""
        found = require_sound(scene.lens, solid, self.self_intersections, faces_by_manifold) if self.check else {}
        progress(1.0)
        return Solid(solid.vertices, solid.faces, solid.grid, solid.eye_mm, {**solid.metrics, **found})
