"""The finisher: what it finds agrees with trimesh, pymeshlab and manifold3d; smoothing keeps to its bound."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from magiclens.contract.artifacts import FloatArray, HeightField, IntArray, Lens, Scene, Solid
from magiclens.contract.errors import StageError
from magiclens.contract.stages import Finisher
from magiclens.geometry.solid import is_built_on_grid, solid_from_raster
from magiclens.meshing.intersections import _is_star, cannot_cut_itself, faces_by_manifold, faces_that_cut
from magiclens.meshing.manifold import ManifoldFinisher
from magiclens.meshing.pymeshlab import Pymeshlab
from magiclens.meshing.validation import (
    as_exported,
    check_areas,
    check_self_intersections,
    check_topology,
    check_volume,
)

N, M, PITCH, THICK = 5, 4, 3.0, 8.0
LENS = Lens(size_mm=N * PITCH, source_size_mm=N * PITCH, facets=N, microfacets=M, thickness_mm=THICK, wall_mm=0.002)
MARKED, WIDE = replace(LENS, mark=True), replace(LENS, floor_mm=40.0)
LINES = N * (M + 1) + 2
SCENE = Scene(LENS, ())
EYES = {"eye": (0.0, 0.0, THICK + 60.0), "eye aside": (20.0, -7.0, THICK + 60.0), "vertical": None}


def lens_solid(
    eye: tuple[float, float, float] | None = EYES["eye"], relief: float = 0.4, seed: int = 3, lens: Lens = LENS
) -> Solid:
    """A slab whose facets are tilted, curved lenslets with steps between them."""
    from magiclens.geometry.solid import solid_from_heights

    rng = np.random.default_rng(seed)
    x = np.linspace(-0.5, 0.5, M + 1)
    bend, tilt, level = (rng.uniform(-relief, relief, (N, N, 1, 1)) for _ in range(3))
    heights = level + tilt * x + 0.5 * tilt * x[:, None] + bend * (x**2 + x[:, None] ** 2)
    return solid_from_heights(HeightField(lens, heights, None if eye is None else np.array(eye)))


def vertex_of(row: int, column: int, down: int = 2, right: int = 2) -> int:
    """The grid vertex at (down, right) within the facet in a row and a column."""
    return (1 + row * (M + 1) + down) * LINES + 1 + column * (M + 1) + right


def with_faces(solid: Solid, faces: IntArray) -> Solid:
    return Solid(solid.vertices, faces.astype(np.int32), solid.grid, solid.eye_mm)


def with_vertex(solid: Solid, vertex: int, place: FloatArray) -> Solid:
    vertices = solid.vertices.copy()
    vertices[vertex] = place
    return Solid(vertices, solid.faces, solid.grid, solid.eye_mm)


def face_at(solid: Solid, row: int, column: int) -> int:
    """A face in the middle of a facet."""
    return int(np.flatnonzero(solid.faces.min(axis=1) == vertex_of(row, column))[0])


def with_hole(solid: Solid) -> Solid:
    return with_faces(solid, np.delete(solid.faces, face_at(solid, 1, 3), axis=0))


def with_flipped_face(solid: Solid) -> Solid:
    faces = solid.faces.copy()
    faces[face_at(solid, 1, 3)] = faces[face_at(solid, 1, 3)][::-1]
    return with_faces(solid, faces)


def with_duplicated_face(solid: Solid) -> Solid:
    return with_faces(solid, np.concatenate([solid.faces, solid.faces[[face_at(solid, 1, 3)]]]))


def with_vertex_poked_through_the_floor(solid: Solid) -> Solid:
    x, y, _ = solid.vertices[vertex_of(1, 3)]
    return with_vertex(solid, vertex_of(1, 3), np.array([x, y, -1.0]))


def with_swapped_vertices(solid: Solid) -> Solid:
    vertices = solid.vertices.copy()
    one, other = vertex_of(1, 3), vertex_of(1, 3, 2, 4)
    vertices[[one, other]] = vertices[[other, one]]
    return Solid(vertices, solid.faces, solid.grid, solid.eye_mm)


def with_overhang(solid: Solid) -> Solid:
    """A vertex pulled over its neighbours: no ray order, yet nothing cuts anything."""
    place = solid.vertices[vertex_of(1, 3, 2, 4)] + np.array([0.5, 0.0, 0.1])
    return with_vertex(solid, vertex_of(1, 3), place)


def with_upright_sides(solid: Solid) -> Solid:
    """The floor's outline right below the top's, though the top is cut along the rays from an eye."""
    index = np.arange(LINES**2).reshape(LINES, LINES)
    rim = np.concatenate([index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]])
    vertices = solid.vertices.copy()
    vertices[LINES**2 : LINES**2 + len(rim), :2] = vertices[rim, :2]
    return Solid(vertices, solid.faces, solid.grid, solid.eye_mm)


def with_foot_drawn_in(solid: Solid) -> Solid:
    """Points of the foot moved in below the top, so that sides lean the other way."""
    vertices = solid.vertices.copy()
    vertices[LINES**2 + 3 : LINES**2 + 6, 0] = -N * PITCH / 4
    return Solid(vertices, solid.faces, solid.grid, solid.eye_mm)


def with_face_without_area(solid: Solid) -> Solid:
    return with_vertex(solid, vertex_of(1, 3), solid.vertices[vertex_of(1, 3, 2, 3)])


def with_straightened_face(solid: Solid) -> Solid:
    """A vertex half-way between two others of one of its faces: no area, though all corners differ."""
    a, b, c = solid.faces[face_at(solid, 1, 3)]
    return with_vertex(solid, a, (solid.vertices[b] + solid.vertices[c]) / 2)


def inside_out(solid: Solid) -> Solid:
    return with_faces(solid, solid.faces[:, ::-1])


def with_another_body(solid: Solid) -> Solid:
    count = len(solid.vertices)
    vertices = np.concatenate([solid.vertices, solid.vertices + np.array([40.0, 0.0, 0.0])])
    return Solid(vertices, np.concatenate([solid.faces, solid.faces + count]), solid.grid, solid.eye_mm)


def with_pinched_vertex(solid: Solid) -> Solid:
    """Two slabs that share one vertex, the first one's top-right corner of the floor."""
    both = with_another_body(solid)
    count = len(solid.vertices)
    low, high = solid.vertices[:, 0].argmin(), solid.vertices[:, 0].argmax()
    vertices = both.vertices.copy()
    vertices[count:] = solid.vertices + solid.vertices[high] - solid.vertices[low]
    faces = np.where(both.faces == low + count, high, both.faces)
    return Solid(vertices, faces.astype(np.int32), solid.grid, solid.eye_mm)


