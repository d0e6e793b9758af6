"""A red farm truck full of fruit, on a country road at sunset."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.images.vector import (
    Layer,
    blob,
    brush,
    down,
    ellipse,
    fill,
    hsv,
    linear_gradient,
    mirrored,
    placed,
    polygon,
    radial_gradient,
    rectangle,
    shifted,
    stroke,
)

_MOUNTAINS = "-1,58 8,48 16,53 27,40 38,51 47,45 60,56 70,49 84,57 101,50 101,70 -1,70"
_SNOW = ("27,40 22.5,45.5 25,44.6 27,46.6 29,44.4 31.5,45.2", "47,45 44.5,46.8 46.6,46.6 48,48 49.6,46.9")
_MEADOW = "-5,62! 14,58 34,62 55,59 78,63 105,58! 105,80! -5,80!"
_FIELD = "-5,66! 20,63 50,65 80,62 105,65! 105,84! -5,84!"
_HALF_FIR = "0,-1 0.14,-0.68 0.08,-0.68 0.22,-0.36 0.12,-0.36 0.3,-0.06 0.05,-0.06 0.05,0 0,0"
_CLOUDS = ((16, 14, 1.0), (58, 9, 0.8), (84, 22, 1.1), (36, 25, 0.6))
_PUFFS = ((0, 0, 7, 3), (-6, 1, 5, 2.2), (6, 1, 6, 2.2), (-1, -2.4, 4, 2.6), (3.5, -1.8, 3.4, 2.2))
_BIRDS = ((30, 8), (36, 11), (41, 7), (70, 15))

_CAB = "50.5,78! 50.5,45! 52,37 57,33.5 66,33.2 71,36 76,50! 88,51.5 94.5,55 96.5,62 96.5,78!"
_WINDOWS = ("54,50.5! 54.2,42 57,37.5 61.5,36.6! 61.5,50.5!", "63.5,36.6! 67.5,37.2 70,41 73,50.5! 63.5,50.5!")
_REFLECTIONS = ("56,50 59.5,37.5 61,37.2 58,50", "65.5,50 67,38 68.6,39 67.8,50")
_SEAMS = ("62.5,35.5 62.5,76", "53,52.5 53,76", "53,76 62,76", "75.5,52 74.5,62 74,70", "53,52.3 75,52.3")
_GLEAMS = ("52.5,44 54,37.5 58,35 66,34.7 70,37", "77,51.6 87,53 93,56")
_FENDERS = ("62.5,78! 64,70 69,65.5 76,64.8 84,66 89,71 91,78!", "13,77! 15,70.5 20,66.8 27,66 34,66.8 39,70.5 41,77!")
_FENDER_GLEAMS = ("64.6,72 68.5,67 76,65.8 83,67", "15.5,71.5 20,68 27,67 33,67.8")
_WHEELS = ((27.0, 80.0), (76.0, 80.0))
_POSTS = (6.0, 19.5, 33.5, 47.6)
_PLANKS = (55.0, 60.4, 65.8)


def truck() -> list[Layer]:
    """Layers of the country, then of the truck from its load to its wheels."""
    wheels = [layer for wheel in _WHEELS for layer in _wheel(*wheel)]
    return [*_sky(), *_hills(), *_verge(), *_road(), *_heap(130), *_bed(), *_cab(), *_bonnet(), *_chrome(), *wheels]


def _sky() -> list[Layer]:
    """The setting sun with clouds and birds."""
    sun = radial_gradient((80, 45), 8.5, "#fffbe0", "#ffe27a", "#ffb03a")
    wings = "-2,-1 -1,-1.4 0,0 1,-1.4 2,-1"
    return [
        fill(down(0, 62, "#27559c", "#5f9fd6", "#bfdcea", "#ffe2a8", "#ffb066"), rectangle(0, 0, 100, 100)),
        fill("#fff3b8", ellipse(80, 45, 15), opacity=0.25),
        fill("#fff3b8", ellipse(80, 45, 11.5), opacity=0.35),
        fill(sun, ellipse(80, 45, 8.5)),
        *(_cloud(*cloud) for cloud in _CLOUDS),
        fill("#1d2a44", *(placed(stroke(wings, 0.15, 0.45, 0.15), x, y, 1) for x, y in _BIRDS)),
    ]


def _cloud(x: float, y: float, size: float) -> Layer:
    """A cloud that is pink below."""
    puffs = (placed(ellipse(*puff), x, y, size) for puff in _PUFFS)
    return fill(down(y - 5 * size, y + 3 * size, "#ffffff", "#f3d3c4"), *puffs)


def _hills() -> list[Layer]:
    """Mountains, a row of firs, a field with furrows."""
    rng = np.random.default_rng(11)
    firs = [_fir(x, 61.5 + 1.5 * np.sin(x / 9), rng.uniform(4, 9)) for x in np.linspace(1, 99, 34)]
    furrows = (f"{50 + 22 * d},62 {50 + 34 * d},67 {50 + 60 * d},78" for d in np.linspace(-2, 2, 27))
    return [
        fill(down(36, 62, "#6a6fa8", "#c7a9b8"), polygon(_MOUNTAINS)),
        fill("#f4eef2", *map(polygon, _SNOW), opacity=0.85),
        fill(down(56, 74, "#6f9a4a", "#3f7436"), blob(_MEADOW)),
        fill(down(52, 64, "#2f6a4a", "#12382c"), *firs),
        fill(down(62, 80, "#d8c04a", "#8a9a2f"), blob(_FIELD)),
        fill("#6a7a22", *(stroke(furrow, 0.2, 0.7) for furrow in furrows), opacity=0.55),
    ]


def _fir(x: float, y: float, height: float) -> FloatArray:
    """A fir on the ground at (x, y)."""
    half = polygon(_HALF_FIR)
    return placed(np.concatenate([half, mirrored(half, axis=0)[::-1]]), x, y, height)


def _verge() -> list[Layer]:
    """Grass along the road, blade by blade."""
    rng = np.random.default_rng(5)
    tufts = zip(rng.uniform(0, 100, 170), rng.normal(0, 0.8, 170), rng.uniform(0.5, 3.2, 170), strict=True)
    blades = [stroke(f"{x},81.5 {x + d / 2},{80 - h / 2} {x + d},{80 - h}", 0.5, 0.1) for x, d, h in tufts]
    return [
        fill(down(79, 83, "#5f8a2c", "#39621f"), rectangle(0, 79, 100, 84)),
        fill("#4a7a26", *blades[::2]),
        fill("#9abf4c", *blades[1::2]),
    ]


def _road() -> list[Layer]:
    """Asphalt with grit and lines, and the truck's shadow on it."""
    rng = np.random.default_rng(6)
    grit = [ellipse(x, y, 0.12 + (y - 80) / 90) for x, y in rng.uniform((0, 83), (100, 100), (160, 2))]
    dashes = (polygon(f"{x},93.6 {x + 11},93.6 {x + 10.2},96 {x - 1.2},96") for x in range(-4, 100, 20))
    return [
        fill(down(81, 100, "#6a6870", "#3a3942"), rectangle(0, 81.5, 100, 100)),
        fill("#8f8d96", *grit[::2], opacity=0.6),
        fill("#24232b", *grit[1::2], opacity=0.6),
        fill("#e8e4d8", rectangle(0, 82.6, 100, 83.3)),
        fill("#f4c93a", *dashes),
        fill("#08080c", ellipse(51, 89.5, 46, 2.2), opacity=0.55),
    ]


