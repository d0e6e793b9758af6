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
LIGHT_STEP = 20
"""Entries of the display table on each side over which its slope is taken: near black it is steep."""
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 0.5, 1e-4, 1e2
"""Damping of the Gauss-Newton steps, relative to the mean square of the gradients: the first, the least, the most."""
_WORSE = 10.0
"""Factor of the damping after a step that is not taken."""
_FLATNESS = 1e-3
"""Pull on heights, beside that on slopes, per mm^2: it keeps a facet's mean where it is."""
_ROUNDING = {"contract", "reassoc", "arcp"}
"""Flags that relax rounding alone; none lets the compiler assume that there is no infinity or NaN."""


class Samples(NamedTuple):
    """Where on a facet its picture is sampled; the same for all facets.

    The sides of pixels and of triangles cut a facet into K pieces, each of one pixel and one triangle. Pieces are in
    layers: the first has a piece of each pixel, the next one another of each pixel that has two, and so on. Pixels are
    sorted by their number of pieces, so that the pieces of a layer are those of the first so many pixels, which
    processors work on side by side. Triangle i m + j is the lower left half of cell (i, j), triangle m^2 + i m + j the
    upper right.

    Args:
        cell_mm: side of a micro-facet, mm.
        pixels: P.
        centroids_mm: (2, T) centroids of the triangles along +x and +y, from the facet's centre, mm.
        pixel: (P P,) row by row, of the sorted ones.
        layers: (S + 1,) layer s has the pieces layers[s] to layers[s + 1] - 1.
        triangle: (K,) uint32 of each piece.
        right_mm: (K,) float32 distance of a piece's centroid from its triangle's along +x, mm.
        up_mm: (K,) float32 the same along +y, mm.
        share: (K,) float32 of its pixel's area.
    """

    cell_mm: float
    pixels: int
    centroids_mm: FloatArray
    pixel: IntArray
    layers: IntArray
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


class _Tile(NamedTuple):
    """What a facet should show.

    Args:
        targets: (C, P P) float32 display values.
        seen: (C, P P) float32 1 for pixels within the lens's square as the channel's eye sees it, 0 for others.
    """

    targets: FloatArray
    seen: FloatArray


class Shown(NamedTuple):
    """What a facet shows, and how that changes with its slopes.

    Args:
        slopes: (2, T) slopes of the triangles along +x and +y.
        residuals: (C, P P) float32 what is shown less the target, display values.
        gradients: (C, 2, K) float32 derivatives of a piece's share of its pixel along the slopes of its triangle.
    """

    slopes: FloatArray
    residuals: FloatArray
    gradients: FloatArray


class _Rays(NamedTuple):
    """Where the rays of an eye land that pass through a facet's triangles, and where pieces of them look.

    Args:
        points: (2, T) exp(-h / D), see ``HeightField``, and z of the triangles' centroids, mm.
        landing: (2, T) float32 x and y of the landing point of the ray through a triangle's centroid, mm.
        by_slope: (2, 2, T) float32 its derivatives: [slope, x or y], mm.
        by_position: (2, 2, T) float32 those along +x and +y over the triangle: [direction, x or y], mm per mm.
        pixel: (K,) uint32 the source's pixel to the upper left of where a piece looks, row by row.
        between: (2, K) float32 how far to the right and down from that pixel to the next it looks.
        weight: (K,) float32 share of its pixel's area; 0 beside the source.
        pull: (2, 2, K) float32 derivatives by slope, times that share: [slope, x or y], pixels of the source.
    """

    points: FloatArray
    landing: FloatArray
    by_slope: FloatArray
    by_position: FloatArray
    pixel: IntArray
    between: FloatArray
    weight: FloatArray
    pull: FloatArray


