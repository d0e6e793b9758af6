"""Where the light goes: the loss budget of one spec, from the matching bound to the path-traced mesh.

    python benchmarks/loss_budget.py specs/single.yaml [key=value ...]

The table lists PSNR in dB, the mean over the views. Each of the first six rows adds one loss or gain to the row before:
ideal facets, the assignment, micro-facets without the shadows of walls, free-form refinement, shadows, and Fresnel
losses. With several eyes, the third row also includes that facets above or below the reference plane are displaced in
the pictures. The fourth row is the prediction of the refinement itself, at its own resolution and exposure. The last
rows leave out one step, or change one setting, and trace the lens again.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from magiclens.analysis.ideal_picture import bound_psnr_db
from magiclens.contract.artifacts import Assignment, FloatArray, HeightField, Scene, View
from magiclens.geometry.facets import patches_seen
from magiclens.geometry.solid import solid_from_heights
from magiclens.images import score
from magiclens.integration.refinement import predicted_errors
from magiclens.kernels.sampling import place
from magiclens.plan.compile import load_plan
from magiclens.rendering.tracer import picture, trace

_RESOLUTION = 512
"""Side of the traced pictures, pixels."""
_SAMPLES = 4
"""Rays along each side of a pixel."""
_TRANSMITTANCE = 0.92
"""Share of light that passes a lens of acrylic at nearly normal incidence, for rays that are put right."""


def pictures(scene: Scene, built: HeightField, fresnel: bool, unshadowed: Assignment | None = None) -> list[FloatArray]:
    """Trace a height field.

    Args:
        scene: Lens and views.
        built: The height field.
        fresnel: Whether light is lost at surfaces; if not, every ray that reaches the source counts fully.
        unshadowed: The assignment for which the facets were built. If given, rays that miss the source points which it
            asks for, by more than two micro-facets, are put right: these are the rays that meet walls.

    Returns:
        One picture (R, R, C) per view, linear light, lens frame.
    """
    solid, out = solid_from_heights(built), []
    for view in scene.views:
        hits = trace(solid, scene.lens, view, _RESOLUTION, _SAMPLES).copy()
        if unshadowed:
            ideal = ideal_source_points(scene, view, unshadowed, built.levels_mm)
            miss = np.linalg.norm(hits[..., :2] - ideal, axis=-1)
            astray = miss > 2 * scene.lens.pitch_mm / scene.lens.microfacets
            hits[astray, :2], hits[astray, 2] = ideal[astray], _TRANSMITTANCE
        if not fresnel:
            hits[..., 2] = hits[..., 2] > 0
        out.append(picture(hits, view.in_lens_frame().source, scene.lens.source_size_mm))
    return out


def ideal_source_points(scene: Scene, view: View, assignment: Assignment, heights: FloatArray) -> FloatArray:
    """Source points that the view's traced rays meet if facets realise the assignment exactly.

    Args:
        scene: Lens and views.
        view: The view.
        assignment: The transformation of every facet.
        heights: (N, N) mean height of each facet above the reference plane, mm.

    Returns:
        (R, R, S^2, 2) mm, lens frame; S is the number of rays along a pixel's side.
    """
    lens, patches = scene.lens, patches_seen(scene, assignment, view.eye_in_lens_frame_mm, heights)
    right, down = np.array([place(k, _SAMPLES) for k in range(_SAMPLES**2)]).T
    pixels = np.arange(_RESOLUTION)
    columns, rows = np.broadcast_arrays(pixels[:, None] + right, pixels[:, None, None] + down)
    own = tuple((at * (lens.facets / _RESOLUTION)).astype(int) for at in (rows, columns))
    along = (patches.maps @ np.linalg.inv(patches.shears))[own]
    p = (np.stack([columns, -rows], axis=-1) / _RESOLUTION + (-0.5, 0.5)) * lens.size_mm - patches.positions_mm[own]
    seen: FloatArray = patches.landings_mm[own] + np.einsum("ijkab,ijkb->ijka", along, p)
    return seen


def mean_psnr(scene: Scene, seen: list[FloatArray]) -> float:
    """Mean PSNR of pictures, one per view, in the lens frame."""
    return float(np.mean([score(p, v.in_lens_frame().target).psnr_db for p, v in zip(seen, scene.views, strict=True)]))


def predicted_psnr(scene: Scene, built: HeightField) -> float:
    """PSNR that the refinement predicts, which knows no walls; facets that show no source are wholly wrong."""
    return float(-10 * np.log10(np.minimum(predicted_errors(scene, built), 1.0).mean()))


def main(spec: str, *overrides: str) -> None:
    """Print the loss budget of a spec with these overrides."""
    plan = load_plan(Path(spec), overrides)
    scene, rng = plan.scene(), np.random.default_rng(plan.spec.seed)
    candidates = plan.matcher.stage.match(scene, rng)
    best = Assignment.pick(candidates, np.zeros(candidates.errors.shape[:2], np.int64))
    chosen = plan.annealer.stage.anneal(scene, candidates, rng)
    integrator = plan.integrator.stage
    fine = Scene(replace(scene.lens, microfacets=2 * scene.lens.microfacets), scene.views)
    lenslets = integrator.integrate(scene, chosen)
    refined = integrator.refine(scene, lenslets)

    def whole(scene: Scene, assignment: Assignment) -> float:
        built = integrator.refine(scene, integrator.integrate(scene, assignment))
        return mean_psnr(scene, pictures(scene, built, True))

    rows = [
        ("every facet's best candidate, ideal", bound_psnr_db(scene, best)),
        ("annealed candidates, ideal", bound_psnr_db(scene, chosen)),
        ("+ micro-facets", mean_psnr(scene, pictures(scene, lenslets, False, chosen))),
        ("+ free-form refinement", predicted_psnr(scene, refined)),
        ("+ rays astray at walls and between facets", mean_psnr(scene, pictures(scene, refined, False))),
        ("+ Fresnel: the lens as traced", mean_psnr(scene, pictures(scene, refined, True))),
        ("the lens as traced, without refinement", mean_psnr(scene, pictures(scene, lenslets, True))),
        ("the lens without annealing", whole(scene, best)),
        ("the lens with twice the micro-facets", whole(fine, chosen)),
    ]
    for name, value in rows:
        print(f"{value:6.2f} dB  {name}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