def _heap(count: int) -> list[Layer]:
    """Fruit heaped on the bed, the nearer in front."""
    rng = np.random.default_rng(8)
    x, hues = rng.uniform(9, 47, count), rng.choice([0.0, 0.03, 0.08, 0.12, 0.25, 0.3, 0.8], count)
    y = 55 - 13 * (1 - ((x - 28) / 21) ** 2) * rng.uniform(0, 1, count) ** 0.7
    return [layer for k in np.argsort(y) for layer in _fruit(x[k], y[k], hues[k])]


def _fruit(x: float, y: float, hue: float) -> list[Layer]:
    """A round fruit with a stalk and a gleam."""
    skin = radial_gradient((x - 0.8, y - 0.8), 3.4, hsv(hue, 0.55, 1), hsv(hue, 0.95, 0.9), hsv(hue, 1, 0.45))
    return [
        fill("#1a0c08", ellipse(x, y + 0.3, 2.6), opacity=0.5),
        fill(skin, ellipse(x, y, 2.4)),
        fill("#3a2a10", stroke(f"{x},{y - 1.6} {x + 0.2},{y - 2.6}", 0.35, 0.25)),
        fill("#ffffff", ellipse(x - 0.9, y - 0.9, 0.5, 0.35, -40), opacity=0.8),
    ]


def _bed() -> list[Layer]:
    """Planks with their grain, nailed to posts, on a frame with tail lights."""
    rows = [y + d for y in _PLANKS for d in (1.4, 3.1)]
    grain = (f"{x},{y} {x + 4},{y + 0.5} {x + 9},{y - 0.2}" for y in rows for x in (8, 18.5, 29, 39.5))
    nails = (ellipse(x + 1.1, y, 0.38) for x in _POSTS for y in rows)
    return [
        fill("#2a1a10", rectangle(7, 55, 49, 71)),
        *(fill(down(y, y + 4.6, "#d9a35c", "#8f5a26"), rectangle(6.5, y, 49.5, y + 4.6)) for y in _PLANKS),
        fill("#6a3e18", *(stroke(line, 0.1, 0.3, 0.1) for line in grain), opacity=0.7),
        fill(down(53, 72, "#b97f3e", "#5f3814"), *(rectangle(x, 53, x + 2.2, 71.5) for x in _POSTS)),
        fill("#e6e2da", *nails),
        fill(down(71, 77, "#5a1210", "#2b0807"), rectangle(5, 71, 54, 76.5)),
        fill("#ffcf4a", rectangle(5, 72, 6.4, 75)),
        fill("#ff5a3a", rectangle(5, 68, 6.2, 70.6)),
    ]


