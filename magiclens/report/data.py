"""What a report is made from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from magiclens.artifacts import Assignment, Candidates, FloatArray, HeightField, Scene, Solid


@dataclass(frozen=True)
class RunData:
    """Everything a run has made. Equal runs have equal data: the manifest has no timings and no file list yet.

    given: the scene before an encoder edited its sources; ``scene`` itself if there is none. first: each facet's best
    candidate, what annealing started from. renders: by renderer type, one picture per view, (R, R, C) float32, linear.
    """

    given: Scene
    scene: Scene
    candidates: Candidates
    first: Assignment
    assignment: Assignment
    height_field: HeightField
    solid: Solid
    renders: Mapping[str, Sequence[FloatArray]]
    manifest: Mapping[str, Any]
