"""Snell, Fresnel and Fermat; lenslets to second order; the light that walls take."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq, minimize_scalar

from magiclens.annealing.heat_bath_kernels import heat_bath_sweep, tabulate
from magiclens.contract.artifacts import FloatArray, IntArray, Lens, Scene
from magiclens.geometry.facets import EDGE_POINTS, central_slopes, cost_of_lost_light, edge_models
from magiclens.integration.orientation_kernels import rises_along_edges
from magiclens.integration.poisson import lenslets
from magiclens.optics.eyes import surface_point
from magiclens.optics.lenslets import shape_drifts, tallest
from magiclens.optics.medium import Cut, Slab, optics_of
from magiclens.optics.refraction import facet_normal, refract, sine_in_slab, transmittance
from magiclens.optics.walls import (
    DOWN,
    LEFT,
    RIGHT,
    UP,
    Edges,
    EnergyTerms,
    best_height,
    levels_sweep,
    settle_levels,
    surroundings,
    wall_energies,
)
from scenes import ABOVE, DISTANCE, IOR, THICK, blank_scene, grey_view, small_lens

EYES = [(0.0, 0.0, THICK + DISTANCE), (120.0, -80.0, THICK + 300.0), (-30.0, 200.0, THICK + 500.0)]
GAPS = [0.0, 0.5, 25.0, 100.0]
TOP = np.array([12.0, -7.0, THICK])
reach = st.floats(-9.0, 9.0)


def to_source(ray: tuple[float, float, float], start: FloatArray, gap: float) -> FloatArray:
    """Where a ray in the slab meets the source plane, by refraction at the flat bottom."""
    x, y, z = ray
    at = start - np.array(ray) * start[2] / z
    if gap > 0:
        out = np.array(refract(x, y, z, 0.0, 0.0, 1.0, 1 / IOR))
        at = at - out * gap / out[2]
    return at[:2]


def seen_through(eye: FloatArray, top: FloatArray, normal: tuple[float, float, float], gap: float) -> FloatArray:
    """The source point that an eye sees at a point of a facet."""
    ray = (top - eye) / np.linalg.norm(top - eye)
    return to_source(refract(*ray, *normal, IOR), top, gap)


def slab_path(sideways: float, depth: float, gap: float) -> float:
    """Optical length of Fermat's path from a point in the slab to the source, ``sideways`` mm away."""

    def rate(x: float) -> float:
        left = sideways - x
        return IOR * x / math.hypot(x, depth) - left / math.hypot(left, gap)

    x = brentq(rate, 0.0, sideways, xtol=1e-13) if gap > 0 and sideways > 0 else sideways
    return IOR * math.hypot(x, depth) + math.hypot(sideways - x, gap)


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("eye", EYES)
def test_light_takes_fermats_path_through_a_facet(eye: tuple[float, float, float], gap: float) -> None:
    source = TOP[:2] + np.array([6.0, -4.5])
    normal = np.array(facet_normal(eye, tuple(TOP), tuple(source), Slab(THICK, gap, IOR)))
    for along in (np.cross(normal, (0.0, 1.0, 0.0)), np.cross(normal, (1.0, 0.3, 0.0))):

        def rate(s: float, along: FloatArray = along) -> float:
            """By how much the optical length changes over a short way across the facet."""
            ends = TOP + (s - 1e-3) * along, TOP + (s + 1e-3) * along
            before, after = (
                np.linalg.norm(p - eye) + slab_path(math.hypot(*(source - p[:2])), p[2], gap) for p in ends
            )
            return float(after - before)

        stationary = brentq(rate, -3.0, 3.0)
        assert stationary == pytest.approx(0.0, abs=1e-5)


@given(reach, reach, st.sampled_from(EYES), st.sampled_from(GAPS))
def test_a_facets_normal_shows_the_wanted_source_point(
    dx: float, dy: float, eye: tuple[float, float, float], gap: float
) -> None:
    wanted = TOP[:2] + np.array([dx, dy])
    normal = facet_normal(eye, tuple(TOP), tuple(wanted), Slab(THICK, gap, IOR))
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    assert normal[2] > 0
    np.testing.assert_allclose(seen_through(np.array(eye), TOP, normal, gap), wanted, atol=1e-9)


