"""The built-in tracer against closed forms: slabs, wedges, walls, turns, and the lenses that integration makes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magiclens.contract.artifacts import FloatArray, HeightField, Lens, Scene, Solid, View
from magiclens.contract.errors import InputError
from magiclens.geometry.facets import edge_models
from magiclens.geometry.solid import solid_from_heights
from magiclens.integration.poisson import Poisson
from magiclens.optics.medium import slab_of
from magiclens.optics.walls import DOWN, RIGHT
from magiclens.rendering.cone_kernels import STEEP, cones
from magiclens.rendering.grid import grid_of
from magiclens.rendering.tracer import Tracer, trace
from magiclens.rendering.tracer_kernels import PictureRows, trace_rows
from magiclens.rendering.transports import transport
from scenes import (
    ABOVE,
    ASIDE,
    IOR,
    THICK,
    Eye,
    assigned,
    blank_scene,
    blotches,
    grey_view,
    letter_f,
    plane_points_mm,
    ramps,
    small_lens,
    surface,
)

LEFT_BEHIND = (-60.0, 20.0, THICK + 150.0)
BLANK = np.ones((8, 8))
UP = np.array([0.0, 0.0, 1.0])
eyes = pytest.mark.parametrize("eye", [ABOVE, ASIDE], ids=["eye above", "eye aside"])
cuts = pytest.mark.parametrize("cut", [ABOVE, ASIDE, None], ids=["eye cells", "eye aside cells", "vertical cells"])
gaps = pytest.mark.parametrize("gap", [0.0, 30.0])


def tilted(lens: Lens, slope_x: float, slope_y: float, cut: Eye | None) -> Solid:
    """A slab whose top is the plane z = thickness + slope_x * x + slope_y * y."""
    x, y = plane_points_mm(lens)
    if cut is None:
        return solid_from_heights(surface(lens, slope_x * x + slope_y * y, None))
    ex, ey, ez = cut
    far = ez - lens.thickness_mm
    rho = (far - slope_x * ex - slope_y * ey) / (far + slope_x * (x - ex) + slope_y * (y - ey))
    return solid_from_heights(surface(lens, -far * np.log(rho), cut))


def refracted(ray: FloatArray, normal: FloatArray, eta: float) -> FloatArray:
    """Snell's law: the part of the unit vector along the surface shrinks by ``eta``."""
    along = (ray - (ray @ normal)[..., None] * normal) / eta
    return along - np.sqrt(1 - (along**2).sum(axis=-1, keepdims=True)) * normal


def fresnel(cos_i: FloatArray, cos_t: FloatArray, eta: float) -> FloatArray:
    """Transmitted share of unpolarised light."""
    s = 4 * eta * cos_i * cos_t / (cos_i + eta * cos_t) ** 2
    p = 4 * eta * cos_i * cos_t / (eta * cos_i + cos_t) ** 2
    return (s + p) / 2


def through_a_plane(
    eye: Eye, q: FloatArray, slope_x: float, slope_y: float, gap: float
) -> tuple[FloatArray, FloatArray]:
    """Source points (..., 2) and transmission seen at points q (..., 2) of the reference plane, through a plane top."""
    ray = np.concatenate([q, np.full((*q.shape[:-1], 1), THICK)], axis=-1) - eye
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    up = np.array([-slope_x, -slope_y, 1.0])
    start = np.array(eye) + ray * ((THICK - np.array(eye) @ up) / (ray @ up))[..., None]
    up /= np.linalg.norm(up)
    inside = refracted(ray, up, IOR)
    outside = refracted(inside, UP, 1 / IOR)
    end = start - inside * (start[..., 2:] / inside[..., 2:]) - outside * (gap / outside[..., 2:])
    share = fresnel(-ray @ up, -inside @ up, IOR) * fresnel(-inside[..., 2], -outside[..., 2], 1 / IOR)
    return end[..., :2], share


def samples_mm(lens: Lens, count: int) -> FloatArray:
    """(count, count, 2) where the samples of a picture lie on the reference plane."""
    c = ((np.arange(count) + 0.5) / count - 0.5) * lens.size_mm
    return np.stack(np.meshgrid(c, -c), axis=-1)


