"""Drawings that explain the optics, computed by the functions that design lenses."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from magiclens.contract.artifacts import Assignment, BoolArray, FloatArray, HeightField, Lens, Scene, View
from magiclens.images import circles
from magiclens.optics.medium import Slab
from magiclens.optics.refraction import facet_normal, refract
from magiclens.web.gallery.svg import Point, Svg

_IOR = 1.49
"""Index of refraction of the drawn lenses, that of acrylic."""
_EYE: Point = (0.0, 115.0)
"""The drawn eye, mm: x, and the height above the source."""
_TOP = 40.0
"""Height of the lens's mean top, mm; its bottom lies on the source, at 0."""
_HALF = 50.0
"""Half the width of the drawn lens, mm."""
PX_PER_MM = 8
"""Pixels per millimetre of the source of discs."""


def refraction(alt: str) -> str:
    """Draw one facet: the ray from the eye bends at the top, and so meets another point of the source."""
    svg = _scene()
    at, seen = (20.0, _TOP), 10.0
    slope = _slope(at, seen)
    _draw_lens(svg, [(-_HALF, _TOP), (11.0, _TOP), *_piece(at, slope, 9.0), (29.0, _TOP), (_HALF, _TOP)])
    straight = _meets(_EYE, at)
    svg.line([at, (straight, 0.0)], "ray faint")
    svg.line([_EYE, at, (seen, 0.0)], "ray")
    normal = _unit(-slope, 1.0)
    svg.line([(at[0] + k * normal[0], at[1] + k * normal[1]) for k in (-16, 22)], "aid")
    svg.text((at[0] + 24 * normal[0], at[1] + 22 * normal[1]), "the facet's normal")
    svg.dot((seen, 0.0), 5, "hot")
    svg.dot((straight, 0.0), 5, "plain")
    svg.text((seen - 2, -8.0), "seen through the facet", "end")
    svg.text((straight + 2, -8.0), "seen without the lens")
    return svg.render(alt)


def many_facets(alt: str) -> str:
    """Draw neighbouring facets that show points of the source far from each other."""
    svg = _scene()
    wanted = [-33.0, -41.0, -8.0, -19.0, 17.0, 7.0, 44.0, 30.0]
    pitch = 2 * _HALF / len(wanted)
    outline: list[Point] = []
    rays = []
    for k, seen in enumerate(wanted):
        at = (-_HALF + (k + 0.5) * pitch, _TOP)
        outline += _piece(at, _slope(at, seen), pitch / 2)
        rays.append((at, seen))
    _draw_lens(svg, outline)
    for k, (at, seen) in enumerate(rays):
        svg.line([_EYE, at, (seen, 0.0)], "ray" if k % 2 else "ray cool")
        svg.dot((seen, 0.0), 4, "hot" if k % 2 else "cool")
    svg.text((0.0, -8.0), "every facet shows the place that looks most like its tile of the hidden picture", "middle")
    return svg.render(alt)


def cells(alt: str) -> str:
    """Draw facets cut vertically and along eye rays; only with the latter, raised facets do not move in the picture."""
    svg = Svg(-112.0, -14.0, 112.0, 128.0, 3.4)
    for middle, along, title in ((-57.0, False, "cut vertically"), (57.0, True, "cut along the eye's rays")):
        eye = (middle, _EYE[1])
        edges = [middle + x for x in (-40.0, -24.0, -8.0, 8.0, 24.0, 40.0)]
        heights = (4.0, -5.0, 6.0, -4.0, 5.0)
        outline = [
            _raised((x, _TOP), rise, eye, along) for k, rise in enumerate(heights) for x in (edges[k], edges[k + 1])
        ]
        svg.area([(edges[0], 0.0), *outline, (edges[-1], 0.0)], "glass")
        svg.line(outline, "edge")
        svg.line([(edges[0] - 4, 0.0), (edges[-1] + 4, 0.0)], "source")
        for x in edges[1:-1]:
            svg.line([eye, (x, _TOP)], "ray faint")
        for k in range(1, len(heights)):
            svg.line(outline[2 * k - 1 : 2 * k + 1], "ray" if along else "ray bad")
        svg.dot(eye, 6, "ink")
        svg.text((middle, -9.0), title, "middle")
    return svg.render(alt)


def maps(alt: str) -> str:
    """Draw the maps from a patch to its picture that a smooth lenslet can have, and a rotation, which it cannot."""
    turn = math.radians(35)
    kinds: Sequence[tuple[str, FloatArray, bool]] = (
        ("as it is", np.eye(2), True),
        ("magnified", np.eye(2) * 0.55, True),
        ("mirrored", np.diag([-1.0, 1.0]), True),
        ("stretched", np.diag([0.55, 1.0]), True),
        ("sheared alike", np.array([[1.0, 0.45], [0.45, 1.0]]), True),
        ("turned: never", np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]]), False),
    )
    svg = Svg(0.0, -10.0, 36.0 * len(kinds), 36.0, 3.5)
    for k, (name, matrix, possible) in enumerate(kinds):
        _letter(svg, (36.0 * k + 18.0, 18.0), np.linalg.inv(matrix), possible)
        svg.text((36.0 * k + 18.0, -6.0), name, "middle")
    return svg.render(alt)