@njit(cache=True)
def room_for_rays(samples):
    """Room for the rays of one eye through a facet."""
    triangles, pieces = samples.centroids_mm.shape[1], len(samples.triangle)
    return _Rays(
        np.zeros((2, triangles)),
        np.zeros((2, triangles), np.float32),
        np.zeros((2, 2, triangles), np.float32),
        np.zeros((2, 2, triangles), np.float32),
        np.zeros(pieces, np.uint32),
        np.zeros((2, pieces), np.float32),
        np.zeros(pieces, np.float32),
        np.zeros((2, 2, pieces), np.float32),
    )


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
    """Fill out (2, T) with the slopes of a facet's triangles along +x and +y, which are linear in its heights."""
    m, each = len(heights) - 1, 1.0 / cell
    lower, upper = out[:, : m * m], out[:, m * m :]
    for i in range(m):
        for j in range(m):
            tl, tr, bl, br = heights[i, j], heights[i, j + 1], heights[i + 1, j], heights[i + 1, j + 1]
            t = i * m + j
            lower[0, t], lower[1, t] = (br - bl) * each, (tl - bl) * each
            upper[0, t], upper[1, t] = (tr - tl) * each, (tr - br) * each


@njit(cache=True)
def triangle_slopes_transposed(forces, cell, out):
    """Fill out (k, k) with the transpose of ``triangle_slopes``, applied to forces (2, T)."""
    m, each = len(out) - 1, 1.0 / cell
    lower, upper = forces[:, : m * m], forces[:, m * m :]
    out[:] = 0.0
    for i in range(m):
        for j in range(m):
            t = i * m + j
            a, b = lower[0, t] * each, lower[1, t] * each
            c, d = upper[0, t] * each, upper[1, t] * each
            out[i, j] += b - c
            out[i, j + 1] += c + d
            out[i + 1, j] -= a + b
            out[i + 1, j + 1] += a - d


@njit(cache=True)
def _raise(heights, optics, points):
    """Fill points (2, T) with exp(-h / D) and z of the centroids of a facet's triangles, see ``_Rays``."""
    m, far = len(heights) - 1, optics.eye[2] - optics.depth
    for upper in range(2):
        for i in range(m):
            for j in range(m):
                t = (upper * m + i) * m + j
                h = (heights[i, j] + heights[i + 1, j + 1] + heights[i + 1 - upper, j + upper]) / 3
                points[0, t] = 1.0 if optics.vertical else math.exp(-h / far)
                points[1, t] = optics.depth + h if optics.vertical else optics.eye[2] - points[0, t] * far


