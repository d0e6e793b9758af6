"""What the whole top shows as a machine makes it, and how that changes with its slopes, compiled.

The made surface is a raster of heights. At its nodes rays are refracted; between nodes the points at which they land
are interpolated, so that a narrow strip that sweeps over the source is looked up in many places for one refraction.
Blocks of cells are pixels; the residuals are their display values less the targets'.

The letters in shapes: R x R nodes of the raster, B x B blocks of b x b cells each, C channels of all eyes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.integration.refinement_kernels import LIGHT_STEP, SLOPE_STEP, Pictures, land_by_slopes, target_at
from magiclens.kernels.compiler import njit
from magiclens.kernels.threads import in_threads
from magiclens.optics.eyes import project
from magiclens.optics.medium import Optics

_NEAR, _NEXT, _FAR = 3 / 4, -3 / 20, 1 / 60
"""Weights of the central difference of sixth order. What the process leaves is so smooth that it is exact."""
SLOPE_REACH = 3
"""Nodes on either side that a slope depends on."""


class MadeRaster(NamedTuple):
    """The raster of the made surface.

    Args:
        left: x of the first column, mm, lens frame.
        top: y of the first row, mm.
        pitch: between nodes, mm.
        first: row and column of the node at the corner of the lens's square.
        block: b, cells along the side of a block.
        blocks: B, blocks along the side of the lens's square.
        look_ups: of the source, along the side of a cell.
    """

    left: float
    top: float
    pitch: float
    first: int
    block: int
    blocks: int
    look_ups: int


class Aim(NamedTuple):
    """Where the rays of one eye land that pass the nodes of the lens's square.

    Args:
        landing: (B b + 1, B b + 1, 2) mm; nan where a ray does not arrive.
        by_slope: (B b + 1, B b + 1, 2, 2) its derivatives: [slope, x or y of the landing point], mm.
    """

    landing: FloatArray
    by_slope: FloatArray


@njit(cache=True, nogil=True)
def _aim_part(part, z, slopes, raster, eye, optics, aim):
    """Part of the rows, see ``shown``; fills aim."""
    for i in range(part.first, part.end):
        for j in range(aim.landing.shape[1]):
            r, q = raster.first + i, raster.first + j
            u, v = raster.left + q * raster.pitch, raster.top - r * raster.pitch
            h, a, b = z[r, q] - optics.depth, slopes[0, r, q], slopes[1, r, q]
            x, y, there = land_by_slopes(u, v, h, a, b, eye, optics)
            ax, ay, good = land_by_slopes(u, v, h, a + SLOPE_STEP, b, eye, optics)
            bx, by, well = land_by_slopes(u, v, h, a, b + SLOPE_STEP, eye, optics)
            aim.landing[i, j, 0], aim.landing[i, j, 1] = (x, y) if there else (np.nan, np.nan)
            # where a neighbouring ray does not arrive, nothing is known: no change is expected
            known = 1.0 / SLOPE_STEP if there and good and well else 0.0
            aim.by_slope[i, j, 0, 0], aim.by_slope[i, j, 0, 1] = (ax - x) * known, (ay - y) * known
            aim.by_slope[i, j, 1, 0], aim.by_slope[i, j, 1, 1] = (bx - x) * known, (by - y) * known


# these flags relax rounding alone; none lets the compiler assume that there is no infinity or NaN
@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "arcp"})
def _look_up(bi, bj, raster, pictures, e, landing, light, pull):
    """Add up the source's light over the look-ups of a block, and how nodes' landing points would change it.

    A look-up at (s, t) of a cell takes the source at the mean of the landing points of the cell's corners, weighted
    bilinearly; a corner's landing point moves it by the same weight.

    Args:
        bi, bj: row and column of the block.
        raster: a ``MadeRaster``.
        pictures: sources and targets.
        e: the eye.
        landing: (B b + 1, B b + 1, 2) mm, of the eye's rays.
        light: (channels of the eye,) to add to.
        pull: (channels of the eye, b + 1, b + 1, 2) to add to: derivatives along x and y of the landing points.
    """
    b, side, first = raster.block, raster.look_ups, pictures.first[e]
    rows = len(pictures.sources)
    per_mm, middle = rows / pictures.source_mm, 0.5 * rows - 0.5
    for k in range((b * side) ** 2):
        down, right = (k // (b * side) + 0.5) / side, (k % (b * side) + 0.5) / side
        ii, jj = int(down), int(right)
        t, s = down - ii, right - jj
        i, j = bi * b + ii, bj * b + jj
        tl, tr, bl, br = (1 - t) * (1 - s), (1 - t) * s, t * (1 - s), t * s
        x = (
            tl * landing[i, j, 0]
            + tr * landing[i, j + 1, 0]
            + bl * landing[i + 1, j, 0]
            + br * landing[i + 1, j + 1, 0]
        )
        y = (
            tl * landing[i, j, 1]
            + tr * landing[i, j + 1, 1]
            + bl * landing[i + 1, j, 1]
            + br * landing[i + 1, j + 1, 1]
        )
        column, row = x * per_mm + middle, middle - y * per_mm
        if not (0.0 <= column < rows - 1.001 and 0.0 <= row < rows - 1.001):
            continue  # beside the source it is dark
        m, n = int(row), int(column)
        fy, fx = np.float32(row - m), np.float32(column - n)
        for c in range(len(light)):
            w = pictures.plane[first + c]
            above, beside = pictures.sources[m, n, w], pictures.sources[m, n + 1, w]
            under, across = pictures.sources[m + 1, n, w], pictures.sources[m + 1, n + 1, w]
            high, low = above + (beside - above) * fx, under + (across - under) * fx
            light[c] += high + (low - high) * fy
            gx = np.float32(((beside - above) + ((across - under) - (beside - above)) * fy) * per_mm)
            gy = np.float32((high - low) * per_mm)
            for corner, weight in enumerate((tl, tr, bl, br)):
                pull[c, ii + corner // 2, jj + corner % 2, 0] += np.float32(weight) * gx
                pull[c, ii + corner // 2, jj + corner % 2, 1] += np.float32(weight) * gy


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "arcp"})
def _shown_part(part, z, raster, pictures, e, plane, aim, found):
    """Part of the rows of blocks, see ``shown``. plane: z of the reference plane. found: residuals and gradients."""
    residuals, gradients = found
    p, b, last = raster.pitch, raster.block, len(pictures.display) - 1
    first, channels = pictures.first[e], pictures.first[e + 1] - pictures.first[e]
    each, eye = np.float32(1.0 / (b * raster.look_ups) ** 2), pictures.eyes_mm[e]
    light, pull = np.zeros(channels, np.float32), np.zeros((channels, b + 1, b + 1, 2), np.float32)
    for bi in range(part.first, part.end):
        for bj in range(raster.blocks):
            light[:] = 0.0
            pull[:] = 0.0
            _look_up(bi, bj, raster, pictures, e, aim.landing, light, pull)
            # where the block is seen: its middle, at the height of the node nearest to that
            r, q = raster.first + bi * b + b // 2, raster.first + bj * b + b // 2
            u = raster.left + (raster.first + (bj + 0.5) * b) * p
            v = raster.top - (raster.first + (bi + 0.5) * b) * p
            px, py = project(eye, (u, v, z[r, q]), plane)
            out = residuals[bi, bj]
            seen = target_at(pictures, e, px, py, out)
            for c in range(channels):
                entry = min(max(light[c] * each, 0.0), 1.0) * last
                k = min(int(entry), last - 1)
                value = pictures.display[k] + (pictures.display[k + 1] - pictures.display[k]) * (entry - k)
                out[first + c] = value - out[first + c] if seen else 0.0
                low, high = max(k - LIGHT_STEP, 0), min(k + LIGHT_STEP, last)
                steep = np.float32((pictures.display[high] - pictures.display[low]) / (high - low) * last) * each
                steep = steep if seen else np.float32(0.0)
                for ii in range(b + 1):
                    for jj in range(b + 1):
                        by = aim.by_slope[bi * b + ii, bj * b + jj]
                        gx, gy = pull[c, ii, jj, 0] * steep, pull[c, ii, jj, 1] * steep
                        gradients[bi, bj, first + c, ii, jj, 0] = gx * by[0, 0] + gy * by[0, 1]
                        gradients[bi, bj, first + c, ii, jj, 1] = gx * by[1, 0] + gy * by[1, 1]


def shown(
    z: FloatArray, raster: MadeRaster, pictures: Pictures, optics: Optics, residuals: FloatArray, gradients: FloatArray
) -> None:
    """Fill in what a made surface shows, ``residual = display(mean light of a block's look-ups) - target``.

    Args:
        z: (R, R) float32, mm above the flat bottom; vertical cells.
        raster: a ``MadeRaster``.
        pictures: sources and targets, a ``refinement_kernels.Pictures``.
        optics: an ``optics.medium.Optics`` of vertical cells.
        residuals: (B, B, C) float32 to fill, display values; 0 where a block is seen beyond the lens's square.
        gradients: (B, B, C, b + 1, b + 1, 2) float32 to fill: their derivatives along the slopes, by +x and by +y, at
            the block's nodes.
    """
    side = raster.block * raster.blocks + 1
    aim = Aim(np.zeros((side, side, 2)), np.zeros((side, side, 2, 2), np.float32))
    slopes = raster_slopes(z, raster.pitch)
    for e in range(len(pictures.eyes_mm)):
        in_threads(_aim_part, side, z, slopes, raster, pictures.eyes_mm[e], optics, aim)
        in_threads(_shown_part, raster.blocks, z, raster, pictures, e, optics.depth, aim, (residuals, gradients))


@njit(cache=True, nogil=True)
def _slopes_part(part, z, pitch, out):
    """Part of the rows, see ``raster_slopes``."""
    rows, columns = z.shape
    near, next_, far = np.float32(_NEAR / pitch), np.float32(_NEXT / pitch), np.float32(_FAR / pitch)
    for i in range(part.first, part.end):
        for j in range(SLOPE_REACH, columns - SLOPE_REACH):
            out[0, i, j] = (
                near * (z[i, j + 1] - z[i, j - 1])
                + next_ * (z[i, j + 2] - z[i, j - 2])
                + far * (z[i, j + 3] - z[i, j - 3])
            )
        if SLOPE_REACH <= i < rows - SLOPE_REACH:
            for j in range(columns):
                out[1, i, j] = (
                    near * (z[i - 1, j] - z[i + 1, j])
                    + next_ * (z[i - 2, j] - z[i + 2, j])
                    + far * (z[i - 3, j] - z[i + 3, j])
                )


def raster_slopes(z: FloatArray, pitch: float) -> FloatArray:
    """Slopes along +x and +y of heights (R, R) float32: (2, R, R) float32; 0 near the border."""
    out = np.zeros((2, *z.shape), np.float32)
    in_threads(_slopes_part, len(z), z, pitch, out)
    return out


@njit(cache=True, nogil=True)
def _slopes_back_part(part, forces, pitch, out):
    """Part of the rows, see ``raster_slopes_transposed``."""
    rows, columns = out.shape
    weights = (np.float32(_NEAR / pitch), np.float32(_NEXT / pitch), np.float32(_FAR / pitch))
    for i in range(part.first, part.end):
        for j in range(columns):
            total = np.float32(0.0)
            for k in range(1, SLOPE_REACH + 1):
                w = weights[k - 1]
                if SLOPE_REACH <= j - k < columns - SLOPE_REACH:
                    total += w * forces[0, i, j - k]
                if SLOPE_REACH <= j + k < columns - SLOPE_REACH:
                    total -= w * forces[0, i, j + k]
                if SLOPE_REACH <= i + k < rows - SLOPE_REACH:
                    total += w * forces[1, i + k, j]
                if SLOPE_REACH <= i - k < rows - SLOPE_REACH:
                    total -= w * forces[1, i - k, j]
            out[i, j] = total


def raster_slopes_transposed(forces: FloatArray, pitch: float) -> FloatArray:
    """The transpose of ``raster_slopes``, applied to forces (2, R, R) float32: (R, R) float32."""
    out = np.zeros(forces.shape[1:], np.float32)
    in_threads(_slopes_back_part, len(out), forces, pitch, out)
    return out


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "arcp"})
def _change_part(part, slopes, raster, gradients, out):
    """Part of the rows of blocks, see ``change_of_residuals``."""
    b, channels = raster.block, out.shape[2]
    local = np.zeros((b + 1, b + 1, 2), np.float32)
    for bi in range(part.first, part.end):
        for bj in range(raster.blocks):
            for ii in range(b + 1):
                for jj in range(b + 1):
                    i, j = raster.first + bi * b + ii, raster.first + bj * b + jj
                    local[ii, jj, 0], local[ii, jj, 1] = slopes[0, i, j], slopes[1, i, j]
            for c in range(channels):
                total = np.float32(0.0)
                for ii in range(b + 1):
                    for jj in range(b + 1):
                        for axis in range(2):
                            total += gradients[bi, bj, c, ii, jj, axis] * local[ii, jj, axis]
                out[bi, bj, c] = total


def change_of_residuals(slopes: FloatArray, raster: MadeRaster, gradients: FloatArray) -> FloatArray:
    """How residuals change with slopes (2, R, R) float32, to first order: (B, B, C) float32."""
    out = np.zeros(gradients.shape[:3], np.float32)
    in_threads(_change_part, raster.blocks, slopes, raster, gradients, out)
    return out


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "arcp"})
def _forces_part(part, residuals, raster, gradients, forces, below):
    """Part of the rows of blocks, see ``forces_of_residuals``; below: (B, B b + 1, 2), on the row under each."""
    b, channels = raster.block, residuals.shape[2]
    rows = np.empty((b + 1, raster.blocks * b + 1, 2), np.float32)
    for bi in range(part.first, part.end):
        rows[:] = 0.0
        for bj in range(raster.blocks):
            for c in range(channels):
                r = residuals[bi, bj, c]
                for ii in range(b + 1):
                    for jj in range(b + 1):
                        for axis in range(2):
                            rows[ii, bj * b + jj, axis] += r * gradients[bi, bj, c, ii, jj, axis]
        for ii in range(b):
            for j in range(rows.shape[1]):
                for axis in range(2):
                    forces[axis, raster.first + bi * b + ii, raster.first + j] = rows[ii, j, axis]
        for j in range(rows.shape[1]):
            for axis in range(2):
                below[bi, j, axis] = rows[b, j, axis]


def forces_of_residuals(
    residuals: FloatArray, raster: MadeRaster, gradients: FloatArray, shape: tuple[int, ...]
) -> FloatArray:
    """The transpose of ``change_of_residuals``: forces on slopes (2, *shape) float32 of residuals (B, B, C) float32."""
    b, count = raster.block, raster.blocks
    side = count * b + 1
    forces, below = np.zeros((2, *shape), np.float32), np.empty((count, side, 2), np.float32)
    in_threads(_forces_part, count, residuals, raster, gradients, forces, below)
    # a row of blocks shares its last nodes with the next, which other threads have written
    inner = forces[:, raster.first : raster.first + side, raster.first : raster.first + side]
    inner[:, b::b] += np.moveaxis(below, -1, 0)
    return forces


@njit(cache=True, nogil=True)
def _finer_part(part, w, times, out):
    """Part of the rows, see ``finer``: weights of a hat over the six triangles around a node."""
    for i in range(part.first, part.end):
        r = i // times
        t = np.float32(i - r * times) / np.float32(times)
        for j in range(out.shape[1]):
            q = j // times
            s = np.float32(j - q * times) / np.float32(times)
            if s >= t:
                out[i, j] = w[r, q] * (1 - s) + w[r, q + 1] * (s - t) + w[r + 1, q + 1] * t
            else:
                out[i, j] = w[r, q] * (1 - t) + w[r + 1, q] * (t - s) + w[r + 1, q + 1] * s


def finer(w: FloatArray, times: int) -> FloatArray:
    """A grid's surface on a raster that is so many times as fine; cells are cut from top left to bottom right.

    Args:
        w: (rows, columns) float32.
        times: steps of the raster per cell.

    Returns:
        ((rows - 1) times, (columns - 1) times) float32: the last row and column are left out, as then the size can be
        one for which transforms are fast.
    """
    out = np.zeros([(n - 1) * times for n in w.shape], np.float32)
    in_threads(_finer_part, len(out), w, times, out)
    return out


@njit(cache=True, nogil=True)
def _coarser_part(part, z, times, out):
    """Part of the rows, see ``finer_transposed``."""
    rows, columns = z.shape
    for r in range(part.first, part.end):
        for q in range(out.shape[1]):
            total = np.float32(0.0)
            for a in range(1 - times, times):
                for b in range(1 - times, times):
                    i, j = r * times + a, q * times + b
                    if 0 <= i < rows and 0 <= j < columns:
                        far = max(abs(a), abs(b), abs(a - b))
                        if far < times:
                            total += np.float32(1.0 - far / times) * z[i, j]
            out[r, q] = total


def finer_transposed(z: FloatArray, times: int) -> FloatArray:
    """The transpose of ``finer``, applied to a raster float32."""
    out = np.zeros([n // times + 1 for n in z.shape], np.float32)
    in_threads(_coarser_part, len(out), z, times, out)
    return out
