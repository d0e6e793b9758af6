"""The lens's top in the light: shaded from its heights or slopes, as a photograph of a matt cast would show it."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray, HeightField

LIGHT = np.array([-0.53, 0.53, 0.66], np.float32)
"""Unit vector toward the lamp, at the upper left."""
HALFWAY = np.array([-0.29, 0.29, 0.91], np.float32)
"""Unit vector halfway between lamp and eye: surfaces that face it gleam."""
ELEVATIONS_DEG = (26.0, 34.0, 42.0)
"""Of the lamp's rim and middle: the lamp is large, so shadows have soft edges."""
SKY, LAMP = np.array([0.030, 0.050, 0.085], np.float32), np.array([0.60, 0.64, 0.68], np.float32)


def sample_heights(field: HeightField, side: int) -> FloatArray:
    """(side, side) float32 mm above the reference plane at the pixels of the lens's square, row 0 at +y."""
    lens = field.lens
    n, m = lens.facets, lens.microfacets
    x = (np.arange(side) + 0.5) / side * n
    facet = x.astype(int)
    wall = lens.wall_mm / lens.pitch_mm
    within = np.clip((x - facet - wall / 2) / (1 - wall), 0, 1) * m
    cell = np.minimum(within.astype(int), m - 1)
    line, part = facet * (m + 1) + cell, (within - cell).astype(np.float32)
    grid = field.heights_mm.transpose(0, 2, 1, 3).reshape(n * (m + 1), -1).astype(np.float32)
    rows = grid[line] * (1 - part)[:, None] + grid[line + 1] * part[:, None]
    return np.asarray(rows[:, line] * (1 - part) + rows[:, line + 1] * part, np.float32)


def relief(heights: FloatArray, pixel_mm: float) -> FloatArray:
    """(S, S, 3) float32, linear light: a surface (S, S) of heights in mm, lit from the upper left, shadows included."""
    down, right = np.gradient(heights, np.float32(pixel_mm))
    return shaded(np.stack([right, -down], axis=-1), shadow(heights, pixel_mm))


def shaded(slopes: FloatArray, shadows: FloatArray | float = 0.0) -> FloatArray:
    """(S, S, 3) float32, linear light: a surface with slopes (S, S, 2) dz/dx, dz/dy.

    shadows: (S, S), 1 where none of the lamp is seen.
    """
    dx, dy = np.moveaxis(slopes.astype(np.float32), -1, 0)
    up = 1 / np.sqrt(1 + dx**2 + dy**2)
    lamp = np.clip((LIGHT[2] - LIGHT[0] * dx - LIGHT[1] * dy) * up, 0, 1) * (1 - 0.8 * np.float32(shadows))
    gloss = np.clip((HALFWAY[2] - HALFWAY[0] * dx - HALFWAY[1] * dy) * up, 0, 1) ** 48 * (1 - np.float32(shadows))
    sky = 1 - 0.8 * dy * up
    return np.asarray(sky[..., None] * SKY + lamp[..., None] * LAMP + 0.35 * gloss[..., None], np.float32)


def shadow(heights: FloatArray, pixel_mm: float) -> FloatArray:
    """(S, S) float32: the part of the lamp, 0 none to 1 all, that the surface hides from its points.

    Walks along the diagonals, away from the lamp, with the edge of the shadow that everything passed so far casts.
    """
    hidden = np.zeros_like(heights)
    for elevation in ELEVATIONS_DEG:
        drop = np.float32(np.sqrt(2) * pixel_mm * np.tan(np.radians(elevation)))
        edge = heights[0].copy()
        for r in range(1, len(heights)):
            edge[1:] = np.maximum(heights[r, 1:], edge[:-1] - drop)
            edge[0] = heights[r, 0]
            hidden[r] += np.clip((edge - heights[r]) / np.float32(3 * pixel_mm), 0, 1)
    return hidden / np.float32(len(ELEVATIONS_DEG))
