"""Refinement: facets' heights that show their tiles best, against a general optimiser on the same residuals."""

from __future__ import annotations

import argparse

import numpy as np

from benchmarks.comparison import Comparison, require
from benchmarks.lenses import lenslets, planned
from magiclens.contract.artifacts import FloatArray, HeightField, Scene

_ROUNDS = 12
_STEPS = 60


def comparisons(options: argparse.Namespace) -> list[Comparison]:
    """Against L-BFGS of SciPy with the same residuals and exact gradients, for some facets, without blurs."""
    small = ("lens.facets=16", "lens.microfacets=8") if options.quick else ()
    (_, scene), built = planned("single", *small), lenslets("single", *small)
    chosen = np.linspace(0, scene.lens.facets**2 - 1, 4 if options.quick else 16).astype(int)
    task = f"{len(chosen)} facets of {scene.lens.microfacets}² micro-facets"
    facets = _Facets(scene, built, chosen)
    return [Comparison("refinement", task, facets.gauss_newton, {"SciPy L-BFGS": facets.lbfgs}, _errors_agree)]


class _Facets:
    """Some facets of a height field, their residuals, and two ways to make these small.

    Each returns (facets,) mean squared residuals, first at the start and then at the end: (2, facets).
    """

    def __init__(self, scene: Scene, built: HeightField, chosen: FloatArray):
        from magiclens.integration.refinement import optics_for, pictures_of, samples_of

        k = scene.lens.microfacets + 1
        self._samples, self._optics = samples_of(scene.lens), optics_for(built)
        self._pictures = pictures_of(scene, self._samples.pixels)
        self._centres = scene.lens.facet_centres_mm().reshape(-1, 2)[chosen]
        self._heights = built.heights_mm.reshape(-1, k, k)[chosen]

    def gauss_newton(self) -> FloatArray:
        """Ours."""
        from magiclens.integration.laplacian import cosines
        from magiclens.integration.refinement_kernels import Descent, Metric, refine_facets

        k = self._heights.shape[1]
        matrix, eigenvalues = cosines(k)
        metric = Metric(np.ascontiguousarray(matrix), eigenvalues / self._samples.cell_mm**2, np.ones((k, k)))
        errors = np.zeros((2, len(self._heights)))
        for rounds, out in zip((0, _ROUNDS), errors, strict=True):
            heights = self._heights.copy()
            refine_facets(
                heights, self._centres, self._samples, self._pictures, self._optics, metric,
                Descent(rounds, 4, 5e-3), out,
            )  # fmt: skip
        return errors

    def lbfgs(self) -> FloatArray:
        """SciPy's, one facet after the other."""
        from scipy.optimize import minimize

        options = {"maxiter": _STEPS, "maxls": 30}
        found = []
        for heights, centre in zip(self._heights, self._centres, strict=True):
            start, _ = self._loss(heights.ravel(), centre)
            found.append(
                (start, minimize(self._loss, heights.ravel(), (centre,), "L-BFGS-B", True, options=options).fun)
            )
        scale = self._samples.pixels**2 * len(self._pictures.plane)
        return np.array(found).T / scale

    def _loss(self, flat: FloatArray, centre: FloatArray) -> tuple[float, FloatArray]:
        """Sum of squared residuals, and its gradient along the heights."""
        from magiclens.integration.refinement_kernels import (
            Shown,
            predict_facet,
            residual_change_transposed,
            room_for_rays,
            tile_of,
            triangle_slopes_transposed,
        )

        k, samples, pictures = self._heights.shape[1], self._samples, self._pictures
        triangles, channels = 2 * (k - 1) ** 2, len(pictures.plane)
        shown = Shown(
            np.zeros((2, triangles)), np.zeros((channels, samples.pixels**2), np.float32),
            np.zeros((channels, 2, len(samples.triangle)), np.float32),
        )  # fmt: skip
        facet = (flat.reshape(k, k), centre, samples, pictures, self._optics)
        error = predict_facet(*facet, tile_of(*facet), room_for_rays(samples), shown)
        if not np.isfinite(error):
            return 1e9, np.zeros_like(flat)
        forces, gradient = np.zeros((2, triangles)), np.zeros((k, k))
        residual_change_transposed(samples, shown, shown.residuals, forces)
        triangle_slopes_transposed(forces, samples.cell_mm, gradient)
        return float((shown.residuals.astype(np.float64) ** 2).sum()), 2 * gradient.ravel()


def _errors_agree(ours: FloatArray, theirs: FloatArray) -> str:
    """Both start from the same residuals; how small they get is said."""
    same = np.allclose(ours[0], theirs[0], rtol=1e-3)
    (start, end), other = ours.mean(axis=1), theirs[1].mean()
    return require(bool(same), f"mean squared residual {start:.2g} → {end:.2g}, other {other:.2g}")