def channels(alt: str) -> str:
    """Draw one facet of a turned lens, which shows another patch of the source after each turn."""
    svg = Svg(-8.0, -14.0, 232.0, 52.0, 3.3)
    for k in range(4):
        middle = (27.0 + 58.0 * k, 25.0)
        corners = [_turned(p, middle, 0) for p in ((-22, -22), (22, -22), (22, 22), (-22, 22))]
        svg.area(corners, "paper")
        facet = _turned((-13.0, 9.0), middle, k)
        patch = _turned((-3.0, 14.0), middle, k)
        svg.area([_turned((x, y), middle, k) for x, y in ((-18, 4), (-8, 4), (-8, 14), (-18, 14))], "glass outline")
        svg.arrow(facet, patch, "ray", 3.0)
        svg.dot(patch, 5, "hot")
        svg.area([_turned((x, y), middle, k) for x, y in ((-22, 22), (-16, 22), (-22, 16))], "mark")
        svg.text((middle[0], -6.0), f"{90 * k}°", "middle")
    return svg.render(alt)


def free_form(alt: str) -> str:
    """Draw one facet before and after refinement: its picture, and the points of the source that it shows."""
    scene, shapes = example_facet()
    (view,), size = scene.views, scene.lens.source_size_mm
    (first, even), (last, bent) = (seen_through(scene, shape) for shape in shapes)
    middle, half = even.mean(axis=(0, 1)), 3.0
    left, top = middle[0] - half + size / 2, size / 2 - middle[1] - half
    columns, rows = (slice(round(at * PX_PER_MM), round((at + 2 * half) * PX_PER_MM)) for at in (left, top))
    source = view.source[rows, columns, 0] < 0.5
    svg = Svg(-2.0, -10.0, 168.0, 116.0, 4.2)
    _draw_picture(svg, (25.0, 88.0), view.target[..., 0] < 0.5, "the facet's tile")
    _draw_picture(svg, (83.0, 88.0), first, "what a lenslet shows")
    _draw_picture(svg, (141.0, 88.0), last, "what it shows refined")
    _draw_picture(svg, (25.0, 27.0), source, "the sheet around its patch")
    for x, net, title in ((83.0, even, "where a lenslet looks"), (141.0, bent, "where it looks refined")):
        _draw_picture(svg, (x, 27.0), source, title)
        for (u, v), white in zip(net.reshape(-1, 2), view.target[1::3, 1::3].ravel(), strict=True):
            at = x + float(u - middle[0]) * 25.0 / half, 27.0 + float(v - middle[1]) * 25.0 / half
            svg.dot(at, 3.5, "cool" if white else "hot")
    return svg.render(alt)


DRAWINGS: Mapping[str, Callable[[str], str]] = MappingProxyType(
    {
        "refraction": refraction, "many-facets": many_facets, "cells": cells, "maps": maps, "channels": channels,
        "free-form": free_form,
    }
)  # fmt: skip
"""Functions that make an SVG element from its alternative text, by the names that documents use."""


def _scene() -> Svg:
    """A drawing with the eye above and the source below."""
    svg = Svg(-90.0, -16.0, 90.0, 122.0, 4.0)
    svg.line([(-72.0, 0.0), (72.0, 0.0)], "source")
    svg.text((56.0, 3.0), "source")
    svg.dot(_EYE, 7, "ink")
    svg.text((4.0, _EYE[1] - 1.0), "eye")
    return svg


def _draw_lens(svg: Svg, outline: Sequence[Point]) -> None:
    """Draw glass below an outline of its top."""
    svg.area([(outline[0][0], 0.0), *outline, (outline[-1][0], 0.0)], "glass")
    svg.line(outline, "edge")


def _slope(at: Point, seen: float) -> float:
    """The slope dz/dx of a facet at a point, by Snell's law, so that it shows the source at x = ``seen``."""
    nx, _, nz = facet_normal((_EYE[0], 0.0, _EYE[1]), (at[0], 0.0, at[1]), (seen, 0.0), Slab(at[1], 0.0, _IOR))
    dx, dz = _unit(at[0] - _EYE[0], at[1] - _EYE[1])
    tx, _, tz = refract(dx, 0.0, dz, nx, 0.0, nz, _IOR)
    if abs(at[0] - tx / tz * at[1] - seen) > 1e-6:
        raise ArithmeticError("the facet does not show what it was made for")
    return float(-nx / nz)


