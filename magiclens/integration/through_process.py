"""Refinement through the process: the whole top is shaped so that the lens *as it is made* shows its targets.

A machine rounds the border between two facets: in a strip as wide as the machine's blur the slope of one facet turns
into that of the next, and the strip looks at whatever lies between their patches. No facet alone can help that. So the
whole top is one surface here, without steps, and every vertex is moved by what the surface shows that the process
leaves of it. Nothing is asked for that cannot be made, and strips learn to sweep over the right colours.

The residuals are differences of display values per pixel and channel. Their sum of squares is lowered by Gauss-Newton
steps whose linear systems are solved by conjugate gradients, without a matrix, in a Sobolev metric: smooth changes of
the surface are the cheap ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter

from magiclens.contract.artifacts import FloatArray, HeightField, Lens, Scene
from magiclens.geometry.solid import carried_on
from magiclens.integration.limits import limit_rises
from magiclens.integration.refinement import blurred, optics_for, pictures_of
from magiclens.integration.refinement_kernels import Pictures
from magiclens.integration.surface_metrics import surface_metrics
from magiclens.integration.through_process_kernels import (
    SLOPE_REACH,
    MadeRaster,
    change_of_residuals,
    finer,
    finer_transposed,
    forces_of_residuals,
    raster_slopes,
    raster_slopes_transposed,
    shown,
)
from magiclens.kernels.resuming import resumable
from magiclens.processes.linear import LinearProcess, filtered, raster_wavenumbers
from magiclens.processes.linear_kernels import spread_evenly

_BLURS_MM = (0.25, 0.1, 0.0)
"""Blurs of the sources, one after the other. A blurred edge has a gradient even far away from it."""
STEPS_BY_BLUR = (8, 8, 10)
"""Gauss-Newton steps per blur, at most."""
GRADIENT_STEPS = 16
"""Iterations of conjugate gradients per step."""
_SMOOTH_MM = 1.0
"""Length of the Sobolev metric: changes of the surface that are shorter cost more."""
ENOUGH = 2e-3
"""Two steps in turn that each lower the error by a smaller share end a blur."""
_LOOK_UPS = 3
"""Look-ups of the source along a cell's side. With 2, what lies between them is missed, which costs 0.4 dB."""
_MOST_NODES = 1800
"""Most nodes along a side of the raster of the made surface."""
_COARSEST = 1.2
"""Widest pitch of that raster, relative to the one that holds all of the made surface."""
_PIXEL_MM, _MOST_PIXELS = 0.15, 720
"""About the side of a pixel, which an eye at 0.4 m just resolves, and most pixels along the lens's side."""
_FIRST_DAMPING = (0.3, 1.0, 4.0)
"""Damping of slopes at first, per blur, relative to the mean square of the gradients."""
_WORSE, _BETTER = 3.0, 0.5
"""Factors of the damping where a step has made the picture worse, and where it has lowered the error by a tenth."""
_NEIGHBOURHOOD = 7
"""Pixels along the side of the squares in which it is judged whether a step has helped."""
_LEAST_PULL = 1e-6
"""Pull on the unknowns themselves, relative to the mean square of the gradients; it keeps the systems definite."""


def refine_through(
    scene: Scene, built: HeightField, process: LinearProcess, progress: Callable[[float], None]
) -> HeightField:
    """Shape the whole top by what it shows as the process makes it.

    Args:
        scene: the lens and its views, with vertical cells.
        built: where to begin.
        process: what the machine leaves of a surface.
        progress: is told the share of the work that is done.

    Returns:
        A height field without steps, within the lens's relief and slope limits.
    """
    top = WholeTop(scene, built, process)
    heights = top.heights_of(built)
    for stage, (blur_mm, steps, damping) in enumerate(zip(_BLURS_MM, STEPS_BY_BLUR, _FIRST_DAMPING, strict=True)):

        def tell(done: float, stage: int = stage) -> None:
            progress((stage + done) / len(_BLURS_MM))

        heights = top.descend(heights, blur_mm, steps, damping, tell)
    refined = replace(built, heights_mm=top.facets_of(heights))
    return replace(refined, metrics={**built.metrics, **surface_metrics(refined)})