BROKEN: dict[str, tuple[Callable[[Solid], Solid], str]] = {
    "hole": (with_hole, r"edges that bound one face only \(3"),
    "flipped face": (with_flipped_face, r"edges between faces of opposite orientation \(3"),
    "duplicated face": (with_duplicated_face, r"edges that bound more than two faces \(3"),
    "face without area": (with_face_without_area, r"faces without area \(2"),
    "straightened face": (with_straightened_face, r"faces without area \(1"),
    "poked through": (with_vertex_poked_through_the_floor, "faces that cut through others"),
    "swapped": (with_swapped_vertices, "faces that cut through others"),
}


def pymeshlab_measures(solid: Solid) -> tuple[dict[str, Any], dict[str, Any]]:
    """pymeshlab's topological and geometric measures of a solid as exported."""
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(as_exported(solid).vertices, solid.faces))
    return meshes.get_topological_measures(), meshes.get_geometric_measures()


def trimesh_of(solid: Solid) -> Any:
    from trimesh import Trimesh

    return Trimesh(as_exported(solid).vertices, solid.faces, process=False)


def manifold_of(solid: Solid) -> Any:
    from manifold3d import Manifold, Mesh

    return Manifold(Mesh(solid.vertices.astype(np.float32), solid.faces.astype(np.uint32)))


