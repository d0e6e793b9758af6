"""Gauss-Newton steps on the shapes of facets, compiled: all of their vertices are free.

A facet's unknowns are its k x k = (m + 1) x (m + 1) heights. Its picture is cut into P x P pixels, each of which
averages the source over the pieces of triangles that it sees: one look-up each. A flat triangle sends its pieces to a
landing point and around it, and its two slopes move the landing point. The residuals are differences of display values
per pixel and channel.

The letters in shapes: F facets, k x k vertices and T = 2 m^2 triangles of a facet, P x P pixels of a facet, K pieces of
a facet, E eyes, C channels of all eyes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.threads import in_threads
from magiclens.optics.eyes import land, project, surface_point
from magiclens.optics.medium import Optics

SLOPE_STEP = 1e-4
"""Change of a triangle's slope over which derivatives are taken by finite differences."""
_SPAN_STEP_MM = 0.02
"""Way over a triangle, mm, over which derivatives are taken by finite differences."""
LIGHT_STEP = 20
"""Entries of the display table on each side over which its slope is taken: near black it is steep."""
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 0.5, 1e-4, 1e2
"""Damping of the Gauss-Newton steps, relative to the mean square of the gradients: the first, the least, the most."""
_WORSE = 10.0
"""Factor of the damping after a step that is not taken."""
_FLATNESS = 1e-3
"""Pull on heights, beside that on slopes, per mm^2: it keeps a facet's mean where it is."""


class Samples(NamedTuple):
    """Where on a facet its picture is sampled; the same for all facets.

    The sides of pixels and of triangles cut a facet into K pieces, each of one pixel and one triangle; they are sorted
    by pixel. Triangle 2 (i m + j) is the lower left half of cell (i, j), the next one the upper right.

    Args:
        cell_mm: side of a micro-facet, mm.
        pixels: P.
        pixel: (K,) of each piece.
        triangle: (K,) of each piece.
        right_mm: (K,) distance of a piece's centroid from its triangle's along +x, mm.
        up_mm: (K,) the same along +y, mm.
        share: (K,) float32 of its pixel's area.
    """

    cell_mm: float
    pixels: int
    pixel: IntArray
    triangle: IntArray
    right_mm: FloatArray
    up_mm: FloatArray
    share: FloatArray


class Pictures(NamedTuple):
    """The sources that the eyes look at and the targets that they should see, lens frame.

    Args:
        eyes_mm: (E, 3) mm.
        first: (E + 1,) eye e has the channels first[e] to first[e + 1] - 1.
        plane: (C,) which plane of ``sources`` a channel looks at.
        sources: (H, W, planes) float32 linear light.
        source_mm: side of the square that the sources cover, mm.
        targets: (R, R, C) float32 display values.
        size_mm: side of the lens's square, which the targets cover, mm.
        display: (entries,) float32 display values of evenly spaced linear light from 0 to 1.
    """

    eyes_mm: FloatArray
    first: IntArray
    plane: IntArray
    sources: FloatArray
    source_mm: float
    targets: FloatArray
    size_mm: float
    display: FloatArray


class Metric(NamedTuple):
    """How changes of a facet's heights are measured, and which of them are allowed.

    Args:
        cosines: (k, k) the orthonormal cosine transform of a line of vertices.
        laplacian: (k, k) the eigenvalues of the vertices' Laplacian, per mm^2.
        free: (k, k) 0 for vertices that keep their height, 1 for others.
    """

    cosines: FloatArray
    laplacian: FloatArray
    free: FloatArray


class Descent(NamedTuple):
    """When the steps end.

    Args:
        rounds: steps of a facet, at most.
        iterations: iterations of conjugate gradients per step.
        enough: a step that lowers the error by a smaller share is a facet's last.
    """

    rounds: int
    iterations: int
    enough: float


class Shown(NamedTuple):
    """What a facet shows, and how that changes with its slopes.

    Args:
        slopes: (T, 2) slopes of the triangles along +x and +y.
        residuals: (P P, C) float32 what is shown less the target, display values.
        gradients: (K, 2, C) float32 derivatives of a piece's share of its pixel along the slopes of its triangle.
    """

    slopes: FloatArray
    residuals: FloatArray
    gradients: FloatArray