def test_a_facet_tilts_against_the_source_point_it_shows() -> None:
    """A wedge bends light toward its thick side: to show a point at +x, the facet rises toward +x."""
    normal = facet_normal(ABOVE, (0.0, 0.0, THICK), (5.0, 0.0), Slab(THICK, 0.0, IOR))
    assert normal[0] < 0
    assert normal[1] == 0


@pytest.mark.parametrize("degrees", [0.0, 20.0, 55.0, 89.0])
def test_refraction_obeys_snells_sines(degrees: float) -> None:
    sine, cosine = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    x, y, z = refract(0.6 * sine, 0.8 * sine, -cosine, 0.0, 0.0, 1.0, IOR)
    assert math.hypot(x, y) == pytest.approx(sine / IOR)
    assert math.hypot(x, y, z) == pytest.approx(1.0)
    assert (x, y) == pytest.approx((0.6 * sine / IOR, 0.8 * sine / IOR))
    assert z < 0


def test_light_is_trapped_beyond_the_critical_angle() -> None:
    critical = math.asin(1 / IOR)
    for off, trapped in ((-1e-6, False), (1e-6, True)):
        sine, cosine = math.sin(critical + off), math.cos(critical + off)
        assert (refract(sine, 0.0, -cosine, 0.0, 0.0, 1.0, 1 / IOR) == (0.0, 0.0, 0.0)) == trapped
        assert (transmittance(cosine, 1 / IOR) == 0.0) == trapped


@pytest.mark.parametrize("n", [1.0, 1.33, 1.49, 2.4, 1 / 1.49])
def test_reflection_at_normal_incidence(n: float) -> None:
    assert 1 - transmittance(1.0, n) == pytest.approx(((n - 1) / (n + 1)) ** 2, abs=1e-12)


def test_at_brewsters_angle_only_one_polarisation_is_reflected() -> None:
    n2 = IOR**2
    cosine = math.cos(math.atan(IOR))
    assert 1 - transmittance(cosine, IOR) == pytest.approx(0.5 * ((n2 - 1) / (n2 + 1)) ** 2)


@given(st.floats(0.01, 1.0))
def test_transmission_is_the_same_both_ways(cosine: float) -> None:
    inside = math.sqrt(1 - (1 - cosine**2) / IOR**2)
    assert transmittance(cosine, IOR) == pytest.approx(transmittance(inside, 1 / IOR), abs=1e-9)


@pytest.mark.parametrize("gap", [0.001, 1.0, 100.0, 1e4])
def test_the_ray_in_the_slab_ends_at_the_wanted_distance(gap: float) -> None:
    for distance in (0.0, 1e-9, 0.1, 5.0, 60.0, 1000.0):

        def miss(s: float, distance: float = distance) -> float:
            return THICK * s / math.sqrt(1 - s * s) + gap * IOR * s / math.sqrt(1 - (IOR * s) ** 2) - distance

        root = brentq(miss, 0.0, (1 - 1e-15) / IOR, xtol=1e-15)
        assert sine_in_slab(distance, THICK, gap, IOR) == pytest.approx(root, abs=1e-11)


@pytest.mark.parametrize("gap", [0.0, 1e-6, 0.05, 10.0, 1e5])
def test_the_angle_in_the_slab_grows_with_distance_up_to_its_limit(gap: float) -> None:
    sines = np.array([sine_in_slab(d, THICK, gap, IOR) for d in np.geomspace(1e-12, 1e9, 300)])
    assert (np.diff(sines) >= 0).all()
    assert np.isfinite(sines).all()
    assert sines[-1] == pytest.approx(1 / IOR if gap > 0 else 1.0, rel=1e-8)


def test_without_a_gap_the_ray_in_the_slab_is_straight() -> None:
    assert sine_in_slab(30.0, 40.0, 0.0, IOR) == pytest.approx(0.6)
    assert sine_in_slab(30.0, 40.0, 1e-12, IOR) == pytest.approx(0.6)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (4.0, -2.5)])