@pytest.mark.parametrize("eye", EYES.values(), ids=EYES.keys())
def test_sound_solid_passes_and_everyone_agrees(eye: tuple[float, float, float] | None) -> None:
    from manifold3d import Error

    solid = lens_solid(eye)
    found = Pymeshlab(self_intersections="always").finish(SCENE, solid).metrics
    topology, geometry = pymeshlab_measures(solid)
    theirs, manifold = trimesh_of(solid), manifold_of(solid)
    assert found["watertight"] == theirs.is_watertight == (topology["boundary_edges"] == 0) == 1
    assert found["two_manifold"] == topology["is_mesh_two_manifold"] == (manifold.status() == Error.NoError) == 1
    assert found["consistently_oriented"] == theirs.is_winding_consistent == 1
    assert found["bodies"] == topology["connected_components_number"] == theirs.body_count == 1
    assert found["self_intersections"] == found["zero_area_faces"] == 0
    assert found["outward_normals"] == 1
    for volume in (theirs.volume, geometry["mesh_volume"], manifold.volume(), (manifold + manifold).volume()):
        assert found["volume_mm3"] == pytest.approx(volume, rel=1e-6)


@pytest.mark.parametrize("finisher", [Pymeshlab(), ManifoldFinisher()], ids=lambda finisher: finisher.type)
@pytest.mark.parametrize("broken", BROKEN)
@pytest.mark.parametrize("eye", EYES.values(), ids=EYES.keys())
def test_broken_solid_is_refused_with_the_facet_named(
    finisher: Finisher, broken: str, eye: tuple[float, float, float] | None
) -> None:
    breaks, complaint = BROKEN[broken]
    with pytest.raises(StageError, match=f"{complaint}.*the first at facet row 1, column [34]"):
        finisher.finish(SCENE, breaks(lens_solid(eye)))


@pytest.mark.parametrize("eye", EYES.values(), ids=EYES.keys())
@pytest.mark.parametrize("breaks", [lens_solid, with_overhang], ids=lambda breaks: breaks.__name__)
def test_both_finishers_measure_the_same(eye: tuple[float, float, float] | None, breaks: Callable[..., Solid]) -> None:
    solid = lens_solid(eye) if breaks is lens_solid else breaks(lens_solid(eye))
    finishers = [Pymeshlab(self_intersections="always"), ManifoldFinisher(self_intersections="always")]
    one, other = (finisher.finish(SCENE, solid) for finisher in finishers)
    assert one.metrics == other.metrics
    assert other.vertices is solid.vertices


@pytest.mark.parametrize(
    "breaks", [with_hole, with_flipped_face, with_duplicated_face, with_pinched_vertex, inside_out]
)
def test_topology_agrees_with_trimesh_and_pymeshlab(breaks: Callable[[Solid], Solid]) -> None:
    solid = breaks(lens_solid())
    flaws = {flaw.what: flaw.count for flaw in check_topology(solid).flaws}
    metrics = check_topology(solid).metrics
    topology, _ = pymeshlab_measures(solid)
    theirs = trimesh_of(solid)
    assert metrics["watertight"] == theirs.is_watertight
    assert flaws.get("edges that bound one face only", 0) == topology["boundary_edges"]
    # pymeshlab counts such an edge once for each of its three faces.
    assert 3 * flaws.get("edges that bound more than two faces", 0) == topology["non_two_manifold_edges"]
    assert flaws.get("vertices that join surfaces which are not neighbours", 0) == topology["non_two_manifold_vertices"]
    if metrics["watertight"]:
        assert metrics["consistently_oriented"] == theirs.is_winding_consistent
        assert metrics["two_manifold"] == topology["is_mesh_two_manifold"]


def test_what_is_built_on_a_grid_needs_no_search() -> None:
    """A mesh of the same faces, of which it is not known that they are a grid's, is searched."""
    for shape in ((2, 2), (2, 5), (4, 3)):
        x, y = np.arange(shape[1], dtype=float), -np.arange(shape[0], dtype=float)
        solid = solid_from_raster(x, y, np.ones(shape))
        assert is_built_on_grid(solid)
        assert check_topology(solid) == check_topology(replace(solid, grid=None))
        assert not is_built_on_grid(replace(solid, faces=solid.faces[:, ::-1]))
        assert not is_built_on_grid(replace(solid, faces=solid.faces[:-1]))
        assert not is_built_on_grid(replace(solid, vertices=np.concatenate([solid.vertices, np.zeros((1, 3))])))