class Rays(NamedTuple):
    """Where the rays through a facet's triangles land.

    Args:
        landing: (..., T, 2) landing point of the ray through a triangle's centroid, mm.
        by_slope: (..., T, 2, 2) its derivatives: [slope, x or y of the landing point], mm.
        by_position: (..., T, 2, 2) derivatives along +x and +y over the triangle: [direction, x or y], mm per mm.
    """

    landing: FloatArray
    by_slope: FloatArray
    by_position: FloatArray


@njit(cache=True)
def land_by_slopes(u, v, height, along_u, along_v, eye, optics):
    """Where an eye's ray through the surface over (u, v) meets the source, see ``optics.eyes.land``.

    With ``along_u`` = dh/du and ``along_v`` = dh/dv the unit normal is ``q (-along_u, -along_v, nz)``. That is the
    inverse of ``optics.eyes.height_gradient``; nz = 1 for vertical cells.

    Args:
        u: of the point, on the reference plane, mm.
        v: the same along +y, mm.
        height: of the surface there, mm.
        along_u: slope of the heights along u.
        along_v: slope of the heights along v.
        eye: (3,) the eye that looks, mm.
        optics: an ``optics.medium.Optics``.

    Returns:
        x, y of the landing point, mm; whether the ray arrives and the surface is not steeper than allowed.
    """
    nz = 1.0
    if not optics.vertical:
        cut_eye = optics.eye
        nz = 1.0 - (along_u * (u - cut_eye[0]) + along_v * (v - cut_eye[1])) / (cut_eye[2] - optics.depth)
    q = 1.0 / math.sqrt(along_u * along_u + along_v * along_v + nz * nz)
    point = surface_point(optics, u, v, height, optics.depth)
    sx, sy, there = land(eye, point, (-along_u * q, -along_v * q, nz * q), optics)
    return sx, sy, there and nz * q >= optics.cos_limit


@njit(cache=True)
def triangle_slopes(heights, cell, out):
    """Fill out (T, 2) with the slopes of a facet's triangles along +x and +y, which are linear in its heights."""
    m = len(heights) - 1
    for i in range(m):
        for j in range(m):
            tl, tr, bl, br = heights[i, j], heights[i, j + 1], heights[i + 1, j], heights[i + 1, j + 1]
            t = 2 * (i * m + j)
            out[t, 0], out[t, 1] = (br - bl) / cell, (tl - bl) / cell
            out[t + 1, 0], out[t + 1, 1] = (tr - tl) / cell, (tr - br) / cell


@njit(cache=True)
def triangle_slopes_transposed(forces, cell, out):
    """Fill out (k, k) with the transpose of ``triangle_slopes``, applied to forces (T, 2)."""
    m = len(out) - 1
    out[:] = 0.0
    for i in range(m):
        for j in range(m):
            t = 2 * (i * m + j)
            a, b = forces[t, 0] / cell, forces[t, 1] / cell
            out[i + 1, j + 1] += a
            out[i + 1, j] -= a + b
            out[i, j] += b
            a, b = forces[t + 1, 0] / cell, forces[t + 1, 1] / cell
            out[i, j + 1] += a + b
            out[i, j] -= a
            out[i + 1, j + 1] -= b