@njit(cache=True, fastmath=_ROUNDING)
def _aim(slopes, centre, eye, samples, optics, rays):
    """Fill in where the rays through a facet's triangles land, and the derivatives.

    It is ``land_by_slopes`` and its differential, in a loop without branches, which processors run side by side. With
    the ray's direction d, the unit normal n, the direction ``t = d / ior + b n`` in the slab and the reach ``g = gap
    ior / cos_out - z / t_z``, the ray through (x, y, z) lands at ``(x, y) + g t_xy``.

    Args:
        slopes: (2, T) of its triangles.
        centre: (2,) of the facet, mm.
        eye: (3,) mm.
        samples: of a facet.
        optics: an ``optics.medium.Optics``.
        rays: to fill; its ``points`` are given.

    Returns:
        False if a ray does not arrive, or a triangle is steeper than allowed.
    """
    rho, z, (lx, ly) = rays.points[0], rays.points[1], (rays.landing[0], rays.landing[1])
    along_u, along_v = slopes[0], slopes[1]
    right, up = samples.centroids_mm[0], samples.centroids_mm[1]
    lean = 0.0 if optics.vertical else 1.0 / (optics.eye[2] - optics.depth)
    axis_x, axis_y = optics.eye[0], optics.eye[1]
    eye_x, eye_y, eye_z = eye[0], eye[1], eye[2]
    ior, gap = optics.ior, optics.gap * optics.ior
    arrived = 0
    for t in range(len(z)):
        a, b, u, v = along_u[t], along_v[t], centre[0] + right[t] - axis_x, centre[1] + up[t] - axis_y
        w = 1.0 - (a * u + b * v) * lean
        q = 1.0 / math.sqrt(a * a + b * b + w * w)
        nx, ny, nz = -a * q, -b * q, w * q
        x, y = axis_x + rho[t] * u, axis_y + rho[t] * v
        dx, dy, dz = x - eye_x, y - eye_y, z[t] - eye_z
        near = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx * near, dy * near, dz * near
        cos_in = -(dx * nx + dy * ny + dz * nz)
        cos_slab = math.sqrt(1.0 - (1.0 - cos_in * cos_in) / (ior * ior))
        bend = cos_in / ior - cos_slab
        tx, ty, tz = dx / ior + bend * nx, dy / ior + bend * ny, dz / ior + bend * nz
        out = 1.0 - ior * ior * (1.0 - tz * tz)
        cos_out, fall = math.sqrt(out), 1.0 / tz
        reach = gap / cos_out - z[t] * fall
        lx[t], ly[t] = x + tx * reach, y + ty * reach
        # beyond the critical angle, roots and what depends on them are nan, and all comparisons false
        arrived += (cos_in > 0.0) & (cos_slab > 0.0) & (fall < 0.0) & (cos_out > 0.0) & (nz >= optics.cos_limit)
        by_cos = 1.0 / ior - cos_in / (ior * ior * cos_slab)
        by_fall = z[t] * fall * fall - gap * ior * ior * tz / (out * cos_out)
        for k in range(2):
            # along a slope the normal turns
            cx, cy, cz = (-1.0, 0.0, -u * lean) if k == 0 else (0.0, -1.0, -v * lean)
            dot = nx * cx + ny * cy + nz * cz
            cx, cy, cz = (cx - nx * dot) * q, (cy - ny * dot) * q, (cz - nz * dot) * q
            more = -by_cos * (dx * cx + dy * cy + dz * cz)
            change = more * nz + bend * cz
            rays.by_slope[k, 0, t] = (more * nx + bend * cx) * reach + tx * by_fall * change
            rays.by_slope[k, 1, t] = (more * ny + bend * cy) * reach + ty * by_fall * change
            # over the triangle the point moves, and the direction with it
            tilt = (a if k == 0 else b) * rho[t]
            px, py = (rho[t] if k == 0 else 0.0) - tilt * u * lean, (0.0 if k == 0 else rho[t]) - tilt * v * lean
            dot = dx * px + dy * py + dz * tilt
            cx, cy, cz = (px - dx * dot) * near, (py - dy * dot) * near, (tilt - dz * dot) * near
            more = -by_cos * (nx * cx + ny * cy + nz * cz)
            change = by_fall * (cz / ior + more * nz) - tilt * fall
            rays.by_position[k, 0, t] = px + (cx / ior + more * nx) * reach + tx * change
            rays.by_position[k, 1, t] = py + (cy / ior + more * ny) * reach + ty * change
    return arrived == len(z)


@njit(cache=True, fastmath=_ROUNDING)
def _place(samples, pictures, rays):
    """Fill in where a facet's pieces look: ``landing + by_position p``, p from the centroid of a piece's triangle."""
    triangle, pixel, weight = samples.triangle, rays.pixel, rays.weight
    rows = len(pictures.sources)
    per_mm, middle, last = np.float32(rows / pictures.source_mm), np.float32(0.5 * rows - 0.5), np.float32(rows - 1.001)
    landing, by_slope, by_position = rays.landing, rays.by_slope, rays.by_position
    for k in range(len(triangle)):
        t, right, up = triangle[k], samples.right_mm[k], samples.up_mm[k]
        x = landing[0, t] + by_position[0, 0, t] * right + by_position[1, 0, t] * up
        y = landing[1, t] + by_position[0, 1, t] * right + by_position[1, 1, t] * up
        column, row = x * per_mm + middle, middle - y * per_mm
        inside = (column >= 0) & (column < last) & (row >= 0) & (row < last)
        column, row = column if inside else np.float32(0), row if inside else np.float32(0)
        i, j = np.int32(row), np.int32(column)
        pixel[k] = i * rows + j
        rays.between[0, k], rays.between[1, k] = column - np.float32(j), row - np.float32(i)
        weight[k] = samples.share[k] if inside else np.float32(0)
        scale = weight[k] * per_mm
        rays.pull[0, 0, k], rays.pull[0, 1, k] = scale * by_slope[0, 0, t], scale * by_slope[0, 1, t]
        rays.pull[1, 0, k], rays.pull[1, 1, k] = scale * by_slope[1, 0, t], scale * by_slope[1, 1, t]