@pytest.mark.parametrize("gap", [0.0, 30.0])
def test_central_slopes_show_the_patches_centres(offset: tuple[float, float], gap: float) -> None:
    scene = blank_scene(small_lens(gap_mm=gap), EYES[1])
    centres = scene.lens.facet_centres_mm()
    slopes = central_slopes(scene, np.full((4, 4, 1, 2), offset))
    for i, j in np.ndindex(4, 4):
        normal = np.append(-slopes[i, j, 0], 1.0)
        top = np.append(centres[i, j], THICK)
        seen = seen_through(np.array(EYES[1]), top, tuple(normal / np.linalg.norm(normal)), gap)
        np.testing.assert_allclose(seen, centres[i, j] + offset, atol=1e-9)


def test_a_lenslets_edges_are_those_of_a_quadratic() -> None:
    """Near the axis the slope is the ray's deviation over (n - 1); h is its integral, of zero mean over the facet."""
    pitch = 0.2
    scene = blank_scene(small_lens(1, pitch))
    xx, xy, yy = -0.6, 0.5, 0.3
    offsets, maps = np.zeros((1, 1, 1, 2)), np.reshape([xx, xy, yy], (1, 1, 1, 3))
    profiles, _ = edge_models(scene, offsets, maps)
    huu, huv, hvv = (
        (IOR * m / THICK - toward_eye / DISTANCE) / (IOR - 1) for m, toward_eye in ((xx - 1, 1), (xy, 0), (yy - 1, 1))
    )
    along = ((np.arange(EDGE_POINTS) + 0.5) / EDGE_POINTS - 0.5) * pitch
    half = np.full(EDGE_POINTS, pitch / 2)
    for edge, (u, v) in {RIGHT: (half, along), UP: (along, half), LEFT: (-half, along), DOWN: (along, -half)}.items():
        h = huu * u**2 / 2 + huv * u * v + hvv * v**2 / 2 - (huu + hvv) * pitch**2 / 24
        np.testing.assert_allclose(profiles[0, 0, 0, edge], h, atol=1e-4 * abs(huu) * pitch**2)


def test_rays_drift_toward_the_edges_on_the_side_they_are_bent_to() -> None:
    """Relative to the eye ray along which the wall stands; away from an edge there is no drift toward it."""
    scene = blank_scene(small_lens(1, 1.0), (40.0, 0.0, THICK + DISTANCE))
    edges = {RIGHT: (0.5, 0.0), UP: (0.0, 0.5), LEFT: (-0.5, 0.0), DOWN: (0.0, -0.5)}
    offset = (3.0, -5.0)
    _, drifts = edge_models(scene, np.reshape(offset, (1, 1, 1, 2)), np.reshape([1.0, 0.0, 1.0], (1, 1, 1, 3)))
    for edge, (x, y) in edges.items():
        inside = np.array(offset) / THICK
        outside = (np.array([x, y]) - (40.0, 0.0)) / DISTANCE
        outward = float((inside - outside) @ np.sign([x, y]))
        np.testing.assert_allclose(drifts[0, 0, 0, edge], max(outward, 0.0), atol=1e-6)


def wall_takes(q: FloatArray, edge: int, normal: FloatArray, cut: Cut, eyes: FloatArray, slab: Slab) -> float:
    """Width of the strip that a wall at q takes, per mm of step: of rays in the slab, and of what eyes see of it."""
    axis, outward = (0, 1, 0, 1)[edge], (1, 1, -1, -1)[edge]
    wall = 0.0 if cut.vertical else (q[axis] - cut.eye[axis]) / (cut.eye[2] - slab.depth)
    taken = []
    for eye in eyes:
        ray = np.append(q, slab.depth) - eye
        bent = refract(*(ray / np.linalg.norm(ray)), *normal, slab.ior)
        inside, outside = -bent[axis] / bent[2] - wall, -ray[axis] / ray[2] - wall
        taken.append(max(outward * inside, 0.0) + max(-outward * outside, 0.0))
    return float(np.mean(taken))