@pytest.mark.parametrize("breaks", [with_hole, with_flipped_face, with_duplicated_face])
def test_manifold3d_refuses_what_we_refuse(breaks: Callable[[Solid], Solid]) -> None:
    from manifold3d import Error

    assert manifold_of(breaks(lens_solid())).status() != Error.NoError


def test_face_without_area_is_one_that_pymeshlab_removes() -> None:
    import pymeshlab

    solid = as_exported(with_face_without_area(lens_solid()))
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(solid.vertices, solid.faces))
    meshes.meshing_remove_null_faces()
    assert check_areas(solid).metrics["zero_area_faces"] == len(solid.faces) - meshes.current_mesh().face_number() == 2


def test_inside_out_solid_has_negative_volume() -> None:
    solid = lens_solid()
    assert check_volume(inside_out(solid)).metrics["volume_mm3"] == pytest.approx(-trimesh_of(solid).volume)
    with pytest.raises(StageError, match="faces that point inward"):
        Pymeshlab().finish(SCENE, inside_out(solid))


def test_two_bodies_are_one_too_many() -> None:
    with pytest.raises(StageError, match=r"separate bodies \(2\)"):
        Pymeshlab().finish(SCENE, with_another_body(lens_solid()))


@pytest.mark.parametrize(
    ("vertex", "facet"),
    [
        (0, "row 0, column 0"),
        (vertex_of(1, 3, 0, 0), "row 1, column 3"),
        (vertex_of(1, 3, M, M), "row 1, column 3"),
        (LINES**2 - 1, f"row {N - 1}, column {N - 1}"),
    ],
)
def test_facets_are_counted_from_plus_y_and_minus_x(vertex: int, facet: str) -> None:
    solid = lens_solid()
    hole = np.flatnonzero(solid.faces.min(axis=1) == vertex)[0]
    with pytest.raises(StageError, match=f"the first at facet {facet}\\)"):
        Pymeshlab().finish(SCENE, with_faces(solid, np.delete(solid.faces, hole, axis=0)))


def test_flaw_outside_the_grid_is_told_by_its_position() -> None:
    solid = lens_solid(None)
    floor = np.flatnonzero(solid.faces.min(axis=1) >= LINES**2)
    with pytest.raises(
        StageError, match=r"edges that bound one face only \(3, the first at x = -7.5, y = [-.\d]+, z = 0 mm\)"
    ):
        Pymeshlab().finish(SCENE, with_faces(solid, np.delete(solid.faces, floor[0], axis=0)))


def test_all_kinds_of_flaws_are_told_at_once() -> None:
    with pytest.raises(StageError, match=r"bound one face only \(3, .*; faces without area"):
        Pymeshlab().finish(SCENE, with_face_without_area(with_hole(lens_solid())))


@pytest.mark.parametrize("eye", EYES.values(), ids=EYES.keys())
def test_structure_of_a_sound_solid_excludes_self_intersections(eye: tuple[float, float, float] | None) -> None:
    solid = as_exported(lens_solid(eye, relief=1.5))
    assert cannot_cut_itself(solid)
    assert len(faces_that_cut(solid)) == 0


@pytest.mark.parametrize("lens", [MARKED, WIDE, replace(WIDE, mark=True)], ids=["mark", "wide", "both"])
@pytest.mark.parametrize("eye", EYES.values(), ids=EYES.keys())
def test_sides_may_lean_out_to_the_foot(eye: tuple[float, float, float] | None, lens: Lens) -> None:
    solid = as_exported(lens_solid(eye, relief=1.5, lens=lens))
    assert cannot_cut_itself(solid)
    assert len(faces_that_cut(solid)) == 0
    assert not cannot_cut_itself(with_foot_drawn_in(solid))


