"""The ``question-answer`` scenario: a picture appears over each readable question (section 6, figures 10 and 16)."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from magiclens.config.fields import ImageFile
from magiclens.config.model import Choice, SpecModel, Viewer
from magiclens.contract.artifacts import BoolArray, FloatArray, Lens
from magiclens.contract.units import Length
from magiclens.scenarios.base import Scenario, Shot
from magiclens.scenarios.camouflage import Camouflage
from magiclens.scenarios.pictures import Art, Source, Target
from magiclens.scenarios.universal_animation import UNIVERSAL_LENS, read_mask, universal_stages

_PAPER = 0.98
"""Display value below which a pixel counts as ink."""


class QuestionAndAnswer(SpecModel):
    """A question to read, and the picture that the lens shows over it."""

    question: Source = Field(description="what lies below the lens")
    answer: Target = Field(description="what the eye shall see")


class QuestionAnswer(Scenario):
    """One lens for several questions: either universal, or designed for the given pictures of the questions."""

    type: ClassVar[str] = "question-answer"

    lens: Literal["universal", "source-optimized"] = Field(
        "universal", description="paint around the questions, or leave their pictures as they are"
    )
    pairs: list[QuestionAndAnswer] = Field(min_length=1, max_length=16, description="questions and their answers")
    mask: ImageFile | None = Field(None, description="black where the questions are; found by their ink by default")
    margin: Length = Field(
        "1mm", validate_default=True, ge=0, le=10_000, description="kept free around the questions' ink"
    )
    subdivisions: int = Field(2, ge=1, le=8, description="sub-regions along one side of a facet's patch (5.1)")
    camouflage: Camouflage = Field(
        {"type": "texture"}, validate_default=True, description="what covers pixels that no facet sees (5.2)"
    )

    def suitable_stages(self) -> dict[str, Choice]:
        """A universal lens needs its own matcher and an encoder; the other kind matches the questions as they are.

        In either, facets over plain paper must look far: to what is painted beside the question, or to its ink.
        """
        if self.lens == "universal":
            stages = universal_stages(self.subdivisions, self.camouflage)
            return {**stages, "matcher": {**stages["matcher"], "reach": "8%"}}
        return {"matcher": {"type": "exhaustive", "pixels": 4, "candidates": 36, "window": "30%"}}

    def suitable_lens(self) -> dict[str, Any]:
        """Large facets for what is painted, small ones for thin letters, of which each facet sees little."""
        return UNIVERSAL_LENS if self.lens == "universal" else {"facets": 128, "microfacets": 11}

    def reserved(self, lens: Lens, art: Art) -> BoolArray | None:
        """For universal lenses: pixels that are ink in any question, and a margin around them."""
        if self.lens != "universal":
            return None
        questions = [pair.question.raster(lens.source_size_mm, art) for pair in self.pairs]
        side = max(map(len, questions))
        if self.mask is not None:
            return read_mask(self.mask, side)
        return _grown(_inked(questions, side), self.margin * side / lens.source_size_mm)

    def shots(self, lens: Lens, viewer: Viewer) -> tuple[Shot, ...]:
        """One shot per question, all seen by the same eye."""
        eye_mm = viewer.eye_mm(lens)
        names = [f"question-{k}" for k in range(len(self.pairs))]
        return tuple(
            Shot(name, pair.question, pair.answer, eye_mm, source_name=name, target_name=name)
            for name, pair in zip(names, self.pairs, strict=True)
        )


def _inked(pictures: list[FloatArray], side: int) -> BoolArray:
    """(side, side) pixels at which any of the pictures (H, W, C) is darker than paper."""
    from magiclens.images import resize, to_display

    inked: BoolArray = np.any([to_display(resize(p, (side, side)).min(axis=-1)) < _PAPER for p in pictures], axis=0)
    return inked


def _grown(region: BoolArray, margin_px: float) -> BoolArray:
    """The region (H, W) and all pixels within the margin around it."""
    from scipy.ndimage import distance_transform_edt

    near: BoolArray = distance_transform_edt(~region) <= margin_px
    return near & region.any()  # without any region, the distances are meaningless