@eyes
@cuts
@gaps
def test_a_flat_slab_shows_the_source_displaced_by_perspective(eye: Eye, cut: Eye | None, gap: float) -> None:
    lens = small_lens(4, 10.0, gap_mm=gap)
    hits = trace(tilted(lens, 0.0, 0.0, cut), lens, grey_view(BLANK, BLANK, eye), 24, 1)[:, :, 0]
    q = samples_mm(lens, 24)
    out = (q - eye[:2]) / (eye[2] - THICK)
    tangent = np.linalg.norm(out, axis=-1, keepdims=True)
    sine = tangent / np.hypot(1, tangent)
    expected = q + (THICK * sine / np.sqrt(IOR**2 - sine**2) + gap * tangent) * out / tangent
    assert_seen(lens, hits, expected, 2e-5)


@eyes
@cuts
@gaps
def test_a_tilted_top_bends_light_as_snell_says(eye: Eye, cut: Eye | None, gap: float) -> None:
    lens = small_lens(4, 10.0, gap_mm=gap)
    hits = trace(tilted(lens, 0.25, -0.1, cut), lens, grey_view(BLANK, BLANK, eye), 24, 1)[:, :, 0]
    points, share = through_a_plane(eye, samples_mm(lens, 24), 0.25, -0.1, gap)
    seen = assert_seen(lens, hits, points, 2e-5)
    np.testing.assert_allclose(hits[seen, 2], share[seen], atol=1e-6)


def assert_seen(lens: Lens, hits: FloatArray, points: FloatArray, atol: float) -> FloatArray:
    """Check and return the samples whose light neither meets a wall nor leaves through the slab's sides."""
    q, half, pitch = samples_mm(lens, len(hits)), lens.size_mm / 2, lens.pitch_mm
    off_walls = (np.abs((q + half + pitch / 2) % pitch - pitch / 2) > 0.01).all(axis=-1)
    seen = off_walls & (hits[..., 2] > 0)
    assert seen[off_walls & (np.abs(q) < half - 12.5).all(axis=-1)].all()
    np.testing.assert_allclose(hits[seen, :2], points[seen], atol=atol)
    return seen


def test_a_wedge_shows_what_lies_toward_its_thick_side() -> None:
    lens = small_lens()
    hits = trace(tilted(lens, 0.3, 0.0, None), lens, grey_view(BLANK, BLANK), 16, 1)[8, 8, 0]
    assert hits[0] > 3.0
    assert abs(hits[1]) < 0.5


def test_transmission_of_a_flat_slab_is_fresnels() -> None:
    lens = small_lens(4, 20.0)
    aside = (400.0, 0.0, THICK + 300.0)
    hits = trace(tilted(lens, 0.0, 0.0, None), lens, grey_view(BLANK, BLANK, aside), 8, 1)[:, :, 0]
    _, share = through_a_plane(aside, samples_mm(lens, 8), 0.0, 0.0, 0.0)
    assert hits[:, 6:, 2] == pytest.approx(share[:, 6:], abs=1e-6)
    assert share.max() < 0.9
    straight = 1 - ((IOR - 1) / (IOR + 1)) ** 2
    above = trace(tilted(lens, 0.0, 0.0, ABOVE), lens, grey_view(BLANK, BLANK), 8, 1)
    np.testing.assert_allclose(above[:, :, 0, 2], straight**2, atol=1e-4)


def test_no_two_samples_of_a_pixel_share_a_row_or_a_column() -> None:
    lens = small_lens()
    solid, view = tilted(lens, 0.0, 0.0, ABOVE), grey_view(BLANK, BLANK)
    coarse, fine = trace(solid, lens, view, 8, 3), trace(solid, lens, view, 72, 1)[:, :, 0]
    for i, j in ((4, 4), (4, 5), (5, 3)):
        within = fine[9 * i : 9 * i + 9, 9 * j : 9 * j + 9, :2]
        apart = np.linalg.norm(coarse[i, j, :, None, None, :2] - within, axis=-1)
        assert (apart.min(axis=(1, 2)) < 1e-5).all()
        rows, columns = np.unravel_index(apart.reshape(9, -1).argmin(axis=1), (9, 9))
        assert sorted(rows) == sorted(columns) == list(range(9))
        assert np.hypot(np.diff(rows[:2]), np.diff(columns[:2])) > 3


