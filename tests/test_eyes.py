"""What other eyes see through facets made for one: against the tracer, and against walls seen askew."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magiclens.analysis.ideal_picture import predict
from magiclens.contract.artifacts import Assignment, FloatArray, HeightField, Scene, View
from magiclens.geometry.facets import edge_models, patches_seen
from magiclens.geometry.solid import solid_from_heights
from magiclens.integration.orientation import edge_rises
from magiclens.integration.poisson import lenslets
from magiclens.optics.eyes import (
    height_gradient,
    land,
    linearise,
    linearised,
    local_map,
    project,
    shift,
    surface_point,
    unknown_first_order,
)
from magiclens.optics.medium import Cut, Slab
from magiclens.optics.refraction import facet_normal, refract
from magiclens.optics.walls import DOWN, LEFT, RIGHT, UP
from magiclens.rendering.tracer import Tracer, trace
from scenes import (
    ABOVE,
    ASIDE,
    IOR,
    THICK,
    Eye,
    assigned,
    blank_scene,
    grey_view,
    plane_points_mm,
    ramps,
    small_lens,
    surface,
)

NEAR, FAR_RIGHT, BEHIND = (40.0, -25.0, THICK + 400.0), (104.0, 0.0, THICK + 386.0), (-70.0, 45.0, THICK + 400.0)
EYES = [NEAR, FAR_RIGHT, BEHIND]
BLANK = np.ones((8, 8))
gaps = pytest.mark.parametrize("gap", [0.0, 30.0])


def onward(eye: Eye, gap: float) -> FloatArray:
    """How far sideways a flat facet shows the source to this eye."""
    return -np.array(eye[:2]) * (THICK / IOR + gap) / (eye[2] - THICK)


@gaps
@pytest.mark.parametrize("height", [0.0, 1.2, -0.8])
@pytest.mark.parametrize("eye", [ABOVE, ASIDE])
def test_the_eye_that_a_facet_was_made_for_sees_its_patch(eye: Eye, height: float, gap: float) -> None:
    out, slab, me = unknown_first_order(2), Slab(THICK, gap, IOR), np.array(eye)
    assert linearise(me, (12.0, -7.0, height), (2.0, -3.0), me, slab, True, out, 1)
    np.testing.assert_allclose(out.landing[1], (14.0, -10.0), atol=1e-9)
    np.testing.assert_allclose(out.position[1], (12.0, -7.0), atol=1e-9)
    np.testing.assert_allclose(out.by_facet[1], np.zeros((2, 2)), atol=1e-7)
    np.testing.assert_allclose(out.by_source[1], np.eye(2), atol=1e-7)
    np.testing.assert_allclose(out.position_by_facet[1], np.eye(2), atol=1e-7)
    assert all(np.isnan(given[0]).all() for given in out), "the other row is left alone"
    m, seen = np.array([0.3, -0.2, 0.7]), np.zeros(4)
    local_map(out, 1, m, seen)
    np.testing.assert_allclose(seen, [0.3, -0.2, -0.2, 0.7], atol=1e-7)


def test_the_reference_eye_of_a_scene_sees_offsets_and_maps_exactly() -> None:
    rng, lens = np.random.default_rng(0), small_lens(3)
    scene = Scene(lens, (grey_view(BLANK, BLANK, (-30.0, 5.0, 440.0)), grey_view(BLANK, BLANK, (30.0, 5.0, 440.0))))
    chosen = assigned(rng.uniform(-2, 2, (3, 3, 2)), rng.uniform(-1, 1, (3, 3, 3)))
    seen = patches_seen(scene, chosen, np.array([0.0, 5.0, 440.0]), np.full((3, 3), 0.7))
    np.testing.assert_array_equal(seen.landings_mm, lens.facet_centres_mm() + chosen.offsets_mm)
    np.testing.assert_array_equal(seen.maps[..., [0, 0, 1, 1], [0, 1, 0, 1]], chosen.maps[..., [0, 1, 1, 2]])
    np.testing.assert_array_equal(seen.positions_mm, lens.facet_centres_mm())
    np.testing.assert_array_equal(seen.shears, np.broadcast_to(np.eye(2), (3, 3, 2, 2)))


CUTS = [Cut(np.array(ABOVE), False), Cut(np.array([30.0, -80.0, THICK + 200.0]), False), Cut(np.array(ABOVE), True)]
at = st.floats(-30.0, 30.0)


@given(at, at, st.floats(-3.0, 3.0), st.sampled_from(CUTS))
def test_a_point_of_the_top_lies_on_the_ray_or_line_of_its_name(u: float, v: float, height: float, cut: Cut) -> None:
    point, named = np.array(surface_point(cut, u, v, height, THICK)), np.array([u, v, THICK])
    if cut.vertical:
        np.testing.assert_allclose(point, (u, v, THICK + height))
        return
    far = cut.eye[2] - THICK
    np.testing.assert_allclose(point - cut.eye, np.exp(-height / far) * (named - cut.eye), atol=1e-9)
    np.testing.assert_allclose(project(cut.eye, tuple(point), THICK), (u, v), atol=1e-9)


@given(at, at, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.sampled_from(CUTS))
def test_heights_with_the_gradient_of_a_normal_make_a_surface_with_that_normal(
    u: float, v: float, x: float, y: float, cut: Cut
) -> None:
    normal = np.array([x, y, 1.0]) / np.hypot(1.0, np.hypot(x, y))
    gu, gv = height_gradient(cut, u, v, tuple(normal), THICK)
    step = 1e-5
    for du, dv in ((step, 0.0), (0.0, step)):
        there = surface_point(cut, u + du, v + dv, gu * du + gv * dv, THICK)
        back = surface_point(cut, u - du, v - dv, -gu * du - gv * dv, THICK)
        assert np.subtract(there, back) @ normal == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("gap", [0.0, 30.0])
@pytest.mark.parametrize("eye", [ABOVE, ASIDE])
def test_light_lands_where_snells_law_takes_it(eye: Eye, gap: float) -> None:
    point, normal = np.array([5.0, -3.0, THICK + 1.0]), np.array([0.2, -0.1, 1.0]) / np.sqrt(1.05)
    ray = (point - eye) / np.linalg.norm(point - np.array(eye))
    inside = np.array(refract(*ray, *normal, IOR))
    bottom = point - inside * point[2] / inside[2]
    below = np.array(refract(*inside, 0.0, 0.0, 1.0, 1 / IOR))
    x, y, arrives = land(eye, tuple(point), tuple(normal), Slab(THICK, gap, IOR))
    assert arrives
    np.testing.assert_allclose((x, y), (bottom - below * gap / below[2])[:2], atol=1e-9)


@pytest.mark.parametrize(("tilt_deg", "arrives"), [(0.0, True), (80.0, True), (85.0, False), (95.0, False)])
def test_light_does_not_land_past_the_critical_angle_nor_from_behind_a_facet(tilt_deg: float, arrives: bool) -> None:
    """Straight from above; a facet of 85 degrees bends it by 43, and 42 are the most at the flat bottom."""
    tilt = np.radians(tilt_deg)
    normal = (float(np.sin(tilt)), 0.0, float(np.cos(tilt)))
    assert land(ABOVE, (0.0, 0.0, THICK), normal, Slab(THICK, 10.0, IOR))[2] == arrives


@pytest.mark.parametrize("gap", [0.0, 30.0])
@pytest.mark.parametrize(("made_for", "eye"), [(ABOVE, (90.0, 40.0, 340.0)), (ASIDE, (-60.0, 150.0, 500.0))])
def test_what_an_eye_sees_to_first_order_is_what_exact_rays_show_nearby(made_for: Eye, eye: Eye, gap: float) -> None:
    """A lenslet with a map, and a flat micro-facet in its middle; raised, so that the eye sees it elsewhere."""
    slab, cut = Slab(THICK, gap, IOR), Cut(np.array(made_for), False)
    centre, height, offset, xx, xy, yy = np.array([4.0, -7.0]), 0.8, np.array([1.5, -2.5]), 0.6, 0.2, -0.4
    seen = linearised(np.array(eye), cut.eye, centre[None], np.array([height]), offset[None], slab)

    def normal_at(p: FloatArray, h: float) -> tuple[float, float, float]:
        wanted = centre + offset + np.array([[xx, xy], [xy, yy]]) @ p
        point = surface_point(cut, *(centre + p), h, THICK)
        normal: tuple[float, float, float] = facet_normal(made_for, point, tuple(wanted), slab)
        return normal

    flat = normal_at(np.zeros(2), height)
    gradient = np.array(height_gradient(cut, *centre, flat, THICK))

    def shown(p: FloatArray, normal: tuple[float, float, float] | None = None) -> FloatArray:
        """Landing and position of the point p from the facet's centre."""
        h = height + gradient @ p
        point = surface_point(cut, *(centre + p), h, THICK)
        x, y, _ = land(eye, point, normal or normal_at(p, h), slab)
        return np.array([x, y, *project(eye, point, THICK)])

    local = np.zeros(4)
    local_map(seen, 0, (xx, xy, yy), local)
    np.testing.assert_allclose(np.append(seen.landing[0], seen.position[0]), shown(np.zeros(2)), atol=1e-9)
    for axis, step in enumerate(1e-3 * np.eye(2)):
        moved = (shown(step) - shown(-step)) / 2e-3
        still = (shown(step, flat) - shown(-step, flat)) / 2e-3
        np.testing.assert_allclose(local.reshape(2, 2)[:, axis], moved[:2], atol=2e-3)
        np.testing.assert_allclose(seen.position_by_facet[0, :, axis], moved[2:], atol=2e-3)
        np.testing.assert_allclose(seen.flat_by_facet[0, :, axis], still[:2], atol=2e-3)
    before = seen.landing[0].copy()
    shift(seen, 0, 0.5)
    np.testing.assert_allclose(seen.landing[0] - before, 0.5 * seen.by_source[0, :, 0])