def _piece(at: Point, slope: float, half: float) -> list[Point]:
    """Both ends of a flat facet, drawn from the side."""
    return [(at[0] - half, at[1] - slope * half), (at[0] + half, at[1] + slope * half)]


def _meets(eye: Point, at: Point) -> float:
    """The x at which the straight line from the eye through a point meets the source."""
    return eye[0] + (at[0] - eye[0]) * eye[1] / (eye[1] - at[1])


def _raised(at: Point, rise: float, eye: Point, along: bool) -> Point:
    """A point of the reference plane, raised straight up or along the ray to the eye."""
    if not along:
        return at[0], at[1] + rise
    share = rise / (eye[1] - at[1])
    return at[0] + share * (eye[0] - at[0]), at[1] + rise


def _letter(svg: Svg, middle: Point, matrix: FloatArray, possible: bool) -> None:
    """Draw a letter F in its square as a map shows it; the letter is asymmetric, so mirroring and turning differ."""
    parts: list[list[Point]] = [[(-3.5, -6), (-3.5, 6), (4, 6)], [(-3.5, 0.5), (2, 0.5)]]
    frame: list[Point] = [(-14, -14), (14, -14), (14, 14), (-14, 14)]
    svg.area([(middle[0] + x, middle[1] + y) for x, y in frame], "paper" if possible else "paper bad")
    for part in parts:
        shown = [matrix @ np.array(p) for p in part]
        svg.line([(middle[0] + float(x), middle[1] + float(y)) for x, y in shown], "stroke")
    if not possible:
        svg.line([(middle[0] - 14, middle[1] - 14), (middle[0] + 14, middle[1] + 14)], "ray bad")


def example_facet() -> tuple[Scene, tuple[HeightField, HeightField]]:
    """A facet over discs whose target is a corner: as the best lenslet, and after refinement."""
    from magiclens.integration.poisson import Poisson
    from magiclens.matching.exhaustive import Exhaustive

    lens = Lens(6.0, 20.0, facets=1, microfacets=16, thickness_mm=20.0, relief_mm=3.0, floor_mm=16.0)
    rng, at = np.random.default_rng(2), np.linspace(-1, 1, 97)[1::2]
    corner = ((at[None, :] > -0.1) & (at[:, None] > -0.25)).astype(np.float32)[..., None]
    discs = circles(lens.source_size_mm, PX_PER_MM, rng)
    scene = Scene(lens, (View("", discs, corner, np.array([0.0, 0.0, 220.0])),))
    found = Exhaustive(candidates=1).match(scene, rng)
    lenslet = Poisson().integrate(scene, Assignment.pick(found, np.zeros((1, 1), np.int64)))
    return scene, (lenslet, Poisson().refine(scene, lenslet))


def seen_through(scene: Scene, shape: HeightField) -> tuple[BoolArray, FloatArray]:
    """The dark pixels of a facet's picture, and the points of the source that its micro-facets show, (m, m, 2) mm."""
    from magiclens.geometry.solid import solid_from_heights
    from magiclens.rendering.tracer import picture, trace

    solid, (view,) = solid_from_heights(shape), scene.views
    seen = picture(trace(solid, scene.lens, view, 48, 3), view.source, scene.lens.source_size_mm)
    return seen[..., 0] < 0.5, trace(solid, scene.lens, view, scene.lens.microfacets, 1)[:, :, 0, :2]


def _draw_picture(svg: Svg, middle: Point, dark: BoolArray, title: str) -> None:
    """Draw a black and white picture, 50 mm wide, as a strip for each run of dark pixels."""
    left, top, pixel = middle[0] - 25.0, middle[1] + 25.0, 50.0 / len(dark)
    svg.area([(left, top), (left + 50, top), (left + 50, top - 50), (left, top - 50)], "paper")
    for row, line in enumerate(np.pad(dark, ((0, 0), (1, 1)))):
        high, low = top - row * pixel, top - min(row + 1.2, len(dark)) * pixel
        for start, end in np.flatnonzero(np.diff(line)).reshape(-1, 2):
            x, to = left + float(start) * pixel, left + float(end) * pixel
            svg.area([(x, high), (to, high), (to, low), (x, low)], "ink")
    svg.text((middle[0], middle[1] - 31.0), title, "middle")


def _turned(point: Point, middle: Point, quarters: int) -> Point:
    """A point turned counter-clockwise around the origin, then moved."""
    x, y = point
    for _ in range(quarters):
        x, y = -y, x
    return middle[0] + x, middle[1] + y


def _unit(x: float, y: float) -> Point:
    length = math.hypot(x, y)
    return x / length, y / length
