"""Kernels of dart throwing: what facets can show of which sub-regions, and drawing again by heat bath."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray, IntArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.threads import in_threads
from magiclens.matching.reachability_kernels import least_upright
from magiclens.optics.medium import Optics
from magiclens.optics.refraction import facet_normal
from magiclens.optics.walls import Edges, best_height, surroundings

_ROUNDS = 4
"""Iterations of slopes and heights, which depend on each other."""


class Labels(NamedTuple):
    """What each facet may draw: a sub-region together with a map.

    Args:
        regions: (N, N, K) number of a label's sub-region.
        usable: (N, N, K) whether the facet can show it.
        edges: (N, N, K, 4, Q) edges of the lenslets that do.
    """

    regions: IntArray
    usable: BoolArray
    edges: Edges


@njit(cache=True, nogil=True)
def _regions_reachable_part(part, centres, offsets, maps, half, optics, out):
    """Part of the facets, see ``regions_reachable``."""
    for f in range(part.first, part.end):
        cx, cy = centres[f, 0], centres[f, 1]
        for k in range(len(offsets)):
            rx, ry = offsets[k, 0], offsets[k, 1]
            for s in range(4):
                out[f, k, s] = least_upright(
                    (cx, cy), (rx, ry), (maps[s, 0], 0.0, maps[s, 1]), half, optics
                ) >= 0.0 and optics.relief >= _tallest((cx, cy), (rx, ry), (maps[s, 0], maps[s, 1]), half, optics)


def regions_reachable(
    centres: FloatArray, offsets: FloatArray, maps: FloatArray, pitch: float, optics: Optics
) -> BoolArray:  # fmt: skip
    """(F, D^2, 4) bool: can a facet show its neighbouring sub-regions with each map, below slope limit and relief?

    Args:
        centres: (F, 2) of the facets, mm, image frame (y down).
        offsets: (D^2, 2) of the sub-regions from the facet, mm.
        maps: (4, 2) xx and yy.
        pitch: side of a facet, mm.
        optics: ``Optics`` in the image frame.
    """
    out = np.zeros((len(centres), len(offsets), 4), np.bool_)
    in_threads(_regions_reachable_part, len(centres), centres, offsets, maps, 0.5 * pitch, optics, out)
    return out


@njit(cache=True)
def _tallest(centre, offset, m, half, optics):
    """How far the corners of a lenslet rise or fall from its mean, mm.

    ``h_k = (g_4 + g_k) / 2 . p_k - mean(h) / 3`` with the slopes g_k at the corners p_k and g_4 at the centre. Where
    the surface is lower, it must be steeper: the heights at which slopes are taken are iterated.
    """
    (cx, cy), (rx, ry), (xx, yy), eye = centre, offset, m, optics.eye
    far = eye[2] - optics.depth
    slopes, rises = np.zeros((5, 2)), np.zeros(5)
    for _ in range(_ROUNDS):
        for k in range(5):
            px = 0.0 if k == 4 else (half if k & 1 else -half)
            py = 0.0 if k == 4 else (half if k & 2 else -half)
            x, y, z = cx + px, cy + py, optics.depth + rises[k]
            lean_x, lean_y = (0.0, 0.0) if optics.vertical else ((x - eye[0]) / far, (y - eye[1]) / far)
            sx, sy = x + rx + (xx - 1.0) * px, y + ry + (yy - 1.0) * py
            nx, ny, nz = facet_normal(eye, (x - lean_x * rises[k], y - lean_y * rises[k], z), (sx, sy), optics)
            along = nx * lean_x + ny * lean_y - nz
            slopes[k, 0], slopes[k, 1] = nx / along, ny / along
        for k in range(4):
            px, py = half if k & 1 else -half, half if k & 2 else -half
            rises[k] = 0.5 * ((slopes[4, 0] + slopes[k, 0]) * px + (slopes[4, 1] + slopes[k, 1]) * py)
        # the mean of a quadratic over the square is a third of its mean over the corners
        rises[4] = 0.0
        rises -= rises[:4].mean() / 3.0
    return np.abs(rises).max()


@njit(cache=True)
def _place(i, j, k, edges, placed):
    """Note the edges of the label that a facet has; placed: (N, N, 4, Q)."""
    for e in range(4):
        for q in range(edges.profiles.shape[4]):
            placed.profiles[i, j, e, q] = edges.profiles[i, j, k, e, q]
            placed.drifts[i, j, e, q] = edges.drifts[i, j, k, e, q]


@njit(cache=True)
def draw_again(chosen, owner, labels, turns, dice, temperature, terms, relief):
    """Sweeps over all facets; each draws anew among the labels whose sub-region is free or its own, in place.

    ``P(k) ~ exp(-E_k / temperature)`` with the energy of a label at its best height, see ``walls.best_height``.

    Args:
        chosen: (N, N) label of each facet, updated in place.
        owner: (R,) facet that has a sub-region, or -1, updated in place.
        labels: what facets may draw.
        turns: (S, N * N) the facets in the order of their turns, sweep by sweep.
        dice: (S, N * N) random numbers in [0, 1).
        temperature: of the heat bath, as a share of a facet's light.
        terms: what steps between facets cost.
        relief: how far the top may rise or fall from the reference plane, mm.
    """
    regions, usable, edges = labels
    n = len(chosen)
    heights, shape = np.zeros((n, n)), (n, n, 4, edges.profiles.shape[4])
    placed = Edges(np.zeros(shape, np.float32), np.zeros(shape, np.float32))
    for i in range(n):
        for j in range(n):
            _place(i, j, chosen[i, j], edges, placed)
    around = np.zeros((4, shape[3] + 1, 2))
    energy, level = np.zeros(regions.shape[2]), np.zeros(regions.shape[2])
    for s in range(len(turns)):
        for t in range(n * n):
            f = turns[s, t]
            i, j = f // n, f % n
            surroundings(i, j, heights, placed, around)
            for k in range(len(energy)):
                energy[k] = np.inf
                own = Edges(edges.profiles[i, j, k], edges.drifts[i, j, k])
                room = relief - np.abs(own.profiles).max()
                taken = owner[regions[i, j, k]] >= 0 and owner[regions[i, j, k]] != f
                if usable[i, j, k] and not taken and room >= 0.0:
                    level[k], energy[k] = best_height(own, around, terms, -room, room)
            if np.isfinite(energy.min()):
                k = _pick(energy, temperature, dice[s, t])
                owner[regions[i, j, chosen[i, j]]] = -1
                owner[regions[i, j, k]] = f
                chosen[i, j], heights[i, j] = k, level[k]
                _place(i, j, k, edges, placed)


@njit(cache=True)
def _pick(energy, temperature, die):
    """A label by the heat bath; ``die`` in [0, 1) is luck. ``energy`` is overwritten."""
    energy[:] = np.exp((energy.min() - energy) / temperature)
    left = die * energy.sum()
    last = 0
    for k in range(len(energy)):
        if energy[k] > 0.0:
            left -= energy[k]
            last = k
            if left < 0.0:
                break
    return last