def lens_at(scene: Scene, chosen: Assignment, levels: FloatArray) -> HeightField:
    """Facets that show what they were assigned, at given mean heights (N, N), by the integrator's own steps."""
    n, k = scene.lens.facets, scene.lens.microfacets + 1
    heights = np.zeros((n, n, k, k)) + levels[..., None, None]
    for _ in range(5):
        rows, columns, _ = edge_rises(scene, chosen, heights)
        heights = lenslets(rows, columns).reshape(n, n, k, k) + levels[..., None, None]
    return HeightField(scene.lens, heights, scene.cut_eye_mm)


@pytest.mark.parametrize(
    ("cells", "height", "gap"), [("eye", 0.0, 0.0), ("eye", 0.7, 30.0), ("vertical", 0.7, 0.0), ("vertical", 0.0, 30.0)]
)
@pytest.mark.parametrize(("made_for", "eye"), [(ABOVE, FAR_RIGHT), (ABOVE, BEHIND), (ASIDE, NEAR)])
def test_other_eyes_see_what_the_tracer_finds(made_for: Eye, eye: Eye, cells: str, height: float, gap: float) -> None:
    """In place and in shape. The lens is one facet, small, so that only the linear part of what it shows matters."""
    pitch, per, rng = 1.0, 256, np.random.default_rng(1)
    lens = small_lens(1, pitch, source=150.0, microfacets=96, gap_mm=gap, cells=cells, floor_mm=100.0)
    scene = blank_scene(lens, made_for)
    signs, sizes = rng.choice([-1.0, 1.0], 2), rng.uniform(0.2, 0.9, 2)
    chosen = assigned(
        np.reshape(onward(made_for, gap) + rng.uniform(-1.5, 1.5, 2), (1, 1, 2)),
        np.array([signs[0] * sizes[0], 0.25, signs[1] * sizes[1]]),
    )
    field = lens_at(scene, chosen, np.full((1, 1), height))
    hits = trace(solid_from_heights(field), lens, grey_view(BLANK, BLANK, eye), per, 1)[:, :, 0].astype(float)
    seen = linearised(
        np.array(eye), np.array(made_for), np.zeros((1, 2)), field.heights_mm[:, :, 48, 48].flatten(),
        chosen.offsets_mm.reshape(1, 2).astype(float), Slab(THICK, gap, IOR),
    )  # fmt: skip
    expected = seen.by_facet[0] + seen.by_source[0] @ chosen.maps[0, 0][[0, 1, 1, 2]].reshape(2, 2)
    at = ((np.arange(per) + 0.5) / per - 0.5) * pitch
    q = np.stack(np.meshgrid(at, -at), axis=-1) - seen.position[0]
    p = q @ np.linalg.inv(seen.position_by_facet[0]).T
    own = np.abs(p).max(axis=-1) < 0.25 * pitch
    assert own.sum() > 3000
    assert (hits[own, 2] > 0).all()
    x, y = p[own].T
    quadratic = np.column_stack([np.ones_like(x), x, y, x**2, x * y, y**2])
    fit = np.linalg.lstsq(quadratic, hits[own, :2], rcond=None)[0]
    np.testing.assert_allclose(fit[0], seen.landing[0], atol=3e-3)
    np.testing.assert_allclose(fit[1:3].T, expected, atol=1.2e-2)
    assert np.linalg.norm(fit[0] - chosen.offsets_mm[0, 0]) > 1.0


