"""The ideal picture: what the eye would see if every facet realised its transformation exactly."""

from __future__ import annotations

import numpy as np

from magiclens.analysis.base import Analysis, Findings
from magiclens.contract.artifacts import Assignment, FloatArray, Scene, View
from magiclens.contract.result import RunResult
from magiclens.geometry.facets import patches_seen
from magiclens.images.score import best_exposure_psnr_db
from magiclens.plan.compile import Plan


def predict(
    scene: Scene, assignment: Assignment, resolution: int = 512, samples: int = 4, heights_mm: FloatArray | None = None
) -> list[FloatArray]:
    """The ideal picture of every view.

    Args:
        scene: The lens and its views.
        assignment: The transformation of every facet.
        resolution: Pixels R along one side of a picture.
        samples: Samples of the source per side of a pixel.
        heights_mm: (N, N) heights of the facets' centres, see ``facets.patches_seen``; None is the reference plane.

    Returns:
        One (R, R, C) float32 picture per view, linear light, world frame.
    """
    return [predict_view(scene, assignment, view, resolution, samples, heights_mm) for view in scene.views]


def predict_view(
    scene: Scene, assignment: Assignment, view: View, resolution: int = 512, samples: int = 4,
    heights_mm: FloatArray | None = None,
) -> FloatArray:  # fmt: skip
    """The ideal picture of one view, (R, R, C) float32; see ``predict`` for the arguments."""
    from magiclens.analysis.ideal_picture_kernels import IdealFacets, sample_ideal_picture
    from magiclens.kernels.threads import in_threads

    local = view.in_lens_frame()
    patches = patches_seen(scene, assignment, local.eye_mm, heights_mm)
    flip = np.array([1, -1])
    turn = np.outer(flip, flip)
    inward = np.linalg.inv(np.where(np.isfinite(patches.shears), patches.shears, np.eye(2)))
    facets = IdealFacets(patches.landings_mm * flip, patches.maps * turn, patches.positions_mm * flip, inward * turn)
    per_mm = local.source.shape[1] / scene.lens.source_size_mm
    seen = np.empty((resolution, resolution, local.source.shape[2]), np.float32)
    in_threads(sample_ideal_picture, resolution, local.source, per_mm, facets, scene.lens.size_mm, samples, seen)
    return np.ascontiguousarray(np.rot90(seen, view.quarter_turns))


def bound_psnr_db(scene: Scene, assignment: Assignment, heights_mm: FloatArray | None = None) -> float:
    """Mean PSNR, dB, over the views of their ideal pictures against their targets; refined facets may do better."""
    pictures = predict(scene, assignment, heights_mm=heights_mm)
    return float(np.mean([best_exposure_psnr_db(p, v.target) for p, v in zip(pictures, scene.views, strict=True)]))


def _compute(plan: Plan, result: RunResult) -> Findings:
    best, chosen = result.best_match, result.assignment
    return Findings(
        {
            "matching_psnr_db": bound_psnr_db(result.scene, best, result.candidates.heights_mm),
            "assigned_psnr_db": bound_psnr_db(result.scene, chosen, result.height_field.levels_mm),
        }
    )


IDEAL_PICTURE = Analysis("ideal-picture", compute=_compute)
"""The bounds that matching and annealing set: PSNR if every facet showed its patch exactly."""
