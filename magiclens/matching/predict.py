"""What the eye would see if every facet realised its transformation exactly: the bound that matching sets."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from magiclens.artifacts import Assignment, FloatArray, Scene, View
from magiclens.images import score


def predict(scene: Scene, assignment: Assignment, resolution: int = 512, samples: int = 3) -> list[FloatArray]:
    """One (R, R, C) float32 picture per view, linear light, world frame; samples^2 source look-ups per pixel."""
    lens = scene.lens
    centres = lens.facet_centres_mm() * (1, -1)
    offsets = assignment.offsets_mm * (1, -1)
    maps = assignment.maps * (1, -1, 1)

    def picture(view: View) -> FloatArray:
        source = view.in_lens_frame().source
        per_mm = source.shape[1] / lens.source_size_mm
        seen = _predict(source, per_mm, centres, offsets, maps, lens.size_mm, resolution, samples)
        return np.ascontiguousarray(np.rot90(seen, view.quarter_turns))

    return [picture(view) for view in scene.views]


def bound_psnr_db(scene: Scene, assignment: Assignment) -> float:
    """Mean PSNR over the views of the ideal pictures ``predict`` gives, against their targets."""
    pictures = predict(scene, assignment)
    return float(np.mean([score(p, v.target).psnr_db for p, v in zip(pictures, scene.views, strict=True)]))


@njit(cache=True, parallel=True)
def _predict(source, per_mm, centres, offsets, maps, size, resolution, samples):
    rows, columns, channels = source.shape
    facets = len(centres)
    out = np.zeros((resolution, resolution, channels), np.float32)
    sub = size / (resolution * samples)
    for r in prange(resolution):
        for c in range(resolution):
            for k in range(samples * samples):
                x = (c * samples + k % samples + 0.5) * sub
                y = (r * samples + k // samples + 0.5) * sub
                j, i = min(int(x / size * facets), facets - 1), min(int(y / size * facets), facets - 1)
                cx, cy = centres[i, j, 0], centres[i, j, 1]
                u, v = x - size / 2 - cx, y - size / 2 - cy
                m = maps[i, j]
                sx = (cx + offsets[i, j, 0] + m[0] * u + m[1] * v) * per_mm + columns / 2 - 0.5
                sy = (cy + offsets[i, j, 1] + m[1] * u + m[2] * v) * per_mm + rows / 2 - 0.5
                sx, sy = min(max(sx, 0.0), columns - 1.001), min(max(sy, 0.0), rows - 1.001)
                ix, iy = int(sx), int(sy)
                fx, fy = sx - ix, sy - iy
                for ch in range(channels):
                    top = source[iy, ix, ch] * (1 - fx) + source[iy, ix + 1, ch] * fx
                    low = source[iy + 1, ix, ch] * (1 - fx) + source[iy + 1, ix + 1, ch] * fx
                    out[r, c, ch] += (top * (1 - fy) + low * fy) / (samples * samples)
    return out