def _cab() -> list[Layer]:
    """Cab with windows and the driver's shadow."""
    glass = [blob(window) for window in _WINDOWS]
    driver = (ellipse(66.6, 46.2, 1.9, 2.3), blob("63.8,50.5! 64.5,48.8 67,48 69.4,49 70,50.5!"))
    sky = linear_gradient((54, 36), (72, 52), "#e9f8ff", "#8fc3de", "#3f6f92", "#9fd0e4")
    return [
        fill(down(32, 80, "#ff7a5c", "#dd2a22", "#a5120f", "#5f0707"), blob(_CAB)),
        fill("#ffd0bd", *(stroke(gleam, 0.3, 0.9, 0.3) for gleam in _GLEAMS), opacity=0.9),
        fill("#3a0505", *(brush(window, 1.6) for window in glass)),
        fill(sky, *glass),
        fill("#ffffff", *map(polygon, _REFLECTIONS), opacity=0.45),
        fill("#2b2530", *driver, opacity=0.75),
        fill("#4a0606", *(stroke(seam, 0.4) for seam in _SEAMS)),
    ]


def _bonnet() -> list[Layer]:
    """Air slots, fenders and wheel arches."""
    slots = [rectangle(78.2 + 2.4 * k, 56 + 0.25 * k, 78.9 + 2.4 * k, 61) for k in range(5)]
    return [
        fill("#f6e7c8", *(shifted(slot, 0.4, -0.2) for slot in slots), opacity=0.25),
        fill("#3a0505", *slots),
        fill(down(62, 78, "#f2503f", "#b31613", "#5a0606"), *map(blob, _FENDERS)),
        fill("#ffb9a5", *(stroke(gleam, 0.2, 0.7, 0.2) for gleam in _FENDER_GLEAMS)),
        fill("#1a1216", *(ellipse(x, y, 11.3) for x, y in _WHEELS)),
    ]


def _chrome() -> list[Layer]:
    """Running board, bumper, trim, handle, mirror and lamps."""
    chrome = down(58, 80, "#ffffff", "#9fb0bd", "#e9f1f5", "#5a6670")
    trim = (stroke("63.8,56.5 67.3,56.5", 1.1), rectangle(52, 63.3, 95, 64.2))
    mirror = (stroke("72.3,51 74.5,49", 0.5), ellipse(75, 47.6, 1.3, 1.8))
    return [
        fill("#2a2a30", rectangle(38.5, 76, 64.5, 79.5)),
        fill(chrome, *trim, *mirror),
        fill(chrome, rectangle(40, 76.3, 63, 78), rectangle(90, 74, 98.5, 78.4), ellipse(94.6, 60.2, 2.6)),
        fill(radial_gradient((95, 60), 2.2, "#ffffff", "#fff2a8", "#ffcf3a"), ellipse(94.8, 60.2, 2)),
        fill("#fff6c0", polygon("96.5,58.6 108,54 108,69 96.5,61.8"), opacity=0.4),
        fill("#ff9a2a", ellipse(94.8, 67, 1.2, 0.9)),
    ]


def _wheel(x: float, y: float) -> list[Layer]:
    """A tyre with tread, a rim with slots, a hub with bolts."""
    rim = down(y - 6, y + 6, "#ffffff", "#8a98a4", "#dfe7ec", "#56616b")
    hub = radial_gradient((x - 1, y - 1), 3.4, "#ff8a6a", "#c8201a", "#5a0606")
    return [
        fill("#17171b", ellipse(x, y, 9.6)),
        fill("#3f3f47", *_ring(x, y, 8.9, 36, 0.32)),
        fill("#f0ece0", ellipse(x, y, 7.5)),
        fill("#1d1d22", ellipse(x, y, 6.7)),
        fill(rim, ellipse(x, y, 6)),
        fill("#2b3036", *_ring(x, y, 4.4, 10, 0.72)),
        fill(hub, ellipse(x, y, 2.9)),
        fill("#e9edf0", *_ring(x, y, 1.9, 6, 0.36)),
    ]


def _ring(x: float, y: float, radius: float, count: int, size: float) -> list[FloatArray]:
    """Discs evenly spaced on a circle."""
    angles = np.arange(count) * 2 * np.pi / count
    return [ellipse(x + radius * np.cos(a), y + radius * np.sin(a), size) for a in angles]