@pytest.mark.parametrize("vertical", [True, False])
@pytest.mark.parametrize("sign", [1, -1])
def test_walls_of_a_built_facet_take_what_its_normals_say(vertical: bool, sign: int) -> None:
    """The facet is a quadratic; its normals are those of the surface through its points."""
    cells, pitch, centre = 20, 2.0, np.array([7.0, -4.0])
    slab, cut = Slab(THICK, 0.0, IOR), Cut(np.array([30.0, 50.0, THICK + 200.0]), vertical)
    eyes = np.array([cut.eye, (-90.0, 10.0, THICK + 300.0)])

    def height(x: float, y: float) -> float:
        u, v = x - centre[0], y - centre[1]
        return float(sign * (0.5 * u - 0.4 * v + 0.1 * u * u + 0.15 * u * v - 0.12 * v * v))

    def normal(q: FloatArray) -> FloatArray:
        ends = [(q + step, q - step) for step in (np.array([1e-4, 0.0]), np.array([0.0, 1e-4]))]
        along = [np.subtract(*(surface_point(cut, *p, height(*p), slab.depth) for p in pair)) for pair in ends]
        across = np.cross(*along)
        return np.asarray(across / np.linalg.norm(across))

    at = np.linspace(-0.5, 0.5, cells + 1) * pitch
    shape = np.array([[height(centre[0] + x, centre[1] - y) for x in at] for y in at])
    found, changes = shape_drifts(shape[None], centre[None], pitch / cells, cut, eyes, slab)[0], []
    for edge, (across, along) in {RIGHT: (1, 0), UP: (0, 1), LEFT: (-1, 0), DOWN: (0, -1)}.items():
        places = [centre + np.where([across, along], np.array([across, along]) * pitch / 2, a) for a in at]
        expected = np.array([wall_takes(q, edge, normal(q), cut, eyes, slab) for q in places])
        np.testing.assert_allclose(found[edge, 1:-1], expected[1:-1], atol=0.01)
        np.testing.assert_allclose(found[edge, [0, -1]], expected[[0, -1]], atol=0.02)
        changes.append(np.ptp(expected))
    assert sum(change > 0.02 for change in changes) >= 2, "along edges to which rays drift"


def test_the_heat_bath_draws_candidates_by_their_energy() -> None:
    """``P(k) ~ exp(-E / T)``; one facet has no neighbours, so its energy is its image error."""
    flat, count, temperature = np.zeros((1, 1, 4, 4, EDGE_POINTS), np.float32), 400, 0.5
    errors = np.array([[[0.7, 0.2, np.inf, 0.9]]])
    drawn = []
    for die in (np.arange(count) + 0.5) / count:
        choice, heights = np.zeros((1, 1), np.int64), np.zeros((1, 1))
        terms, dice = EnergyTerms(1.0, 1.0, 0.0, 1.0), np.array([[die]])
        heat_bath_sweep(choice, heights, tabulate(errors, Edges(flat, flat), 2.0), terms, temperature, dice)
        drawn.append(int(choice[0, 0]))
    likely = np.exp(-errors[0, 0] / temperature)
    assert np.bincount(drawn, minlength=4) == pytest.approx(count * likely / likely.sum(), abs=1.5)


def cold_sweep(choice: IntArray, heights: FloatArray, table: FloatArray, terms: EnergyTerms) -> None:
    """All facets take their best candidates."""
    heat_bath_sweep(choice, heights, table, terms, 0.0, np.zeros(choice.shape))


def chosen(choice: IntArray, edges: Edges) -> Edges:
    """The edges of the candidates that facets take."""
    i, j = np.indices(choice.shape)
    return Edges(edges.profiles[i, j, choice], edges.drifts[i, j, choice])


def total_energy(
    choice: IntArray, heights: FloatArray, errors: FloatArray, edges: Edges, terms: EnergyTerms
) -> FloatArray:  # fmt: skip
    """(3,) image error, lost light and the even part, summed over the lens."""
    i, j = np.indices(choice.shape)
    light, even = wall_energies(heights, chosen(choice, edges), terms).sum(axis=(0, 1))
    return np.array([errors[i, j, choice].sum(), light, even])


