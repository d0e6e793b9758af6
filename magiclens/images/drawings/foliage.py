"""Leaves, blossoms and berries of every hue: a source in which any colour picture can be hidden."""

from __future__ import annotations

import numpy as np

from magiclens.images.drawings.plants import leaf, petal
from magiclens.images.vector import Layer, brush, ellipse, fill, hsv, placed, radial_gradient, rectangle, shifted

_LEAVES, _BLOSSOMS, _BERRIES = 900, 70, 45


def foliage() -> list[Layer]:
    """Layers of plants from dark to white, with fine veins; large leaves are below small ones."""
    rng = np.random.default_rng(21)
    leaves = [_leaf(rng, size) for size in np.geomspace(26, 5, _LEAVES)]
    blossoms = [_blossom(rng) for _ in range(_BLOSSOMS)]
    berries = [_berries(rng) for _ in range(_BERRIES)]
    low, high = leaves[: _LEAVES // 2] + blossoms[: _BLOSSOMS // 2], leaves[_LEAVES // 2 :] + blossoms[_BLOSSOMS // 2 :]
    ground = fill("#0b1410", rectangle(0, 0, 100, 100))
    return [ground, *(layer for plant in low + high + berries for layer in plant)]


def _leaf(rng: np.random.Generator, size: float) -> list[Layer]:
    """A leaf anywhere, of any hue, with a shadow and pale or dark veins."""
    x, y, degrees = (*rng.uniform(-6, 106, 2), rng.uniform(0, 360))
    hue, value, saturation, width = rng.uniform((0, 0.25, 0.35, 0.7), (1, 1, 1, 1.3))
    wide = leaf().outline * (width, 1)
    codes = _leaf_colours(hue, saturation, value)
    veins = hsv(hue + 0.1, 0.25, 1) if rng.uniform() < 0.6 else hsv(hue, 1, 0.2)
    return [
        fill("#000000", placed(wide, x + size / 40, y + size / 25, size * 1.03, degrees), opacity=0.4),
        fill(radial_gradient((x, y), size, *codes), placed(wide, x, y, size, degrees)),
        fill(veins, *leaf().placed(x, y, size, degrees).veins, opacity=0.6),
    ]


def _leaf_colours(hue: float, saturation: float, value: float) -> tuple[str, str, str]:
    """Colours from a leaf's root to its tip."""
    middle = hsv(hue + 0.03, saturation, value)
    return hsv(hue, saturation, 0.45 * value), middle, hsv(hue + 0.08, 0.6 * saturation, 1.15 * value)


def _blossom(rng: np.random.Generator) -> list[Layer]:
    """A small blossom with five to eight petals."""
    x, y, start, size = (*rng.uniform(0, 100, 2), rng.uniform(0, 90), rng.uniform(2, 5.5))
    hue, pale, count = rng.uniform(), rng.choice([0.0, 0.25, 0.85]), int(rng.integers(5, 9))
    paint = radial_gradient((x, y), size, hsv(hue, pale + 0.3, 0.75), hsv(hue, pale, 1))
    petals = [placed(petal().outline * (1.5, 1), x, y, size, start + k * 360 / count) for k in range(count)]
    rims = [fill("#30182a", brush(outline, 0.12), opacity=0.5) for outline in petals]
    middle = radial_gradient((x, y), size / 4, "#fff2a0", "#f0a018", "#8a4a08")
    return [
        fill("#000000", *(shifted(outline, 0.2, 0.3) for outline in petals), opacity=0.4),
        *(layer for rim, outline in zip(rims, petals, strict=True) for layer in (rim, fill(paint, outline))),
        fill(middle, ellipse(x, y, size / 4)),
    ]


def _berries(rng: np.random.Generator) -> list[Layer]:
    """A cluster of glossy berries of one hue."""
    middle, hue = rng.uniform(0, 100, 2), rng.choice([0.0, 0.1, 0.6, 0.75, 0.95])
    return [layer for x, y in rng.normal(middle, 1.5, (7, 2)) for layer in _berry(x, y, hue)]


def _berry(x: float, y: float, hue: float) -> list[Layer]:
    """One berry with its gleam."""
    light = radial_gradient((x - 0.3, y - 0.3), 1.3, hsv(hue, 0.5, 1), hsv(hue, 1, 0.7), hsv(hue, 1, 0.2))
    return [fill(light, ellipse(x, y, 1)), fill("#ffffff", ellipse(x - 0.35, y - 0.35, 0.25))]