@gaps
def test_within_a_flat_micro_facet_the_source_passes_by_as_through_a_plane(gap: float) -> None:
    lens, offset = small_lens(2, 1.0, source=150.0, gap_mm=gap, floor_mm=100.0), np.array([3.0, -2.0])
    slab = Slab(THICK, gap, IOR)
    seen = linearised(np.array(FAR_RIGHT), np.array(ABOVE), np.zeros((1, 2)), np.zeros(1), offset[None], slab)
    nx, ny, nz = facet_normal(ABOVE, (0.0, 0.0, THICK), tuple(offset), slab)
    x, y = plane_points_mm(lens)
    plane = solid_from_heights(surface(lens, -(nx * x + ny * y) / nz, None))
    hits = trace(plane, lens, grey_view(BLANK, BLANK, FAR_RIGHT), 64, 1)[20:44, 20:44, 0].astype(float)
    at = (((np.arange(64) + 0.5) / 64 - 0.5) * lens.size_mm)[20:44]
    p = np.stack(np.meshgrid(at, -at), axis=-1).reshape(-1, 2) @ np.linalg.inv(seen.position_by_facet[0]).T
    fit = np.linalg.lstsq(np.column_stack([np.ones(len(p)), p]), hits.reshape(-1, 3)[:, :2], rcond=None)[0]
    np.testing.assert_allclose(fit[0], seen.landing[0], atol=1e-4)
    np.testing.assert_allclose(fit[1:].T, seen.flat_by_facet[0], atol=1e-3)
    assert np.abs(seen.flat_by_facet[0] - np.eye(2)).max() > 0.05