@njit(cache=True)
def _aim(heights, slopes, centre, eye, samples, optics, derive, rays):
    """Fill rays with every triangle's landing point and its derivatives, by finite differences, equal in cells' halves.

    Args:
        heights: (k, k) of the facet, mm.
        slopes: (T, 2) of its triangles.
        centre: (2,) of the facet, mm.
        eye: (3,) mm.
        samples: of a facet.
        optics: an ``optics.medium.Optics``.
        derive: whether the derivatives are filled in; they change little from step to step.
        rays: to fill.

    Returns:
        False if a ray does not arrive, or a triangle is steeper than allowed.
    """
    m, cell = len(heights) - 1, samples.cell_mm
    for i in range(m):
        for j in range(m):
            for upper in range(2):
                t = 2 * (i * m + j) + upper
                # the centroid, a third of a cell from the right angle
                right, down = (j + (1 + upper) / 3) * cell, (i + (2 - upper) / 3) * cell
                u, v = centre[0] - 0.5 * m * cell + right, centre[1] + 0.5 * m * cell - down
                third = heights[i + 1 - upper, j + upper]
                h, a, b = (heights[i, j] + heights[i + 1, j + 1] + third) / 3, slopes[t, 0], slopes[t, 1]
                # the ray itself, then those beside it: along both slopes and along both ways over the triangle
                for k in range(5 if derive and not upper else 1):
                    da, db = (SLOPE_STEP if k == 1 else 0.0), (SLOPE_STEP if k == 2 else 0.0)
                    du, dv = (_SPAN_STEP_MM if k == 3 else 0.0), (_SPAN_STEP_MM if k == 4 else 0.0)
                    x, y, there = land_by_slopes(u + du, v + dv, h + a * du + b * dv, a + da, b + db, eye, optics)
                    if k == 0:
                        if not there:
                            return False
                        rays.landing[t, 0], rays.landing[t, 1] = x, y
                        continue
                    out, step = (
                        (rays.by_slope[t, k - 1], SLOPE_STEP) if k < 3 else (rays.by_position[t, k - 3], _SPAN_STEP_MM)
                    )
                    # where the neighbouring ray does not arrive, nothing is known: no change is expected
                    out[0] = (x - rays.landing[t, 0]) / step if there else 0.0
                    out[1] = (y - rays.landing[t, 1]) / step if there else 0.0
                if derive and upper:  # the derivatives of the cell's other half are near enough
                    for k in range(2):
                        for axis in range(2):
                            rays.by_slope[t, k, axis] = rays.by_slope[t - 1, k, axis]
                            rays.by_position[t, k, axis] = rays.by_position[t - 1, k, axis]
    return True


# these flags relax rounding alone; none lets the compiler assume that there is no infinity or NaN
@njit(cache=True, fastmath={"contract", "reassoc", "arcp"})
def _gather(samples, rays, pictures, e, light, gradients):
    """Add up the source's light over the pieces of one eye's picture, and fill in its derivatives along slopes.

    A piece whose centroid is at p from its triangle's takes the source at ``landing + by_position p``, between pixels;
    its derivative along a slope is ``gradient of the source . by_slope``.

    Args:
        samples: of a facet.
        rays: of the eye through the facet's triangles.
        pictures: sources and targets.
        e: the eye.
        light: (P P, C) to add to.
        gradients: (K, 2, C) to fill.
    """
    landing, by_slope, by_position = rays
    rows = len(pictures.sources)
    per_mm, middle = rows / pictures.source_mm, 0.5 * rows - 0.5
    for k in range(len(samples.pixel)):
        t, p, share = samples.triangle[k], samples.pixel[k], samples.share[k]
        x = landing[t, 0] + by_position[t, 0, 0] * samples.right_mm[k] + by_position[t, 1, 0] * samples.up_mm[k]
        y = landing[t, 1] + by_position[t, 0, 1] * samples.right_mm[k] + by_position[t, 1, 1] * samples.up_mm[k]
        column, row = x * per_mm + middle, middle - y * per_mm
        if not (0.0 <= column < rows - 1.001 and 0.0 <= row < rows - 1.001):
            for c in range(pictures.first[e], pictures.first[e + 1]):
                gradients[k, 0, c] = gradients[k, 1, c] = 0.0  # beside the source it is dark
            continue
        # not ``sampling.bilinear``, which would find these pixels and weights again for every channel
        i, j = int(row), int(column)
        # float32 as the sources: float64 weights would turn all sums below into float64
        fy, fx, scale = np.float32(row - i), np.float32(column - j), np.float32(share * per_mm)
        ax, ay = np.float32(by_slope[t, 0, 0]), np.float32(by_slope[t, 0, 1])
        bx, by = np.float32(by_slope[t, 1, 0]), np.float32(by_slope[t, 1, 1])
        for c in range(pictures.first[e], pictures.first[e + 1]):
            w = pictures.plane[c]
            tl, tr = pictures.sources[i, j, w], pictures.sources[i, j + 1, w]
            bl, br = pictures.sources[i + 1, j, w], pictures.sources[i + 1, j + 1, w]
            top, low = tl + (tr - tl) * fx, bl + (br - bl) * fx
            light[p, c] += share * (top + (low - top) * fy)
            to_x, to_y = scale * ((tr - tl) + ((br - bl) - (tr - tl)) * fy), scale * (top - low)
            gradients[k, 0, c] = to_x * ax + to_y * ay
            gradients[k, 1, c] = to_x * bx + to_y * by