def test_light_from_beyond_the_source_is_black() -> None:
    lens = small_lens(4, 5.0, source=20.0, gap_mm=50.0)
    solid, view = tilted(lens, 0.0, 0.0, ABOVE), grey_view(BLANK, BLANK)
    points = trace(solid, lens, view, 32, 1)[:, :, 0, :2]
    beyond = np.abs(points).max(axis=-1) > 10.0
    assert 0 < beyond.sum() < beyond.size
    seen = Tracer(resolution=32, samples=1).render(Scene(lens, (view,)), solid)[0][..., 0]
    assert (seen[~beyond] > 0.9).all()
    assert (seen[beyond] == 0.0).all()


def shown(lens: Lens, solid: Solid, source: FloatArray, **view: object) -> FloatArray:
    """The picture of a source (H, W, C)."""
    shot = View("view", source, source, np.array(view.pop("eye", ABOVE)), **view)  # type: ignore[arg-type]
    return Tracer(resolution=48, samples=2).render(Scene(lens, (shot,)), solid)[0]


def test_row_0_shows_plus_y_and_column_0_minus_x() -> None:
    lens = small_lens(4, source=14.0)
    seen = shown(lens, tilted(lens, 0.0, 0.0, ABOVE), ramps())
    red, green = seen[..., 0] / seen[..., 2], seen[..., 1] / seen[..., 2]
    assert (np.diff(red[4:-4, 4:-4], axis=1) > 0).all()
    assert (np.diff(green[4:-4, 4:-4], axis=0) < 0).all()
    assert red[24, 24] == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("pixels", [24, 25])
def test_a_picture_has_the_sources_values_at_the_points_that_are_seen(pixels: int) -> None:
    """Ramps tell the source point to a hundredth of a pixel, and so would any shift of half a one."""
    lens = small_lens(3, 8.0, source=48.0)
    solid, view = tilted(lens, 0.1, 0.05, ABOVE), View("view", ramps(pixels), ramps(pixels), np.array(ABOVE))
    points, _ = through_a_plane(ABOVE, samples_mm(lens, 20), 0.1, 0.05, 0.0)
    seen = Tracer(resolution=20, samples=1).render(Scene(lens, (view,)), solid)[0]
    carried = transport(solid, lens, view, 20, 1).see(view.source)
    lit = seen[..., 2] > 0
    assert lit.mean() > 0.8
    for picture in (seen, carried):
        xy = (picture[lit, :2] / picture[lit, 2:] - 0.5) * 48.0
        np.testing.assert_allclose(xy, points[lit], atol=0.01 * 48.0 / pixels)


@pytest.mark.parametrize("turn", [0.0, 90.0, 180.0, 270.0])
@pytest.mark.parametrize("eye", [ABOVE, ASIDE])
def test_the_matrix_gives_the_picture_that_is_traced(eye: Eye, turn: float) -> None:
    """Rays of rough facets, some lost at walls and beyond the source, several to a source pixel."""
    lens, rng = small_lens(3, 8.0, source=24.0, microfacets=4), np.random.default_rng(0)
    solid = solid_from_heights(surface(lens, rng.uniform(-0.4, 0.4, (3, 3, 5, 5))))
    view = View("view", ramps(25), ramps(25), np.array(eye), turn)
    (seen,) = Tracer(resolution=21, samples=3).render(Scene(lens, (view,)), solid)
    carried = transport(solid, lens, view, 21, 3)
    np.testing.assert_allclose(carried.see(view.source), seen, atol=1e-4)  # borders are clipped by 0.001 pixels
    lines = np.split(carried.matrix.indices, carried.matrix.indptr[1:-1])
    assert all(len(set(line.tolist())) == len(line) for line in lines)
    assert 0.3 < seen.mean() < 0.9


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_a_matrix_turns_with_lens_and_eye(turns: int) -> None:
    lens, solid = random_lens()
    x, y, z = ASIDE
    for _ in range(turns):
        x, y = -y, x
    views = [View("view", ramps(25), ramps(25), np.array(e), t) for e, t in ((ASIDE, 0.0), ((x, y, z), 90.0 * turns))]
    first, then = (transport(solid, lens, view, 21, 3) for view in views)
    np.testing.assert_allclose(first.turned(turns).see(ramps(25)), then.see(ramps(25)), atol=1e-5)
    np.testing.assert_allclose(then.turned(-turns).see(ramps(25)), first.see(ramps(25)), atol=1e-5)
    assert np.abs(first.see(ramps(25)) - then.see(ramps(25))).max() > 0.1


