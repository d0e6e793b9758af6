"""The kernels of ``refine``: Gauss-Newton steps on what every facet shows, all of its vertices free.

A facet's unknowns are its (m + 1) x (m + 1) heights. Its picture is cut into P x P pixels, each of which averages S x S
look-ups of the source. A flat triangle sends its look-ups to a landing point and around it, and its two slopes move the
landing point. The residuals are differences of display values per pixel and channel.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.optics.eyes import land, project, surface_point

SLOPE_STEP, SPAN_STEP_MM = 1e-4, 0.02
"""Of the finite differences."""
LIGHT_STEP = 20
"""Entries of the display table on each side over which its slope is taken: near black it is steep."""
DAMPING, LEAST_DAMPING, MOST_DAMPING = 0.1, 1e-4, 1e2
"""Of the Gauss-Newton steps, relative to the mean square of the gradients: the first, the least and the most."""
FLATNESS = 1e-3
"""Pull on heights, beside that on slopes, per mm^2: what keeps a facet's mean where it is."""


class Samples(NamedTuple):
    """Where a facet is looked at; the same for all facets.

    cell_mm: side of a micro-facet. pixels: P. per_side: P S. triangle, pair: (P S * P S,), the triangle of each look-up
    and its pair of pixel and triangle; right_mm, up_mm: the look-up's place from the triangle's centroid. pair_pixel,
    pair_triangle: (K,). Triangle 2 (i m + j) is the lower left half of cell (i, j), the next one the upper right.
    """

    cell_mm: float
    pixels: int
    per_side: int
    triangle: IntArray
    right_mm: FloatArray
    up_mm: FloatArray
    pair: IntArray
    pair_pixel: IntArray
    pair_triangle: IntArray


class Sights(NamedTuple):
    """What the eyes see and should see; lens frame, mm.

    eyes_mm: (E, 3). first: (E + 1,), eye e has the channels first[e] to first[e + 1] - 1. plane: (C,), the channel's
    source among sources (H, W, planes), linear light, which covers a square of the side source_mm. targets: (R, R, C),
    display values, over the lens's square of the side size_mm. display: display values of evenly spaced linear light.
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
    """The cosine transform (k, k) of a facet's vertices, and the eigenvalues (k, k) of their Laplacian, per mm^2."""

    cosines: FloatArray
    laplacian: FloatArray


class View(NamedTuple):
    """A facet as it is seen: slopes (T, 2) of its triangles; residuals (P P, C); their derivatives along the slopes of
    the triangle, gradients (K, 2, C), per pair of pixel and triangle."""

    slopes: FloatArray
    residuals: FloatArray
    gradients: FloatArray


@njit(cache=True)
def _land(u, v, height, along_u, along_v, eye, optics):
    """Where the eye's ray through the surface over (u, v), with these slopes, meets the source; and whether it does."""
    nz = 1.0
    if not optics.vertical:
        cut_eye = optics.eye
        nz = 1.0 - (along_u * (u - cut_eye[0]) + along_v * (v - cut_eye[1])) / (cut_eye[2] - optics.depth)
    q = 1.0 / math.sqrt(along_u * along_u + along_v * along_v + nz * nz)
    point = surface_point(optics, u, v, height, optics.depth)
    sx, sy, there = land(eye, point, (-along_u * q, -along_v * q, nz * q), optics)
    return sx, sy, there and nz * q >= optics.cos_limit


@njit(cache=True)
def _slopes(heights, cell, out):
    """out (T, 2): the slopes of a facet's triangles along +x and +y; linear in its heights."""
    m = len(heights) - 1
    for i in range(m):
        for j in range(m):
            tl, tr, bl, br = heights[i, j], heights[i, j + 1], heights[i + 1, j], heights[i + 1, j + 1]
            t = 2 * (i * m + j)
            out[t, 0], out[t, 1] = (br - bl) / cell, (tl - bl) / cell
            out[t + 1, 0], out[t + 1, 1] = (tr - tl) / cell, (tr - br) / cell