@njit(cache=True)
def target_at(pictures, e, px, py, out):
    """Fill out (C,) with the targets of eye e at (px, py), mm, between pixels; False beyond the lens's square."""
    targets = pictures.targets
    rows = len(targets)
    # the centres of the first and the last pixel are at 0 and rows - 1, the square ends half a pixel beyond
    column, row = (px / pictures.size_mm + 0.5) * rows - 0.5, (0.5 - py / pictures.size_mm) * rows - 0.5
    if not (-0.5 <= column <= rows - 0.5 and -0.5 <= row <= rows - 0.5):
        return False
    column, row = min(max(column, 0.0), rows - 1.0), min(max(row, 0.0), rows - 1.0)
    i, j = min(int(row), rows - 2), min(int(column), rows - 2)
    a, b = np.float32(row - i), np.float32(column - j)
    for c in range(pictures.first[e], pictures.first[e + 1]):
        top = targets[i, j, c] + (targets[i, j + 1, c] - targets[i, j, c]) * b
        low = targets[i + 1, j, c] + (targets[i + 1, j + 1, c] - targets[i + 1, j, c]) * b
        out[c] = top + (low - top) * a
    return True


@njit(cache=True)
def predict_facet(heights, centre, samples, pictures, optics, derive, rays, shown):
    """Fill in what a facet shows: ``residual = display(mean light of a pixel's pieces) - target``.

    The gradients are those of the residuals, by the chain rule; the display curve's slope is taken over some entries
    of its table.

    Args:
        heights: (k, k) of the facet, mm.
        centre: (2,) of the facet, mm.
        samples: of a facet.
        pictures: sources and targets.
        optics: an ``optics.medium.Optics``.
        derive: whether the rays' derivatives are taken anew.
        rays: with a leading axis for the eyes, to fill; they keep their derivatives from one prediction to the next.
        shown: to fill.

    Returns:
        The mean squared residual; infinite if a ray does not arrive or a triangle is steeper than allowed.
    """
    slopes, residuals, gradients = shown
    light = np.zeros_like(residuals)
    side, last = samples.pixels, len(pictures.display) - 1
    m, cell = len(heights) - 1, samples.cell_mm
    triangle_slopes(heights, cell, slopes)
    total, count = 0.0, 0
    for e in range(len(pictures.eyes_mm)):
        eye = pictures.eyes_mm[e]
        through = Rays(rays.landing[e], rays.by_slope[e], rays.by_position[e])
        if not _aim(heights, slopes, centre, eye, samples, optics, derive, through):
            return np.inf
        _gather(samples, through, pictures, e, light, gradients)
        for p in range(side * side):
            right, down = (p % side + 0.5) * m / side, (p // side + 0.5) * m / side
            h = heights[int(down), int(right)]  # of a vertex nearby: where a pixel is seen depends little on heights
            u, v = centre[0] + (right - 0.5 * m) * cell, centre[1] + (0.5 * m - down) * cell
            px, py = project(eye, surface_point(optics, u, v, h, optics.depth), optics.depth)
            seen = target_at(pictures, e, px, py, residuals[p])
            for c in range(pictures.first[e], pictures.first[e + 1]):
                # residuals hold the targets until here, and light holds the display curve's slope from here on
                at = min(int(light[p, c] * last + 0.5), last)
                residuals[p, c] = pictures.display[at] - residuals[p, c] if seen else 0.0
                lo, hi = max(at - LIGHT_STEP, 0), min(at + LIGHT_STEP, last)
                slope = (pictures.display[hi] - pictures.display[lo]) * last / (hi - lo)
                light[p, c] = slope if seen else 0.0
                total += residuals[p, c] ** 2
                count += seen
    for k in range(len(gradients)):
        for c in range(gradients.shape[2]):
            scale = light[samples.pixel[k], c]
            gradients[k, 0, c] *= scale
            gradients[k, 1, c] *= scale
    return total / max(count, 1)


@njit(cache=True)
def to_spectrum(field, cosines, work, out):
    """Fill out (k, k) with the cosine transform of a field (k, k); work (k, k) is overwritten."""
    np.dot(cosines, field, work)
    np.dot(work, cosines.T, out)


@njit(cache=True)
def to_field(spectrum, cosines, work, out):
    """Fill out (k, k) with the inverse, and transpose, of ``to_spectrum``; work (k, k) is overwritten."""
    np.dot(cosines.T, spectrum, work)
    np.dot(work, cosines, out)


@njit(cache=True, fastmath={"contract", "reassoc", "arcp"})
def residual_change(samples, shown, slopes, out):
    """Fill out (P P, C) with the derivative of the residuals along a change of the slopes (T, 2)."""
    out[:] = 0.0
    for k in range(len(shown.gradients)):
        p, t = samples.pixel[k], samples.triangle[k]
        a, b = np.float32(slopes[t, 0]), np.float32(slopes[t, 1])
        for c in range(out.shape[1]):
            out[p, c] += shown.gradients[k, 0, c] * a + shown.gradients[k, 1, c] * b


@njit(cache=True, fastmath={"contract", "reassoc", "arcp"})
def residual_change_transposed(samples, shown, residuals, out):
    """Fill out (T, 2) with the transpose of ``residual_change``, applied to residuals (P P, C)."""
    out[:] = 0.0
    for k in range(len(shown.gradients)):
        p, t = samples.pixel[k], samples.triangle[k]
        a, b = np.float32(0.0), np.float32(0.0)
        for c in range(residuals.shape[1]):
            a += shown.gradients[k, 0, c] * residuals[p, c]
            b += shown.gradients[k, 1, c] * residuals[p, c]
        out[t, 0] += a
        out[t, 1] += b


@njit(cache=True)
def _step(shown, samples, metric, damping, iterations, out):
    """Fill in the damped Gauss-Newton step d, which solves ``(J'J + damping (L + flatness)) d = -J'r``.

    J are the derivatives of the residuals r along the heights, L is the Laplacian of the vertices, scaled like J'J. The
    solver is conjugate gradients on the cosine spectrum of d, preconditioned by ``1 / (damping (L + flatness) + 0.3
    L)``, which is diagonal there: 0.3 L takes the place of J'J. J is never stored, only multiplied with.

    Args:
        shown: what the facet shows.
        samples: of a facet.
        metric: of its vertices.
        damping: relative to the mean square of the gradients.
        iterations: of conjugate gradients.
        out: (k, k) to fill, mm.

    Returns:
        By how much the sum of squared residuals falls if they change with the heights as J says.
    """
    free = metric.free
    k, cell = len(out), samples.cell_mm
    even = 0.0
    for n in range(len(shown.gradients)):
        for c in range(shown.gradients.shape[2]):
            even += shown.gradients[n, 0, c] ** 2 + shown.gradients[n, 1, c] ** 2
    even = even / len(shown.slopes) + 1e-12  # a facet that sees plain areas only has no gradients
    laplacian = even * metric.laplacian
    stiff = damping * (laplacian + even * _FLATNESS)
    inverse = 1.0 / (stiff + 0.3 * laplacian)
    residual, direction, image, total = np.zeros((k, k)), np.zeros((k, k)), np.zeros((k, k)), np.zeros((k, k))
    field, work = np.zeros((k, k)), np.zeros((k, k))
    forces, changes, seen = np.zeros_like(shown.slopes), np.zeros_like(shown.slopes), np.zeros_like(shown.residuals)
    residual_change_transposed(samples, shown, shown.residuals, forces)
    triangle_slopes_transposed(forces, cell, field)
    field *= -free
    to_spectrum(field, metric.cosines, work, residual)
    old, expected = 1.0, 0.0
    for n in range(iterations):
        new = (residual * inverse * residual).sum()
        if new <= 1e-18:
            break
        direction *= new / old if n else 0.0
        direction += inverse * residual
        to_field(direction, metric.cosines, work, field)
        field *= free
        triangle_slopes(field, cell, changes)
        residual_change(samples, shown, changes, seen)
        residual_change_transposed(samples, shown, seen, forces)
        triangle_slopes_transposed(forces, cell, field)
        field *= free
        to_spectrum(field, metric.cosines, work, image)
        image += stiff * direction
        length = new / (direction * image).sum()
        total += length * direction
        expected += length * new
        residual -= length * image
        old = new
    to_field(total, metric.cosines, work, out)
    out *= free
    return expected + (stiff * total * total).sum()


@njit(cache=True, nogil=True)
def _refine_part(part, shapes, samples, pictures, optics, metric, descent, errors):
    """Part of the facets, see ``refine_facets``; shapes: heights and centres."""
    heights, centres = shapes
    k, pieces, channels = heights.shape[1], len(samples.pixel), len(pictures.plane)
    triangles, pixels = 2 * (k - 1) ** 2, samples.pixels**2
    eyes = len(pictures.eyes_mm)
    rays = Rays(np.zeros((eyes, triangles, 2)), np.zeros((eyes, triangles, 2, 2)), np.zeros((eyes, triangles, 2, 2)))
    slopes, residuals = np.zeros((2, triangles, 2)), np.zeros((2, pixels, channels), np.float32)
    gradients = np.zeros((2, pieces, 2, channels), np.float32)
    # one of the facet as it is and one of the trial: a step that is taken exchanges them
    predictions = (Shown(slopes[0], residuals[0], gradients[0]), Shown(slopes[1], residuals[1], gradients[1]))
    step = np.zeros((k, k))
    derive = np.bool_(True)  # not the literal, for which numba would compile the prediction apart
    for f in range(part.first, part.end):
        trial, now = heights[f].copy(), 0
        error = predict_facet(trial, centres[f], samples, pictures, optics, derive, rays, predictions[0])
        damping = _FIRST_DAMPING
        for _ in range(descent.rounds):
            if not 0.0 < error < np.inf:
                break
            expected = _step(predictions[now], samples, metric, damping, descent.iterations, step)
            for n in range(k * k):  # element by element, see ``polishing_kernels.read_candidate``
                trial[n // k, n % k] = heights[f, n // k, n % k] + step[n // k, n % k]
            less = predict_facet(trial, centres[f], samples, pictures, optics, not derive, rays, predictions[1 - now])
            if less < error:
                for n in range(k * k):
                    heights[f, n // k, n % k] = trial[n // k, n % k]
                ratio = (error - less) * predictions[now].residuals.size / expected
                # Nielsen's rule: the better the step was foreseen, the less the next one is damped
                damping = max(damping * max(1 / 3, 1 - (2 * ratio - 1) ** 3), _LEAST_DAMPING)
                gain, error, now = error - less, less, 1 - now
                # the step taken is kept all the same
                if gain < descent.enough * error:
                    break
            else:
                damping *= _WORSE
                if damping > _MOST_DAMPING:
                    break
        errors[f] = error


def refine_facets(
    heights: FloatArray,
    centres: FloatArray,
    samples: Samples,
    pictures: Pictures,
    optics: Optics,
    metric: Metric,
    descent: Descent,
    errors: FloatArray,
) -> None:
    """Lower the facets' mean squared residuals, in place, by damped Gauss-Newton steps (Levenberg-Marquardt).

    A step that lowers a facet's error is taken, and the damping falls to as little as a third; else it grows tenfold.

    Args:
        heights: (F, k, k) mm, changed in place.
        centres: (F, 2) mm.
        samples: of a facet.
        pictures: sources and targets.
        optics: an ``optics.medium.Optics``.
        metric: of a facet's vertices.
        descent: when steps end.
        errors: (F,) to fill with the mean squared residuals after the last step.
    """
    in_threads(_refine_part, len(heights), (heights, centres), samples, pictures, optics, metric, descent, errors)
