"""What the eye would see if every facet realised its transformation exactly: the bound that matching sets."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from magiclens.contract.artifacts import Assignment, FloatArray, Scene, View
from magiclens.geometry.facets import patches_seen
from magiclens.images import score
from magiclens.kernels.sampling import place


def predict(
    scene: Scene, assignment: Assignment, resolution: int = 512, samples: int = 4, heights_mm: FloatArray | None = None
) -> list[FloatArray]:
    """One (R, R, C) float32 picture per view, linear light, world frame; samples^2 source look-ups per pixel.

    heights_mm: (N, N), where facets stand (see ``facets.patches_seen``); None is the reference plane.
    """
    return [predict_view(scene, assignment, view, resolution, samples, heights_mm) for view in scene.views]


def predict_view(
    scene: Scene, assignment: Assignment, view: View, resolution: int = 512, samples: int = 4,
    heights_mm: FloatArray | None = None,
) -> FloatArray:  # fmt: skip
    """(R, R, C) float32: the picture of one view, see ``predict``."""
    local = view.in_lens_frame()
    patches = patches_seen(scene, assignment, local.eye_mm, heights_mm)
    flip = np.array([1, -1])
    turn = np.outer(flip, flip)
    inward = np.linalg.inv(np.where(np.isfinite(patches.shears), patches.shears, np.eye(2)))
    seen = _predict(
        local.source, local.source.shape[1] / scene.lens.source_size_mm, patches.landings_mm * flip,
        patches.maps * turn, patches.places_mm * flip, inward * turn, scene.lens.size_mm, resolution, samples,
    )  # fmt: skip
    return np.ascontiguousarray(np.rot90(seen, view.quarter_turns))


def bound_psnr_db(scene: Scene, assignment: Assignment, heights_mm: FloatArray | None = None) -> float:
    """Mean PSNR over the views of the ideal pictures ``predict`` gives, against their targets."""
    pictures = predict(scene, assignment, heights_mm=heights_mm)
    return float(np.mean([score(p, v.target).psnr_db for p, v in zip(pictures, scene.views, strict=True)]))


@njit(cache=True)
def _at_facet(places, inward, i, j, x, y):
    """The point of facet (i, j) that is seen at (x, y)."""
    u, v, m = x - places[i, j, 0], y - places[i, j, 1], inward[i, j]
    return m[0, 0] * u + m[0, 1] * v, m[1, 0] * u + m[1, 1] * v


@njit(cache=True)
def _facet(places, inward, size, x, y):
    """The facet seen at (x, y) from the picture's corner, and the point of it: the facet that belongs there, unless it
    has moved away and a neighbour has taken its place."""
    facets = len(places)
    half = 0.5 * size / facets + 1e-9
    j, i = min(int(x / size * facets), facets - 1), min(int(y / size * facets), facets - 1)
    x, y = x - size / 2, y - size / 2
    u, v = _at_facet(places, inward, i, j, x, y)
    if abs(u) > half or abs(v) > half:
        near_j = min(max(j + (u > half) - (u < -half), 0), facets - 1)
        near_i = min(max(i + (v > half) - (v < -half), 0), facets - 1)
        a, b = _at_facet(places, inward, near_i, near_j, x, y)
        if abs(a) <= half and abs(b) <= half:
            return near_i, near_j, a, b
    return i, j, u, v


@njit(cache=True, parallel=True)
def _predict(source, per_mm, landings, maps, places, inward, size, resolution, samples):
    rows, columns, channels = source.shape
    out = np.zeros((resolution, resolution, channels), np.float32)
    pixel = size / resolution
    for r in prange(resolution):
        for c in range(resolution):
            for k in range(samples * samples):
                right, down = place(k, samples)
                i, j, u, v = _facet(places, inward, size, (c + right) * pixel, (r + down) * pixel)
                at, m = landings[i, j], maps[i, j]
                if math.isnan(at[0]):
                    continue
                sx = (at[0] + m[0, 0] * u + m[0, 1] * v) * per_mm + columns / 2 - 0.5
                sy = (at[1] + m[1, 0] * u + m[1, 1] * v) * per_mm + rows / 2 - 0.5
                if not (-0.5 <= sx <= columns - 0.5 and -0.5 <= sy <= rows - 0.5):
                    continue  # beside the source it is dark
                sx, sy = min(max(sx, 0.0), columns - 1.001), min(max(sy, 0.0), rows - 1.001)
                ix, iy = int(sx), int(sy)
                fx, fy = sx - ix, sy - iy
                for ch in range(channels):
                    top = source[iy, ix, ch] * (1 - fx) + source[iy, ix + 1, ch] * fx
                    low = source[iy + 1, ix, ch] * (1 - fx) + source[iy + 1, ix + 1, ch] * fx
                    out[r, c, ch] += (top * (1 - fy) + low * fy) / (samples * samples)
    return out