@njit(cache=True)
def _pull(forces, cell, out):
    """out (k, k): the transpose of ``_slopes``."""
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
    """rays (T, 10): every triangle's landing point and, if ``derive``, its derivatives along both slopes and both ways
    over the triangle, which hardly change. False if a ray does not arrive, or a triangle is steeper than allowed.
    """
    m, cell = len(heights) - 1, samples.cell_mm
    for t in range(2 * m * m):
        i, j = t // 2 // m, t // 2 % m
        right, down = ((j + 2 / 3) * cell, (i + 1 / 3) * cell) if t & 1 else ((j + 1 / 3) * cell, (i + 2 / 3) * cell)
        u, v = centre[0] - 0.5 * m * cell + right, centre[1] + 0.5 * m * cell - down
        third = heights[i, j + 1] if t & 1 else heights[i + 1, j]
        h, a, b = (heights[i, j] + heights[i + 1, j + 1] + third) / 3, slopes[t, 0], slopes[t, 1]
        x, y, there = _land(u, v, h, a, b, eye, optics)
        if not there:
            return False
        rays[t, 0], rays[t, 1] = x, y
        for k in range(4 if derive else 0):
            du, dv = (SPAN_STEP_MM if k == 2 else 0.0), (SPAN_STEP_MM if k == 3 else 0.0)
            da, db = (SLOPE_STEP if k == 0 else 0.0), (SLOPE_STEP if k == 1 else 0.0)
            ax, ay, good = _land(u + du, v + dv, h + a * du + b * dv, a + da, b + db, eye, optics)
            step = SLOPE_STEP if k < 2 else SPAN_STEP_MM
            rays[t, 2 + 2 * k] = (ax - x) / step if good else 0.0
            rays[t, 3 + 2 * k] = (ay - y) / step if good else 0.0
    return True


@njit(cache=True, fastmath={"contract", "reassoc", "arcp"})
def _gather(samples, rays, sights, e, light, gradients):
    """Add up the source's light per pixel and channel of eye e, and its derivatives per pair; both are sums."""
    rows = len(sights.sources)
    per_mm, middle = rows / sights.source_mm, 0.5 * rows - 0.5
    for s in range(samples.per_side * samples.per_side):
        ray, k = rays[samples.triangle[s]], samples.pair[s]
        x = ray[0] + ray[6] * samples.right_mm[s] + ray[8] * samples.up_mm[s]
        y = ray[1] + ray[7] * samples.right_mm[s] + ray[9] * samples.up_mm[s]
        column, row = x * per_mm + middle, middle - y * per_mm
        if not (0.0 <= column < rows - 1.001 and 0.0 <= row < rows - 1.001):
            continue  # beside the source it is dark
        i, j = int(row), int(column)
        fy, fx = np.float32(row - i), np.float32(column - j)
        p = samples.pair_pixel[k]
        for c in range(sights.first[e], sights.first[e + 1]):
            w = sights.plane[c]
            tl, tr = sights.sources[i, j, w], sights.sources[i, j + 1, w]
            bl, br = sights.sources[i + 1, j, w], sights.sources[i + 1, j + 1, w]
            top, low = tl + (tr - tl) * fx, bl + (br - bl) * fx
            light[p, c] += top + (low - top) * fy
            to_x, to_y = ((tr - tl) + ((br - bl) - (tr - tl)) * fy) * per_mm, (top - low) * per_mm
            gradients[k, 0, c] += to_x * ray[2] + to_y * ray[3]
            gradients[k, 1, c] += to_x * ray[4] + to_y * ray[5]