def test_the_heat_bath_leaves_out_candidates_that_rise_beyond_the_relief() -> None:
    profiles = np.zeros((1, 1, 2, 4, EDGE_POINTS), np.float32)
    profiles[0, 0, 0, LEFT, 0] = -2.1
    choice, heights = np.zeros((1, 1), np.int64), np.full((1, 1), 0.7)
    edges, terms = Edges(profiles, np.zeros_like(profiles)), EnergyTerms(1.0, 1.0, 0.0, 1.0)
    errors = np.array([[[0.1, 0.2]]])
    cold_sweep(choice, heights, tabulate(errors, edges, 2.0), terms)
    assert choice[0, 0] == 1
    assert heights[0, 0] == pytest.approx(0.0, abs=1e-4)
    cold_sweep(choice, heights, tabulate(errors, edges, 2.2), terms)
    assert choice[0, 0] == 0


def test_the_energy_of_a_lens_changes_as_a_facets_own_cost_does() -> None:
    """Wherever the facet is, with whatever neighbours; ``best_height`` counts both sides of its edges and corners."""
    rng, n, points = np.random.default_rng(3), 3, (3, 3, 2, 4, EDGE_POINTS)
    profiles, drifts = rng.uniform(-1, 1, points).astype(np.float32), rng.uniform(0, 0.4, points).astype(np.float32)
    edges, terms, errors = Edges(profiles, drifts), EnergyTerms(0.7, 1.3, 0.1, 0.05), np.zeros((n, n, 2))
    choice, heights = rng.integers(0, 2, (n, n)), rng.uniform(-1, 1, (n, n))
    around = np.zeros((4, EDGE_POINTS + 1, 2))
    for i, j in np.ndindex(n, n):
        surroundings(i, j, heights, chosen(choice, edges), around)
        facet, costs = (Edges(profiles[i, j, choice[i, j]], drifts[i, j, choice[i, j]]), around.copy()), []
        for height in (0.4, -0.6):
            moved = heights.copy()
            moved[i, j] = height
            whole = total_energy(choice, moved, errors, edges, terms).sum()
            costs.append((whole, cost_at(height, facet, terms)))
        (high, own_high), (low, own_low) = costs
        assert high - low == pytest.approx(own_high - own_low, rel=1e-5)


def two_facets(step: float, drift: float, edge: int = RIGHT) -> tuple[Any, ...]:
    """(1 of 2) x 2 facets; the left one is ``step`` higher, all of its rays drift toward one edge."""
    heights, profiles = np.array([[step, 0.0], [0.0, 0.0]]), np.zeros((2, 2, 1, 4, EDGE_POINTS), np.float32)
    drifts = np.zeros((2, 2, 1, 4, EDGE_POINTS), np.float32)
    drifts[0, 0, 0, edge] = drift
    return np.zeros((2, 2), np.int64), heights, np.zeros((2, 2, 1)), Edges(profiles, drifts)


@pytest.mark.parametrize(
    ("step", "edge", "lost"), [(0.8, RIGHT, 0.8), (0.8, DOWN, 0.8), (0.8, UP, 0.0), (-0.8, RIGHT, 0.0)]
)
def test_only_the_higher_side_loses_light_and_only_where_its_rays_drift_to(step: float, edge: int, lost: float) -> None:
    image, light, even = total_energy(*two_facets(step, 0.1, edge), EnergyTerms(2.0, 1.0, 0.0, 0.0))
    assert (image, even) == (0.0, 0.0)
    assert light == pytest.approx(2.0 * 0.1 * lost)


def test_errors_of_the_chosen_candidates_are_the_images_share_of_the_energy() -> None:
    choice, heights, _, edges = two_facets(0.8, 0.1)
    image, light, even = total_energy(choice, heights, np.full((2, 2, 1), 0.3), edges, EnergyTerms(2.0, 1.0, 0.5, 0.25))
    without = total_energy(*two_facets(0.8, 0.1), EnergyTerms(2.0, 1.0, 0.5, 0.25))
    assert image == pytest.approx(4 * 0.3)
    assert (light, even) == tuple(without[1:])


def test_every_edge_counts_once_and_both_its_sides_share_the_step() -> None:
    _, light, even = total_energy(*two_facets(0.8, 0.0), EnergyTerms(2.0, 1.0, 0.5, 0.25))
    assert light == 0.0
    assert even == pytest.approx(0.5 * 2 * 0.8**2 + 0.25 * 0.8**2)


