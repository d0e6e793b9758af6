"""The numerics of the ``least-squares`` encoder: an accelerated projected gradient method with a diagonal majoriser."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_array, vstack

from magiclens.contract.artifacts import BoolArray, FloatArray, IntArray, Scene, Transport, View
from magiclens.contract.stages import Progress
from magiclens.images import resize, to_display, to_linear
from magiclens.kernels.sparse import times

if TYPE_CHECKING:
    from magiclens.encoding.least_squares import LeastSquares

DARKEST = 0.02
"""Linear light below which display values count as steep as here: the sRGB curve would weigh black alone."""
MOST_PASS = 0.25
"""The exposure is what all but this share of the lit pixels let through."""


class Matrix:
    """The stacked matrices of views that share a source, on the columns of pixels that may be painted.

    columns: (n,) int64 of these pixels. rim, inside: (r,) int64 paintable pixels that no ray sees, but within
    ``bleed_px`` of painted ones, and the nearest of these. free: (S,) pixels that nobody needs.
    """

    def __init__(self, transports: Sequence[Transport], paintable: BoolArray | None, bleed_px: float):
        whole = transports[0].matrix if len(transports) == 1 else vstack([t.matrix for t in transports], format="csr")
        seen = np.zeros(whole.shape[1], bool)
        seen[whole.indices] = True
        self.columns: IntArray = np.flatnonzero(seen if paintable is None else seen & paintable)
        painted = np.zeros(whole.shape[1], bool)
        painted[self.columns] = True
        self._kept = np.flatnonzero(seen & ~painted)
        self._fixed = _columns(whole, self._kept) if len(self._kept) else None
        self._forward = _columns(whole, self.columns)
        self._back = csr_array(self._forward.T)
        self.rim, self.inside = _rim(painted.reshape(transports[0].source_shape), paintable, bleed_px)
        self.free: BoolArray = ~seen if paintable is None else ~seen & paintable
        self.free[self.rim] = False

    def see(self, values: FloatArray) -> FloatArray:
        """(rows, C) picture of the paintable pixels (n, C)."""
        return _product(self._forward, values)

    def back(self, picture: FloatArray) -> FloatArray:
        """(n, C) transposed product of (rows, C)."""
        return _product(self._back, picture)

    def unchangeable(self, source: FloatArray) -> FloatArray | float:
        """(rows, C) picture of the pixels of a source (S, C) that may not be painted."""
        return 0.0 if self._fixed is None else _product(self._fixed, source[self._kept])


def encode(
    options: LeastSquares, scene: Scene, transports: Sequence[Transport], rng: np.random.Generator, progress: Progress
) -> Scene:
    """See ``LeastSquares.encode``."""
    names = list(dict.fromkeys(view.source_name for view in scene.views))
    painted: dict[str, FloatArray] = {}
    matrices: dict[tuple[int, ...], Matrix] = {}
    for done, name in enumerate(names):
        group = [k for k, view in enumerate(scene.views) if view.source_name == name]
        views, seen_by = [scene.views[k] for k in group], [transports[k] for k in group]
        same = tuple(map(id, seen_by))  # frames of an animation share one
        if same not in matrices:
            paintable = None if scene.reserved is None else ~scene.reserved.ravel()
            bleed_px = options.bleed / scene.lens.source_size_mm * len(views[0].source)
            matrices[same] = Matrix(seen_by, paintable, bleed_px)
        painted[name] = _paint(options, views, matrices[same], seen_by[0].shape, scene, rng)
        progress((done + 1) / len(names))
    return replace(scene, views=tuple(replace(view, source=painted[view.source_name]) for view in scene.views))


def _paint(
    options: LeastSquares, views: list[View], matrix: Matrix, shape: tuple[int, int], scene: Scene,
    rng: np.random.Generator,
) -> FloatArray:  # fmt: skip
    """One source (H, W, C) for its views, whose pictures have this shape."""
    given = views[0].source
    targets = np.concatenate([resize(view.target, shape).reshape(-1, given.shape[-1]) for view in views])
    flat = given.reshape(-1, given.shape[-1])
    out = flat.copy()
    out[matrix.columns] = _rounded(_solve(options, matrix, targets, flat))
    out[matrix.rim] = out[matrix.inside]
    covered = options.camouflage.cover(
        out.reshape(given.shape), ~matrix.free.reshape(given.shape[:2]), scene.lens.source_size_mm, rng
    )
    return covered if options.change == 1 else np.clip(covered, *bounds(given, options.change))


def _solve(options: LeastSquares, matrix: Matrix, targets: FloatArray, given: FloatArray) -> FloatArray:
    """(n, C) values of the paintable pixels. targets: (rows, C), given: (S, C), all linear light.

    Minimises ``|W (A s - g t)|^2 + pull |s - given|^2`` within the bounds, W the slope of the display curve at the
    target. ``A^T W^2 A 1`` bounds the curvature, since A has no negative entries, and so sets every pixel's step.
    """
    start = given[matrix.columns]
    low, high = bounds(start, options.change)
    through = matrix.see(np.ones_like(start))
    want = exposure(options.exposure, through) * targets - matrix.unchangeable(given)
    weight = _steepness(targets) ** 2
    curvature = matrix.back(weight * through)
    pull = np.float32(options.pull) * np.median(curvature, axis=0)
    curvature += pull + np.float32(1e-12)
    x = y = start
    momentum = 1.0
    for _ in range(options.iterations):
        slope = matrix.back(weight * (matrix.see(y) - want)) + pull * (y - start)
        before, x = x, np.clip(y - slope / curvature, low, high)
        if ((y - x) * (x - before)).sum() > 0:  # overshot: start the acceleration anew
            momentum = 1.0
        faster = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        y = x + np.float32((momentum - 1) / faster) * (x - before)
        momentum = faster
    return x


def _rim(painted: BoolArray, paintable: BoolArray | None, bleed_px: float) -> tuple[IntArray, IntArray]:
    """Pixels near ``painted`` ones (H, W), and for each the nearest of these, as indices of the flat source."""
    if bleed_px <= 0 or not painted.any():
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    from scipy.ndimage import distance_transform_edt

    away, nearest = distance_transform_edt(~painted, return_indices=True)
    near = (away > 0) & (away <= bleed_px)
    if paintable is not None:
        near &= paintable.reshape(painted.shape)
    return np.flatnonzero(near), np.ravel_multi_index(tuple(nearest[:, near]), painted.shape)


def bounds(given: FloatArray, change: float) -> tuple[FloatArray, FloatArray]:
    """Least and largest linear light of pixels whose display values may move by ``change``."""
    display = to_display(given)
    return to_linear(np.maximum(display - change, 0)), to_linear(np.minimum(display + change, 1))


def exposure(wanted: float | None, through: FloatArray) -> float:
    """The factor between targets and pictures; ``through``: (rows, C) picture of a white source."""
    if wanted is not None:
        return wanted
    lit = through[:, 0][through[:, 0] > 0]
    return min(float(np.quantile(lit, MOST_PASS)), 1.0) if len(lit) else 1.0


def _steepness(linear: FloatArray) -> FloatArray:
    """Slope of the sRGB curve, no steeper than at DARKEST."""
    slope: FloatArray = (1.055 / 2.4 * np.maximum(linear, DARKEST) ** (1 / 2.4 - 1)).astype(np.float32)
    return slope


def _rounded(linear: FloatArray) -> FloatArray:
    """As 8-bit files will hold it."""
    return to_linear(np.rint(to_display(linear) * 255) / np.float32(255)).astype(np.float32)


def _columns(matrix: csr_array, columns: IntArray) -> csr_array:
    return csr_array(matrix[:, columns])


def _product(matrix: csr_array, x: FloatArray) -> FloatArray:
    out: FloatArray = times(matrix.indptr, matrix.indices, matrix.data, np.ascontiguousarray(x, np.float32))
    return out
