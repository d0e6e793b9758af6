"""Integration: known surfaces come back, edges meet, and what cannot be built is said."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.optimize import brentq

from magiclens.contract.artifacts import Assignment, FloatArray, HeightField, Lens, Scene, Solid
from magiclens.contract.errors import StageError
from magiclens.contract.stages import Integrator
from magiclens.geometry.facets import EDGE_POINTS, built_drifts, edge_models
from magiclens.geometry.solid import solid_from_heights
from magiclens.integration.iterate import iterate
from magiclens.integration.least_squares import LeastSquaresIntegrator, solve_weighted
from magiclens.integration.levels import levels_of_least_lost_light, levels_of_least_steps
from magiclens.integration.orientation import edge_rises
from magiclens.integration.poisson import Poisson, lenslets
from magiclens.optics.walls import DOWN, LEFT, RIGHT, UP
from scenes import ABOVE, ASIDE, IOR, THICK, Eye, assigned, blank_scene, small_lens

SLOPES = {
    "plane": (0.12, -0.07, 0.0, 0.0, 0.0),
    "paraboloid": (0.0, 0.0, 0.008, 0.0, 0.008),
    "saddle": (0.02, 0.03, 0.006, 0.003, -0.005),
}
surfaces = pytest.mark.parametrize("name", list(SLOPES))
integrators = pytest.mark.parametrize(
    "integrator",
    [Poisson(placement="steps", screening=1e-9), LeastSquaresIntegrator(screening=1e-12)],
    ids=["poisson", "least-squares"],
)


def height(name: str, x: FloatArray, y: FloatArray) -> FloatArray:
    """z - thickness of a known surface, mm."""
    a, b, xx, xy, yy = SLOPES[name]
    return a * x + b * y + xx * x**2 / 2 + xy * x * y + yy * y**2 / 2


def seen_through(name: str, lens: Lens, eye: Eye, u: float, v: float) -> FloatArray:
    """The source point that the eye sees through a known surface, at (u, v) of the reference plane."""
    ray = np.array([u, v, lens.thickness_mm]) - eye
    ray /= np.linalg.norm(ray)

    def above(t: float) -> float:
        x, y, z = eye + t * ray
        return float(z - lens.thickness_mm - height(name, x, y))

    start = eye + brentq(above, 0.0, 2 * eye[2], xtol=1e-12) * ray
    a, b, xx, xy, yy = SLOPES[name]
    x, y, _ = start
    normal = np.array([-a - xx * x - xy * y, -b - xy * x - yy * y, 1.0])
    inside = bent(ray, normal / np.linalg.norm(normal), IOR)
    outside = bent(inside, np.array([0, 0, 1.0]), 1 / IOR)
    return (start - inside * start[2] / inside[2] - outside * lens.gap_mm / outside[2])[:2]


def bent(ray: FloatArray, normal: FloatArray, eta: float) -> FloatArray:
    along = (ray - ray @ normal * normal) / eta
    return along - math.sqrt(1 - along @ along) * normal


def transformations(name: str, lens: Lens, eye: Eye) -> Assignment:
    """What each facet of a known surface shows: the offset at its centre and the map around it."""
    n, d = lens.facets, 1e-3
    offsets, maps = np.zeros((n, n, 2)), np.zeros((n, n, 3))
    for i, j in np.ndindex(n, n):
        x, y = lens.facet_centres_mm()[i, j]
        offsets[i, j] = seen_through(name, lens, eye, x, y) - (x, y)
        by_x = (seen_through(name, lens, eye, x + d, y) - seen_through(name, lens, eye, x - d, y)) / (2 * d)
        by_y = (seen_through(name, lens, eye, x, y + d) - seen_through(name, lens, eye, x, y - d)) / (2 * d)
        maps[i, j] = by_x[0], (by_x[1] + by_y[0]) / 2, by_y[1]
    return assigned(offsets, maps)


def top_points(heights: HeightField) -> FloatArray:
    solid = solid_from_heights(heights)
    assert solid.grid is not None
    return solid.vertices[: solid.grid[0] * solid.grid[1]].reshape(*solid.grid, 3)[1:-1, 1:-1]


@surfaces
@integrators
@pytest.mark.parametrize(("cells", "eye", "gap"), [("eye", ABOVE, 0.0), ("eye", ASIDE, 25.0), ("vertical", ABOVE, 0.0)])
def test_a_known_surface_comes_back(name: str, integrator: Integrator, cells: str, eye: Eye, gap: float) -> None:
    lens = small_lens(8, 1.0, microfacets=4, cells=cells, gap_mm=gap)
    heights = integrator.integrate(blank_scene(lens, eye), transformations(name, lens, eye))
    x, y, z = np.moveaxis(top_points(heights), -1, 0)
    miss = z - lens.thickness_mm - height(name, x, y)
    # where the surface crosses the reference plane is up to the integrator
    assert np.abs(miss - miss.mean()).max() < 2e-3
    assert np.ptp(z) > 0.1
    assert heights.metrics["step_max_mm"] < 1e-3


@integrators
def test_the_surface_is_where_the_heights_say_for_the_reference_eye(integrator: Integrator) -> None:
    lens = small_lens(4, 1.0, microfacets=4)
    scene = blank_scene(lens, ASIDE)
    upright = replace(scene, lens=replace(lens, cells="vertical"))
    assignment = transformations("saddle", lens, ASIDE)
    np.testing.assert_array_equal(integrator.integrate(scene, assignment).eye_mm, ASIDE)
    assert integrator.integrate(upright, assignment).eye_mm is None


@integrators
def test_far_eyes_make_no_difference_between_eye_cells_and_vertical_ones(integrator: Integrator) -> None:
    far = (0.0, 0.0, 1e7)
    lens = small_lens(4, 2.0, microfacets=4)
    rng = np.random.default_rng(0)
    assignment = assigned(rng.uniform(-3, 3, (4, 4, 2)), (0.4, 0.1, -0.5))
    upright = replace(lens, cells="vertical")
    along_rays = integrator.integrate(blank_scene(lens, far), assignment).heights_mm
    vertical = integrator.integrate(blank_scene(upright, far), assignment).heights_mm
    assert np.ptp(vertical) > 0.5
    np.testing.assert_allclose(along_rays, vertical, atol=1e-4)


@pytest.mark.parametrize("k", [2, 3, 6, 9])
def test_integrable_edge_rises_are_integrated_exactly(k: int) -> None:
    h = np.random.default_rng(k).normal(size=(5, k, k))
    h -= h.mean(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(lenslets(np.diff(h, axis=2), np.diff(h, axis=1)), h, atol=1e-12)


def test_rises_with_a_curl_are_met_in_the_least_squares_sense() -> None:
    rng, k = np.random.default_rng(0), 4
    rows, columns = rng.normal(size=(1, k, k - 1)), rng.normal(size=(1, k - 1, k))
    best = lenslets(rows, columns)[0]

    def miss(h: FloatArray) -> float:
        return float(((np.diff(h, axis=1) - rows[0]) ** 2).sum() + ((np.diff(h, axis=0) - columns[0]) ** 2).sum())

    for _ in range(20):
        assert miss(best) < miss(best + 1e-3 * rng.normal(size=(k, k)))
    assert abs(best.mean()) < 1e-12


def test_pieces_of_one_surface_are_placed_so_that_they_meet() -> None:
    rng, n, k = np.random.default_rng(0), 4, 5
    whole = np.cumsum(np.cumsum(rng.normal(size=(n * (k - 1) + 1,) * 2), axis=0), axis=1) / 20
    pieces = np.array([[whole[i * 4 : i * 4 + k, j * 4 : j * 4 + k] for j in range(n)] for i in range(n)])
    means = pieces.mean(axis=(2, 3))
    levels, _ = levels_of_least_steps(pieces - means[:, :, None, None], 1e-12, 100.0)
    np.testing.assert_allclose(levels - levels.mean(), means - means.mean(), atol=1e-6)


def test_screening_pulls_facets_to_the_reference_plane() -> None:
    rise = np.linspace(-0.5, 0.5, 5) * np.ones((6, 6, 5, 1))
    shapes = rise * np.cos(np.pi * (np.arange(6) + 0.5) / 6)[:, None, None]
    free, pulled, flat = (levels_of_least_steps(shapes, screening, 50.0)[0] for screening in (0.0, 0.5, 100.0))
    assert np.abs(pulled).mean() < 0.7 * np.abs(free).mean()
    assert np.abs(flat).mean() < 0.02 * np.abs(free).mean()


@pytest.mark.parametrize("wall", [1e-6, 0.2])
def test_row_rises_grow_with_plus_x_and_column_rises_fall_with_plus_y(wall: float) -> None:
    """A facet that shows what lies at +x and +y of it must rise toward both."""
    lens = small_lens(2, 1.0, microfacets=3, wall_mm=wall)
    rows, columns, clamped = edge_rises(
        blank_scene(lens), assigned(np.full((2, 2, 2), 3.0), (1, 0, 1)), np.zeros((2, 2, 4, 4))
    )
    assert (rows > 0).all()
    assert (columns < 0).all()
    assert (clamped == 0).all()
    # near normal incidence a wedge bends light by (n - 1) times its slope, over n inside
    assert rows.mean() / ((lens.pitch_mm - lens.wall_mm) / 3) == pytest.approx(3.0 / THICK * IOR / (IOR - 1), rel=0.05)


@pytest.mark.parametrize(("cells", "eye"), [("eye", ABOVE), ("eye", ASIDE), ("vertical", ASIDE)])
def test_a_lenslets_edges_are_as_the_annealer_assumed(cells: str, eye: Eye) -> None:
    """The second-order model of ``edge_models`` against the integrated surface, edge by edge."""
    lens = small_lens(1, 1.0, microfacets=32, wall_mm=1e-6, cells=cells)
    scene = blank_scene(lens, eye)
    for seed in range(6):
        rng = np.random.default_rng(seed)
        wanted = assigned(rng.uniform(-4, 4, (1, 1, 2)), rng.uniform(-0.9, 0.9, 3))
        shape = Poisson().integrate(scene, wanted).heights_mm[0, 0]
        shape = shape - shape.mean()
        profiles, _ = edge_models(scene, wanted.offsets_mm[:, :, None], wanted.maps[:, :, None])
        at = (np.arange(EDGE_POINTS) + 0.5) / EDGE_POINTS * 32
        for edge, line in {RIGHT: shape[::-1, -1], LEFT: shape[::-1, 0], UP: shape[0], DOWN: shape[-1]}.items():
            np.testing.assert_allclose(profiles[0, 0, 0, edge], np.interp(at, np.arange(33), line), atol=5e-3)


@pytest.mark.parametrize(("cells", "eye"), [("eye", ABOVE), ("eye", ASIDE), ("vertical", ASIDE)])
def test_rays_drift_at_built_edges_as_the_annealer_assumed(cells: str, eye: Eye) -> None:
    lens = small_lens(3, 1.0, microfacets=32, wall_mm=1e-6, cells=cells)
    scene, assignment = blank_scene(lens, eye), wild(3, 4, 1.0)
    built = built_drifts(scene, Poisson().integrate(scene, assignment).heights_mm)
    _, drifts = edge_models(scene, assignment.offsets_mm[:, :, None], assignment.maps[:, :, None])
    assert drifts.max() > 0.02
    np.testing.assert_allclose(built.mean(-1), drifts[:, :, 0].mean(-1), atol=5e-3)


def wild(n: int, seed: int, reach: float = 4.0) -> Assignment:
    rng = np.random.default_rng(seed)
    return assigned(rng.uniform(-reach, reach, (n, n, 2)), rng.uniform(-1, 1, (n, n, 3)) * (1, 0.3, 1))


@pytest.mark.parametrize("placement", ["light", "steps"])
@pytest.mark.parametrize("seed", range(3))
def test_heights_converge_and_keep_within_the_relief(placement: str, seed: int) -> None:
    lens = small_lens(6, 3.0, microfacets=8, relief_mm=2.0)
    options = Poisson(placement=placement)
    heights = options.integrate(blank_scene(lens), wild(6, seed))
    assert np.abs(heights.heights_mm).max() <= 2.0
    assert heights.metrics["integration_change_mm"] < options.tolerance
    assert heights.metrics["integration_rounds"] < options.rounds
    assert not heights.heights_mm.flags.writeable


def test_a_tighter_relief_lowers_the_lens() -> None:
    assignment = assigned(np.broadcast_to((3.0, 2.0), (8, 8, 2)), (1, 0, 1))
    spans = []
    for relief in (5.0, 1.0):
        lens = small_lens(8, 2.0, microfacets=4, relief_mm=relief)
        spans.append(np.ptp(Poisson(placement="steps").integrate(blank_scene(lens), assignment).heights_mm))
    assert spans[1] <= 2.0 < spans[0]


def test_placing_for_light_loses_less_light_than_placing_for_small_steps() -> None:
    lens = small_lens(6, 3.0, microfacets=8)
    scene, assignment = blank_scene(lens), wild(6, 0)
    lost = {
        p: lost_light(scene, assignment, Poisson(placement=p).integrate(scene, assignment)) for p in ("light", "steps")
    }
    assert lost["light"] < 0.8 * lost["steps"]


@pytest.mark.parametrize("end", [0, -1])
def test_a_wall_at_one_end_of_an_edge_is_seen_by_placing(end: int) -> None:
    """Rays of the left facets drift right: wherever these stand higher, even at a corner alone, light is lost."""
    lens = small_lens(2, 3.0, microfacets=16)
    scene = blank_scene(lens)
    shapes = np.zeros((2, 2, 17, 17))
    shapes[:, 0] = np.linspace(-0.5, 0.5, 17)
    shapes[:, 0, end, -1] += 0.3
    drifts = built_drifts(scene, shapes)
    assert (drifts[:, 0, RIGHT] > 0).all()
    assert (drifts[:, 1, LEFT] < 1e-6).all()
    h = shapes + levels_of_least_lost_light(scene, shapes, np.zeros((2, 2)), 1e-7)[..., None, None]
    assert (h[:, 0, :, -1] - h[:, 1, :, 0]).max() == pytest.approx(0, abs=1e-3)


def lost_light(scene: Scene, assignment: Assignment, heights: HeightField) -> float:
    """Area of the strips that walls darken, mm^2: step times drift, on the higher side."""
    _, drifts = edge_models(scene, assignment.offsets_mm[:, :, None], assignment.maps[:, :, None])
    h, t = heights.heights_mm, drifts[:, :, 0].mean(-1)
    steps_right = (h[:, :-1, :, -1] - h[:, 1:, :, 0]).clip(0), (h[:, 1:, :, 0] - h[:, :-1, :, -1]).clip(0)
    steps_up = (h[1:, :, 0] - h[:-1, :, -1]).clip(0), (h[:-1, :, -1] - h[1:, :, 0]).clip(0)
    across = steps_right[0].mean(-1) * t[:, :-1, RIGHT] + steps_right[1].mean(-1) * t[:, 1:, LEFT]
    along = steps_up[0].mean(-1) * t[1:, :, UP] + steps_up[1].mean(-1) * t[:-1, :, DOWN]
    return float(across.sum() + along.sum()) * scene.lens.pitch_mm


@pytest.mark.parametrize("microfacets", [1, 2, 3])
@pytest.mark.parametrize("placement", ["light", "steps"])
def test_facets_of_very_few_microfacets_can_be_built(placement: str, microfacets: int) -> None:
    lens = small_lens(4, microfacets=microfacets)
    heights = Poisson(placement=placement).integrate(blank_scene(lens), wild(4, 0, 2.0)).heights_mm
    assert np.isfinite(heights).all()
    assert np.ptp(heights) > 0.1


def test_light_placement_fits_in_the_relief_whenever_steps_placement_does() -> None:
    """Lenslets of different shapes: some reach furthest at their edges, some in the middle."""
    lens = small_lens(6, microfacets=10, relief_mm=0.8)
    rng = np.random.default_rng(11)
    offsets = np.broadcast_to(rng.uniform(-3, 3, 2), (6, 6, 2))
    scale = rng.uniform(-1.5, 2, (6, 6))
    assignment = assigned(offsets, np.stack([scale, 0 * scale, scale], axis=-1))
    for placement in ("steps", "light"):
        heights = Poisson(placement=placement).integrate(blank_scene(lens), assignment)
        assert np.abs(heights.heights_mm).max() <= 0.8


@integrators
def test_a_facet_taller_than_the_relief_is_named(integrator: Integrator) -> None:
    lens = small_lens(3, 6.0, relief_mm=0.2)
    offsets = np.zeros((3, 3, 2))
    offsets[1, 2] = (8.0, 0.0)
    with pytest.raises(StageError, match=r"facet \(row \d, column \d\) needs .* mm of relief, more than .*0\.2"):
        integrator.integrate(blank_scene(lens), assigned(offsets, (1, 0, 1)))


def test_heights_that_will_not_rest_are_an_error_that_names_a_facet() -> None:
    lens = small_lens(3, 6.0, relief_mm=30.0)
    with pytest.raises(StageError, match=r"did not converge: facet \(row \d, column \d\) still moves by .* mm; use a"):
        Poisson(rounds=1).integrate(blank_scene(lens), wild(3, 0))


def test_rounds_end_once_nothing_moves_and_whole_changes_are_made() -> None:
    lens = small_lens(2)
    scene, wanted = blank_scene(lens), np.random.default_rng(0).normal(size=(2, 2, 9, 9)) / 10
    told: list[float] = []
    built = iterate(scene, wild(2, 0), lambda *_: wanted, 5, 1e-6, told.append)
    np.testing.assert_allclose(built.heights_mm, wanted, atol=1e-12)
    assert built.metrics["integration_rounds"] == 2
    assert built.metrics["integration_change_mm"] == 0
    assert told == pytest.approx([0.2, 0.4])


def test_changes_that_grow_are_halved_until_the_heights_rest() -> None:
    """Each round overshoots by one and a half times what is missing."""
    lens, wanted = small_lens(1), 0.5
    built = iterate(
        blank_scene(lens), wild(1, 0), lambda rows, columns, heights, done: wanted - 1.5 * (heights - wanted),
        100, 1e-6, lambda _: None,
    )  # fmt: skip
    np.testing.assert_allclose(built.heights_mm, wanted, atol=1e-5)


@pytest.mark.parametrize(("placement", "times"), [("light", 1), ("steps", 0)])
def test_light_is_asked_for_in_the_first_round_only(
    placement: str, times: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[FloatArray] = []

    def counted(scene: Scene, shapes: FloatArray, levels: FloatArray, step_weight: float) -> FloatArray:
        calls.append(levels)
        return levels_of_least_lost_light(scene, shapes, levels, step_weight)

    monkeypatch.setattr("magiclens.integration.levels.levels_of_least_lost_light", counted)
    built = Poisson(placement=placement).integrate(blank_scene(small_lens(3)), wild(3, 1))
    assert built.metrics["integration_rounds"] > 3
    assert len(calls) == times


def test_placing_for_light_settles_and_keeps_low_steps_only_as_far_as_they_weigh() -> None:
    lens = small_lens(4, relief_mm=3.0)
    steps = [
        Poisson(step_weight=weight).integrate(blank_scene(lens), wild(4, 2)).metrics["step_mean_mm"]
        for weight in (0.0, 100.0)
    ]
    assert steps[1] < 0.95 * steps[0]


def microfacet_angles(solid: Solid, lens: Lens) -> FloatArray:
    """Angles in degrees between +z and the normals of the top's triangles, walls and rim left out."""
    assert solid.grid is not None
    cells, k = solid.grid[0] - 1, lens.microfacets + 1
    a, b, c = (solid.vertices[solid.faces[: 2 * cells**2, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    angles = np.degrees(np.arccos(normals[:, 2] / np.linalg.norm(normals, axis=1))).reshape(cells, cells, 2)
    within = np.arange(cells) % k != 0
    return angles[np.ix_(within, within)]


@pytest.mark.parametrize("cells", ["eye", "vertical"])
def test_slopes_stay_below_their_limit_and_the_facets_held_there_are_counted(cells: str) -> None:
    lens = small_lens(3, 3.0, microfacets=6, max_slope_deg=15.0, cells=cells, relief_mm=10.0)
    offsets = np.zeros((3, 3, 2))
    offsets[1, 1] = (9.0, 0.0)
    heights = Poisson().integrate(blank_scene(lens), assigned(offsets, (1, 0, 1)))
    assert heights.metrics["facets_at_slope_limit"] == 1
    angles = microfacet_angles(solid_from_heights(heights), lens)
    assert angles.max() == pytest.approx(15.0, abs=0.05)


@pytest.mark.parametrize(("cells", "eye"), [("vertical", ABOVE), ("eye", ABOVE), ("eye", (150.0, 0.0, THICK + 400.0))])
def test_reported_slopes_are_those_of_the_meshs_faces(cells: str, eye: Eye) -> None:
    lens = small_lens(4, 3.0, microfacets=12, cells=cells, relief_mm=10.0)
    heights = Poisson().integrate(blank_scene(lens, eye), wild(4, 1, 6.0))
    angles = microfacet_angles(solid_from_heights(heights), lens)
    assert heights.metrics["slope_mean_deg"] == pytest.approx(angles.mean(), abs=0.3)
    assert heights.metrics["slope_max_deg"] == pytest.approx(angles.max(), abs=0.5)


@pytest.mark.parametrize("cells", ["eye", "vertical"])
def test_reported_extent_is_that_of_the_mesh(cells: str) -> None:
    lens = small_lens(4, 3.0, microfacets=6, cells=cells)
    heights = Poisson().integrate(blank_scene(lens), wild(4, 1, 6.0))
    z = top_points(heights)[..., 2]
    assert heights.metrics["z_min_mm"] == pytest.approx(z.min(), abs=1e-6)
    assert heights.metrics["z_max_mm"] == pytest.approx(z.max(), abs=1e-6)


def test_reported_steps_are_those_between_facing_edges() -> None:
    lens = small_lens(2, 3.0, microfacets=6)
    heights = Poisson().integrate(blank_scene(lens), wild(2, 1))
    h = heights.heights_mm
    steps = np.abs(
        [
            h[0, 0, :, -1] - h[0, 1, :, 0],
            h[1, 0, :, -1] - h[1, 1, :, 0],
            h[0, 0, -1] - h[1, 0, 0],
            h[0, 1, -1] - h[1, 1, 0],
        ]
    )
    assert heights.metrics["step_max_mm"] == pytest.approx(steps.max())
    assert heights.metrics["step_mean_mm"] == pytest.approx(steps.mean())


def test_no_step_exceeds_the_limit_and_only_borders_change() -> None:
    lens = small_lens(5, 2.0, microfacets=6)
    scene, assignment = blank_scene(lens), wild(5, 0, 3.0)
    free, limited = (Poisson(step_limit=limit).integrate(scene, assignment) for limit in (None, "0.1mm"))
    assert free.metrics["step_max_mm"] > 0.2
    assert limited.metrics["step_max_mm"] <= 0.1
    h = limited.heights_mm
    assert np.abs(h[:, :-1, :, -1] - h[:, 1:, :, 0]).max() <= 0.1
    assert np.abs(h[:-1, :, -1] - h[1:, :, 0]).max() <= 0.1
    np.testing.assert_array_equal(h[:, :, 1:-1, 1:-1], free.heights_mm[:, :, 1:-1, 1:-1])
    low = np.abs(free.heights_mm[:, :-1, 1:-1, -1] - free.heights_mm[:, 1:, 1:-1, 0]) <= 0.1
    np.testing.assert_array_equal(h[:, :-1, 1:-1, -1][low], free.heights_mm[:, :-1, 1:-1, -1][low])


def test_least_squares_trades_slopes_for_continuity() -> None:
    lens = small_lens(6, 2.0, microfacets=4)
    scene, assignment = blank_scene(lens), wild(6, 0, 2.0)
    built = [LeastSquaresIntegrator(continuity=c).integrate(scene, assignment) for c in (0.01, 1.0, 100.0)]
    steps = [heights.metrics["step_mean_mm"] for heights in built]
    assert steps[0] > 2 * steps[1] > 20 * steps[2]


@pytest.mark.parametrize("walls", [3.0, 50.0], ids=["even", "walls"])
def test_heights_solve_the_weighted_system(walls: float) -> None:
    weights = np.where(np.arange(11) % 4 == 3, walls, 3.0)
    ends = np.concatenate([[0.0], weights, [0.0]])
    line = np.diag(ends[:-1] + ends[1:]) - np.diag(weights, 1) - np.diag(weights, -1)
    right = np.random.default_rng(0).normal(size=(12, 12))
    heights = solve_weighted(right, weights, 1e-3)
    np.testing.assert_allclose(line @ heights + heights @ line + 1e-3 * heights, right, atol=1e-10)
    right -= right.mean()
    heights = solve_weighted(right, weights, 0.0)
    np.testing.assert_allclose(line @ heights + heights @ line, right, atol=1e-10)
    assert abs(heights.mean()) < 1e-10


def test_options_are_checked() -> None:
    for wrong in ({"placement": "nice"}, {"screening": -1.0}, {"rounds": 0}, {"tolerance": 0.0}, {"unknown": 1}):
        with pytest.raises(ValidationError):
            Poisson(**wrong)


def test_reference_eye_is_the_mean_of_all_eyes() -> None:
    lens = small_lens()
    views = tuple(blank_scene(lens, eye).views[0] for eye in ((30.0, 0.0, 440.0), (-10.0, 20.0, 440.0)))
    np.testing.assert_allclose(Scene(lens, views).reference_eye_mm, (10.0, 10.0, 440.0))
