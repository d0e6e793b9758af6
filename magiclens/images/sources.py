"""Generated sources: random discs."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.images.colour import to_linear

BLACK_AND_WHITE = ((0.0,), (1.0,))
"""Linear light of black and white, the default inks of ``circles``."""

COLOURED = tuple(
    tuple(to_linear(np.array(rgb) / 255).tolist())
    for rgb in (
        (20, 20, 24),
        (255, 255, 255),
        (214, 40, 40),
        (247, 127, 0),
        (252, 211, 77),
        (42, 157, 84),
        (29, 120, 200),
        (106, 60, 160),
    )
)
"""Linear light of a small palette: black, white, red, orange, yellow, green, blue, violet."""


def inks(colours: str | Sequence[str]) -> Sequence[Sequence[float]]:
    """Linear light of inks: ``black-and-white``, ``coloured``, or sRGB values such as ``#d62828``.

    Returns:
        For each ink its C values; C is 1 if none of them is coloured, else 3.

    Raises:
        ValueError: A colour is none.
    """
    if isinstance(colours, str):
        return COLOURED if colours == "coloured" else BLACK_AND_WHITE
    if not all(re.fullmatch("#[0-9a-fA-F]{6}", each) for each in colours):
        raise ValueError("a colour is a number sign and six digits, such as #d62828")
    rgb = np.array([list(bytes.fromhex(each[1:])) for each in colours])
    if (rgb == rgb[:, :1]).all():
        rgb = rgb[:, :1]
    return [tuple(each) for each in to_linear(rgb / 255).tolist()]


def circles(
    size_mm: float,
    px_per_mm: float,
    rng: np.random.Generator,
    radius_mm: tuple[float, float] = (0.5, 2.5),
    colours: Sequence[Sequence[float]] = BLACK_AND_WHITE,
    layers: float = 4.0,
) -> FloatArray:
    """Draw random discs, one over the other, on white paper (the dead leaves model); edges are anti-aliased.

    White discs over black ones leave the paper half dark, with large plain areas of both kinds and fine slivers.

    Args:
        size_mm: Side of the source.
        px_per_mm: Resolution.
        rng: Randomness.
        radius_mm: Smallest and largest radius; radii are uniform in between.
        colours: Linear light, C values each; every disc takes one at random.
        layers: How many discs cover a point on average.

    Returns:
        (S, S, C) float32, linear light.
    """
    side = round(size_mm * px_per_mm)
    lo, hi = radius_mm[0] * px_per_mm, radius_mm[1] * px_per_mm
    count = disc_count(side, lo, hi, layers)
    centres = rng.uniform(-hi, side + hi, (count, 2))
    radii, inks = rng.uniform(lo, hi, count), rng.integers(len(colours), size=count)
    paper = np.ones((side, side, len(colours[0])), np.float32)
    palette = np.asarray(colours, np.float32)
    for (y, x), radius, ink in zip(centres.tolist(), radii.tolist(), inks.tolist(), strict=True):
        _drop(paper, y, x, radius, palette[ink])
    return paper


def disc_count(side: float, lo: float, hi: float, layers: float) -> int:
    """How many discs ``circles`` draws on a square; side and radii in the same unit."""
    mean_area = np.pi * (lo * lo + lo * hi + hi * hi) / 3
    return round(layers * (side + 2 * hi) ** 2 / mean_area)


def _drop(paper: FloatArray, y: float, x: float, radius: float, ink: FloatArray) -> None:
    """Paint one disc, lengths in pixels; a pixel's coverage, 0 to 1, is how far its centre lies inside the rim."""
    top, left = max(int(y - radius) - 1, 0), max(int(x - radius) - 1, 0)
    window = paper[top : max(int(y + radius) + 2, 0), left : max(int(x + radius) + 2, 0)]
    rows, columns = window.shape[:2]
    dy = (np.arange(rows) + (top + 0.5 - y))[:, None]
    dx = (np.arange(columns) + (left + 0.5 - x))[None, :]
    cover = np.clip(radius + 0.5 - np.hypot(dy, dx), 0.0, 1.0)[..., None]
    window += cover * (ink - window)
