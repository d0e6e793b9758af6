"""The encoder: sources painted or edited by box-constrained least squares through the traced lens (5.2; 7)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from pydantic import Field

from magiclens.contract.artifacts import Scene, Transport
from magiclens.contract.stages import Encoder, Progress, silent
from magiclens.contract.units import Fraction, Length
from magiclens.scenarios.camouflage import Camouflage


class LeastSquares(Encoder):
    """What the eye sees is linear in the source: the source whose picture is nearest to the targets, within bounds.

    Walls, perspective, Fresnel losses and the lenslets' true shapes are in the traced matrix, so they are compensated.
    Errors count as the eye sees them, in display values. Views that share a source are solved together.
    """

    type: ClassVar[str] = "least-squares"

    change: Fraction = Field(
        "100%", validate_default=True, gt=0, le=1, description="farthest a display value may move from the given source"
    )
    exposure: float | None = Field(
        None, gt=0, le=1, description="brightness of the picture; by default what most facets let through"
    )
    pull: float = Field(1e-4, ge=0, description="how strongly pixels that hardly matter stay as they were given")
    iterations: int = Field(40, ge=1, description="steps of the solver")
    bleed: Length = Field(
        "0mm", validate_default=True, ge=0,
        description="how far painted pixels spread over unseen ones, lest a small shift of the lens uncovers these",
    )  # fmt: skip
    camouflage: Camouflage = Field(
        {"type": "none"}, validate_default=True, description="what covers pixels that no facet sees (5.2)"
    )

    def encode(
        self, scene: Scene, transports: Sequence[Transport], rng: np.random.Generator, progress: Progress = silent
    ) -> Scene:
        """Solve for every source, then cover what no facet sees. Reserved pixels keep the given source bit for bit."""
        from magiclens.encoding.solver import encode

        return encode(self, scene, transports, rng, progress)
