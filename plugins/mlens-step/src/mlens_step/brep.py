"""Entities of a boundary representation (ISO 10303-42): vertices, edges and faces that share them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magiclens import FloatArray
from mlens_step.part21 import DERIVED, NO, UNSPECIFIED, YES, Part21, Ref
from mlens_step.splines import degree, knots

_PICOMETRE = 9
"""Decimals of a millimetre that coordinates have."""

Loop = Sequence[tuple[Ref, bool]]
"""Edges around a face, counter-clockwise seen from outside, each with whether it is run along or against."""


@dataclass(frozen=True)
class Corner:
    """A vertex: where it is, (3,) mm, and the numbers of its point and of the vertex itself."""

    at: FloatArray
    point: Ref
    vertex: Ref


def points(file: Part21, grid: FloatArray) -> list[list[Ref]]:
    """Cartesian points of a grid (R, C, 3), row by row."""
    rounded = (np.round(grid, _PICOMETRE) + 0.0).tolist()
    return [[file.add("CARTESIAN_POINT", "", xyz) for xyz in row] for row in rounded]


def corner(file: Part21, at: FloatArray, point: Ref | None = None) -> Corner:
    """A vertex, at a point that is written already or at a new one."""
    point = point or points(file, at[None, None])[0][0]
    return Corner(at, point, file.add("VERTEX_POINT", "", point))


def straight_edge(file: Part21, a: Corner, b: Corner) -> Ref:
    """A straight edge."""
    vector = file.add("VECTOR", "", _direction(file, b.at - a.at), 1.0)
    return _edge(file, a, b, file.add("LINE", "", a.point, vector))


def spline_edge(file: Part21, a: Corner, b: Corner, controls: Sequence[Ref]) -> Ref:
    """An edge along a B-spline that starts at one vertex and ends at the other."""
    width = len(controls) - 1
    if width == 1:
        return straight_edge(file, a, b)
    shape = (degree(width), controls, UNSPECIFIED, NO, NO, *_knots(width), UNSPECIFIED)
    return _edge(file, a, b, file.add("B_SPLINE_CURVE_WITH_KNOTS", "", *shape))


def spline_surface(file: Part21, controls: Sequence[Sequence[Ref]]) -> Ref:
    """A B-spline surface; from outside, the second index turns left from the first."""
    across, along = len(controls) - 1, len(controls[0]) - 1
    (u_times, u), (v_times, v) = _knots(across), _knots(along)
    return file.add(
        "B_SPLINE_SURFACE_WITH_KNOTS", "", degree(across), degree(along), controls, UNSPECIFIED, NO, NO, NO,
        u_times, v_times, u, v, UNSPECIFIED,
    )  # fmt: skip


def plane(file: Part21, at: Ref, normal: FloatArray, along: FloatArray) -> Ref:
    """A plane through a point; its normal points out."""
    axes = _direction(file, normal), _direction(file, along)
    return file.add("PLANE", "", file.add("AXIS2_PLACEMENT_3D", "", at, *axes))


def face(file: Part21, surface: Ref, loop: Loop) -> Ref:
    """A face without holes on a surface whose normal points out."""
    oriented = [file.add("ORIENTED_EDGE", "", DERIVED, DERIVED, edge, YES if along else NO) for edge, along in loop]
    bound = file.add("FACE_OUTER_BOUND", "", file.add("EDGE_LOOP", "", oriented), YES)
    return file.add("ADVANCED_FACE", "", (bound,), surface, YES)


def solid(file: Part21, faces: Sequence[Ref]) -> Ref:
    """What a closed shell encloses."""
    return file.add("MANIFOLD_SOLID_BREP", "lens", file.add("CLOSED_SHELL", "", faces))


def _edge(file: Part21, a: Corner, b: Corner, curve: Ref) -> Ref:
    return file.add("EDGE_CURVE", "", a.vertex, b.vertex, curve, YES)


def _direction(file: Part21, vector: FloatArray) -> Ref:
    unit = vector / np.linalg.norm(vector) + 0.0
    return file.add("DIRECTION", "", unit.tolist())


def _knots(width: int) -> tuple[list[int], list[float]]:
    """How often each knot occurs, and the knots."""
    values, times = np.unique(knots(width), return_counts=True)
    return times.tolist(), values.tolist()
