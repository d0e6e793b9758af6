"""Small lenses and simple bodies for tests of what is fabricated from them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from magiclens.contract.artifacts import FloatArray, HeightField, IntArray, Lens, Scene, Solid, View
from magiclens.contract.stages import Exporter
from magiclens.geometry.solid import solid_from_heights

Eye = tuple[float, float, float] | None
LENS = Lens(size_mm=10.0, source_size_mm=10.0, facets=3, microfacets=4, thickness_mm=8.0, wall_mm=0.002)
EYE = (0.0, 0.0, 108.0)
CUBE = np.array(
    [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6],
     [1, 3, 5], [3, 7, 5]], np.int32,
)  # fmt: skip
"""Faces of a box whose vertices count x fastest, then y, then z."""


def bumpy(eye: Eye = EYE, seed: int = 5, lens: Lens = LENS) -> Solid:
    """A slab with a rough top and steps between its facets, cut along the rays from an eye or vertically."""
    shape = (lens.facets, lens.facets, lens.microfacets + 1, lens.microfacets + 1)
    heights = np.random.default_rng(seed).uniform(-0.5, 0.5, shape)
    return solid_from_heights(HeightField(lens, heights, None if eye is None else np.array(eye)))


def flat(lens: Lens = LENS, eye: Eye = None) -> Solid:
    """A slab with a flat top."""
    shape = (lens.facets, lens.facets, lens.microfacets + 1, lens.microfacets + 1)
    return solid_from_heights(HeightField(lens, np.zeros(shape), None if eye is None else np.array(eye)))


def box(low: Sequence[float], high: Sequence[float]) -> Solid:
    """An upright box between two corners (x, y, z)."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    vertices = [(x, y, z) for z in (z0, z1) for y in (y0, y1) for x in (x0, x1)]
    return Solid(np.array(vertices, float), CUBE.copy())


def together(*solids: Solid) -> Solid:
    """Several solids that do not touch, as one mesh."""
    counts = np.cumsum([0, *(len(s.vertices) for s in solids)])
    faces: list[IntArray] = [s.faces + first for s, first in zip(solids, counts, strict=False)]
    return Solid(np.concatenate([s.vertices for s in solids]), np.concatenate(faces).astype(np.int32))


def winding(solid: Solid, points: FloatArray) -> FloatArray:
    """(P,) how often a closed mesh winds around each of (P, 3) points: 1 inside, 0 outside.

    By solid angles (Van Oosterom and Strackee 1983): nothing in it follows a line through the mesh.
    """
    a, b, c = (solid.vertices[solid.faces[:, k]] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    above = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
    below = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    return np.asarray(np.arctan2(above, below).sum(axis=-1) / (2 * np.pi))


def view_of(source: FloatArray, name: str = "view", turn: float = 0.0, source_name: str = "source") -> View:
    """A view of an (H, W) or (H, W, C) source in linear light, from straight above."""
    picture = np.ascontiguousarray(source.reshape(*source.shape[:2], -1), np.float32)
    return View(name, picture, picture, np.array(EYE), turn, source_name)


def written(exporter: Exporter, folder: Path, solid: Solid, scene: Scene | None = None) -> Path:
    """The file that an exporter writes."""
    folder.mkdir(exist_ok=True)
    path = folder / f"lens{exporter.suffix}"
    exporter.export(scene or Scene(LENS, ()), solid, path)
    return path
