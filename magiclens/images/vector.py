"""Vector graphics: outlines, paints, and layers of both.

Picture units: the square is 100 x 100, x to the right, y *down* (as in SVG); (0, 0) is the top left corner.
An outline is a closed polygon (n, 2); curves are flattened finely enough for any sensible size in pixels.
Points are mostly written as text, ``"10,20 30,40! 50,20"``; curves go through all of them and turn sharply at ``!``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from colorsys import hsv_to_rgb
from dataclasses import dataclass, replace

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.images.colour import to_linear

PICTURE_SIDE = 100.0
"""Side of the picture, in picture units."""
_CURVE_STEPS = 16
"""Number of straight pieces of a curve from one given point to the next."""

Paint = Callable[[FloatArray, FloatArray], FloatArray]
"""A function from x and y (...), in picture units, to linear light (..., C)."""


@dataclass(frozen=True)
class Layer:
    """Outlines filled with one paint, drawn over the layers before it; overlapping outlines are united."""

    outlines: tuple[FloatArray, ...]
    paint: Paint
    opacity: float = 1.0


def centred(layers: Sequence[Layer], side: float = 82.0) -> list[Layer]:
    """The layers, scaled and moved so that their bounding box is centred and its longer side is ``side`` units.

    Paints are not moved, so this is meant for layers of one colour.
    """
    points = np.concatenate([outline for layer in layers for outline in layer.outlines])
    low, high = points.min(0), points.max(0)
    scale, middle = side / (high - low).max(), (low + high) / 2
    return [replace(x, outlines=tuple((o - middle) * scale + PICTURE_SIDE / 2 for o in x.outlines)) for x in layers]


# Paints


def flat(*light: float) -> Paint:
    """A paint of one colour, given as linear light."""
    return lambda x, y: np.broadcast_to(np.array(light), (*x.shape, len(light)))


def colour(code: str) -> Paint:
    """A paint of one display colour, such as ``#d24b2a``."""
    return flat(*to_linear(_display(code)).tolist())


def hsv(hue: float, saturation: float, value: float) -> str:
    """A display colour ``#rrggbb``; the hue is in turns, saturation and value are clipped to 0..1."""
    channels = hsv_to_rgb(hue % 1.0, float(np.clip(saturation, 0, 1)), float(np.clip(value, 0, 1)))
    return "#" + "".join(f"{round(255 * channel):02x}" for channel in channels)