def can_be_held(lens: Lens, process: LinearProcess) -> bool:
    """Whether the raster of a lens's made surface is fine enough for what the process leaves.

    A machine that hardly rounds anything leaves edges that no raster of a size that can be computed would see; its
    lenses are better refined facet by facet.
    """
    cells, pitch = lens.facets * lens.microfacets, lens.pitch_mm / lens.microfacets
    return pitch / _times(cells, pitch, process) <= _COARSEST * process.finest_mm


class WholeTop:
    """The whole top of a lens while it is refined: one grid of vertices, and the raster of what is made of it.

    Heights are (G, G) float32, mm above the reference plane, on the vertices of all facets, G = N m + 1: those on a
    border belong to both facets.

    Attributes:
        raster: Where the made surface is sampled.
        pictures: The sources, and the targets at the resolution of the compared pixels.
        gradients: (B, B, C, b + 1, b + 1, 2) of the residuals that were last shown, see ``shown``.
    """

    def __init__(self, scene: Scene, built: HeightField, process: LinearProcess):
        lens = scene.lens
        self._lens, self._optics = lens, optics_for(built)
        cells, pitch = lens.facets * lens.microfacets, lens.pitch_mm / lens.microfacets
        self._times = _times(cells, pitch, process)
        self._margin = _margin(cells, self._times, math.ceil(process.reach_mm / pitch) + SLOPE_REACH)
        fine = pitch / self._times
        side = (cells + 2 * self._margin) * self._times
        self._block = _block(lens, self._times)
        self.raster = MadeRaster(
            left=-side / 2 * fine,
            top=side / 2 * fine,
            pitch=fine,
            first=self._margin * self._times,
            block=self._block,
            blocks=cells * self._times // self._block,
            look_ups=_LOOK_UPS,
        )
        self.pictures = pictures_of(scene, lens.microfacets * self._times // self._block)
        self._side, self._process = side, process
        if process.levelling:
            self._kept = process.kept(raster_wavenumbers((side,) * 2, (fine, fine))).astype(np.float32)
        waves = raster_wavenumbers((cells + 1,) * 2, (pitch, pitch))
        self._smooth = (1 / (1 + (_SMOOTH_MM * waves) ** 2)).astype(np.float32)
        blocks, channels, nodes = self.raster.blocks, self.pictures.targets.shape[2], self._block + 1
        self.gradients = np.zeros((blocks, blocks, channels, nodes, nodes, 2), np.float32)

    def heights_of(self, built: HeightField) -> FloatArray:
        """The vertices of a height field, its relief in the middle; a step between two facets becomes a slope.

        The top of a lens that stands on its source is a dome, since its corners look inward. In the middle of the
        relief there is room for what goes on beyond the lens's square.
        """
        n, m = self._lens.facets, self._lens.microfacets
        total, count = np.zeros((n * m + 1,) * 2), np.zeros((n * m + 1,) * 2)
        for i in range(m + 1):
            for j in range(m + 1):
                rows, columns = slice(i, i + (n - 1) * m + 1, m), slice(j, j + (n - 1) * m + 1, m)
                total[rows, columns] += built.heights_mm[:, :, i, j]
                count[rows, columns] += 1
        heights = total / count
        return self._allowed(heights - (heights.min() + heights.max()) / 2)

    def facets_of(self, heights: FloatArray) -> FloatArray:
        """(N, N, m + 1, m + 1) float64: the heights by facets."""
        n, m = self._lens.facets, self._lens.microfacets
        at = np.arange(n)[:, None] * m + np.arange(m + 1)
        return np.asarray(heights[at[:, None, :, None], at[None, :, None, :]], np.float64)

    def descend(
        self, heights: FloatArray, blur_mm: float, steps: int, first_damping: float, progress: Callable[[float], None]
    ) -> FloatArray:
        """Take steps as long as they help.

        Damping is local: where a step has made the picture worse, the next ones are shorter.

        Args:
            heights: where to begin.
            blur_mm: sigma by which the sources are blurred.
            steps: number of steps, at most.
            first_damping: of slopes, relative to the mean square of the gradients.
            progress: is told the share that is done.

        Returns:
            Heights whose error, with blurred sources, is not higher.
        """
        pictures, raster, heights = blurred(self.pictures, blur_mm), self.raster, heights.copy()
        residuals = self.show(heights, pictures)
        error, scale = _mean_square(residuals), float(np.vdot(self.gradients, self.gradients))
        scale /= (raster.blocks * self._block) ** 2
        damping = np.full((raster.blocks,) * 2, first_damping * scale, np.float32)
        little = np.zeros((), np.int64)  # steps in turn that each gained little
        at_hand = 0  # the step for which there are residuals and gradients
        for step in resumable(range(steps), heights, damping, little):
            if little == 2:
                continue
            if step > at_hand:  # a run that was killed goes on here
                residuals = self.show(heights, pictures)
                error = _mean_square(residuals)
            change = self._step(residuals, damping, _LEAST_PULL * scale)
            trial = self._allowed(heights + change)
            after = self.show(trial, pictures)
            was, now = (uniform_filter((r**2).sum(axis=-1), _NEIGHBOURHOOD) for r in (residuals, after))
            damping *= np.where(now > was, _WORSE, np.where(now < 0.9 * was, _BETTER, 1.0)).astype(np.float32)
            trial_error = _mean_square(after)
            if trial_error < error:
                little[...] = little + 1 if trial_error > (1 - ENOUGH) * error else 0
                heights[...], residuals, error = trial, after, trial_error
            else:
                damping *= _WORSE
                self.show(heights, pictures)  # for its gradients
            at_hand = step + 1
            progress((step + 1) / steps)
        return heights

    def show(self, heights: FloatArray, pictures: Pictures) -> FloatArray:
        """(B, B, C) residuals of the made surface; its gradients are kept."""
        z = self.made(heights) + np.float32(self._lens.thickness_mm)
        residuals = np.zeros(self.gradients.shape[:3], np.float32)
        shown(z, self.raster, pictures, self._optics, residuals, self.gradients)
        return residuals

    def _step(self, residuals: FloatArray, damping: FloatArray, pull: float) -> FloatArray:
        """The Gauss-Newton step: it solves ``(J^T J + D + pull S^-1) x = -J^T r`` approximately.

        J is the change of residuals with heights, D damps slopes of the made surface, and S is the Sobolev metric,
        which also preconditions.

        Args:
            residuals: r, (B, B, C).
            damping: (B, B) of slopes.
            pull: of the heights.
        """
        full = np.zeros((2, self._side, self._side), np.float32)
        inner = slice(self.raster.first, self.raster.first + self.raster.blocks * self._block)
        full[:, inner, inner] = damping.repeat(self._block, axis=0).repeat(self._block, axis=1)
        # conjugate gradients on y with x = S^(1/2) y, written with x alone
        x = np.zeros((self._lens.facets * self._lens.microfacets + 1,) * 2, np.float32)
        left = -self._pulled_back(self._forces(residuals))
        eased = self._eased(left)
        direction, size = eased.copy(), _dot(left, eased)
        if size == 0.0:
            return x
        unpreconditioned = left.copy()  # S^-1 direction, which the pull needs
        for _ in range(GRADIENT_STEPS):
            slopes = raster_slopes(self.made(direction), self.raster.pitch)
            forces = self._forces(change_of_residuals(slopes, self.raster, self.gradients))
            slopes *= full  # in place: new arrays of this size take longer than what is computed
            forces += slopes
            image = self._pulled_back(forces) + np.float32(pull) * unpreconditioned
            length = np.float32(size / _dot(direction, image))
            x += length * direction
            left -= length * image
            eased = self._eased(left)
            before, size = size, _dot(left, eased)
            if size == 0.0:
                break
            turn = np.float32(size / before)
            direction, unpreconditioned = eased + turn * direction, left + turn * unpreconditioned
        return x

    def _forces(self, residuals: FloatArray) -> FloatArray:
        return forces_of_residuals(residuals, self.raster, self.gradients, (self._side,) * 2)

    def made(self, heights: FloatArray) -> FloatArray:
        """(R, R) the surface that the process leaves, mm above the reference plane."""
        return self._evened(finer(extended(heights, self._margin), self._times))

    def _pulled_back(self, forces: FloatArray) -> FloatArray:
        """(G, G) forces on heights, of forces (2, R, R) on slopes of the made surface."""
        raster = self._evened(raster_slopes_transposed(forces, self.raster.pitch))
        return extended_transposed(finer_transposed(raster, self._times), self._margin)

    def _evened(self, raster: FloatArray) -> FloatArray:
        """(R, R) what the process leaves of a raster. It is its own transpose."""
        if self._process.levelling:
            return filtered(raster, self._kept)
        return spread_evenly(raster, self._process.spread / self.raster.pitch)

    def _eased(self, forces: FloatArray) -> FloatArray:
        """(G, G) S times forces on heights."""
        return filtered(forces, self._smooth)

    def _allowed(self, heights: FloatArray) -> FloatArray:
        """The heights, within relief and slope limit; all are moved before any is cut."""
        lens = self._lens
        low, high = float(heights.min()), float(heights.max())
        heights = heights + max(-lens.relief_mm - low, 0.0) - max(high - lens.relief_mm, 0.0)
        # both rises of a triangle count, hence the root; a little is left for rounding
        rise = 0.999 * math.tan(math.radians(lens.max_slope_deg)) / math.sqrt(2) * lens.pitch_mm / lens.microfacets
        return limit_rises(np.clip(heights, -lens.relief_mm, lens.relief_mm).astype(np.float32), rise)


def _times(cells: int, pitch: float, process: LinearProcess) -> int:
    """How many times as fine as the vertices the raster of the made surface is: a number without large prime factors.

    Multiples of others have no fast cosine transform, whatever the margin.
    """
    from scipy.fft import next_fast_len

    wanted = math.ceil(pitch / process.finest_mm) if process.finest_mm > 0 else 1
    times = int(max(1, min(next_fast_len(wanted, real=True), _MOST_NODES // cells)))
    while next_fast_len(times, real=True) > times:
        times -= 1
    return times


def _margin(cells: int, times: int, least: int) -> int:
    """Cells of the raster's margin, at least so many, for which the cosine transform is fast."""
    from scipy.fft import next_fast_len

    margin = least
    while next_fast_len((cells + 2 * margin) * times, real=True) > (cells + 2 * margin) * times:
        margin += 1
    return margin


def _block(lens: Lens, times: int) -> int:
    """Cells along the side of a pixel: a divisor of those of a facet, so that no pixel straddles two."""
    of_facet = lens.microfacets * times
    wanted = of_facet * max(_PIXEL_MM / lens.pitch_mm, lens.facets / _MOST_PIXELS)
    return min((b for b in range(1, of_facet + 1) if of_facet % b == 0), key=lambda b: abs(math.log(b / wanted)))


def extended(heights: FloatArray, margin: int) -> FloatArray:
    """Heights (G, G) that go on beyond the lens's square by so many cells, as the solid does; (G + 2 margin, ...)."""
    return np.ascontiguousarray(carried_on(heights, np.arange(margin, 0, -1, dtype=np.float32)))


def extended_transposed(forces: FloatArray, margin: int) -> FloatArray:
    """The transpose of ``extended``."""
    beyond = np.arange(margin, 0, -1, dtype=np.float32)[:, None]
    for _ in range(2):
        before, inner, after = forces[:margin], forces[margin:-margin].copy(), forces[-margin:]
        inner[0] += (before * (1 + beyond)).sum(axis=0)
        inner[1] -= (before * beyond).sum(axis=0)
        inner[-1] += (after * (1 + beyond[::-1])).sum(axis=0)
        inner[-2] -= (after * beyond[::-1]).sum(axis=0)
        forces = inner.T
    return np.ascontiguousarray(forces)


def _mean_square(residuals: FloatArray) -> float:
    return float(np.mean(np.square(residuals, dtype=np.float64)))


def _dot(a: FloatArray, b: FloatArray) -> float:
    return float(np.sum(a * b, dtype=np.float64))
