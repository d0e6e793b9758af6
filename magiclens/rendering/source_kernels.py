"""What traced samples take from a source, compiled: pictures, and the entries of sparse matrices.

Both look the source up between its pixels: ``sum over corners of weight * (1 - |dx|) (1 - |dy|) * pixel``. Half a
pixel at the border repeats the outermost pixels; beyond the source it is dark.
"""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.sampling import clamped_cell, weighted_light
from magiclens.kernels.threads import in_threads
from magiclens.kernels.uncounted import uncounted


@njit(cache=True, forceinline=True)
def _on_raster(x, y, shape, per_mm):
    """Whether a source point lies on the source, and the pixels around it, see ``clamped_cell``."""
    rows, columns = shape
    right, down = x * per_mm, -y * per_mm
    inside = not (abs(right) > 0.5 * columns or abs(down) > 0.5 * rows)
    ix, iy, fx, fy = clamped_cell(right + 0.5 * columns - 0.5, down + 0.5 * rows - 0.5, columns, rows)
    return inside, ix, iy, fx, fy


@njit(cache=True, nogil=True)
def _average_part(part, hits, source, per_mm, out):
    """Part of the rows, see ``average_samples``; sums stay in registers, which loops over channels would not allow."""
    hits, source, out = uncounted(hits), uncounted(source), uncounted(out)
    rows, columns, channels = source.shape
    values = source.reshape(-1)
    _, width, samples, _ = hits.shape
    for i in range(part.first, part.end):
        for j in range(width):
            red = green = blue = np.float32(0)
            for k in range(samples):
                weight = hits[i, j, k, 2] / np.float32(samples)
                inside, ix, iy, fx, fy = _on_raster(hits[i, j, k, 0], hits[i, j, k, 1], (rows, columns), per_mm)
                if weight == 0.0 or not inside:
                    continue
                light = weighted_light(values, columns, channels, iy, ix, fx, fy, weight)
                red, green, blue = red + light[0], green + light[1], blue + light[2]
            out[i, j, 0] = red
            if channels == 3:
                out[i, j, 1], out[i, j, 2] = green, blue


def average_samples(hits: FloatArray, source: FloatArray, per_mm: float) -> FloatArray:
    """Pictures from traced samples: the mean over a pixel's samples of ``transmission * source at the sample``.

    Args:
        hits: (R, R, S, 3) float32 source point x, y, mm, and transmission of every sample; lens frame.
        source: (H, W, C) float32 linear light, lens frame; C is 1 or 3.
        per_mm: source pixels per mm.

    Returns:
        (R, R, C) float32 linear light.
    """
    out = np.empty((*hits.shape[:2], source.shape[2]), np.float32)
    in_threads(_average_part, len(out), hits, source, per_mm, out)
    return out


@njit(cache=True, nogil=True)
def _gather_part(part, hits, shape, per_mm, pointers, index, share):
    """Part of the rows, see ``gather_shares``."""
    columns = shape[1]
    _, width, samples, _ = hits.shape
    found, weights = np.zeros(4 * samples, np.int32), np.zeros(4 * samples)
    for i in range(part.first, part.end):
        for j in range(width):
            count = 0
            for k in range(samples):
                weight = hits[i, j, k, 2] / samples
                inside, ix, iy, fx, fy = _on_raster(hits[i, j, k, 0], hits[i, j, k, 1], shape, per_mm)
                if weight == 0.0 or not inside:
                    continue
                for corner in range(4):
                    right, below = corner & 1, corner >> 1
                    part = weight * (fx if right else 1.0 - fx) * (fy if below else 1.0 - fy)
                    if part > 0.0:
                        count = _add(found, weights, count, (iy + below) * columns + ix + right, part)
            pixel = i * width + j
            if len(index) == 0:
                pointers[pixel + 1] = count
            else:
                first = pointers[pixel]
                for n in range(count):
                    index[first + n], share[first + n] = found[n], weights[n]


def gather_shares(
    hits: FloatArray, shape: tuple[int, int], per_mm: float, pointers: IntArray, index: IntArray, share: FloatArray
) -> None:  # fmt: skip
    """The rows of a sparse matrix: which source pixels each pixel of the picture draws from, and how much.

    A first call, without room for entries, leaves each picture pixel's number of them in ``pointers[1:]``; with these
    added up, a second call fills ``index`` and ``share``.

    Args:
        hits: (R, R, S, 3) float32 source point x, y, mm, and transmission of every sample; lens frame.
        shape: rows and columns of the source.
        per_mm: source pixels per mm.
        pointers: (R * R + 1,) int32, where each picture pixel's entries start.
        index: (entries,) int32 row-major indices of source pixels, or of length 0.
        share: (entries,) float32 shares of these pixels, or of length 0.
    """
    in_threads(_gather_part, len(hits), hits, shape, per_mm, pointers, index, share)


@njit(cache=True)
def _add(found, weights, count, pixel, part):
    """Add to a pixel's weight in a list of ``count`` different pixels; returns how many there are then."""
    for n in range(count - 1, -1, -1):
        if found[n] == pixel:
            weights[n] += part
            return count
    found[count], weights[count] = pixel, part
    return count + 1


@njit(cache=True, nogil=True)
def _meet_part(part, rays, turn, move, hits):
    """Part of the rows, see ``meet_sheet``."""
    _, width, samples, _ = rays.shape
    for i in range(part.first, part.end):
        for j in range(width):
            for k in range(samples):
                x, y, along_x, along_y = rays[i, j, k, 0], rays[i, j, k, 1], rays[i, j, k, 3], rays[i, j, k, 4]
                height = turn[2, 0] * x + turn[2, 1] * y + move[2]
                fall = turn[2, 2] - turn[2, 0] * along_x - turn[2, 1] * along_y
                for axis in range(2):
                    at = turn[axis, 0] * x + turn[axis, 1] * y + move[axis]
                    way = turn[axis, 0] * along_x + turn[axis, 1] * along_y - turn[axis, 2]
                    hits[i, j, k, axis] = at + way * (height / fall)
                hits[i, j, k, 2] = rays[i, j, k, 2]


def meet_sheet(rays: FloatArray, turn: FloatArray, move: FloatArray) -> FloatArray:
    """Where rays below a lens meet a sheet.

    Args:
        rays: (R, R, S, 5) as of ``trace_rays``, lens frame.
        turn: (3, 3), with ``move`` from the lens frame to that of the sheet, which is z = 0 there.
        move: (3,) mm.

    Returns:
        (R, R, S, 3) float32: x and y on the sheet, mm, and transmission.
    """
    hits = np.empty((*rays.shape[:3], 3), np.float32)
    in_threads(_meet_part, len(hits), rays, turn, move, hits)
    return hits