@njit(cache=True, fastmath=_ROUNDING)
def _look(sources, plane, layers, rays, light, gradients):
    """Add up the source's light over the pieces of each pixel of a channel, and fill in its derivatives along slopes.

    Args:
        sources: (H, W, planes) float32.
        plane: of the channel.
        layers: of the pieces.
        rays: of its eye.
        light: (P P,) to add to.
        gradients: (2, K) to fill.
    """
    planes = sources.shape[2]
    flat, down, pixel = sources.reshape(-1)[plane:], sources.shape[1] * planes, rays.pixel
    for s in range(len(layers) - 1):
        first = layers[s]
        for p in range(layers[s + 1] - first):
            k = first + p
            at = np.uint64(pixel[k]) * np.uint64(planes)
            tl, tr = flat[at], flat[at + np.uint64(planes)]
            bl, br = flat[at + np.uint64(down)], flat[at + np.uint64(down + planes)]
            fx, fy = rays.between[0, k], rays.between[1, k]
            top, low = tl + (tr - tl) * fx, bl + (br - bl) * fx
            light[p] += rays.weight[k] * (top + (low - top) * fy)
            to_x, to_y = (tr - tl) + ((br - bl) - (tr - tl)) * fy, top - low
            gradients[0, k] = to_x * rays.pull[0, 0, k] + to_y * rays.pull[0, 1, k]
            gradients[1, k] = to_x * rays.pull[1, 0, k] + to_y * rays.pull[1, 1, k]


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
def tile_of(heights, centre, samples, pictures, optics):
    """What a facet should show, a ``_Tile``: where a pixel is seen depends little on heights.

    Args:
        heights: (k, k) of the facet, mm.
        centre: (2,) of the facet, mm.
        samples: of a facet.
        pictures: sources and targets.
        optics: an ``optics.medium.Optics``.
    """
    channels, side, m, cell = len(pictures.plane), samples.pixels, len(heights) - 1, samples.cell_mm
    tile = _Tile(np.zeros((channels, side * side), np.float32), np.zeros((channels, side * side), np.float32))
    pixel = np.zeros(channels, np.float32)
    for e in range(len(pictures.eyes_mm)):
        eye = pictures.eyes_mm[e]
        for p in range(side * side):
            right, down = (samples.pixel[p] % side + 0.5) * m / side, (samples.pixel[p] // side + 0.5) * m / side
            h = heights[int(down), int(right)]  # of a vertex nearby
            u, v = centre[0] + (right - 0.5 * m) * cell, centre[1] + (0.5 * m - down) * cell
            px, py = project(eye, surface_point(optics, u, v, h, optics.depth), optics.depth)
            seen = target_at(pictures, e, px, py, pixel)
            for c in range(pictures.first[e], pictures.first[e + 1]):
                tile.targets[c, p], tile.seen[c, p] = pixel[c], seen
    return tile


@njit(cache=True, fastmath=_ROUNDING)
def _compare(tile, c, display, layers, light, shown):
    """Turn a channel's light (P P,) into residuals, and gradients into theirs, by the chain rule.

    The display curve's slope is taken over some entries of its table.

    Returns:
        The sum of the squared residuals.
    """
    last, total = len(display) - 1, 0.0
    for p in range(len(light)):
        at = min(int(light[p] * last + 0.5), last)
        residual = (display[at] - tile.targets[c, p]) * tile.seen[c, p]
        shown.residuals[c, p] = residual
        total += np.float64(residual) * residual
        lo, hi = max(at - LIGHT_STEP, 0), min(at + LIGHT_STEP, last)
        light[p] = (display[hi] - display[lo]) * last / (hi - lo) * tile.seen[c, p]
    gradients = shown.gradients[c]
    for s in range(len(layers) - 1):
        layer = slice(layers[s], layers[s + 1])
        a, b = gradients[0, layer], gradients[1, layer]
        for p in range(len(a)):
            a[p] *= light[p]
            b[p] *= light[p]
    return total


@njit(cache=True)
def predict_facet(heights, centre, samples, pictures, optics, tile, rays, shown):
    """Fill in what a facet shows: ``residual = display(mean light of a pixel's pieces) - target``.

    Args:
        heights: (k, k) of the facet, mm.
        centre: (2,) of the facet, mm.
        samples: of a facet.
        pictures: sources and targets.
        optics: an ``optics.medium.Optics``.
        tile: what it should show.
        rays: room.
        shown: to fill.

    Returns:
        The mean squared residual; infinite if a ray does not arrive or a triangle is steeper than allowed.
    """
    triangle_slopes(heights, samples.cell_mm, shown.slopes)
    _raise(heights, optics, rays.points)
    total = 0.0
    light = np.zeros(samples.pixels**2, np.float32)
    for e in range(len(pictures.eyes_mm)):
        if not _aim(shown.slopes, centre, pictures.eyes_mm[e], samples, optics, rays):
            return np.inf
        _place(samples, pictures, rays)
        for c in range(pictures.first[e], pictures.first[e + 1]):
            light[:] = 0.0
            _look(pictures.sources, pictures.plane[c], samples.layers, rays, light, shown.gradients[c])
            total += _compare(tile, c, pictures.display, samples.layers, light, shown)
    return total / max(tile.seen.sum(), 1)


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


@njit(cache=True, fastmath=_ROUNDING)
def residual_change(samples, shown, slopes, out):
    """Fill out (C, P P) with the derivative of the residuals along a change of the slopes (2, T)."""
    triangle, layers, gradients = samples.triangle, samples.layers, shown.gradients
    of_piece = np.empty((2, len(triangle)), np.float32)
    for k in range(len(triangle)):
        of_piece[0, k], of_piece[1, k] = slopes[0, triangle[k]], slopes[1, triangle[k]]
    out[:] = 0.0
    for c in range(len(out)):
        change = out[c]
        for s in range(len(layers) - 1):
            # slices, so that kernels need not look for negative indices
            layer = slice(layers[s], layers[s + 1])
            ga, gb, a, b = gradients[c, 0, layer], gradients[c, 1, layer], of_piece[0, layer], of_piece[1, layer]
            for p in range(len(a)):
                change[p] += ga[p] * a[p] + gb[p] * b[p]


@njit(cache=True, fastmath=_ROUNDING)
def residual_change_transposed(samples, shown, residuals, out):
    """Fill out (2, T) with the transpose of ``residual_change``, applied to residuals (C, P P)."""
    triangle, layers, gradients = samples.triangle, samples.layers, shown.gradients
    of_piece = np.zeros((2, len(triangle)), np.float32)
    for c in range(len(residuals)):
        residual = residuals[c]
        for s in range(len(layers) - 1):
            layer = slice(layers[s], layers[s + 1])
            ga, gb, a, b = gradients[c, 0, layer], gradients[c, 1, layer], of_piece[0, layer], of_piece[1, layer]
            for p in range(len(a)):
                a[p] += ga[p] * residual[p]
                b[p] += gb[p] * residual[p]
    out[:] = 0.0
    for k in range(len(triangle)):
        out[0, triangle[k]] += of_piece[0, k]
        out[1, triangle[k]] += of_piece[1, k]


@njit(cache=True, fastmath=_ROUNDING)
def _mean_square(gradients, triangles):
    """The sum of all squared gradients, per triangle."""
    total = np.float32(0.0)
    for g in gradients.flat:
        total += g * g
    return total / triangles


# element by element: numba takes long to compile expressions of whole arrays
@njit(cache=True)
def _weigh(laplacian, even, damping, stiff, inverse):
    """Fill in what the damping adds to J'J and the preconditioner, see ``_step``; all (k, k).

    A facet that sees plain areas only has no gradients: ``even``, their mean square, is a little above zero.
    """
    for i in range(len(stiff)):
        for j in range(len(stiff)):
            scaled = even * laplacian[i, j]
            stiff[i, j] = damping * (scaled + even * _FLATNESS)
            inverse[i, j] = 1.0 / (stiff[i, j] + 0.3 * scaled)


@njit(cache=True)
def _keep_free(field, free, factor):
    """Multiply a field (k, k) by a factor where heights are free, by zero elsewhere."""
    for i in range(len(field)):
        for j in range(len(field)):
            field[i, j] *= factor * free[i, j]


@njit(cache=True)
def _add(factor, field, weights, other):
    """``factor field + weights other``, element by element, in place of the field; all (k, k)."""
    for i in range(len(field)):
        for j in range(len(field)):
            field[i, j] = field[i, j] * factor + weights[i, j] * other[i, j]


@njit(cache=True)
def _product(field, other):
    total = 0.0
    for i in range(len(field)):
        for j in range(len(field)):
            total += field[i, j] * other[i, j]
    return total


@njit(cache=True)
def _weighed_square(weights, field):
    total = 0.0
    for i in range(len(field)):
        for j in range(len(field)):
            total += weights[i, j] * field[i, j] * field[i, j]
    return total


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
    k, cell = len(out), samples.cell_mm
    stiff, inverse = np.zeros((k, k)), np.zeros((k, k))
    _weigh(metric.laplacian, _mean_square(shown.gradients, shown.slopes.shape[1]) + 1e-12, damping, stiff, inverse)
    residual, direction, image, total = np.zeros((k, k)), np.zeros((k, k)), np.zeros((k, k)), np.zeros((k, k))
    field, work = np.zeros((k, k)), np.zeros((k, k))
    forces, changes = np.zeros(shown.slopes.shape), np.zeros(shown.slopes.shape)
    seen = np.zeros(shown.residuals.shape, np.float32)
    residual_change_transposed(samples, shown, shown.residuals, forces)
    triangle_slopes_transposed(forces, cell, field)
    _keep_free(field, metric.free, -1.0)
    to_spectrum(field, metric.cosines, work, residual)
    old, expected = 1.0, 0.0
    for n in range(iterations):
        new = _weighed_square(inverse, residual)
        if new <= 1e-18:
            break
        _add(new / old if n else 0.0, direction, inverse, residual)
        to_field(direction, metric.cosines, work, field)
        _keep_free(field, metric.free, 1.0)
        triangle_slopes(field, cell, changes)
        residual_change(samples, shown, changes, seen)
        residual_change_transposed(samples, shown, seen, forces)
        triangle_slopes_transposed(forces, cell, field)
        _keep_free(field, metric.free, 1.0)
        to_spectrum(field, metric.cosines, work, image)
        _add(1.0, image, stiff, direction)
        length = new / _product(direction, image)
        for i in range(k):
            for j in range(k):
                total[i, j] += length * direction[i, j]
                residual[i, j] -= length * image[i, j]
        expected += length * new
        old = new
    to_field(total, metric.cosines, work, out)
    _keep_free(out, metric.free, 1.0)
    return expected + _weighed_square(stiff, total)


@njit(cache=True, nogil=True)
def _refine_part(part, shapes, samples, pictures, optics, metric, descent, errors):
    """Part of the facets, see ``refine_facets``; shapes: heights and centres."""
    heights, centres = shapes
    k, pieces, channels = heights.shape[1], len(samples.triangle), len(pictures.plane)
    triangles = 2 * (k - 1) ** 2
    rays = room_for_rays(samples)
    slopes, residuals = np.zeros((2, 2, triangles)), np.zeros((2, channels, samples.pixels**2), np.float32)
    gradients = np.zeros((2, channels, 2, pieces), np.float32)
    # one of the facet as it is and one of the trial: a step that is taken exchanges them
    predictions = (Shown(slopes[0], residuals[0], gradients[0]), Shown(slopes[1], residuals[1], gradients[1]))
    step = np.zeros((k, k))
    for f in range(part.first, part.end):
        trial, now = heights[f].copy(), 0
        tile = tile_of(trial, centres[f], samples, pictures, optics)
        error = predict_facet(trial, centres[f], samples, pictures, optics, tile, rays, predictions[0])
        damping = _FIRST_DAMPING
        for _ in range(descent.rounds):
            if not 0.0 < error < np.inf:
                break
            expected = _step(predictions[now], samples, metric, damping, descent.iterations, step)
            for n in range(k * k):  # element by element, see ``polishing_kernels.read_candidate``
                trial[n // k, n % k] = heights[f, n // k, n % k] + step[n // k, n % k]
            less = predict_facet(trial, centres[f], samples, pictures, optics, tile, rays, predictions[1 - now])
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