def linear_gradient(start: tuple[float, float], end: tuple[float, float], *codes: str) -> Paint:
    """A paint of display colours, evenly spaced along the line from ``start`` to ``end`` and constant beyond it."""
    (x0, y0), (x1, y1) = start, end
    dx, dy = x1 - x0, y1 - y0
    return lambda x, y: _ramp(((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy), codes)


def down(top: float, bottom: float, *codes: str) -> Paint:
    """A linear gradient from y = ``top`` to y = ``bottom``."""
    return linear_gradient((0, top), (0, bottom), *codes)


def radial_gradient(centre: tuple[float, float], radius: float, *codes: str) -> Paint:
    """A paint of display colours, evenly spaced from ``centre`` out to ``radius`` and constant beyond it."""
    return lambda x, y: _ramp(np.hypot(x - centre[0], y - centre[1]) / radius, codes)


def _ramp(t: FloatArray, codes: Sequence[str]) -> FloatArray:
    """Linear light (..., 3) at ``t`` (...): display values interpolated between colours evenly spaced over 0..1."""
    stops, values = np.linspace(0, 1, len(codes)), np.stack([_display(code) for code in codes])
    return to_linear(np.stack([np.interp(t, stops, channel) for channel in values.T], axis=-1))


def _display(code: str) -> FloatArray:
    """(3,) display values 0..1 of ``#rrggbb``."""
    return np.array([int(code[k : k + 2], 16) for k in (1, 3, 5)]) / 255


def fill(paint: Paint | str, *outlines: FloatArray, opacity: float = 1.0) -> Layer:
    """A layer of outlines, filled with a paint or with one display colour."""
    return Layer(outlines, colour(paint) if isinstance(paint, str) else paint, opacity)


# Outlines


def polygon(text: str) -> FloatArray:
    """A polygon through the points of a text."""
    return np.array([point for point, _ in _points(text)])


def rectangle(left: float, top: float, right: float, bottom: float) -> FloatArray:
    """A rectangle whose sides are parallel to the picture's."""
    return np.array([(left, top), (right, top), (right, bottom), (left, bottom)], float)


def ellipse(x: float, y: float, rx: float, ry: float | None = None, turn: float = 0.0) -> FloatArray:
    """An ellipse about (x, y), a circle without ``ry``, turned clockwise by ``turn`` degrees."""
    a = np.linspace(0, 2 * np.pi, 8 * _CURVE_STEPS, endpoint=False)
    return turned(np.stack([x + rx * np.cos(a), y + (rx if ry is None else ry) * np.sin(a)], -1), turn, (x, y))


def arc(x: float, y: float, radius: float, start: float, end: float) -> FloatArray:
    """An open circular line from one angle to another, degrees clockwise as seen from +x."""
    a = np.radians(np.linspace(start, end, 4 * _CURVE_STEPS))
    return np.stack([x + radius * np.cos(a), y + radius * np.sin(a)], -1)


def blob(text: str) -> FloatArray:
    """A closed curve through the points of a text."""
    p = _knots(text)
    return _spline(np.concatenate([p[-1:], p, p[:2]]))


def curve(text: str) -> FloatArray:
    """An open line (n, 2), from the first point of a text through all others to the last."""
    p = _knots(text)
    return _spline(np.concatenate([p[:1], p, p[-1:]]))


def brush(line: FloatArray, *widths: float) -> FloatArray:
    """The outline of a stroke with round ends along an open line (n, 2); the widths are spread evenly along it."""
    stops = np.linspace(0, 1, len(widths))
    half = np.interp(np.linspace(0, 1, len(line)), stops, widths)[:, None] / 2
    along = np.gradient(line, axis=0)
    along /= np.hypot(along[:, :1], along[:, 1:])
    across = half * np.stack([-along[:, 1], along[:, 0]], -1)
    tip, tail = _cap(line[-1], across[-1]), _cap(line[0], -across[0])
    return np.concatenate([line + across, tip, (line - across)[::-1], tail])


def stroke(text: str, *widths: float) -> FloatArray:
    """The outline of a stroke through the points of a text."""
    return brush(curve(text), *widths)


def turned(outline: FloatArray, degrees: float, about: tuple[float, float] = (50.0, 50.0)) -> FloatArray:
    """The outline, turned clockwise as seen (y is down) about a point."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    moved: FloatArray = (outline - about) @ np.array([[c, s], [-s, c]]) + about
    return moved


def shifted(outline: FloatArray, dx: float, dy: float) -> FloatArray:
    """The outline, moved right by ``dx`` and down by ``dy``."""
    moved: FloatArray = outline + np.array((dx, dy))
    return moved


def placed(outline: FloatArray, x: float, y: float, size: float, degrees: float = 0.0) -> FloatArray:
    """An outline that was drawn about (0, 0), scaled by ``size``, turned clockwise and moved to (x, y)."""
    return shifted(turned(outline * size, degrees, (0.0, 0.0)), x, y)


def mirrored(outline: FloatArray, axis: float = 50.0) -> FloatArray:
    """The outline, mirrored left to right about x = ``axis``."""
    return shifted(outline * (-1, 1), 2 * axis, 0)


def both(*outlines: FloatArray) -> tuple[FloatArray, ...]:
    """The outlines, and their mirror images about the picture's middle."""
    return (*outlines, *(mirrored(o) for o in outlines))


def _points(text: str) -> list[tuple[tuple[float, float], bool]]:
    """The points of a text, and for each whether it is a corner."""
    pairs = [(token.rstrip("!").split(","), token.endswith("!")) for token in text.split()]
    return [((float(x), float(y)), corner) for (x, y), corner in pairs]


def _knots(text: str) -> FloatArray:
    """(n, 2) spline points of a text; a corner is a point given twice, which lets the curve turn sharply there."""
    return np.array([point for point, corner in _points(text) for _ in range(1 + corner)])


def _spline(p: FloatArray) -> FloatArray:
    """A centripetal Catmull-Rom spline, which has no loops, from the second point to the last but one.

    Points that repeat the one before are left out.
    """
    pieces = [_spline_piece(*p[k : k + 4]) for k in range(len(p) - 3)]
    points = np.concatenate([*pieces, p[-2:-1]])
    moves = np.diff(points, axis=0, prepend=np.inf)
    return points[np.hypot(moves[:, 0], moves[:, 1]) > 1e-9]


def _spline_piece(p0: FloatArray, p1: FloatArray, p2: FloatArray, p3: FloatArray) -> FloatArray:
    """(_CURVE_STEPS, 2) points from p1 up to, not including, p2: the spline's piece as a cubic Bezier curve."""
    d1, d2, d3 = (max(float(np.hypot(*(b - a))), 1e-12) ** 0.5 for a, b in ((p0, p1), (p1, p2), (p2, p3)))
    b1 = (d1**2 * p2 - d2**2 * p0 + (2 * d1**2 + 3 * d1 * d2 + d2**2) * p1) / (3 * d1 * (d1 + d2))
    b2 = (d3**2 * p1 - d2**2 * p3 + (2 * d3**2 + 3 * d3 * d2 + d2**2) * p2) / (3 * d3 * (d3 + d2))
    t = np.linspace(0, 1, _CURVE_STEPS, endpoint=False)[:, None]
    piece: FloatArray = (1 - t) ** 3 * p1 + 3 * t * (1 - t) ** 2 * b1 + 3 * t**2 * (1 - t) * b2 + t**3 * p2
    return piece


def _cap(centre: FloatArray, across: FloatArray) -> FloatArray:
    """A half circle from ``centre + across`` to ``centre - across``."""
    a = np.linspace(0, np.pi, _CURVE_STEPS)[1:-1, None]
    cap: FloatArray = centre + np.cos(a) * across + np.sin(a) * np.array([across[1], -across[0]])
    return cap