@pytest.mark.parametrize("breaks", [with_vertex_poked_through_the_floor, with_swapped_vertices])
def test_search_finds_what_reasoning_cannot_exclude(breaks: Callable[[Solid], Solid]) -> None:
    solid = as_exported(breaks(lens_solid()))
    assert not cannot_cut_itself(solid)
    assert set(faces_that_cut(solid)) & set(np.flatnonzero((solid.faces == vertex_of(1, 3)).any(axis=1)))
    reasoned, searched = (check_self_intersections(solid, reason=r).metrics for r in (True, False))
    assert reasoned == searched
    assert reasoned["self_intersections"] > 1


@pytest.mark.parametrize("seed", range(30))
@pytest.mark.parametrize("lens", [LENS, MARKED], ids=["plain", "mark"])
def test_reasoning_never_passes_what_the_search_finds(lens: Lens, seed: int) -> None:
    rng = np.random.default_rng(seed)
    solid = lens_solid(EYES["eye aside"], seed=seed, lens=lens)
    vertices = solid.vertices.copy()
    moved = rng.integers(0, len(vertices), 2)
    vertices[moved] += rng.normal(0, rng.choice([0.001, 0.05, 0.5]), (2, 3))
    shaken = as_exported(Solid(vertices, solid.faces, solid.grid, solid.eye_mm))
    assert not (cannot_cut_itself(shaken) and len(faces_that_cut(shaken)))


@pytest.mark.every_third
@pytest.mark.parametrize("seed", range(30))
def test_manifold3d_finds_a_cut_where_pymeshlab_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solid = lens_solid([*EYES.values()][seed % 3], seed=seed)
    vertices = solid.vertices.copy()
    moved = rng.integers(0, len(vertices), 2)
    vertices[moved] += rng.normal(0, rng.choice([0.001, 0.05, 0.5]), (2, 3))
    shaken = as_exported(Solid(vertices, solid.faces, solid.grid, solid.eye_mm))
    cut, theirs = set(faces_by_manifold(shaken)), set(faces_that_cut(shaken))
    assert bool(cut) == bool(theirs)
    assert not cut or cut & theirs


def test_overlap_shows_in_the_volume_of_a_self_union() -> None:
    """manifold3d's way to see self-intersections agrees with the search on the poked solid."""
    solid = with_vertex_poked_through_the_floor(lens_solid())
    manifold = manifold_of(solid)
    assert (manifold + manifold).volume() != pytest.approx(manifold.volume(), rel=1e-6)


def test_low_facets_at_the_rim_stick_out_through_upright_sides() -> None:
    """Why the sides of a lens that is cut along eye rays must follow the rays too."""
    solid = lens_solid(relief=1.0)
    assert Pymeshlab().finish(SCENE, solid).metrics["self_intersections"] == 0
    with pytest.raises(StageError, match="faces that cut through others"):
        Pymeshlab().finish(SCENE, with_upright_sides(solid))


@pytest.mark.parametrize(
    ("turns", "wobble", "expected"), [(1, 0.0, True), (2, 0.0, False), (-1, 0.0, False), (1, 0.5, False)]
)
def test_outline_goes_around_once_and_never_back(turns: int, wobble: float, expected: bool) -> None:
    angles = turns * np.arange(40) * 2 * np.pi / 40 + wobble * (np.arange(40) % 2)
    points = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    assert _is_star(np.stack([points, np.roll(points, -1, axis=0)], axis=1)) is expected


def test_overhang_that_cuts_nothing_is_sound() -> None:
    solid = with_overhang(lens_solid())
    assert not cannot_cut_itself(as_exported(solid))
    assert Pymeshlab().finish(SCENE, solid).metrics["self_intersections"] == 0


def test_check_can_be_switched_off() -> None:
    solid = with_hole(lens_solid())
    assert Pymeshlab(check=False).finish(SCENE, solid).faces is solid.faces


def test_search_can_be_left_out() -> None:
    found = Pymeshlab(self_intersections="never").finish(SCENE, lens_solid()).metrics
    assert "self_intersections" not in found
    assert found["watertight"] == 1


def test_metrics_of_the_solid_are_kept_and_its_arrays_untouched() -> None:
    solid = lens_solid()
    marked = Solid(solid.vertices, solid.faces, solid.grid, solid.eye_mm, {"slope_max_deg": 12.5})
    finished = Pymeshlab().finish(SCENE, marked)
    assert finished.metrics["slope_max_deg"] == 12.5
    assert np.array_equal(finished.vertices, solid.vertices)
    assert finished.grid == (LINES, LINES)


