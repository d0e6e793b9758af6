"""The built-in renderer."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from magiclens.contract.artifacts import FloatArray, Scene, Solid
from magiclens.contract.stages import Progress, Renderer, silent


class Tracer(Renderer):
    """Height-field ray tracing of the finished solid: fast, noise-free, with Fresnel losses and shadowing by walls."""

    type: ClassVar[str] = "tracer"

    resolution: int = Field(512, ge=16, le=4096, description="pixels per side of the picture")
    samples: int = Field(4, ge=1, le=16, description="samples per side of a pixel")

    def render(self, scene: Scene, solid: Solid, progress: Progress = silent) -> list[FloatArray]:
        """See Renderer. Raises InputError if the solid is no longer a height field."""
        from magiclens.rendering.trace import picture, trace

        out = []
        made: dict[tuple[float, ...], FloatArray] = {}
        for done, view in enumerate(scene.views):
            eye = tuple(view.eye_in_lens_frame_mm.tolist())
            if eye not in made:  # frames of an animation share one
                made[eye] = trace(solid, scene.lens, view, self.resolution, self.samples)
            seen = picture(made[eye], view.in_lens_frame().source, scene.lens.source_size_mm)
            out.append(np.ascontiguousarray(np.rot90(seen, view.quarter_turns)))
            progress((done + 1) / len(scene.views))
        return out
