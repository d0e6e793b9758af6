"""What a STEP file says itself, before any CAD program has repaired it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from magiclens import FloatArray

Entities = dict[int, tuple[str, str]]


@dataclass(frozen=True)
class Face:
    """A face of the file.

    normal: (3,) of its surface, in the middle. edges: around it, each with whether it is run along. ends: the vertices
    at which each of them starts and ends. corners: (K, 3) where they start, mm.
    """

    normal: FloatArray
    edges: list[tuple[int, bool]]
    ends: list[tuple[int, int]]
    corners: FloatArray

    @property
    def area(self) -> FloatArray:
        """(3,) the area vector of the polygon of its corners: it points to where they run counter-clockwise."""
        area: FloatArray = np.cross(self.corners, np.roll(self.corners, -1, axis=0)).sum(axis=0) / 2
        return area

    @property
    def cone(self) -> float:
        """The signed volume between the polygon of its corners and the origin, mm^3."""
        return float(self.area @ self.corners.mean(axis=0) / 3)


def faces(path: Path) -> list[Face]:
    """All faces of the one shell in a file."""
    found = re.findall(r"^#(\d+)=([A-Z_0-9]+)\((.*)\);$", path.read_text(), re.M)
    entities = {int(number): (name, parameters) for number, name, parameters in found}
    shells = [parameters for name, parameters in entities.values() if name == "CLOSED_SHELL"]
    assert len(shells) == 1
    return [_face(entities, number) for number in _refs(shells[0])]


def _face(entities: Entities, number: int) -> Face:
    bound, surface = _refs(entities[number][1])
    (loop,) = _refs(entities[bound][1])
    edges, ends = [], []
    for oriented in _refs(entities[loop][1]):
        (edge,), along = _refs(entities[oriented][1]), entities[oriented][1].endswith(".T.")
        first, last, _ = _refs(entities[edge][1])
        edges.append((edge, along))
        ends.append((first, last) if along else (last, first))
    corners = [_numbers(entities, _refs(entities[vertex][1])[0]) for vertex, _ in ends]
    return Face(_normal(entities, surface), edges, ends, np.array(corners))


def _normal(entities: Entities, surface: int) -> FloatArray:
    name, parameters = entities[surface]
    if name == "PLANE":
        _, axis, _ = _refs(entities[_refs(parameters)[0]][1])
        return _numbers(entities, axis)
    rows = [_refs(row) for row in re.findall(r"\(([#\d,]+)\)", parameters.split(".UNSPECIFIED.")[0])]
    a, b, c, d = (_numbers(entities, rows[i][j]) for i, j in ((0, 0), (-1, 0), (-1, -1), (0, -1)))
    return np.cross(b - a + c - d, d - a + c - b)


def _refs(parameters: str) -> list[int]:
    return [int(number) for number in re.findall(r"#(\d+)", parameters)]


def _numbers(entities: Entities, number: int) -> FloatArray:
    """Coordinates of a point or a direction."""
    return np.array([float(x) for x in entities[number][1].split("(")[1].rstrip(")").split(",")])