def test_lost_light_costs_what_a_random_source_pixel_in_its_place_would() -> None:
    lens, n = small_lens(), 16
    black, white = np.zeros((n, n)), np.ones((n, n))
    half = np.where(np.arange(n) < n // 2, 0.0, 1.0) * np.ones((n, 1))
    for source, target, cost in ((white, black, 1.0), (white, white, 0.0), (half, white, 0.5), (half, half, 0.5)):
        assert cost_of_lost_light(Scene(lens, (grey_view(source, target),))) == pytest.approx(cost, abs=1e-6)


@pytest.mark.parametrize(("diagonal", "lost"), [(0.8, 0.8**2), (-0.8, 0.0)])
def test_light_is_lost_past_a_corner_where_the_diagonal_facet_stands_lower(diagonal: float, lost: float) -> None:
    """The upper left facet's rays drift right and down, below neighbours that stand as high, to the lower right one."""
    choice, heights, errors, edges = two_facets(0.0, 0.0)
    heights[1, 1] = -diagonal
    edges.drifts[0, 0, 0, RIGHT], edges.drifts[0, 0, 0, DOWN] = 0.1, 0.3
    _, light, _ = total_energy(choice, heights, errors, edges, EnergyTerms(2.0, 5.0, 0.0, 0.0))
    assert light == pytest.approx(2.0 * 0.1 * 0.3 * lost / 5.0**2)


def random_facet(rng: np.random.Generator) -> tuple[Edges, FloatArray]:
    own, outward = rng.uniform(-1, 1, (4, EDGE_POINTS)), rng.uniform(0, 0.5, (4, EDGE_POINTS))
    around = np.stack([rng.uniform(-1, 1, (4, EDGE_POINTS + 1)), rng.uniform(0, 0.5, (4, EDGE_POINTS + 1))], axis=-1)
    around[rng.random(4) < 0.3] = np.nan
    return Edges(own, outward), around


def cost_at(height: float, facet: tuple[Edges, FloatArray], terms: EnergyTerms) -> float:
    (own, outward), around = facet
    loss, pitch, even, screening = terms
    steps = own + height - around[:, :-1, 0]
    widths = np.maximum(steps, 0) * outward + np.maximum(-steps, 0) * around[:, :-1, 1]
    ends = [(own[e, p] + own[f, q]) / 2 for e, p, f, q in CORNERS]
    drifts = [outward[e, p] * outward[f, q] for e, p, f, q in CORNERS]
    corners = np.array(ends) + height - around[:, -1, 0]
    areas = np.maximum(corners, 0) ** 2 * drifts + np.maximum(-corners, 0) ** 2 * around[:, -1, 1]
    edges = np.nansum(loss / pitch * widths + even * steps**2) / EDGE_POINTS
    return float(edges + np.nansum(loss / pitch**2 * areas) + screening * height**2)


CORNERS = ((RIGHT, -1, UP, -1), (UP, 0, LEFT, -1), (LEFT, 0, DOWN, 0), (DOWN, -1, RIGHT, 0))
"""Two edges each, and at which end of either."""


@pytest.mark.parametrize("seed", range(20))
def test_a_facet_is_put_where_it_costs_least(seed: int) -> None:
    rng = np.random.default_rng(seed)
    facet, terms = random_facet(rng), EnergyTerms(1.0, 1.5, rng.choice([0.0, 0.05]), 1e-4)
    height, cost = best_height(*facet, terms, -1.5, 1.5)
    best = minimize_scalar(cost_at, bounds=(-1.5, 1.5), args=(facet, terms), method="bounded")
    assert cost == pytest.approx(cost_at(height, facet, terms), rel=1e-9)
    assert cost <= best.fun + 1e-4


@pytest.mark.parametrize("screening", [0.0, 0.5, 4.0])
def test_a_facet_is_pulled_to_the_reference_plane_as_much_as_screening_weighs(screening: float) -> None:
    """Against four neighbours that stand 1 mm high: ``4 even (c - 1) + screening c = 0``."""
    flat, around = np.zeros((4, EDGE_POINTS)), np.zeros((4, EDGE_POINTS + 1, 2))
    around[:, :-1, 0], around[:, -1] = 1.0, np.nan
    height, _ = best_height(Edges(flat, flat), around, EnergyTerms(1.0, 1.0, 0.5, screening), -2.0, 2.0)
    assert height == pytest.approx(2 / (2 + screening), abs=1e-4)


def test_a_facet_is_moved_to_its_neighbours() -> None:
    flat, heights = np.zeros((2, 2, 4, EDGE_POINTS), np.float32), np.array([[0.2, 1.0], [1.0, 1.0]])
    terms = EnergyTerms(1.0, 1.0, 1.0, 0.0)
    levels_sweep(heights, Edges(flat, flat), terms, 2.0, (1, 0, 0))
    np.testing.assert_allclose(heights, 1.0, atol=1e-3)


@pytest.mark.parametrize("squares", [(2, 0, 0), (3, 1, 2), (4, 3, 0), (1, 0, 0)])
def test_squares_of_facets_are_moved_to_where_they_cost_least(squares: tuple[int, int, int]) -> None:
    """The energy falls, and no square that moves alone could lower it further at once."""
    choice, heights, errors, edges = random_lens(np.random.default_rng(1), 7, 2)
    terms, before = EnergyTerms(0.5, 1.5, 0.02, 1e-2), heights.copy()
    costs = [total_energy(choice, heights, errors, edges, terms).sum()]
    for _ in range(12):
        levels_sweep(heights, chosen(choice, edges), terms, 9.0, squares)
        costs.append(total_energy(choice, heights, errors, edges, terms).sum())
    assert (np.diff(costs) < 1e-6).all()
    side, cut_rows, cut_columns = squares
    rows, columns = (np.arange(7) + cut_rows) // side, (np.arange(7) + cut_columns) // side
    for block in ((0, 0), (1, 1), (1, 0)):
        inside = (rows == block[0])[:, None] & (columns == block[1])
        assert np.ptp((heights - before)[inside]) < 1e-12
        for rise in (0.02, -0.02):
            assert total_energy(choice, heights + rise * inside, errors, edges, terms).sum() > costs[-1] - 1e-6


def test_squares_of_many_sizes_find_lower_levels_than_single_facets() -> None:
    choice, heights, errors, edges = random_lens(np.random.default_rng(2), 12, 1)
    terms, alone = EnergyTerms(0.5, 1.5, 0.002, 1e-5), heights.copy()
    for turn in range(10):
        settle_levels(heights, chosen(choice, edges), terms, 3.0, turn)
    for _ in range(100):
        levels_sweep(alone, chosen(choice, edges), terms, 3.0, (1, 0, 0))
    settled, single = (total_energy(choice, h, errors, edges, terms).sum() for h in (heights, alone))
    assert settled < single


def test_no_square_leaves_the_relief() -> None:
    choice, heights, _, edges = random_lens(np.random.default_rng(4), 6, 1)
    settle_levels(heights, chosen(choice, edges), EnergyTerms(0.5, 1.5, 0.02, 0.0), 1.6, 0)
    assert (np.abs(heights) + np.abs(edges.profiles[:, :, 0]).max(axis=(2, 3)) <= 1.6 + 1e-9).all()


def random_lens(rng: np.random.Generator, n: int, labels: int) -> tuple[Any, ...]:
    """Choice, heights, errors and edges."""
    points = (n, n, labels, 4, EDGE_POINTS)
    drifts = np.broadcast_to(rng.uniform(0, 0.4, (*points[:-1], 1)), points).astype(np.float32)
    edges = Edges(rng.uniform(-0.5, 0.5, points).astype(np.float32), drifts)
    errors = rng.uniform(0, 0.1, (n, n, labels))
    return rng.integers(0, labels, (n, n)), rng.uniform(-1, 1, (n, n)), errors, edges


@pytest.mark.parametrize("labels", [1, 16, 37])
def test_candidates_weighed_side_by_side_cost_what_each_costs_by_itself(labels: int) -> None:
    """The upper left facet draws first. Whichever candidate is the best of those left, it is taken at its height."""
    choice, heights, errors, edges = random_lens(np.random.default_rng(5), 3, labels)
    terms, around = EnergyTerms(0.5, 1.5, 0.02, 1e-4), np.zeros((4, EDGE_POINTS + 1, 2))
    surroundings(0, 0, heights, chosen(choice, edges), around)
    found = [best_height(Edges(*(a[0, 0, k] for a in edges)), around, terms, -1.5, 1.5) for k in range(labels)]
    costs = np.array([cost for _, cost in found]) + errors[0, 0]
    for best in costs.argsort():
        drawn, levels = choice.copy(), heights.copy()
        cold_sweep(drawn, levels, tabulate(errors, edges, 2.0), terms)
        assert drawn[0, 0] == best
        assert levels[0, 0] == pytest.approx(found[best][0], abs=1e-3)
        errors[0, 0, best] = np.inf


def test_a_facet_is_put_within_its_bounds() -> None:
    flat, far = np.zeros((4, EDGE_POINTS)), np.full((4, EDGE_POINTS + 1, 2), 3.0)
    height, _ = best_height(Edges(flat, flat), far, EnergyTerms(1.0, 1.0, 1.0, 0.0), -0.5, 0.5)
    assert height == pytest.approx(0.5, abs=1e-4)


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(2, 5), st.integers(1, 4))
def test_a_cold_sweep_never_raises_the_energy(seed: int, n: int, labels: int) -> None:
    choice, heights, errors, edges = random_lens(np.random.default_rng(seed), n, labels)
    terms, table = EnergyTerms(0.3, 1.0, 0.02, 1e-4), tabulate(errors, edges, 2.0)
    before = total_energy(choice, heights, errors, edges, terms).sum()
    for _ in range(3):
        cold_sweep(choice, heights, table, terms)
        after = total_energy(choice, heights, errors, edges, terms).sum()
        assert after <= before + 2e-5 * n**2
        before = after