def test_a_flat_slab_shows_an_f_upright_and_not_mirrored() -> None:
    lens = small_lens(4, source=12.0)
    glyph = letter_f(96)[..., None]
    seen = shown(lens, tilted(lens, 0.0, 0.0, ABOVE), glyph)[..., 0]
    likeness = [
        np.corrcoef(np.rot90(mirrored, k).ravel(), seen.ravel())[0, 1]
        for mirrored in (glyph[::2, ::2, 0], glyph[::2, ::-2, 0])
        for k in range(4)
    ]
    assert np.argmax(likeness) == 0
    assert likeness[0] > max(likeness[1:]) + 0.2


@pytest.mark.parametrize("turns", [1, 2, 3])
@cuts
def test_a_turned_lens_is_a_lens_that_was_built_turned(turns: int, cut: Eye | None) -> None:
    """Facets are planes, so that the diagonals of their cells, which turn too, make no difference."""
    lens, rng = small_lens(3, 10.0, microfacets=4), np.random.default_rng(turns)
    x, y = plane_points_mm(lens)
    a, b, level = rng.uniform(-0.15, 0.15, (3, 3, 3, 1, 1))
    heights = surface(lens, level + a * x + b * y, cut)
    turned_cut = None if cut is None else tuple(np.array([*turn_ccw(np.array(cut[:2]), turns), cut[2]]))
    built = HeightField(lens, np.rot90(np.rot90(heights.heights_mm, turns), turns, (2, 3)).copy(), turned_cut)
    source = np.repeat(blotches(128, 4.0)[..., None], 1, axis=-1)
    as_turned = shown(lens, solid_from_heights(heights), source, eye=ASIDE, rotation_deg=90.0 * turns)
    as_built = shown(
        lens, solid_from_heights(replace(built, eye_mm=turned_cut and np.array(turned_cut))), source, eye=ASIDE
    )
    assert as_turned.std() > 0.05
    # curves of equal h are not quite planes where cells follow eye rays
    assert np.abs(as_turned - as_built).mean() < 1e-3


def turn_ccw(xy: FloatArray, turns: int) -> FloatArray:
    """A point after counter-clockwise quarter turns: +x goes to +y."""
    for _ in range(turns):
        xy = np.array([-xy[1], xy[0]])
    return xy


def test_a_quarter_turn_moves_plus_x_to_plus_y() -> None:
    """A wedge that shows what lies toward its own +x shows, once turned, what lies toward the world's +y."""
    lens = small_lens(source=30.0)
    seen = shown(lens, tilted(lens, 0.2, 0.0, None), ramps(), rotation_deg=90.0)[24, 24]
    assert seen[1] / seen[2] > 0.55
    assert seen[0] / seen[2] == pytest.approx(0.5, abs=0.02)


def random_lens(cut: Eye | None = ABOVE) -> tuple[Lens, Solid]:
    lens = small_lens(3, 4.0, microfacets=4, source=24.0)
    return lens, solid_from_heights(surface(lens, np.random.default_rng(3).uniform(-0.3, 0.3, (3, 3, 5, 5)), cut))


@pytest.mark.parametrize("rotation", [0.0, 90.0, 180.0, 270.0])
def test_the_picture_is_the_transport_times_the_source(rotation: float) -> None:
    lens, solid = random_lens()
    source = np.stack([blotches(80, 2.0, seed) for seed in range(3)], axis=-1)
    view = View("view", source, source, np.array(ASIDE), rotation)
    seen = Tracer(resolution=32, samples=2).render(Scene(lens, (view,)), solid)[0]
    carried = transport(solid, lens, view, 32, 2)
    assert carried.matrix.shape == (32 * 32, 80 * 80)
    np.testing.assert_allclose(carried.see(source), seen, atol=1e-5)


def test_each_row_of_the_transport_sums_to_the_transmission() -> None:
    lens, solid = random_lens()
    view = grey_view(blotches(80, 2.0), BLANK)
    hits = trace(solid, lens, view, 32, 2)
    assert np.abs(hits[..., :2]).max() < 12.0
    sums = transport(solid, lens, view, 32, 2).matrix.sum(axis=1)
    np.testing.assert_allclose(sums, hits[..., 2].mean(axis=-1).ravel(), atol=1e-5)
    assert sums.min() < 0.9 < sums.max() < 1.0


