"""What the artifacts of a stage must be like; a stage that breaks its contract is named, not the one after it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from magiclens.artifacts import Assignment, Candidates, FloatArray, HeightField, IntArray, Lens, Scene, Solid

T = TypeVar("T")


class BadArtifact(ValueError):
    """An artifact that breaks the contract; the message says how."""


def check_candidates(lens: Lens, found: object) -> None:
    """Offsets, maps and errors of one K, and at least one candidate for every facet."""
    candidates = _is(Candidates, found)
    k = candidates.errors.shape[-1] if candidates.errors.ndim == 3 else 0
    n = lens.facets
    _shape("errors", candidates.errors, (n, n, max(k, 1)))
    _shape("offsets_mm", candidates.offsets_mm, (n, n, k, 2))
    _shape("maps", candidates.maps, (n, n, k, 3))
    usable = np.isfinite(candidates.errors)
    if np.isnan(candidates.errors).any():
        raise BadArtifact("errors has NaN")
    _finite("offsets_mm", candidates.offsets_mm[usable])
    _finite("maps", candidates.maps[usable])
    empty = np.argwhere(~usable.any(axis=-1))
    if len(empty):
        row, column = empty[0]
        raise BadArtifact(f"{len(empty)} facets have no candidate, the first at row {row}, column {column}")


def check_assignment(lens: Lens, candidates: Candidates, found: object) -> None:
    """One existing candidate per facet."""
    assignment = _is(Assignment, found)
    n, k = lens.facets, candidates.errors.shape[-1]
    _shape("choice", assignment.choice, (n, n))
    if assignment.choice.min() < 0 or assignment.choice.max() >= k:
        raise BadArtifact(f"choice is not within 0 to {k - 1}")
    for name, width in (("offsets_mm", (2,)), ("maps", (3,)), ("errors", ())):
        _shape(name, getattr(assignment, name), (n, n, *width))
        _finite(name, getattr(assignment, name))


def check_height_field(lens: Lens, found: object) -> None:
    """One finite grid of heights per facet."""
    height_field = _is(HeightField, found)
    n, m = lens.facets, lens.microfacets
    _shape("heights_mm", height_field.heights_mm, (n, n, m + 1, m + 1))
    _finite("heights_mm", height_field.heights_mm)


def check_solid(found: object) -> None:
    """Finite vertices, and faces that refer to them."""
    solid = _is(Solid, found)
    _shape("vertices", solid.vertices, (max(len(solid.vertices), 4), 3))
    _shape("faces", solid.faces, (max(len(solid.faces), 4), 3))
    _finite("vertices", solid.vertices)
    if solid.faces.min() < 0 or solid.faces.max() >= len(solid.vertices):
        raise BadArtifact(f"faces refer to vertices outside 0 to {len(solid.vertices) - 1}")
    if solid.grid and solid.grid[0] * solid.grid[1] > len(solid.vertices):
        raise BadArtifact(f"grid {solid.grid} needs more than {len(solid.vertices)} vertices")


def check_encoded(given: Scene, found: object) -> None:
    """The given scene with other sources, of the same sizes and within 0 to 1."""
    scene = _is(Scene, found)
    if scene.lens != given.lens or len(scene.views) != len(given.views):
        raise BadArtifact("its scene has another lens or other views")
    for old, new in zip(given.views, scene.views, strict=True):
        _shape(f"the source of {old.name}", new.source, old.source.shape)
        if not (new.source.min() >= 0 and new.source.max() <= 1):
            raise BadArtifact(f"the source of {old.name} is not within 0 to 1")


def check_file(path: Path) -> None:
    """A file that is there and not empty."""
    if not path.is_file() or path.stat().st_size == 0:
        raise BadArtifact(f"it has not written {path.name}")


def check_pictures(scene: Scene, found: object) -> None:
    """One square, finite picture per view, with the scene's channels."""
    pictures: list[Any] = _is(list, found)
    if len(pictures) != len(scene.views):
        raise BadArtifact(f"{len(pictures)} pictures for {len(scene.views)} views")
    for view, picture in zip(scene.views, pictures, strict=True):
        side = len(_is(np.ndarray, picture))
        _shape(view.name, picture, (side, side, view.target.shape[-1]))
        _finite(view.name, picture)


def _is(cls: type[T], found: object) -> T:
    if not isinstance(found, cls):
        raise BadArtifact(f"it is a {type(found).__name__} instead of a {cls.__name__}")
    return found


def _shape(name: str, array: FloatArray | IntArray, shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise BadArtifact(f"{name} has shape {array.shape} instead of {shape}")


def _finite(name: str, array: FloatArray) -> None:
    if not np.isfinite(array).all():
        raise BadArtifact(f"{name} has NaN or infinite values")