def test_what_is_reflected_totally_is_not_seen_and_predicted_black() -> None:
    """A facet that bends light far to the right traps the light of an eye that looks to the right already."""
    far_left = np.array([-700.0, 0.0, THICK + 400.0])
    offsets = np.array([[0.0, 0.0], [15.0, 0.0]])
    slab = Slab(THICK, 5.0, IOR)
    seen = linearised(far_left, np.array(ABOVE), np.zeros((2, 2)), np.zeros(2), offsets, slab)
    assert all(np.isfinite(a[0]).all() and np.isnan(a[1]).all() for a in seen)
    white = np.ones((16, 16))
    scene = Scene(
        small_lens(1, source=90.0, gap_mm=5.0),
        tuple(grey_view(white, white, (x, 0.0, THICK + 400.0)) for x in (-700.0, 700.0)),
    )
    for offset, light in zip(offsets, (1.0, 0.0), strict=True):
        picture = predict(scene, assigned(offset.reshape(1, 1, 2), np.array([0.2, 0.0, 0.2])), 16, 1)[0]
        np.testing.assert_allclose(picture, light, atol=1e-6)


@pytest.mark.parametrize("turns", [0, 1])
def test_the_prediction_for_other_eyes_is_the_traced_picture(turns: int) -> None:
    """The source tells by its colour which point is seen. Where the facets stand matters."""
    lens, rng = small_lens(3, 3.0, source=60.0, microfacets=48, floor_mm=56.0, bleed_mm=1.5), np.random.default_rng(0)
    views = tuple(View("v", ramps(), ramps(), np.array([x, 0.3 * x, 440.0]), 90.0 * turns) for x in (90.0, -90.0))
    scene = Scene(lens, views)
    chosen = assigned(rng.uniform(-1, 1, (3, 3, 2)), np.array([0.5, 0.1, -0.4]))
    field = lens_at(scene, chosen, rng.uniform(-1, 1, (3, 3)))
    traced = Tracer(resolution=96, samples=2).render(scene, solid_from_heights(field))
    standing, lying = (predict(scene, chosen, 96, 2, at) for at in (field.levels_mm, None))
    for k in range(2):
        lit = traced[k][..., 2] > 0.8
        points = [(p[k][lit, :2] / p[k][lit, 2:] - 0.5) * 60.0 for p in (traced, standing, lying)]
        astray, astray_lying = (np.linalg.norm(points[0] - p, axis=-1) for p in points[1:])
        assert lit.mean() > 0.9
        assert np.median(astray) < 0.02
        assert np.quantile(astray, 0.9) < 0.06
        assert np.quantile(astray_lying, 0.9) > 3 * np.quantile(astray, 0.9)