def test_lens_centres_start_at_the_upper_left() -> None:
    centres = small_lens(4, 3.0).facet_centres_mm()
    np.testing.assert_allclose(centres[0, 0], (-4.5, 4.5))
    np.testing.assert_allclose(centres[0, 3], (4.5, 4.5))
    np.testing.assert_allclose(centres[3, 0], (-4.5, -4.5))


def test_the_lens_frame_turns_against_the_lens() -> None:
    """After a quarter turn, what lies at +y in the world lies at the turned lens's own +x."""
    dot = np.zeros((5, 5))
    dot[0, 2] = 1.0
    view = grey_view(dot, dot, (0.0, 70.0, 300.0), 90.0).in_lens_frame()
    np.testing.assert_allclose(view.eye_mm, (70.0, 0.0, 300.0))
    for picture in (view.source, view.target):
        assert picture[2, 4, 0] == 1.0
    half = replace(view, rotation_deg=180.0).in_lens_frame()
    np.testing.assert_allclose(half.eye_mm, (-70.0, 0.0, 300.0))
    assert half.source[2, 0, 0] == 1.0


@pytest.mark.parametrize("vertical", [False, True])
@pytest.mark.parametrize("gap", [0.0, 20.0])
def test_nine_points_tell_how_tall_a_small_lenslet_is_when_it_is_integrated(vertical: bool, gap: float) -> None:
    rng, m = np.random.default_rng(1), 12
    lens = Lens(size_mm=4.0, source_size_mm=60.0, facets=2, microfacets=m, thickness_mm=40.0, gap_mm=gap, wall_mm=1e-6)
    optics, centres = optics_of(lens, Cut(np.array([20.0, -30.0, 440.0]), vertical)), lens.facet_centres_mm()
    centres, offsets = centres.reshape(-1, 2), rng.uniform(-4, 4, (4, 2))
    maps = rng.uniform(-1, 1, (4, 3)) * (1.2, 0.5, 1.2)
    heights = np.zeros((4, m + 1, m + 1))
    for _ in range(4):
        rows, columns, held = rises_along_edges(heights, centres, offsets, maps, lens.pitch_mm, optics)
        assert not held.any()
        heights = lenslets(rows, columns)
    weights = np.concatenate([[0.5], np.ones(m - 1), [0.5]]) / m
    heights -= (weights @ heights @ weights)[:, None, None]  # of zero mean over the area
    told = [tallest(centres[f], offsets[f], maps[f], lens.pitch_mm / 2, optics) for f in range(4)]
    np.testing.assert_allclose(np.abs(heights).max(axis=(1, 2)), told, rtol=0.003)
