"""The ``least-squares`` encoder: sources painted or edited through the traced lens (sections 5.2 and 7)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from pydantic import Field

from magiclens.contract.artifacts import BoolArray, FloatArray, IntArray, Scene, Transport, View
from magiclens.contract.stages import Encoder, Progress, silent
from magiclens.contract.units import Fraction, Length
from magiclens.images import resize, to_display, to_linear
from magiclens.images.resample import pixels_touching
from magiclens.scenarios.camouflage import Camouflage

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_DARKEST = 0.02
"""Linear light below which the slope of the display curve is taken as here. The sRGB curve is so steep at black that
errors there would outweigh all others."""
_SHARE_BELOW_EXPOSURE = 0.25
"""Share of the lit pixels that may let through less light than the exposure asks for."""


class LeastSquaresEncoder(Encoder):
    """Finds the sources whose pictures are nearest to the targets, within bounds.

    What the eye sees is linear in the source, and the traced matrix holds walls, perspective, Fresnel losses and the
    lenslets' true shapes, so the solution compensates for all of them. Errors count as the eye sees them, in display
    values. Views that share a source are solved together.
    """

    type: ClassVar[str] = "least-squares"

    change: Fraction = Field(
        "100%", validate_default=True, gt=0, le=1, description="farthest a display value may move from the given source"
    )
    exposure: float | None = Field(
        None, gt=0, le=1, description="brightness of the picture; by default what most facets let through"
    )
    pull: float = Field(
        1e-4, ge=0, le=1e6, description="how strongly pixels that hardly matter stay as they were given"
    )
    iterations: int = Field(40, ge=1, le=10_000, description="steps of the solver")
    bleed: Length = Field(
        "0mm", validate_default=True, ge=0, le=10_000,
        description="how far painted pixels spread over unseen ones, so that a small shift of the lens uncovers none",
    )  # fmt: skip
    camouflage: Camouflage = Field(
        {"type": "none"}, validate_default=True, description="what covers pixels that no facet sees (5.2)"
    )

    def encode(
        self, scene: Scene, transports: Sequence[Transport], rng: np.random.Generator, progress: Progress = silent
    ) -> Scene:
        """Solve for every source, then cover what no facet sees.

        Args:
            scene: Lens, targets and given sources. Pixels in ``scene.reserved`` keep the given source bit for bit.
            transports: One matrix per view, from its source to what its eye sees.
            rng: Randomness of the camouflage.
            progress: Told the share of sources that are done.

        Returns:
            The scene with new sources.
        """
        names = list(dict.fromkeys(view.source_name for view in scene.views))
        painted: dict[str, FloatArray] = {}
        matrices: dict[tuple[int, ...], _SourceMatrix] = {}
        for done, name in enumerate(names):
            group = [k for k, view in enumerate(scene.views) if view.source_name == name]
            views, seen_by = [scene.views[k] for k in group], [transports[k] for k in group]
            same = tuple(map(id, seen_by))  # frames of an animation share one matrix, which is prepared once
            if same not in matrices:
                # reserved pixels may have a resolution of their own
                kept = None if scene.reserved is None else pixels_touching(scene.reserved, views[0].source.shape[:2])
                paintable = None if kept is None else ~kept.ravel()
                bleed_px = self.bleed / scene.lens.source_size_mm * len(views[0].source)
                matrices[same] = _SourceMatrix(seen_by, paintable, bleed_px)
            painted[name] = self._paint(views, matrices[same], seen_by[0].shape, scene, rng)
            progress((done + 1) / len(names))
        return replace(scene, views=tuple(replace(view, source=painted[view.source_name]) for view in scene.views))

    def _paint(
        self, views: list[View], matrix: _SourceMatrix, shape: tuple[int, int], scene: Scene, rng: np.random.Generator
    ) -> FloatArray:
        """One source (H, W, C) for its views, whose pictures have this shape (rows, columns)."""
        given = views[0].source
        # in the order in which ``_SourceMatrix`` stacks the matrices of the views
        targets = np.concatenate([resize(view.target, shape).reshape(-1, given.shape[-1]) for view in views])
        flat = given.reshape(-1, given.shape[-1])
        out = flat.copy()
        out[matrix.columns] = _rounded(self._solve(matrix, targets, flat))
        out[matrix.rim] = out[matrix.inside]
        covered = self.camouflage.cover(
            out.reshape(given.shape), ~matrix.free.reshape(given.shape[:2]), scene.lens.source_size_mm, rng
        )
        return np.clip(covered, *_bounds(given, self.change))

    def _solve(self, matrix: _SourceMatrix, targets: FloatArray, given: FloatArray) -> FloatArray:
        """Minimise ``|W (A s - g t)|^2 + pull |s - given|^2`` within the bounds.

        A is the matrix, s the source, g the exposure, t the targets, and W the slope of the display curve at the
        targets, which turns errors of light into errors of display values. The method is an accelerated projected
        gradient descent. A has no negative entries, so ``A^T W^2 A 1`` bounds the curvature and sets every pixel's
        step.

        Args:
            matrix: A, on the paintable pixels.
            targets: t, (rows, C) linear light.
            given: The given source, (S, C) linear light.

        Returns:
            (n, C) linear light of the paintable pixels.
        """
        start = given[matrix.columns]
        low, high = _bounds(start, self.change)
        through = matrix.see(np.ones_like(start))
        want = _exposure(self.exposure, through) * targets - matrix.unchangeable(given)
        weight = _steepness(targets) ** 2
        curvature = matrix.back(weight * through)
        pull = np.float32(self.pull) * np.median(curvature, axis=0)
        curvature += pull + np.float32(1e-12)  # not 0 where a pixel has no weight and there is no pull
        # x: the sources; y: x carried on by the last change, where the next slope is taken (Nesterov)
        x = y = start
        momentum = 1.0
        for _ in range(self.iterations):
            slope = matrix.back(weight * (matrix.see(y) - want)) + pull * (y - start)
            before, x = x, np.clip(y - slope / curvature, low, high)
            # the last change went uphill: start the acceleration anew
            if ((y - x) * (x - before)).sum() > 0:
                momentum = 1.0
            faster = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
            y = x + np.float32((momentum - 1) / faster) * (x - before)
            momentum = faster
        return x


class _SourceMatrix:
    """The stacked matrices of views that share a source, on the columns of pixels that may be painted.

    S is the number of pixels of the source.

    Attributes:
        columns: (n,) int64 indices of the pixels that rays see and that may be painted.
        rim: (r,) int64 indices of paintable pixels that no ray sees, within ``bleed_px`` of painted ones.
        inside: (r,) int64 indices of the painted pixel that is nearest to each pixel of the rim.
        free: (S,) whether a pixel may be painted, is seen by no ray and is not on the rim.
    """

    def __init__(self, transports: Sequence[Transport], paintable: BoolArray | None, bleed_px: float):
        from scipy.sparse import csr_array, vstack

        whole = transports[0].matrix if len(transports) == 1 else vstack([t.matrix for t in transports], format="csr")
        seen = np.zeros(whole.shape[1], bool)
        seen[whole.indices] = True
        self.columns: IntArray = np.flatnonzero(seen if paintable is None else seen & paintable)
        painted = np.zeros(whole.shape[1], bool)
        painted[self.columns] = True
        self._kept = np.flatnonzero(seen & ~painted)
        self._fixed = csr_array(whole[:, self._kept]) if len(self._kept) else None
        self._forward = csr_array(whole[:, self.columns])
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


def _rim(painted: BoolArray, paintable: BoolArray | None, bleed_px: float) -> tuple[IntArray, IntArray]:
    """The rim of the painted pixels.

    Args:
        painted: (H, W) pixels that are painted.
        paintable: (H W,) pixels that may be painted; None if all may.
        bleed_px: largest distance of the rim from painted pixels, pixels.

    Returns:
        Indices of the pixels of the rim, and for each that of the nearest painted pixel, in the flat source.
    """
    if not bleed_px or not painted.any():
        none = np.zeros(0, np.int64)
        return none, none
    from scipy.ndimage import distance_transform_edt

    away, nearest = distance_transform_edt(~painted, return_indices=True)
    near = (away > 0) & (away <= bleed_px)
    if paintable is not None:
        near &= paintable.reshape(painted.shape)
    return np.flatnonzero(near), np.ravel_multi_index(tuple(nearest[:, near]), painted.shape)


def _bounds(given: FloatArray, change: float) -> tuple[FloatArray, FloatArray]:
    """Least and largest linear light of pixels whose display values may move by ``change``."""
    display = to_display(given)
    return to_linear(np.maximum(display - change, 0)), to_linear(np.minimum(display + change, 1))


def _exposure(wanted: float | None, through: FloatArray) -> float:
    """The factor between targets and pictures; ``through``: (rows, C) picture of a white source."""
    if wanted is not None:
        return wanted
    lit = through[:, 0][through[:, 0] > 0]  # all channels are alike, since the matrix is the same for them
    return min(float(np.quantile(lit, _SHARE_BELOW_EXPOSURE)), 1.0) if len(lit) else 1.0


def _steepness(linear: FloatArray) -> FloatArray:
    """Slope of the sRGB curve, no steeper than at ``_DARKEST``."""
    slope: FloatArray = (1.055 / 2.4 * np.maximum(linear, _DARKEST) ** (1 / 2.4 - 1)).astype(np.float32)
    return slope


def _rounded(linear: FloatArray) -> FloatArray:
    """Linear light rounded to what 8-bit files hold, so that the stored source is the solved one."""
    return to_linear(np.rint(to_display(linear) * 255) / np.float32(255)).astype(np.float32)


def _product(matrix: csr_array, x: FloatArray) -> FloatArray:
    """The matrix times (columns, C), on all cores."""
    from magiclens.kernels.sparse import times

    out: FloatArray = times(matrix.indptr, matrix.indices, matrix.data, np.ascontiguousarray(x, np.float32))
    return out