def test_a_lens_that_stands_higher_is_predicted_where_a_tilted_eye_sees_its_facets() -> None:
    """All of them are displaced in its picture, by a sixth of their width: a strip of each place shows a neighbour."""
    lens, rng = small_lens(3, 3.0, source=60.0, microfacets=48, floor_mm=56.0, bleed_mm=1.5), np.random.default_rng(0)
    views = tuple(View("v", ramps(), ramps(), np.array([x, 0.0, 440.0])) for x in (90.0, -90.0))
    scene = Scene(lens, views)
    chosen = assigned(rng.uniform(-1.5, 1.5, (3, 3, 2)), np.array([0.5, 0.1, -0.4]))
    field = lens_at(scene, chosen, np.full((3, 3), 2.2))
    traced = Tracer(resolution=96, samples=2).render(scene, solid_from_heights(field))
    predicted = predict(scene, chosen, 96, 2, field.levels_mm)
    for ours, real in zip(predicted, traced, strict=True):
        lit = real[..., 2] > 0.8
        astray = np.linalg.norm(ours[lit, :2] / ours[lit, 2:] - real[lit, :2] / real[lit, 2:], axis=-1) * 60.0
        assert lit.mean() > 0.95
        assert np.quantile(astray, 0.9) < 0.08


def test_walls_of_a_scene_whose_views_share_one_eye_are_those_of_that_eye() -> None:
    rng, lens = np.random.default_rng(0), small_lens(3)
    offsets, maps = rng.uniform(-2, 2, (3, 3, 4, 2)), rng.uniform(-1, 1, (3, 3, 4, 3))
    one, same = (Scene(lens, (grey_view(BLANK, BLANK, ASIDE),) * k) for k in (1, 4))
    for a, b in zip(edge_models(one, offsets, maps), edge_models(same, offsets, maps), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.every_third
@pytest.mark.parametrize("cells", ["eye", "vertical"])
@pytest.mark.parametrize("edge", [RIGHT, UP, LEFT, DOWN])
def test_a_wall_takes_light_inside_the_slab_and_where_an_eye_sees_it(edge: int, cells: str) -> None:
    """Eyes on either side of a plateau: one sees its wall, light of the other meets it from within."""
    step, count, side = 0.8, 600, edge in (RIGHT, LEFT)
    lens = small_lens(3, 4.0, source=150.0, wall_mm=1e-4, microfacets=1, floor_mm=120.0, cells=cells)
    eyes = [(x, 0.0, THICK + 400.0) if side else (0.0, x, THICK + 400.0) for x in (100.0, -100.0)]
    scene = Scene(lens, tuple(grey_view(BLANK, BLANK, eye) for eye in eyes))
    flat = np.zeros((3, 3, 1, 1))
    plateau = flat.copy()
    plateau[1, 1] = step
    solids = [solid_from_heights(surface(lens, h, None if cells == "vertical" else ABOVE)) for h in (flat, plateau)]
    pixel, middle = lens.size_mm / count, count // 2 + 3
    beyond = ((np.arange(count) + 0.5) * pixel - lens.size_mm / 2) * (1 if edge in (RIGHT, DOWN) else -1) > 0
    widths = []
    for view in scene.views:
        straight, seen = (trace(solid, lens, view, count, 1)[:, :, 0] for solid in solids)
        straight, seen = (hits[middle] if side else hits[:, middle] for hits in (straight, seen))
        astray = (np.abs(seen - straight)[:, :2].max(axis=-1) > 0.5) | (seen[:, 2] == 0)
        widths.append((astray & beyond).sum() * pixel)
    _, drifts = edge_models(scene, np.zeros((3, 3, 1, 2)), np.ones((3, 3, 1, 3)) * (1, 0, 1))
    assert min(widths) > 0.1
    assert np.mean(widths) == pytest.approx(step * drifts[1, 1, 0, edge, 0], abs=pixel)


@pytest.mark.parametrize("cells", ["eye", "vertical"])
def test_what_a_wall_takes_is_a_mean_over_the_eyes(cells: str) -> None:
    rng, lens = np.random.default_rng(2), small_lens(3, cells=cells)
    offsets, maps = rng.uniform(-2, 2, (3, 3, 2, 2)), rng.uniform(-1, 1, (3, 3, 2, 3))
    centre, aside = np.array(ABOVE), np.array([80.0, 30.0, 0.0])

    def drifts(*eyes: FloatArray) -> FloatArray:
        return edge_models(Scene(lens, tuple(grey_view(BLANK, BLANK, tuple(e)) for e in eyes)), offsets, maps)[1]

    # all pairs have the same middle, and so the same facets
    pairs = [drifts(centre + k * aside, centre - k * aside) for k in (1.0, 0.5)]
    four = drifts(*(centre + k * aside for k in (1.0, 0.5, -0.5, -1.0)))
    np.testing.assert_allclose(four, np.mean(pairs, axis=0), atol=1e-6)
    assert (pairs[0] > drifts(centre) + 0.01).mean() > 0.3