def first_face(solid: Solid, start: FloatArray, ray: FloatArray) -> tuple[float, int]:
    """Distance to the nearest face in front of a point, and that face."""
    a, b, c = (solid.vertices[solid.faces[:, k]] for k in range(3))
    across = np.cross(np.broadcast_to(ray, a.shape), c - a)
    scale = np.einsum("ij,ij->i", b - a, across)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("ij,ij->i", start - a, across) / scale
        around = np.cross(start - a, b - a)
        v = around @ ray / scale
        t = np.einsum("ij,ij->i", c - a, around) / scale
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-7)
    face = int(np.where(hit, t, np.inf).argmin())
    return (float(t[face]), face) if hit.any() else (np.inf, -1)


def followed(solid: Solid, lens: Lens, eye: Eye, q: FloatArray) -> FloatArray:
    """Source point and transmission of a path from the eye through q, by brute force over all faces of the mesh."""
    tops = 2 * (solid.grid[0] - 1) * (solid.grid[1] - 1) if solid.grid else 0
    point, weight, inside = np.array(eye), 1.0, False
    ray = np.array([*q, THICK]) - point
    ray /= np.linalg.norm(ray)
    for _ in range(9):
        t, face = first_face(solid, point, ray)
        if face < 0:
            return np.zeros(3)
        point = point + t * ray
        a, b, c = solid.vertices[solid.faces[face]]
        normal = np.cross(b - a, c - a) * (-1 if inside else 1)
        normal /= np.linalg.norm(normal)
        eta, cos_i = 1 / IOR if inside else IOR, float(-ray @ normal)
        k = 1 - (1 - cos_i**2) / eta**2
        share = float(fresnel(np.array(cos_i), np.sqrt(np.array(k)), eta)) if k > 0 else 0.0
        if face >= tops:
            if not inside or point[2] > 1e-6:
                return np.zeros(3)
            ray = refracted(ray, normal, eta)
            return np.array([*(point - ray * lens.gap_mm / ray[2])[:2], weight * share])
        if share >= 0.5:
            ray, weight, inside = refracted(ray, normal, eta), weight * share, not inside
        else:
            ray, weight = ray + 2 * cos_i * normal, weight * (1 - share)
    return np.zeros(3)


@pytest.mark.every_third
@eyes
@cuts
@pytest.mark.parametrize("sides", [{}, {"bleed_mm": 2.0, "floor_mm": 70.0}], ids=["", "leaning sides"])
def test_paths_are_those_through_the_meshs_own_triangles(eye: Eye, cut: Eye | None, sides: dict[str, float]) -> None:
    """Slopes, walls and shadows of a rugged top; brute force knows nothing of grids and cells."""
    lens = small_lens(3, 8.0, microfacets=2, gap_mm=5.0, wall_mm=0.5, **sides)
    rng = np.random.default_rng(5)
    heights = rng.uniform(-1.5, 1.5, (3, 3, 1, 1)) + rng.uniform(-0.5, 0.5, (3, 3, 3, 3))
    solid = solid_from_heights(surface(lens, heights, cut))
    hits, q = trace(solid, lens, grey_view(BLANK, BLANK, eye), 26, 1)[:, :, 0], samples_mm(lens, 26)
    lost = 0
    for i, j in np.ndindex(26, 26):
        if i == j:
            continue  # along the cells' diagonals: either triangle is right
        expected = followed(solid, lens, eye, q[i, j])
        assert (hits[i, j, 2] > 0) == (expected[2] > 0)
        if expected[2] > 0:
            np.testing.assert_allclose(hits[i, j], expected, atol=1e-3)
        lost += expected[2] == 0
    assert 0 < lost < 0.5 * 26**2


@cuts
def test_a_ray_that_leaves_the_last_facet_sideways_reaches_the_source_where_the_sides_lean_out(cut: Eye | None) -> None:
    lens, view = small_lens(4, 5.0, source=80.0), grey_view(BLANK, BLANK, LEFT_BEHIND)
    points, share = through_a_plane(LEFT_BEHIND, samples_mm(lens, 24), 0.1, 0.0, 0.0)
    upright, leaning = (
        trace(tilted(replace(lens, floor_mm=f, bleed_mm=f / 40), 0.1, 0.0, cut), lens, view, 24, 1)[:, :, 0]
        for f in (0.0, 60.0)
    )
    lost = upright[..., 2] == 0
    assert lost[:, -3:].all()
    assert not lost[12, 3]
    seen = leaning[..., 2] > 0
    assert seen.mean() > 0.95
    np.testing.assert_allclose(leaning[seen, :2], points[seen], atol=2e-4)
    np.testing.assert_allclose(leaning[seen, 2], share[seen], atol=1e-4)
    np.testing.assert_array_equal(upright[~lost, :2], leaning[~lost, :2])


