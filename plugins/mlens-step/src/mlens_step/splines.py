"""From a grid of vertices to a coarser grid of control points: facets become smooth, their edges stay shared.

Facets are (m + 1) x (m + 1) vertices, walls the strips between them. Along each axis, the same linear map takes the
m + 1 lines of every facet to c lines of control points, and keeps its first and last line. So facets and walls go on
meeting in the same curves, and the whole grid of control points is laid out as the grid of vertices was.

Smooth lenslets need few control points, fitted by least squares. Free-form facets need a knot at every vertex: with
fewer, surfaces would miss vertices or swing far out between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from magiclens import FloatArray, InputError

_CUBIC = 3
"""Degree of the splines."""
_MOST_FITTED = 2 / 3
"""Spans between control points that are fitted, per micro-facet: with nearly as many, unevenness of the vertices would
come out up to 80 times as large between them."""
_MICROMETRE = 1e-3
"""In mm."""


@dataclass(frozen=True)
class Net:
    """Control points of the top: each pair of intervals between neighbouring ``breaks`` is one B-spline patch.

    points: (R, R, 3) float64, mm, rows from +y down. breaks: lines of control points at which patches end.
    miss_mm: the most by which the surface misses a vertex of the mesh. departure_mm: the most by which it leaves a
    micro-facet, measured in the middle.
    """

    points: FloatArray
    breaks: list[int]
    miss_mm: float
    departure_mm: float


def um(mm: float) -> str:
    """A length as a spec writes it, in micrometres, rounded up to two digits and to a nanometre."""
    length = max(mm / _MICROMETRE, _MICROMETRE)
    step = 10.0 ** (np.floor(np.log10(length)) - 1)
    return f"{np.ceil(length / step) * step:.6g}um"


def degree(width: int) -> int:
    """The degree of a patch of ``width + 1`` control points: cubic, if they suffice."""
    return min(_CUBIC, width)


def knots(width: int) -> FloatArray:
    """(width + degree + 2,) clamped and uniform, the length of each span is 1."""
    k = degree(width)
    spans = width + 1 - k
    return np.concatenate([np.zeros(k), np.arange(spans + 1.0), np.full(k, float(spans))])


def averages(width: int) -> FloatArray:
    """(width + 1,) from 0 to 1: control points of a straight line that is run along at constant speed."""
    t, k = knots(width), degree(width)
    greville = np.array([t[j + 1 : j + k + 1].mean() for j in range(width + 1)])
    return np.array(greville / greville[-1])


def breaks(facets: int, lines: int, rim: int) -> list[int]:
    """First and last line of each facet, and of the rim if there is one, where a facet has this many lines."""
    ends = [rim + k * lines + end for k in range(facets) for end in (0, lines - 1)]
    return [0, *ends, ends[-1] + 1] if rim else ends


def smooth_net(vertices: FloatArray, facets: int, rim: int, tolerance_mm: float, departure_mm: float) -> Net:
    """The net of fewest control points whose surface misses no vertex by more than the tolerance.

    vertices: (G, G, 3), rows from +y down, ``rim`` (0 or 1) lines around the facets' own. If no few control points do,
    the surface passes through all vertices. Raises InputError naming the facet that the surface leaves by most, if that
    is more than ``departure_mm``.
    """
    m = (len(vertices) - 2 * rim) // facets - 1
    for width in _widths(m):
        points = _along_both(vertices, facets, _fit(m, width))
        miss_mm = _length(_along_both(points, facets, _values(width, np.arange(m + 1) / m)) - vertices).max()
        if miss_mm <= tolerance_mm:
            break
    inner, controls = (slice(rim, len(grid) - rim) for grid in (vertices, points))
    departures = _departures(vertices[inner, inner], points[controls, controls], facets)
    _check(departures, departure_mm)
    return Net(points, breaks(facets, width + 1, rim), float(miss_mm), float(departures.max()))


def _check(departures: FloatArray, departure_mm: float) -> None:
    """Raises InputError if a facet's surface leaves its micro-facets by more than that."""
    row, column = np.unravel_index(departures.argmax(), departures.shape)
    worst = um(float(departures[row, column]))
    if departures[row, column] > departure_mm:
        raise InputError(
            f"a smooth surface through the vertices of facet row {row}, column {column} leaves its micro-facets by "
            f"{worst}, more than {um(departure_mm)}; more lens.microfacets bring them together, "
            f"'departure: {worst}' allows it, 'surface: triangles' writes the micro-facets",
            "exporter step: departure",
        )


def _widths(m: int) -> list[int]:
    """How many control points but one may stand for m + 1 vertices: few fitted ones, or a spline's through them all."""
    fewest = degree(m)
    return [*range(fewest, max(fewest, int(_MOST_FITTED * m)) + 1), m + _CUBIC - 1]


def _fit(m: int, width: int) -> FloatArray:
    """(width + 1, m + 1): from equidistant points to the control points that fit them best and keep both ends."""
    if width > m:
        return _interpolation(m)
    basis = _values(width, np.arange(m + 1) / m)
    fit = np.zeros((width + 1, m + 1))
    fit[0, 0] = fit[-1, -1] = 1.0
    rest = np.eye(m + 1)[1:-1] - basis[1:-1, [0, -1]] @ fit[[0, -1]]
    fit[1:-1] = np.linalg.pinv(basis[1:-1, 1:-1]) @ rest
    return fit


def _interpolation(m: int) -> FloatArray:
    """(m + 3, m + 1): from equidistant points to the natural cubic through them, with a knot at each."""
    controls: FloatArray = make_interp_spline(np.arange(m + 1.0), np.eye(m + 1), _CUBIC, bc_type="natural").c
    return controls


def _values(width: int, where: FloatArray) -> FloatArray:
    """(P, width + 1): from control points to points of the curve, at parameters from 0 to 1."""
    t = knots(width)
    values: FloatArray = BSpline.design_matrix(where * t[-1], t, degree(width)).toarray()
    return values


def _along_both(grid: FloatArray, facets: int, linear: FloatArray) -> FloatArray:
    """A linear map (a, b) of every facet's b lines to a lines, along both axes of a grid; the rim's lines are kept."""
    return _along(_along(grid, facets, linear).swapaxes(0, 1), facets, linear).swapaxes(0, 1)


def _along(grid: FloatArray, facets: int, linear: FloatArray) -> FloatArray:
    after, before = linear.shape
    rim = (len(grid) - facets * before) // 2
    blocks = linear @ grid[rim : len(grid) - rim].reshape(facets, before, -1)
    inner = blocks.reshape(facets * after, *grid.shape[1:])
    return np.concatenate([grid[:rim], inner, grid[len(grid) - rim :]])


def _departures(vertices: FloatArray, points: FloatArray, facets: int) -> FloatArray:
    """(N, N) mm: the most by which each facet's surface leaves the middles of its micro-facets."""
    m, width = len(vertices) // facets - 1, len(points) // facets - 1
    cells = vertices.reshape(facets, m + 1, facets, m + 1, 3)
    flat = (cells[:, :-1, :, :-1] + cells[:, 1:, :, 1:]) / 2
    round_ = _along_both(points, facets, _values(width, (np.arange(m) + 0.5) / m)).reshape(flat.shape)
    departures: FloatArray = _length(round_ - flat).max(axis=(1, 3))
    return departures


def _length(vectors: FloatArray) -> FloatArray:
    lengths: FloatArray = np.linalg.norm(vectors, axis=-1)
    return lengths