class TestSmoothing:
    """A rough surface becomes smoother, by height changes within the bound, inside the facets only."""

    @staticmethod
    def rough(eye: tuple[float, float, float] | None) -> Solid:
        """A lens whose top vertices are off by some micrometres along their rays."""
        solid = lens_solid(eye)
        off = np.random.default_rng(1).normal(0.0, 0.003, LINES**2)
        vertices = solid.vertices.copy()
        vertices[: LINES**2] += off[:, None] * TestSmoothing.rays(solid)
        return Solid(vertices, solid.faces, solid.grid, solid.eye_mm)

    @staticmethod
    def rays(solid: Solid) -> FloatArray:
        top = solid.vertices[: LINES**2]
        if solid.eye_mm is None:
            return np.tile([0.0, 0.0, 1.0], (len(top), 1))
        away: FloatArray = top - solid.eye_mm
        away /= np.linalg.norm(away, axis=1, keepdims=True)
        return away

    @staticmethod
    def inner() -> NDArray[np.bool_]:
        """(LINES, LINES) whether a grid vertex lies inside a facet, not on its edge."""
        within = np.tile(np.arange(M + 1), N)
        line = np.concatenate([[False], (within > 0) & (within < M), [False]])
        inner: NDArray[np.bool_] = line[:, None] & line
        return inner

    @pytest.mark.parametrize("eye", EYES.values(), ids=EYES.keys())
    def test_moves_along_rays_within_the_bound_and_only_inside_facets(
        self, eye: tuple[float, float, float] | None
    ) -> None:
        solid = self.rough(eye)
        finished = Pymeshlab(smoothing="2um").finish(SCENE, solid)
        moved = finished.vertices - solid.vertices
        along = np.einsum("ij,ij->i", moved[: LINES**2], self.rays(solid))
        assert np.abs(moved[: LINES**2] - along[:, None] * self.rays(solid)).max() < 1e-12
        assert np.abs(along).max() == pytest.approx(0.002)
        assert finished.metrics["smoothing_mm"] == pytest.approx(0.002)
        assert not along.reshape(LINES, LINES)[~self.inner()].any()
        assert not moved[LINES**2 :].any()
        assert finished.grid == solid.grid

    @pytest.mark.parametrize("eye", EYES.values(), ids=EYES.keys())
    def test_takes_roughness_away(self, eye: tuple[float, float, float] | None) -> None:
        solid, truth = self.rough(eye), lens_solid(eye, relief=0.0)
        flat = Solid(
            truth.vertices + (solid.vertices - lens_solid(eye).vertices), truth.faces, truth.grid, truth.eye_mm
        )
        finished = Pymeshlab(smoothing="10um").finish(SCENE, flat)
        before, after = (
            (s.vertices - truth.vertices)[: LINES**2, 2][self.inner().ravel()].std() for s in (flat, finished)
        )
        assert after < 0.75 * before

    def test_nothing_moves_unless_asked(self) -> None:
        solid = self.rough(EYES["eye"])
        assert np.array_equal(Pymeshlab().finish(SCENE, solid).vertices, solid.vertices)

    def test_needs_the_grid_of_the_lens(self) -> None:
        solid = lens_solid()
        free = Solid(solid.vertices, solid.faces)
        with pytest.raises(StageError, match="smoothing needs the grid of facets"):
            Pymeshlab(smoothing="1um").finish(SCENE, free)

    def test_bound_has_a_unit(self) -> None:
        with pytest.raises(ValidationError, match="bare number"):
            Pymeshlab.model_validate({"smoothing": 2})


def test_free_mesh_is_checked_too() -> None:
    solid = lens_solid()
    found = Pymeshlab().finish(SCENE, Solid(solid.vertices, solid.faces)).metrics
    assert found["self_intersections"] == 0
    poked = with_vertex_poked_through_the_floor(solid)
    with pytest.raises(StageError, match=r"cut through others \(\d+, the first at x ="):
        Pymeshlab().finish(SCENE, Solid(poked.vertices, poked.faces))