def test_light_that_would_pass_through_a_leaning_side_is_lost() -> None:
    lens, view = small_lens(4, 5.0, source=80.0), grey_view(BLANK, BLANK, LEFT_BEHIND)
    points, _ = through_a_plane(LEFT_BEHIND, samples_mm(lens, 24), 0.0, 0.0, 0.0)
    hits = trace(tilted(replace(lens, floor_mm=36.0), 0.0, 0.0, None), lens, view, 24, 1)[:, :, 0]
    within = (np.abs(points) < 18.0).all(axis=-1)
    assert 0.1 < within.mean() < 0.9
    assert (within == (hits[..., 2] > 0)).all()


@pytest.mark.parametrize("step", [1.0, 2.0])
@pytest.mark.parametrize("raised", [2, 3])
def test_a_step_takes_a_strip_as_wide_as_step_times_drift_from_the_higher_facet(step: float, raised: int) -> None:
    """Eye rays run toward +x here, and less so inside the slab: relative to the walls light drifts toward -x."""
    lens, count, row = small_lens(6, 4.0, wall_mm=1e-4), 800, 400 - 67
    heights = np.zeros((6, 6, 1, 1))
    flat, high = (surface(lens, h, LEFT_BEHIND) for h in (heights, heights + step * np.eye(6)[raised][:, None, None]))
    view = grey_view(BLANK, BLANK, LEFT_BEHIND)
    straight, seen = (trace(solid_from_heights(h), lens, view, count, 1)[row, :, 0] for h in (flat, high))
    q = samples_mm(lens, count)[row]
    near = (np.abs(q[:, 0]) < 5) & (straight[:, 2] > 0)
    lost = q[near & (np.abs(seen[:, 0] - straight[:, 0]) > 3.0), 0]
    left = (raised - 3) * 4.0
    out = (np.array([left, q[0, 1]]) - LEFT_BEHIND[:2]) / (LEFT_BEHIND[2] - THICK)
    tangent = np.hypot(*out)
    sine = tangent / np.hypot(1, tangent)
    drift = out[0] * (1 - sine / np.sqrt(IOR**2 - sine**2) / tangent)
    pixel = lens.size_mm / count
    assert drift > 0.1
    assert (lost.min() - pixel / 2, lost.max() + pixel / 2) == pytest.approx((left, left + step * drift), abs=pixel)
    assert len(lost) == pytest.approx(step * drift / pixel, abs=1)


