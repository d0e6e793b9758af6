"""The closed mesh under a height field: manifold, outward, of the right size, every vertex on its ray."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import magiclens.geometry.solid as solid_module
from magiclens.contract.artifacts import FloatArray, Solid
from magiclens.geometry.solid import grid_lines, heights_of, solid_from_heights, volume
from magiclens.meshing.validation import check_areas, check_volume
from scenes import ABOVE, ASIDE, THICK, Eye, plane_points_mm, small_lens, surface

LENS = small_lens(3, 4.0, microfacets=5, wall_mm=0.3)
EYES = [ABOVE, ASIDE, None]
EYE_NAMES = ["eye", "eye aside", "vertical"]
every_cut = pytest.mark.parametrize("eye", EYES, ids=EYE_NAMES)


def bumpy(eye: Eye | None) -> Solid:
    """Every vertex at a height of its own."""
    return solid_from_heights(surface(LENS, np.random.default_rng(0).uniform(-2, 2, (3, 3, 6, 6)), eye))


def on_the_plane(points: FloatArray, eye: Eye | None) -> FloatArray:
    """x and y where the cutting rays through points (V, 3) cross the reference plane."""
    if eye is None:
        return points[:, :2]
    share = (eye[2] - THICK) / (eye[2] - points[:, 2:])
    return np.array(eye)[:2] + (points[:, :2] - np.array(eye)[:2]) * share


def top_grid(solid: Solid) -> FloatArray:
    assert solid.grid is not None
    rows, columns = solid.grid
    return solid.vertices[: rows * columns].reshape(rows, columns, 3)


def test_volumes_and_checks_do_not_depend_on_how_many_faces_are_looked_at_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lens = bumpy(ABOVE)
    expected = volume(lens), check_areas(lens), check_volume(lens)
    monkeypatch.setattr(solid_module, "FACES_AT_ONCE", 11)
    assert (volume(lens), check_areas(lens)) == expected[:2]
    assert check_volume(lens).metrics["volume_mm3"] == pytest.approx(volume(lens), rel=1e-12)


@every_cut
def test_every_edge_joins_two_faces_that_run_along_it_in_opposite_ways(eye: Eye | None) -> None:
    faces = bumpy(eye).faces
    ways = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ahead = {tuple(way) for way in ways.tolist()}
    assert len(ahead) == len(ways)
    assert {(b, a) for a, b in ahead} == ahead


@every_cut
def test_the_surface_is_one_ball_without_loose_vertices(eye: Eye | None) -> None:
    solid = bumpy(eye)
    edges = len(solid.faces) * 3 // 2
    assert len(solid.vertices) - edges + len(solid.faces) == 2
    assert set(np.unique(solid.faces)) == set(range(len(solid.vertices)))


@every_cut
def test_normals_point_outward(eye: Eye | None) -> None:
    solid = bumpy(eye)
    a, b, c = (solid.vertices[solid.faces[:, k]] for k in range(3))
    normals, middles = np.cross(b - a, c - a), (a + b + c) / 3
    top = np.arange(len(normals)) < 2 * (len(grid_lines(LENS)) - 1) ** 2
    toward_eye = np.array([0, 0, 1.0]) if eye is None else eye - middles
    assert ((normals * toward_eye).sum(axis=1)[top] > 0).all()
    floor = (solid.vertices[solid.faces, 2] == 0).all(axis=1)
    assert (normals[floor, 2] < 0).all()
    sides = ~top & ~floor
    axis = solid.vertices[-1] * (1 - middles[sides, 2:] / THICK) if eye is not None else 0
    assert ((normals[sides] * (middles[sides] - axis))[:, :2].sum(axis=1) > 0).all()


@pytest.mark.parametrize("height", [0.0, 1.5, -2.0])
def test_the_volume_of_an_upright_slab_is_base_times_height(height: float) -> None:
    solid = solid_from_heights(surface(LENS, np.array(height), None))
    assert solid.metrics["volume_mm3"] == pytest.approx(LENS.size_mm**2 * (THICK + height), rel=1e-12)


@pytest.mark.parametrize("eye", [ABOVE, ASIDE])
@pytest.mark.parametrize("height", [0.0, 1.5, -2.0])
def test_the_volume_of_a_slab_cut_along_eye_rays_is_a_frustums(eye: Eye, height: float) -> None:
    solid = solid_from_heights(surface(LENS, np.array(height), eye))
    far = eye[2] - THICK
    down = far * np.exp(-height / far)
    top, bottom = (LENS.size_mm * d / far for d in (down, eye[2]))
    expected = (eye[2] - down) * (top**2 + top * bottom + bottom**2) / 3
    assert solid.metrics["volume_mm3"] == pytest.approx(expected, rel=1e-12)


def test_volume_grows_by_what_a_raised_facet_adds() -> None:
    flat, heights = solid_from_heights(surface(LENS, np.zeros(1), None)), np.zeros((3, 3, 1, 1))
    heights[1, 1] = 2.0
    raised = solid_from_heights(surface(LENS, heights, None))
    within, wall = LENS.pitch_mm - LENS.wall_mm, LENS.wall_mm
    # walls are ramps: half of them along the edges, a third at the corners, as both triangles of a corner meet there
    corners = (2 / 3 + 2 * 1 / 3 + 2 / 3) / 2 * wall**2
    assert volume(raised) - volume(flat) == pytest.approx(2.0 * (within**2 + 4 * within * wall / 2 + corners))


@every_cut
def test_every_vertex_lies_on_its_ray_at_its_height(eye: Eye | None) -> None:
    heights = np.random.default_rng(1).uniform(-2, 2, (3, 3, 6, 6))
    top = top_grid(solid_from_heights(surface(LENS, heights, eye)))[1:-1, 1:-1]
    x, y = (p.transpose(0, 2, 1, 3).reshape(18, 18) for p in plane_points_mm(LENS))
    plane = on_the_plane(top.reshape(-1, 3), eye)
    np.testing.assert_allclose(plane, np.stack([x, y], axis=-1).reshape(-1, 2), atol=1e-12)
    h = heights.transpose(0, 2, 1, 3).reshape(18, 18)
    far = ABOVE[2] - THICK
    z = THICK + h if eye is None else THICK + far * (1 - np.exp(-h / far))
    np.testing.assert_allclose(top[..., 2], z, atol=1e-12)


@every_cut
def test_the_sides_stand_along_the_rays_of_the_lenss_square(eye: Eye | None) -> None:
    solid = bumpy(eye)
    plane, half = on_the_plane(solid.vertices, eye), LENS.size_mm / 2
    border = top_grid(solid)
    rows, columns = border.shape[:2]
    outline = rows * columns + np.arange(2 * (rows + columns - 2))
    np.testing.assert_array_equal(solid.vertices[outline, 2], 0)
    np.testing.assert_allclose(np.abs(plane[outline]).max(axis=1), half, atol=1e-11)
    for side in (border[0], border[-1], border[:, 0], border[:, -1]):
        np.testing.assert_allclose(np.abs(on_the_plane(side, eye)).max(axis=1), half, atol=1e-11)


def test_row_0_is_plus_y_and_column_0_is_minus_x() -> None:
    heights = np.zeros((3, 3, 6, 6))
    heights[0, 2, 1, 4] = 2.0
    top = top_grid(solid_from_heights(surface(LENS, heights, None)))
    peak = top.reshape(-1, 3)[top[..., 2].argmax()]
    within = (LENS.pitch_mm - LENS.wall_mm) / 2
    np.testing.assert_allclose(peak, (4.0 + 0.6 * within, 4.0 + 0.6 * within, THICK + 2.0))


def test_walls_have_their_width_and_facets_the_rest() -> None:
    lines = grid_lines(LENS)
    gaps = np.diff(lines)
    np.testing.assert_allclose(gaps[6:-1:6], LENS.wall_mm)
    np.testing.assert_allclose(gaps[[0, -1]], LENS.wall_mm / 2)
    within = np.delete(gaps, [0, 6, 12, 18])
    np.testing.assert_allclose(within, (LENS.pitch_mm - LENS.wall_mm) / LENS.microfacets)
    assert (lines[0], lines[-1]) == (-LENS.size_mm / 2, LENS.size_mm / 2)


WIDE = replace(LENS, bleed_mm=1.5, floor_mm=40.0)


@every_cut
def test_a_lens_that_bleeds_and_leans_out_is_one_closed_ball(eye: Eye | None) -> None:
    solid = solid_from_heights(surface(WIDE, np.random.default_rng(0).uniform(-2, 2, (3, 3, 6, 6)), eye))
    mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.euler_number == 2
    assert mesh.body_count == 1
    assert mesh.volume == pytest.approx(solid.metrics["volume_mm3"])
    assert mesh.volume > bumpy(eye).metrics["volume_mm3"]
    assert mesh.area_faces.min() > 0


def test_the_volume_of_a_slab_that_leans_out_is_a_frustums() -> None:
    solid = solid_from_heights(surface(WIDE, np.zeros(1), None))
    top, bottom = LENS.size_mm + 3.0, 40.0
    assert solid.metrics["volume_mm3"] == pytest.approx(THICK * (top**2 + top * bottom + bottom**2) / 3, rel=1e-12)


@every_cut
@pytest.mark.parametrize("floor", [0.0, 10.0, 40.0])
def test_the_floor_holds_its_square_and_what_lies_below_the_lens(eye: Eye | None, floor: float) -> None:
    lens = replace(LENS, floor_mm=floor)
    field = surface(lens, np.zeros(1), eye)
    bottoms = [s.vertices[s.vertices[:, 2] == 0] for s in (bumpy(eye), solid_from_heights(field))]
    plain, found = (np.stack([b.min(axis=0), b.max(axis=0)])[:, :2] for b in bottoms)
    half = floor / 2 if floor else -np.inf
    np.testing.assert_allclose(found, [np.minimum(plain[0], -half), np.maximum(plain[1], half)], atol=1e-9)


def test_outer_facets_go_on_into_the_bleed_with_their_slope() -> None:
    x, y = plane_points_mm(WIDE)
    z = top_grid(solid_from_heights(surface(WIDE, 0.2 * x - 0.1 * y, None)))
    np.testing.assert_allclose(z[..., 2], THICK + 0.2 * z[..., 0] - 0.1 * z[..., 1], atol=1e-9)
    assert (z[0, 0, 0], z[0, 0, 1]) == (-LENS.size_mm / 2 - 1.5, LENS.size_mm / 2 + 1.5)


def test_what_goes_on_stays_within_the_relief() -> None:
    x, _ = plane_points_mm(WIDE)
    z = top_grid(solid_from_heights(surface(replace(WIDE, relief_mm=2.0), 0.3 * x, None)))[..., 2]
    assert (z.min(), z.max()) == (THICK - 2.0, THICK + 2.0)


@every_cut
def test_heights_are_read_back_from_a_lens_that_bleeds(eye: Eye | None) -> None:
    heights = np.random.default_rng(3).uniform(-2, 2, (3, 3, 6, 6))
    found = heights_of(solid_from_heights(surface(WIDE, heights, eye)), WIDE)
    np.testing.assert_allclose(found, heights, atol=1e-9)