@njit(cache=True)
def _wish(sights, e, px, py, out):
    """out (C,) = the targets of eye e at a place, between pixels; False beyond the lens's square."""
    targets = sights.targets
    rows = len(targets)
    column, row = (px / sights.size_mm + 0.5) * rows - 0.5, (0.5 - py / sights.size_mm) * rows - 0.5
    if not (-0.5 <= column <= rows - 0.5 and -0.5 <= row <= rows - 0.5):
        return False
    column, row = min(max(column, 0.0), rows - 1.0), min(max(row, 0.0), rows - 1.0)
    i, j = min(int(row), rows - 2), min(int(column), rows - 2)
    a, b = np.float32(row - i), np.float32(column - j)
    for c in range(sights.first[e], sights.first[e + 1]):
        top = targets[i, j, c] + (targets[i, j + 1, c] - targets[i, j, c]) * b
        low = targets[i + 1, j, c] + (targets[i + 1, j + 1, c] - targets[i + 1, j, c]) * b
        out[c] = top + (low - top) * a
    return True


@njit(cache=True)
def _look(heights, centre, samples, sights, optics, derive, rays, light, view):
    """Fill ``view``; returns the mean squared residual, infinite if the facet cannot be built so. See ``_aim``."""
    slopes, residuals, gradients = view
    side, last = samples.pixels, len(sights.display) - 1
    m, cell = len(heights) - 1, samples.cell_mm
    each = 1.0 / (samples.per_side // side) ** 2
    _slopes(heights, cell, slopes)
    light[:], gradients[:] = 0.0, 0.0
    total, count = 0.0, 0
    for e in range(len(sights.eyes_mm)):
        eye = sights.eyes_mm[e]
        if not _aim(heights, slopes, centre, eye, samples, optics, derive, rays[e]):
            return np.inf
        _gather(samples, rays[e], sights, e, light, gradients)
        for p in range(side * side):
            right, down = (p % side + 0.5) * m / side, (p // side + 0.5) * m / side
            h = heights[int(down), int(right)]
            u, v = centre[0] + (right - 0.5 * m) * cell, centre[1] + (0.5 * m - down) * cell
            px, py = project(eye, surface_point(optics, u, v, h, optics.depth), optics.depth)
            seen = _wish(sights, e, px, py, residuals[p])
            for c in range(sights.first[e], sights.first[e + 1]):
                at = min(int(light[p, c] * each * last + 0.5), last)
                residuals[p, c] = sights.display[at] - residuals[p, c] if seen else 0.0
                lo, hi = max(at - LIGHT_STEP, 0), min(at + LIGHT_STEP, last)
                slope = (sights.display[hi] - sights.display[lo]) * last / (hi - lo)
                light[p, c] = slope * each if seen else 0.0
                total += residuals[p, c] ** 2
                count += seen
    for k in range(len(gradients)):
        for c in range(gradients.shape[2]):
            scale = light[samples.pair_pixel[k], c]
            gradients[k, 0, c] *= scale
            gradients[k, 1, c] *= scale
    return total / max(count, 1)


@njit(cache=True)
def _spectrum(field, cosines, work, out):
    """out (k, k) = the cosine transform of a field (k, k)."""
    np.dot(cosines, field, work)
    np.dot(work, cosines.T, out)


@njit(cache=True)
def _field(spectrum, cosines, work, out):
    """out (k, k): the inverse, and transpose, of ``_spectrum``."""
    np.dot(cosines.T, spectrum, work)
    np.dot(work, cosines, out)


@njit(cache=True, fastmath={"contract", "reassoc", "arcp"})
def _along(samples, view, slopes, out):
    """out (P P, C) = the derivative of the residuals along a change of the slopes (T, 2)."""
    out[:] = 0.0
    for k in range(len(view.gradients)):
        p, t = samples.pair_pixel[k], samples.pair_triangle[k]
        a, b = np.float32(slopes[t, 0]), np.float32(slopes[t, 1])
        for c in range(out.shape[1]):
            out[p, c] += view.gradients[k, 0, c] * a + view.gradients[k, 1, c] * b


@njit(cache=True, fastmath={"contract", "reassoc", "arcp"})
def _back(samples, view, residuals, out):
    """out (T, 2): the transpose of ``_along``."""
    out[:] = 0.0
    for k in range(len(view.gradients)):
        p, t = samples.pair_pixel[k], samples.pair_triangle[k]
        a, b = np.float32(0.0), np.float32(0.0)
        for c in range(residuals.shape[1]):
            a += view.gradients[k, 0, c] * residuals[p, c]
            b += view.gradients[k, 1, c] * residuals[p, c]
        out[t, 0] += a
        out[t, 1] += b


@njit(cache=True)
def _step(view, samples, metric, free, damping, iterations, out):
    """out (k, k) = the damped Gauss-Newton step, by preconditioned conjugate gradients on its cosine spectrum."""
    k, cell = len(out), samples.cell_mm
    even = 0.0
    for n in range(len(view.gradients)):
        for c in range(view.gradients.shape[2]):
            even += view.gradients[n, 0, c] ** 2 + view.gradients[n, 1, c] ** 2
    even = even / len(view.slopes) + 1e-12
    laplacian = even * metric.laplacian
    stiff = damping * (laplacian + even * FLATNESS)
    inverse = 1.0 / (stiff + 0.3 * laplacian)
    residual, way, image, total = np.zeros((k, k)), np.zeros((k, k)), np.zeros((k, k)), np.zeros((k, k))
    field, work = np.zeros((k, k)), np.zeros((k, k))
    forces, changes, seen = np.zeros_like(view.slopes), np.zeros_like(view.slopes), np.zeros_like(view.residuals)
    _back(samples, view, view.residuals, forces)
    _pull(forces, cell, field)
    field *= -free
    _spectrum(field, metric.cosines, work, residual)
    old = 1.0
    for n in range(iterations):
        new = (residual * inverse * residual).sum()
        if new <= 1e-18:
            break
        way *= new / old if n else 0.0
        way += inverse * residual
        _field(way, metric.cosines, work, field)
        field *= free
        _slopes(field, cell, changes)
        _along(samples, view, changes, seen)
        _back(samples, view, seen, forces)
        _pull(forces, cell, field)
        field *= free
        _spectrum(field, metric.cosines, work, image)
        image += stiff * way
        length = new / (way * image).sum()
        total += length * way
        residual -= length * image
        old = new
    _field(total, metric.cosines, work, out)
    out *= free


@njit(cache=True, parallel=True)
def refine_facets(heights, centres, samples, sights, optics, metric, free, rounds, iterations, enough, errors):
    """Lower what the facets show amiss, in place, by at most ``rounds`` steps.

    heights: (F, k, k) mm. centres: (F, 2) mm. free: (k, k), 0 for vertices that stay, 1 for others. iterations: of
    conjugate gradients per step. enough: a step that lowers the error by a smaller share is a facet's last. errors:
    (F, 2) is filled with the mean squared residuals before and after.
    """
    k, pairs, channels = heights.shape[1], len(samples.pair_pixel), len(sights.plane)
    triangles, pixels = 2 * (k - 1) ** 2, samples.pixels**2
    for f in prange(len(heights)):
        rays, light = np.zeros((len(sights.eyes_mm), triangles, 10)), np.zeros((pixels, channels), np.float32)
        slopes, residuals = np.zeros((2, triangles, 2)), np.zeros((2, pixels, channels), np.float32)
        gradients = np.zeros((2, pairs, 2, channels), np.float32)
        views = [View(slopes[n], residuals[n], gradients[n]) for n in range(2)]
        step, trial, now = np.zeros((k, k)), heights[f].copy(), 0
        error = _look(trial, centres[f], samples, sights, optics, True, rays, light, views[0])
        damping = DAMPING
        for _ in range(rounds):
            if not 0.0 < error < np.inf:
                break
            _step(views[now], samples, metric, free, damping, iterations, step)
            trial[:] = heights[f] + step
            less = _look(trial, centres[f], samples, sights, optics, False, rays, light, views[1 - now])
            if less < error:
                heights[f] = trial
                gain, error, now, damping = error - less, less, 1 - now, max(damping / 3, LEAST_DAMPING)
                if gain < enough * error:
                    break
            else:
                damping *= 5
                if damping > MOST_DAMPING:
                    break
        errors[f] = error