def test_the_loss_model_predicts_the_strips_width() -> None:
    """Rays of a facet on the far side of the lens, bent toward +x, drift toward its right edge as ``walls`` says."""
    lens, count, step, bend = small_lens(2, 6.0, wall_mm=1e-4), 480, 0.8, 5.0
    view = grey_view(BLANK, BLANK)
    chosen = np.zeros((2, 2, 2))
    chosen[:, 0, 0] = bend
    scene = blank_scene(lens)
    field = Poisson(placement="steps").integrate(scene, assigned(chosen, (1, 0, 1)))
    shape = field.heights_mm[0, 0] - field.heights_mm[0, 0].mean()
    heights = np.zeros((2, 2, *shape.shape))
    heights[:, 0] = shape
    heights[:, 0] += step - shape[:, -1].mean()
    hits = trace(solid_from_heights(surface(lens, heights)), lens, view, count, 1)
    row = count // 4
    seen = hits[row, : count // 2, 0, 0] - samples_mm(lens, count)[row, : count // 2, 0]
    strip = (np.abs(seen - bend) > 1.0).sum() * lens.size_mm / count
    _, drifts = edge_models(scene, chosen[:, :, None], np.ones((2, 2, 1, 3)) * (1, 0, 1))
    assert strip == pytest.approx(step * drifts[0, 0, 0, RIGHT, 0], abs=0.04)


def test_the_loss_model_predicts_what_passes_a_corner() -> None:
    """Rays that drift right and down, below neighbours that stand higher, to a diagonal facet that stands lower."""
    lens, count, step, bend = small_lens(2, 6.0, wall_mm=1e-4), 960, 2.0, (5.0, -4.0)
    view = grey_view(BLANK, BLANK)
    scene, chosen = blank_scene(lens), np.zeros((2, 2, 2))
    chosen[0, 0] = bend
    shape = Poisson(placement="steps").integrate(scene, assigned(chosen, (1, 0, 1))).heights_mm[0, 0]
    heights = np.full((2, 2, *shape.shape), 2.0)
    heights[0, 0] = shape - shape[-1, -1]
    heights[1, 1] = -step
    seen = trace(solid_from_heights(surface(lens, heights)), lens, view, count, 1)[: count // 2, : count // 2, 0]
    straight = samples_mm(lens, count)[: count // 2, : count // 2] + bend
    astray = (np.abs(seen[..., :2] - straight).max(axis=-1) > 1.0) | (seen[..., 2] == 0)
    _, drifts = edge_models(scene, chosen[:, :, None], np.ones((2, 2, 1, 3)) * (1, 0, 1))
    area = step**2 * drifts[0, 0, 0, RIGHT, 0] * drifts[0, 0, 0, DOWN, 0]
    assert area > 0.01
    assert astray.sum() * (lens.size_mm / count) ** 2 == pytest.approx(area, rel=0.15)


def test_cells_along_eye_rays_hide_their_walls_and_keep_their_places() -> None:
    """However high the facets stand, every sample enters through the facet it belongs to."""
    lens = small_lens(6, 6.0, microfacets=2)
    heights = np.random.default_rng(0).uniform(-3, 3, (6, 6, 1, 1))
    hits = trace(solid_from_heights(surface(lens, heights, ASIDE)), lens, grey_view(BLANK, BLANK, ASIDE), 120, 1)[
        :, :, 0
    ]
    q, far = samples_mm(lens, 120), ASIDE[2] - THICK
    rise = far * (1 - np.exp(-heights[:, :, 0, 0] / far)).repeat(20, axis=0).repeat(20, axis=1)[..., None]
    out = (q - ASIDE[:2]) / far
    tangent = np.linalg.norm(out, axis=-1, keepdims=True)
    sine = tangent / np.hypot(1, tangent)
    straight = q - rise * out + (THICK + rise) * sine / np.sqrt(IOR**2 - sine**2) * out / tangent
    through_its_top = np.abs(hits[..., :2] - straight).max(axis=-1) < 1e-4
    well_inside = np.tile((np.abs(np.arange(20) - 9.5) < 7), (6, 1)).ravel() & (np.abs(np.arange(120) - 59.5) < 40)
    assert through_its_top[np.ix_(well_inside, well_inside)].all()


@pytest.mark.parametrize("cut", [ABOVE, None], ids=["eye cells", "vertical cells"])
def test_a_tall_facet_far_away_darkens_nothing(cut: Eye | None) -> None:
    """An eye far to the right looks in over the right rim; what happens at the left end of the lens is no matter."""
    lens, eye = small_lens(4, 5.0), (120.0, 0.0, THICK + 300.0)
    view = grey_view(BLANK, BLANK, eye)
    flat = trace(solid_from_heights(surface(lens, np.zeros(1), cut)), lens, view, 40, 1)[:, 30:, 0]
    heights = np.zeros((4, 4, 1, 1))
    heights[:, 0] = 3.0
    tall = trace(solid_from_heights(surface(lens, heights, cut)), lens, view, 40, 1)[:, 30:, 0]
    assert (flat[..., 2] > 0).mean() > 0.5
    assert ((tall[..., 2] > 0) == (flat[..., 2] > 0)).all()


@pytest.mark.every_third
@pytest.mark.parametrize("eye", [ABOVE, ASIDE], ids=["eye above", "eye aside"])
@pytest.mark.parametrize(("cells", "gap", "atol"), [("eye", 0.0, 0.01), ("eye", 60.0, 0.01), ("vertical", 0.0, 0.03)])
def test_every_facet_shows_the_patch_it_was_assigned(eye: Eye, cells: str, gap: float, atol: float) -> None:
    """Source points seen across a facet, fitted by offset and map, are those of its transformation.

    Exact only for small facets: a transformation's slopes have a curl of second order, which no surface can have, and
    with vertical cells under a slanting eye even one of first order.
    """
    n, per, rng = 8, 72, np.random.default_rng(0)
    lens = small_lens(n, 2.5, microfacets=24, gap_mm=gap, cells=cells)
    scene, centres = blank_scene(lens, eye), lens.facet_centres_mm()
    xx, yy = rng.choice([-1.0, 1.0], (2, n, n)) * rng.uniform(0.2, 0.9, (2, n, n))
    xy = rng.uniform(-0.3, 0.3, (n, n))
    onward = 0.5 * (centres - eye[:2]) * (THICK + gap) / (eye[2] - THICK)
    wanted = assigned(onward + rng.uniform(-1.5, 1.5, (n, n, 2)), np.stack([xx, xy, yy], axis=-1))
    solid = solid_from_heights(Poisson().integrate(scene, wanted))
    hits = trace(solid, lens, scene.views[0], n * per, 1)[:, :, 0].astype(float)
    middle = np.flatnonzero(np.abs(np.arange(per) - (per - 1) / 2) < per / 3)
    for i, j in np.ndindex(n, n):
        if not (1 < i < n - 2 and 1 < j < n - 2):
            continue
        own = np.ix_(i * per + middle, j * per + middle)
        seen, p = hits[own].reshape(-1, 3), samples_mm(lens, n * per)[own].reshape(-1, 2) - centres[i, j]
        assert seen[:, 2].min() > 0
        quadratic = np.column_stack([np.ones(len(p)), p, p[:, 0] ** 2, p[:, 0] * p[:, 1], p[:, 1] ** 2])
        fit = np.linalg.lstsq(quadratic, seen[:, :2], rcond=None)[0]
        np.testing.assert_allclose(fit[0] - centres[i, j], wanted.offsets_mm[i, j], atol=atol)
        np.testing.assert_allclose(fit[1:3], [[xx[i, j], xy[i, j]], [xy[i, j], yy[i, j]]], atol=3 * atol)


@pytest.mark.parametrize("cut", [None, ABOVE])
def test_light_that_is_known_to_meet_nothing_more_is_not_followed_and_ends_where_it_would(cut: Eye | None) -> None:
    lens, rng = small_lens(3, 4.0, microfacets=12, source=24.0), np.random.default_rng(4)
    heights = rng.uniform(-0.6, 0.6, (3, 3, 1, 1)) + rng.uniform(-0.05, 0.05, (3, 3, 13, 13))
    grid, eye = grid_of(solid_from_heights(surface(lens, heights, cut)), lens), np.array(ABOVE, float)
    assert 0.2 < np.mean(grid.below > STEEP) < 1
    rows = PictureRows(lens.size_mm, 64, 4, 0, 64)
    all_steep = np.full_like(grid.below, 2 * STEEP)
    nothing_known = grid._replace(above=-all_steep, below=all_steep)
    shortened, followed = (trace_rows(way, slab_of(lens), eye, rows) for way in (grid, nothing_known))
    np.testing.assert_allclose(shortened, followed, rtol=1e-6, atol=1e-6)


def test_cones_reach_from_every_steep_cell_to_wherever_lines_could_meet_it() -> None:
    rng, slope = np.random.default_rng(0), 2.0
    us, vs = np.cumsum(rng.uniform(0.5, 1.0, 14)), -np.cumsum(rng.uniform(0.5, 1.0, 12))
    ws = rng.uniform(0.0, 0.4, (12, 14))
    ws[4:6, 6:9] += 3.0
    above, below = cones(us, vs, ws, slope, 0.6)
    steep = below < STEEP
    assert 0.2 < steep.mean() < 0.8
    assert (steep == (above > -STEEP)).all()
    corners = np.stack([ws[:-1, :-1], ws[:-1, 1:], ws[1:, :-1], ws[1:, 1:]]) - ws.min()
    gap_u = np.maximum(np.maximum(us[:-1, None] - us[1:], us[:-1] - us[1:, None]), 0)
    gap_v = np.maximum(np.maximum(vs[1:, None] - vs[:-1], vs[1:] - vs[:-1, None]), 0)
    for r, c in np.argwhere(~steep):
        cone = slope * np.maximum(gap_v[r][:, None], gap_u[c])[steep]
        assert below[r, c] <= (corners.min(axis=0)[steep] + cone).min() + 1e-5
        assert above[r, c] >= (corners.max(axis=0)[steep] - cone).max() - 1e-5
        assert below[r, c] >= corners.min() - 1e-5  # a bound that says something


def test_a_free_mesh_is_for_other_renderers() -> None:
    lens, solid = random_lens()
    free = replace(solid, grid=None)
    with pytest.raises(InputError, match=r"needs the top's regular grid.*use mitsuba"):
        trace(free, lens, grey_view(BLANK, BLANK), 16, 1)
