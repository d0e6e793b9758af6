"""Checks of artifacts. A run checks what each stage returns, so that a stage that breaks its contract is named itself.

Every check raises ``BadArtifact`` with a message that says what is wrong with the artifact.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from numbers import Real
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from magiclens.contract.artifacts import (
    Assignment,
    Candidates,
    FloatArray,
    HeightField,
    IntArray,
    Lens,
    Scene,
    Solid,
    View,
)

_T = TypeVar("_T")


class BadArtifact(ValueError):
    """An artifact breaks the contract of its stage; the message says how. Runs turn it into a StageError."""


def check_candidates(lens: Lens, found: object) -> None:
    """Check a matcher's candidates: shapes that fit the lens, finite numbers, at least one candidate per facet.

    That errors ascend is not checked here: rematching may return them in another order.
    """
    candidates = _is(Candidates, found)
    k = candidates.errors.shape[-1] if candidates.errors.ndim == 3 else 0
    n = lens.facets
    _shape("errors", candidates.errors, (n, n, max(k, 1)))  # at least 1, so that K = 0 is refused
    _shape("offsets_mm", candidates.offsets_mm, (n, n, k, 2))
    _shape("maps", candidates.maps, (n, n, k, 3))
    # an error of inf marks the free end of a list, where the other arrays may hold anything
    usable = np.isfinite(candidates.errors)
    if np.isnan(candidates.errors).any():
        raise BadArtifact("errors has NaN")
    _finite("offsets_mm", candidates.offsets_mm[usable])
    _finite("maps", candidates.maps[usable])
    empty = np.argwhere(~usable.any(axis=-1))
    if len(empty):
        row, column = empty[0]
        raise BadArtifact(f"{len(empty)} facets have no candidate, the first at row {row}, column {column}")
    _metrics(candidates.metrics)


def check_assignment(lens: Lens, candidates: Candidates, found: object) -> None:
    """Check an annealer's assignment: it chooses one of the facet's candidates for every facet."""
    assignment = _is(Assignment, found)
    n, k = lens.facets, candidates.errors.shape[-1]
    _shape("choice", assignment.choice, (n, n))
    _whole("choice", assignment.choice)
    if assignment.choice.min() < 0 or assignment.choice.max() >= k:
        raise BadArtifact(f"choice is not within 0 to {k - 1}")
    for name, width in (("offsets_mm", (2,)), ("maps", (3,)), ("errors", ())):
        _shape(name, getattr(assignment, name), (n, n, *width))
        _finite(name, getattr(assignment, name))
    _metrics(assignment.metrics)


def check_height_field(lens: Lens, found: object) -> None:
    """Check an integrator's height field: it is of this lens, and has one grid of finite heights per facet."""
    height_field = _is(HeightField, found)
    n, m = lens.facets, lens.microfacets
    if height_field.lens != lens:
        raise BadArtifact("it is of another lens")
    _shape("heights_mm", height_field.heights_mm, (n, n, m + 1, m + 1))
    _finite("heights_mm", height_field.heights_mm)
    _metrics(height_field.metrics)


def check_solid(found: object) -> None:
    """Check a finisher's solid: finite vertices, faces that refer to them, a grid that is not larger than the solid."""
    solid = _is(Solid, found)
    # the smallest closed mesh, a tetrahedron, has four vertices and four faces
    _shape("vertices", solid.vertices, (max(len(solid.vertices), 4), 3))
    _shape("faces", solid.faces, (max(len(solid.faces), 4), 3))
    _finite("vertices", solid.vertices)
    _whole("faces", solid.faces)
    if solid.faces.min() < 0 or solid.faces.max() >= len(solid.vertices):
        raise BadArtifact(f"faces refer to vertices outside 0 to {len(solid.vertices) - 1}")
    if solid.grid and solid.grid[0] * solid.grid[1] > len(solid.vertices):
        raise BadArtifact(f"grid {solid.grid} needs more than {len(solid.vertices)} vertices")
    _metrics(solid.metrics)


def check_encoded(given: Scene, found: object) -> None:
    """Check an encoder's scene: only sources have changed; they have the same sizes, are within 0 to 1, and shared."""
    scene = _is(Scene, found)
    if scene.lens != given.lens or len(scene.views) != len(given.views):
        raise BadArtifact("its scene has another lens or other views")
    for old, new in zip(given.views, scene.views, strict=True):
        _shape(f"the source of {old.name}", new.source, old.source.shape)
        # written so that NaN fails, too
        if not (new.source.min() >= 0 and new.source.max() <= 1):
            raise BadArtifact(f"the source of {old.name} is not within 0 to 1")
        if not _same_view(replace(new, source=old.source), old):
            raise BadArtifact(f"of {old.name}, more than the source has changed")
    sources: dict[str, Any] = {}
    for view in scene.views:
        if not np.array_equal(sources.setdefault(view.source_name, view.source), view.source):
            raise BadArtifact(f"views that share the source {view.source_name} have got different ones")


def check_file(path: Path) -> None:
    """Check an exporter's file: it exists and is not empty."""
    if not path.is_file() or path.stat().st_size == 0:
        raise BadArtifact(f"it has not written {path.name}")


def check_pictures(scene: Scene, found: object) -> None:
    """Check a renderer's pictures: one per view, square and finite, with the channels of the scene."""
    pictures: list[Any] = _is(list, found)
    if len(pictures) != len(scene.views):
        raise BadArtifact(f"{len(pictures)} pictures for {len(scene.views)} views")
    for view, picture in zip(scene.views, pictures, strict=True):
        side = max(len(np.atleast_1d(_is(np.ndarray, picture))), 1)
        _shape(view.name, picture, (side, side, view.target.shape[-1]))
        _finite(view.name, picture)


def _is(cls: type[_T], found: object) -> _T:
    if not isinstance(found, cls):
        raise BadArtifact(f"it is a {type(found).__name__} instead of a {cls.__name__}")
    return found


def _shape(name: str, array: FloatArray | IntArray, shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise BadArtifact(f"{name} has shape {array.shape} instead of {shape}")


def _finite(name: str, array: FloatArray) -> None:
    if not np.isfinite(array).all():
        raise BadArtifact(f"{name} has NaN or infinite values")


def _whole(name: str, array: IntArray) -> None:
    if not np.issubdtype(array.dtype, np.integer):
        raise BadArtifact(f"{name} has {array.dtype} values instead of whole numbers")


def _metrics(metrics: Mapping[str, float]) -> None:
    for name, value in metrics.items():
        if not isinstance(name, str) or not isinstance(value, Real):
            raise BadArtifact(f"metrics has {name!r}: {value!r}, which is not a name and a number")


def _same_view(one: View, other: View) -> bool:
    return all(np.array_equal(getattr(one, f.name), getattr(other, f.name)) for f in fields(View))
