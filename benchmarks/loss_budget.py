"""Where the light goes: the loss budget of one spec, from the matching bound to the path-traced mesh.

    python benchmarks/loss_budget.py specs/single.yaml [key=value ...]

Every row changes one thing and traces again; PSNR in dB, mean over the views. Rows of the solid differ from the one
before by one loss or gain: ideal facets, the assignment, micro-facets without walls' shadows, free-form refinement,
shadows, Fresnel. With several eyes the third row also counts that facets stand high or low, which moves them about in
the pictures. The fourth row is what refinement itself foresees, at its own resolution and exposure.
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
from magiclens.integration.refinement import foreseen
from magiclens.kernels.sampling import place
from magiclens.plan.compile import load_plan
from magiclens.rendering.tracer import picture, trace

RESOLUTION, SAMPLES = 512, 4


def pictures(scene: Scene, built: HeightField, fresnel: bool, unshadowed: Assignment | None = None) -> list[FloatArray]:
    """One picture per view, lens frame; without Fresnel losses every path that arrives counts fully.

    unshadowed: what the facets are lenslets for; rays that go astray are put where it wants them.
    """
    solid, out = solid_from_heights(built), []
    for view in scene.views:
        hits = trace(solid, scene.lens, view, RESOLUTION, SAMPLES).copy()
        if unshadowed:
            ideal = wanted(scene, view, unshadowed, built.levels_mm)
            miss = np.linalg.norm(hits[..., :2] - ideal, axis=-1)
            astray = miss > 2 * scene.lens.pitch_mm / scene.lens.microfacets
            hits[astray, :2], hits[astray, 2] = ideal[astray], 0.92
        if not fresnel:
            hits[..., 2] = hits[..., 2] > 0
        out.append(picture(hits, view.in_lens_frame().source, scene.lens.source_size_mm))
    return out


def wanted(scene: Scene, view: View, assignment: Assignment, heights: FloatArray) -> FloatArray:
    """(R, R, S^2, 2) source points, mm, lens frame, at which the view's traced samples should arrive."""
    lens, patches = scene.lens, patches_seen(scene, assignment, view.eye_in_lens_frame_mm, heights)
    right, down = np.array([place(k, SAMPLES) for k in range(SAMPLES**2)]).T
    pixels = np.arange(RESOLUTION)
    columns, rows = np.broadcast_arrays(pixels[:, None] + right, pixels[:, None, None] + down)
    own = tuple((at * (lens.facets / RESOLUTION)).astype(int) for at in (rows, columns))
    along = (patches.maps @ np.linalg.inv(patches.shears))[own]
    p = (np.stack([columns, -rows], axis=-1) / RESOLUTION + (-0.5, 0.5)) * lens.size_mm - patches.places_mm[own]
    seen: FloatArray = patches.landings_mm[own] + np.einsum("ijkab,ijkb->ijka", along, p)
    return seen


def mean_psnr(scene: Scene, seen: list[FloatArray]) -> float:
    """Mean PSNR over the views of pictures in the lens frame."""
    return float(
        np.mean([score(p, v.in_lens_frame().target).psnr_db for p, v in zip(seen, scene.views, strict=True)])
    )


def foreseen_psnr(scene: Scene, built: HeightField) -> float:
    """PSNR over all views if no wall were in a ray's way, as refinement sees them; dark facets are wholly wrong."""
    return float(-10 * np.log10(np.minimum(foreseen(scene, built), 1.0).mean()))


def main(spec: str, *overrides: str) -> None:
    """Print the budget of a spec."""
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
        ("+ free-form refinement", foreseen_psnr(scene, refined)),
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
