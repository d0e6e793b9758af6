"""A large blossom in rose and apricot before a hazy garden."""

from __future__ import annotations

import numpy as np

from magiclens.images.drawings.plants import leaf, petal
from magiclens.images.vector import (
    Layer,
    ellipse,
    fill,
    hsv,
    linear_gradient,
    placed,
    radial_gradient,
    rectangle,
    stroke,
)

_MIDDLE = (50.0, 45.0)
_LEAVES = ((52, 90, 46, 66), (50, 95, 44, -70), (50, 101, 24, 24))
_DEW = ((30, 27, 1.5), (70, 36, 1.9), (60, 17, 1.2), (34, 62, 1.7), (73, 58, 1.3))
_GOLDEN_ANGLE_DEG = 180 * (3 - 5**0.5)


def flower() -> list[Layer]:
    """Layers of the garden, stem and leaves, three whorls of petals, florets and dew."""
    return [
        fill(linear_gradient((0, 0), (30, 100), "#bfe3ea", "#8cc4b4", "#3f7f5f"), rectangle(0, 0, 100, 100)),
        *_haze(40),
        fill(linear_gradient((44, 60), (58, 60), "#8cbf4a", "#2f6b2a"), stroke("51,58 54,80 48,102", 3.4, 4.2)),
        *(layer for place in _LEAVES for layer in _garden_leaf(*place)),
        *_whorl(15, 43, 0, "#7a0f3c", "#d42a68", "#f47fa4", "#fde3ea"),
        *_whorl(13, 35, 9, "#8a1233", "#e24a5a", "#f79a86", "#ffe2cf"),
        *_whorl(11, 26, 20, "#9a2a1c", "#f0793f", "#fdc27a", "#fff0c8"),
        *_florets(330, 12.5),
        *(layer for drop in _DEW for layer in _drop(*drop)),
    ]


def _haze(count: int) -> list[Layer]:
    """Soft discs of light, out of focus."""
    rng = np.random.default_rng(3)
    discs = zip(rng.uniform(0, 100, (count, 2)), rng.uniform(2, 8, count), rng.uniform(0.1, 0.55, count), strict=True)
    return [fill(hsv(hue, 0.35, 1), ellipse(x, y, radius), opacity=0.22) for (x, y), radius, hue in discs]


def _garden_leaf(x: float, y: float, size: float, degrees: float) -> list[Layer]:
    """A leaf, lighter toward its tip."""
    blade = leaf().placed(x, y, size, degrees)
    light = radial_gradient((x, y), size, "#1f5a2a", "#4f9a3a", "#a5d05a")
    return [fill(light, blade.outline), fill("#dcefa0", *blade.veins, opacity=0.6)]


def _whorl(count: int, length: float, start: float, *codes: str) -> list[Layer]:
    """Petals about the blossom's middle, coloured from root to tip."""
    return [layer for k in range(count) for layer in _petal(length, start + k * 360 / count, codes)]


def _petal(length: float, degrees: float, codes: tuple[str, ...]) -> list[Layer]:
    """A petal with its shadow, a bright rim and veins."""
    x, y = _MIDDLE
    whole = petal().placed(x, y, length, degrees)
    return [
        fill("#4a0820", placed(petal().outline, x + 0.3, y + 0.6, length * 1.02, degrees + 1.5), opacity=0.35),
        fill(codes[-1], whole.outline),
        fill(radial_gradient(_MIDDLE, length, *codes), placed(petal().outline * (0.93, 0.985), x, y, length, degrees)),
        fill(codes[0], *whole.veins, opacity=0.35),
    ]


def _florets(count: int, radius: float) -> list[Layer]:
    """The blossom's middle: florets in a sunflower's spirals, orange at the rim, brown, then green within."""
    heart = fill(radial_gradient(_MIDDLE, radius + 1, "#6b5a14", "#4a2208", "#2a0d06"), ellipse(*_MIDDLE, radius + 0.8))
    return [heart, *(layer for k in range(count, 0, -1) for layer in _floret((k / count) ** 0.5, k, radius))]


def _floret(t: float, k: int, radius: float) -> list[Layer]:
    """The k-th floret, at the share t of the radius, with its gleam."""
    angle, size = np.radians(k * _GOLDEN_ANGLE_DEG), 0.32 + 0.24 * t
    x, y = _MIDDLE[0] + t * radius * np.cos(angle), _MIDDLE[1] + t * radius * np.sin(angle)
    shade = 0.65 if 0.4 < t < 0.7 else 0.95
    return [
        fill(hsv(0.06 + 0.16 * (1 - t), 0.9, shade), ellipse(x, y, size)),
        fill("#fff6cf", ellipse(x - size / 3, y - size / 3, size / 3)),
    ]


def _drop(x: float, y: float, r: float) -> list[Layer]:
    """A drop of water."""
    light = linear_gradient((x - r, y - r), (x + r, y + r), "#d66a86", "#ffd9e2", "#ffffff")
    return [
        fill("#5a1030", ellipse(x + 0.3, y + 0.5, r), opacity=0.35),
        fill(light, ellipse(x, y, r)),
        fill("#ffffff", ellipse(x - r / 2.4, y - r / 2.4, r / 4)),
    ]
