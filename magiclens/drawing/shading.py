"""The top of the lens in slanting light: shaded like a photograph of a matt cast."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray, HeightField

_LAMP_DIRECTION = np.array([-0.53, 0.53, 0.66], np.float32)
"""Unit vector toward the lamp, which is at the upper left."""
_HALFWAY = np.array([-0.29, 0.29, 0.91], np.float32)
"""Unit vector halfway between lamp and eye: surfaces with this normal reflect the lamp into the eye."""
_LAMP_ELEVATIONS_DEG = (26.0, 34.0, 42.0)
"""Elevations of the lower rim, the middle and the upper rim of the lamp; a large lamp gives shadows soft edges."""
_SKY_COLOUR = np.array([0.030, 0.050, 0.085], np.float32)
"""Linear RGB of the light from all around."""
_LAMP_COLOUR = np.array([0.60, 0.64, 0.68], np.float32)
"""Linear RGB of the light from the lamp."""


def sample_heights(field: HeightField, side: int) -> FloatArray:
    """Sample the top of the lens at the pixels of its square.

    Args:
        field: Heights on the grid of the micro-facets' corners.
        side: Pixels along one side.

    Returns:
        (side, side) float32 mm above the reference plane, row 0 at +y.
    """
    lens = field.lens
    n, m = lens.facets, lens.microfacets
    x = (np.arange(side) + 0.5) / side * n
    facet = x.astype(int)
    wall = lens.wall_mm / lens.pitch_mm
    # a pixel on the wall gets the height of the facet's edge
    within = np.clip((x - facet - wall / 2) / (1 - wall), 0, 1) * m
    cell = np.minimum(within.astype(int), m - 1)
    line, part = facet * (m + 1) + cell, (within - cell).astype(np.float32)
    grid = field.heights_mm.transpose(0, 2, 1, 3).reshape(n * (m + 1), -1).astype(np.float32)
    rows = grid[line] * (1 - part)[:, None] + grid[line + 1] * part[:, None]
    return np.asarray(rows[:, line] * (1 - part) + rows[:, line + 1] * part, np.float32)


def shade_heights(heights: FloatArray, pixel_mm: float) -> FloatArray:
    """Light a surface from the upper left, shadows included.

    Args:
        heights: (S, S) mm, row 0 at +y.
        pixel_mm: Width of a pixel.

    Returns:
        (S, S, 3) float32, linear light.
    """
    down, right = np.gradient(heights, np.float32(pixel_mm))
    return shade_slopes(np.stack([right, -down], axis=-1), hidden_share(heights, pixel_mm))


def shade_slopes(slopes: FloatArray, shadows: FloatArray | float = 0.0) -> FloatArray:
    """Light a surface that is known by its slopes.

    Args:
        slopes: (S, S, 2) dz/dx and dz/dy.
        shadows: (S, S) share of the lamp that is hidden, 0 none to 1 all.

    Returns:
        (S, S, 3) float32, linear light.
    """
    dx, dy = np.moveaxis(slopes.astype(np.float32), -1, 0)
    up = 1 / np.sqrt(1 + dx**2 + dy**2)
    lamp = np.clip((_LAMP_DIRECTION[2] - _LAMP_DIRECTION[0] * dx - _LAMP_DIRECTION[1] * dy) * up, 0, 1)
    lamp = lamp * (1 - 0.8 * np.float32(shadows))
    gloss = np.clip((_HALFWAY[2] - _HALFWAY[0] * dx - _HALFWAY[1] * dy) * up, 0, 1)
    for _ in range(4):
        gloss *= gloss
    gloss = gloss**3 * (1 - np.float32(shadows))  # to the power of 48, by far faster than NumPy's own
    # surfaces that face the top of the picture get more light from the sky
    sky = 1 - 0.8 * dy * up
    light = sky[..., None] * _SKY_COLOUR + lamp[..., None] * _LAMP_COLOUR + 0.35 * gloss[..., None]
    return np.asarray(light, np.float32)


def hidden_share(heights: FloatArray, pixel_mm: float) -> FloatArray:
    """How much of the lamp the surface hides from each of its points.

    Goes along the diagonals, away from the lamp, and carries the upper edge of the shadow of all points passed so far.

    Args:
        heights: (S, S) mm, row 0 at +y.
        pixel_mm: Width of a pixel.

    Returns:
        (S, S) float32, 0 where all of the lamp is visible, 1 where none is.
    """
    hidden = np.zeros_like(heights)
    for elevation in _LAMP_ELEVATIONS_DEG:
        drop = np.float32(np.sqrt(2) * pixel_mm * np.tan(np.radians(elevation)))
        edge = heights[0].copy()
        for r in range(1, len(heights)):
            edge[1:] = np.maximum(heights[r, 1:], edge[:-1] - drop)
            edge[0] = heights[r, 0]
            hidden[r] += np.clip((edge - heights[r]) / np.float32(3 * pixel_mm), 0, 1)
    return hidden / np.float32(len(_LAMP_ELEVATIONS_DEG))
