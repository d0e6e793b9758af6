"""Matching: rasters are box averages, the search is exhaustive, and patches are found where they were cut out."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.ndimage import map_coordinates

from magiclens.analysis.ideal_picture import predict
from magiclens.contract.artifacts import Assignment, Candidates, FloatArray, Lens, Scene, View
from magiclens.contract.errors import InputError
from magiclens.contract.stages import Matcher, silent
from magiclens.geometry.solid import solid_from_heights
from magiclens.images import to_display, to_linear
from magiclens.integration.poisson import Poisson
from magiclens.matching import rasters
from magiclens.matching.channels import stack_channels
from magiclens.matching.exhaustive import Exhaustive, resolved_scales, search_all
from magiclens.matching.features import LOW_BITS
from magiclens.matching.multi_view import MultiViewMatcher
from magiclens.matching.polishing import blur_levels, box_blur, polished
from magiclens.matching.pool import Pool
from magiclens.matching.raster_kernels import average_columns
from magiclens.matching.tuples import Tiles
from magiclens.optics.medium import slab_of
from magiclens.optics.refraction import facet_normal
from magiclens.rendering.facet_errors import facet_errors
from magiclens.rendering.tracer import Tracer
from scenes import (
    ABOVE,
    ASIDE,
    IOR,
    THICK,
    Eye,
    assigned,
    blank_scene,
    blotches,
    choices,
    grey_view,
    letter_f,
    ramps,
    small_lens,
)

RNG = np.random.default_rng(0)
TILE_PX = 48


def matched(options: Exhaustive, scene: Scene) -> Candidates:
    return options.match(scene, np.random.default_rng(0))


def turned(points: FloatArray, turns: int) -> FloatArray:
    """Points (..., 2) after counter-clockwise quarter turns: +x goes to +y."""
    for _ in range(turns % 4):
        points = np.stack([-points[..., 1], points[..., 0]], axis=-1)
    return points


def looked_up(source: FloatArray, size_mm: float, points: FloatArray) -> FloatArray:
    """Bilinear values of an (H, W) source, which covers ``size_mm``, at points (..., 2) mm, +y up."""
    per_mm = len(source) / size_mm
    column, row = points[..., 0] * per_mm + len(source) / 2 - 0.5, -points[..., 1] * per_mm + len(source) / 2 - 0.5
    return map_coordinates(source, [row, column], order=1, mode="nearest")


def seen_points(lens: Lens, assignment: Assignment, q: FloatArray) -> FloatArray:
    """Source points (..., 2) seen at points q (..., 2) of the lens, mm, +y up, lens frame."""
    j = np.floor((q[..., 0] + lens.size_mm / 2) / lens.pitch_mm).astype(int)
    i = np.floor((lens.size_mm / 2 - q[..., 1]) / lens.pitch_mm).astype(int)
    centre = lens.facet_centres_mm()[i, j]
    p, (xx, xy, yy) = q - centre, np.moveaxis(assignment.maps[i, j], -1, 0)
    mapped = np.stack([xx * p[..., 0] + xy * p[..., 1], xy * p[..., 0] + yy * p[..., 1]], axis=-1)
    return centre + assignment.offsets_mm[i, j] + mapped


def seen(source: FloatArray, lens: Lens, assignment: Assignment, pixels: int, turns: int = 0) -> FloatArray:
    """(pixels, pixels): what shows if facets realise their transformations exactly, the lens turned so many times."""
    c = ((np.arange(pixels) + 0.5) / pixels - 0.5) * lens.size_mm
    points = seen_points(lens, assignment, turned(np.stack(np.meshgrid(c, -c), axis=-1), -turns))
    return looked_up(source, lens.source_size_mm, turned(points, turns))


# rasters


@pytest.mark.parametrize(
    ("scale", "px", "step"), [(1.2, 0.39, 0.13), (0.6, 0.39, 0.3), (0.25, 0.39, 0.4), (0.1, 0.39, 0.13)]
)
def test_a_raster_axis_has_tile_pixels_and_offsets_on_whole_samples(scale: float, px: float, step: float) -> None:
    axis = rasters.raster_axis(scale, px, step, 30.0)
    places = axis.positions_mm()
    assert axis.skip * axis.spacing_mm == pytest.approx(scale * px)
    assert axis.stride * axis.spacing_mm <= step * (1 + 1e-9)
    assert axis.stride * axis.spacing_mm > step / 2
    np.testing.assert_allclose(places, -places[::-1], atol=1e-12)
    assert 15.0 - places[-1] >= scale * px / 2 - 1e-9
    assert 15.0 - places[-1] < scale * px / 2 + axis.spacing_mm


def area_mean(image: FloatArray, size: float, x: float, y: float, width: float, tall: float) -> FloatArray:
    """Mean of (C, H, W) over a box, mm, y down, as far as the image reaches; brute force over all pixels."""
    rows, columns = image.shape[1:]

    def cover(count: int, at: float, wide: float) -> FloatArray:
        edges = np.arange(count + 1) * size / count - size / 2
        part = np.minimum(edges[1:], at + wide / 2) - np.maximum(edges[:-1], at - wide / 2)
        return part.clip(0) / part.clip(0).sum()

    return np.einsum("chw,h,w->c", image, cover(rows, y, tall), cover(columns, x, width))


@pytest.mark.parametrize("scales", [(0.9, 0.9), (0.1, 0.7), (0.35, 0.1)])
def test_raster_samples_are_box_averages_of_the_source_at_their_places(scales: tuple[float, float]) -> None:
    size, px, grain, source = 12.0, 0.375, 0.21, np.random.default_rng(1).random((2, 67, 67)).astype(np.float32)
    x, y = (rasters.raster_axis(s, px, 0.13, size) for s in scales)
    wide, tall = (s * px + grain for s in scales)
    columns = average_columns(source, *rasters.footprints(x, wide, size, 67))
    samples, basis, features = rasters.build_raster(columns, *rasters.footprints(y, tall, size, 67), x, y, 8)
    corners = [(0, 0), (y.count - 1, x.count - 1)]
    for r, c in corners + [(RNG.integers(y.count), RNG.integers(x.count)) for _ in range(40)]:
        mean = area_mean(source, size, x.positions_mm()[c], y.positions_mm()[r], wide, tall)
        found = samples[:, c % x.skip, r, c // x.skip]
        np.testing.assert_allclose(found, to_display(mean), atol=1e-3)
    vectors = np.einsum("ni,nj,nk->nijk", *(m[v] for m, v in zip(basis[:2] + basis[1:2], basis.vectors.T, strict=True)))
    vectors = vectors.reshape(len(vectors), -1)
    np.testing.assert_allclose(vectors @ vectors.T, np.eye(len(vectors)), atol=1e-12)
    for _ in range(10):
        r, c = RNG.integers((y.count - 7 * y.skip) // y.stride), RNG.integers((x.count - 7 * x.skip) // x.stride)
        rs, cs = r * y.stride + np.arange(8)[:, None] * y.skip, c * x.stride + np.arange(8) * x.skip
        patch = samples[:, cs % x.skip, rs, cs // x.skip].ravel() - 0.5
        numbers = features[c // 8, r, :, c % 8].ravel().astype(int)
        rest = np.sqrt((patch**2).sum() - ((vectors @ patch) ** 2).sum())
        known = np.array([rest, *(vectors @ patch)]) * basis.steps
        np.testing.assert_allclose(numbers[[2, *basis.places]], known, atol=0.51)
        assert numbers[0] * 2**LOW_BITS + numbers[1] == (numbers[2:] ** 2).sum()


# the search


def flat_enough(lens: Lens, eye: Eye, centre: FloatArray, offset: FloatArray, xx: float, yy: float) -> bool:
    """Can a facet's centre and corners show their source points with slopes below the limit? (+y up)"""
    half = lens.pitch_mm / 2
    for p in np.array([(0, 0), *itertools.product((-half, half), repeat=2)], float):
        s = centre + offset + (xx * p[0], yy * p[1])
        normal = facet_normal(eye, (*(centre + p), lens.thickness_mm), tuple(s), slab_of(lens))
        if normal[2] < math.cos(math.radians(lens.max_slope_deg)):
            return False
    return True


def brute_force(options: Exhaustive, scene: Scene, samples_of: Callable[[float, float], tuple]) -> dict:
    """Best error, offset and map (y down) per facet and bucket, by comparing every tile with every patch."""
    lens, best = scene.lens, {}
    tiles = stack_channels(scene).tiles(lens.facets, options.pixels)
    size, step = lens.source_size_mm, options.step.mm(lens.source_size_mm)
    window, buckets = options.window.mm(size) / 2, math.ceil(math.sqrt(options.candidates))
    m2 = (2 * window / step) ** 2
    signs = [(1, 1), (-1, 1), (1, -1), (-1, -1)] if options.maps == "symmetric" else [(1, 1)]
    for sx, sy in itertools.product(options.scales, repeat=2):
        if options.maps == "scale" and sx != sy:
            continue
        plain, x, y = samples_of(sx, sy)
        for i, j in np.ndindex(lens.facets, lens.facets):
            cx, cy = lens.facet_centres_mm()[i, j] * (1, -1)
            reach_x, reach_y = (options.pixels - 1) * x.skip, (options.pixels - 1) * y.skip
            # the centre of the patch that starts at a sample
            at_x, at_y = (
                a.positions_mm()[: a.count - r] + r * a.spacing_mm / 2 for a, r in ((x, reach_x), (y, reach_y))
            )
            fits_x, fits_y = (np.flatnonzero(np.abs(a - c) <= window) for a, c in ((at_x, cx), (at_y, cy)))
            fits_x, fits_y = fits_x[fits_x % x.stride == 0], fits_y[fits_y % y.stride == 0]
            for (fx, fy), r, c in itertools.product(signs, fits_y, fits_x):
                patch = plain[:, r : r + reach_y + 1 : y.skip, c : c + reach_x + 1 : x.skip][:, ::fy, ::fx]
                rx, ry = at_x[c] - cx, at_y[r] - cy
                far = 1 / (m2 - (rx**2 + ry**2) / step**2) - 1 / m2
                error = float(((patch.astype(np.float64) - tiles[i, j]) ** 2).mean()) + far
                bucket = tuple(min(int((v + window) / (2 * window) * buckets), buckets - 1) for v in (ry, rx))
                key = (i * lens.facets + j, bucket[0] * buckets + bucket[1])
                if error < best.get(key, (math.inf,))[0] and flat_enough(
                    lens, ABOVE, np.array([cx, -cy]), np.array([rx, -ry]), fx * sx, fy * sy
                ):
                    best[key] = error, (rx, ry), (fx * sx, 0.0, fy * sy)
    return best


def searched(options: Exhaustive, scene: Scene) -> tuple[Pool, dict]:
    """What the search leaves in the pool, and what comparing every tile with every patch finds."""
    channels, lens = stack_channels(scene), scene.lens
    tiles = channels.tiles(lens.facets, options.pixels).reshape(lens.facets**2, -1, options.pixels, options.pixels)
    pool = Pool(len(tiles), math.ceil(math.sqrt(options.candidates)))
    split: dict[tuple[float, float], tuple] = {}

    def remember(*arguments: object) -> tuple:
        built = build(*arguments)
        x, y = arguments[3:5]
        rows, columns = np.arange(y.count), np.arange(x.count)
        plain = built[0][:, columns % x.skip, rows[:, None], columns // x.skip]
        split[len(split)] = plain, x, y
        return built

    build = rasters.build_raster
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rasters, "build_raster", remember)
        centres = lens.facet_centres_mm().reshape(-1, 2) * (1, -1)
        search_all(options, scene, channels, Tiles(tiles, centres, lens.pitch_mm), pool, silent)
    symmetric = options.maps == "symmetric"
    pairs = itertools.product(options.scales, repeat=2) if symmetric else [(s, s) for s in options.scales]
    by_scales = dict(zip(pairs, split.values(), strict=True))
    return pool, brute_force(options, scene, lambda sx, sy: by_scales[sx, sy])


@pytest.mark.parametrize("maps", ["symmetric", "scale"])
@pytest.mark.parametrize("limit", [60.0, 10.0])
def test_the_search_finds_what_brute_force_finds(maps: str, limit: float) -> None:
    lens = small_lens(2, 3.0, source=12.0, max_slope_deg=limit)
    scene = Scene(lens, (grey_view(blotches(120, 3.0), blotches(64, 8.0, seed=5)),))
    options = Exhaustive(
        window="4mm", step="0.4mm", scales=(0.15, 0.5, 0.8), pixels=8, candidates=9, maps=maps, polish=0
    )
    pool, expected = searched(options, scene)
    assert {(f, k) for f, k in np.argwhere(np.isfinite(pool.errors)).tolist()} == set(expected)
    assert len(expected) > 12
    for (f, k), (error, offset, map_) in expected.items():
        assert pool.errors[f, k] == pytest.approx(error, abs=1e-6)
        np.testing.assert_allclose(pool.offsets[f, k], offset, atol=1e-9)
        np.testing.assert_array_equal(pool.maps[f, k], map_)


@pytest.mark.parametrize("seed", range(2))
def test_nothing_is_missed_where_bounds_are_the_differences_themselves(seed: int) -> None:
    """Tiles and patches of one tone, as in letters: what blocks' means leave out is nothing, and rounding decides."""
    rng = np.random.default_rng(seed)
    source, target = (rng.random((n, n)).repeat(k, 0).repeat(k, 1) for n, k in ((3, 40), (4, 8)))
    lens = small_lens(4, 3.0, source=12.0)
    options = Exhaustive(window="6.1mm", step="0.2mm", scales=(0.3, 0.8), pixels=4, candidates=9, polish=0)
    pool, expected = searched(options, Scene(lens, (grey_view(source, target),)))
    assert len(expected) >= 100
    for (f, k), (error, _, _) in expected.items():  # which of several equal ones is found is not asked
        assert pool.errors[f, k] == pytest.approx(error, abs=3e-7)


# known patches

MAPS = np.array([(0.6, 0, 0.6), (-0.6, 0, 0.6), (0.4, 0, -0.85), (-0.85, 0, -0.4), (0.85, 0, 0.6), (0.6, 0, -0.4)])


def cut_out(maps: FloatArray, seed: int = 0, eye: Eye = ABOVE, turns: tuple[int, ...] = (0,), facets: int = 3) -> tuple:
    """A scene whose tiles are patches of its source, and the transformations that lead back to them."""
    lens, rng = small_lens(facets, 3.0, source=30.0, microfacets=22), np.random.default_rng(seed)
    chosen = assigned(rng.uniform(-2.4, 2.4, (facets, facets, 2)), maps[rng.integers(len(maps), size=(facets, facets))])
    sources = [blotches(450, 5.0, seed + 10 * k) for k in range(len(turns))]
    views = tuple(
        grey_view(s, seen(s, lens, chosen, facets * TILE_PX, k), eye, 90.0 * k)
        for k, s in zip(turns, sources, strict=True)
    )
    return Scene(lens, views), chosen


@pytest.mark.parametrize("eye", [ABOVE, ASIDE], ids=["eye above", "eye aside"])
def test_a_patch_cut_out_of_the_source_is_found_where_it_was(eye: Eye) -> None:
    scene, cut = cut_out(MAPS, eye=eye)
    found = matched(Exhaustive(window="6mm", scales=(0.4, 0.6, 0.85), candidates=16), scene)
    np.testing.assert_allclose(found.offsets_mm[:, :, 0], cut.offsets_mm, atol=0.01)
    np.testing.assert_allclose(found.maps[:, :, 0], cut.maps, atol=0.01)
    assert (found.errors[:, :, 0] < 2e-3).all()


def test_a_patch_of_another_symmetric_map_is_found_by_polishing() -> None:
    sheared = np.array([(0.7, 0.12, 0.5), (-0.5, 0.1, 0.65), (0.55, -0.1, 0.75), (0.72, 0.08, -0.5)])
    scene, cut = cut_out(sheared, seed=1)
    found = matched(Exhaustive(window="6mm", scales=(0.45, 0.6, 0.8), candidates=16), scene)
    np.testing.assert_allclose(found.offsets_mm[:, :, 0], cut.offsets_mm, atol=0.01)
    np.testing.assert_allclose(found.maps[:, :, 0], cut.maps, atol=0.01)


@pytest.mark.parametrize("eye", [ABOVE, ASIDE], ids=["eye above", "eye aside"])
def test_rough_candidates_of_any_origin_are_polished_to_the_patch_they_are_near(eye: Eye) -> None:
    """The second of two is out of reach: its facets would be too steep."""
    scene, cut = cut_out(MAPS, eye=eye)
    near, far = cut.offsets_mm + np.float32((0.15, -0.1)), np.full((3, 3, 2), 60.0)
    offsets, maps = np.stack([far, near], axis=2), np.stack([cut.maps, cut.maps * np.float32(1.06)], axis=2)
    found = polished(scene, choices(offsets, maps, np.zeros((3, 3, 2))), Exhaustive(window="6mm", candidates=2))
    np.testing.assert_allclose(found.offsets_mm[:, :, 0], cut.offsets_mm, atol=0.01)
    np.testing.assert_allclose(found.maps[:, :, 0], cut.maps, atol=0.01)
    assert not np.isfinite(found.errors[:, :, 1]).any()
    with pytest.raises(InputError, match=r"facet \(row 0, column 0\) reaches no patch"):
        polished(scene, choices(far[:, :, None], maps[:, :, :1], np.zeros((3, 3, 1))), Exhaustive(window="6mm"))


@pytest.mark.parametrize("eye", [ABOVE, ASIDE], ids=["eye above", "eye aside"])
def test_what_is_within_reach_is_asked_of_each_facet_where_it_is(eye: Eye) -> None:
    lens = small_lens(6, 3.0, source=90.0, max_slope_deg=35.0)
    rng = np.random.default_rng(0)
    offsets = rng.uniform(-10, 10, (6, 6, 24, 2))
    maps = np.broadcast_to([0.5, 0.0, 0.5], (6, 6, 24, 3))
    scene = Scene(lens, (grey_view(blotches(90, 4.0), letter_f(64), eye),))
    options = Exhaustive(window="100%", candidates=24, polish=0, acceptance=10.0)
    found = polished(scene, choices(offsets, maps, np.zeros((6, 6, 24))), options)
    left = np.isfinite(found.errors)
    shares = []
    for (i, j), centre in zip(np.ndindex(6, 6), lens.facet_centres_mm().reshape(-1, 2), strict=True):
        expected = [k for k, o in enumerate(offsets[i, j]) if flat_enough(lens, eye, centre, o, 0.5, 0.5)]
        shares.append(len(expected) / 24)
        kept = sorted(found.offsets_mm[i, j][left[i, j]].tolist())
        np.testing.assert_allclose(kept, sorted(offsets[i, j][expected].tolist()), atol=1e-5)
    assert 0.2 < np.mean(shares) < 0.9


def test_without_polishing_patches_lie_on_the_lattice_of_offsets() -> None:
    scene, cut = cut_out(MAPS)
    found = matched(Exhaustive(window="6mm", scales=(0.4, 0.6, 0.85), candidates=16, polish=0), scene)
    np.testing.assert_allclose(found.offsets_mm[:, :, 0], cut.offsets_mm, atol=0.5 * 0.13 + 0.02)
    np.testing.assert_allclose(found.maps[:, :, 0], cut.maps, atol=1e-6)


def test_one_patch_serves_all_quarter_turns() -> None:
    """Every view has its own source; only one offset and map fits all four."""
    scene, cut = cut_out(MAPS, turns=(0, 1, 2, 3))
    found = matched(Exhaustive(window="6mm", scales=(0.4, 0.6, 0.85), candidates=16), scene)
    np.testing.assert_allclose(found.offsets_mm[:, :, 0], cut.offsets_mm, atol=0.01)
    np.testing.assert_allclose(found.maps[:, :, 0], cut.maps, atol=0.01)


def test_polishing_never_makes_the_best_candidate_worse() -> None:
    lens = small_lens(4, 3.0, source=24.0)
    scene = Scene(lens, (grey_view(blotches(360, 6.0), letter_f(128)),))
    plain, polished = (matched(Exhaustive(window="6mm", polish=p), scene).errors[..., 0] for p in (0, 16))
    # the distance term is not polished; it is at most 1 / m^2
    assert (polished <= plain + (0.13 / 6) ** 2).all()
    assert (polished < 0.99 * plain).mean() > 0.5


def test_the_papers_maps_stay_isotropic() -> None:
    scene, _ = cut_out(MAPS)
    maps = matched(Exhaustive(window="6mm", maps="scale", candidates=9), scene).maps
    np.testing.assert_array_equal(maps[..., 0], maps[..., 2])
    np.testing.assert_array_equal(maps[..., 1], 0)
    assert (maps[..., 0] > 0).all()


def test_an_error_is_the_mean_squared_difference_of_display_values() -> None:
    lens = small_lens(3, 3.0, source=24.0, microfacets=100)
    scene = Scene(lens, (grey_view(blotches(360, 8.0), blotches(3 * TILE_PX, 16.0, seed=4)),))
    found = matched(Exhaustive(window="6mm", scales=(0.4, 0.6, 0.85)), scene)
    best = Assignment.pick(found, np.zeros((3, 3), np.int64))
    shows = to_display(predict(scene, best, 3 * TILE_PX, 3)[0][..., 0])
    difference = (shows - to_display(scene.views[0].target[..., 0])) ** 2
    errors = difference.reshape(3, TILE_PX, 3, TILE_PX).mean(axis=(1, 3))
    np.testing.assert_allclose(found.errors[..., 0], errors, rtol=0.1, atol=4e-4)


def staircase(source: FloatArray, lens: Lens, assignment: Assignment, pixels: int, spread: float) -> FloatArray:
    """(pixels, pixels): what flat micro-facets show; each its own patch, ``spread`` times as large as itself."""
    c = ((np.arange(pixels) + 0.5) / pixels - 0.5) * lens.size_mm
    q, cell = np.stack(np.meshgrid(c, -c), axis=-1), lens.pitch_mm / lens.microfacets
    middle = (np.floor(q / cell) + 0.5) * cell
    at_middles = seen_points(lens, assignment, middle)
    return looked_up(source, lens.source_size_mm, at_middles + spread * (q - middle))


@pytest.mark.parametrize("gap", [0.0, 60.0])
def test_errors_are_judged_by_the_staircase_that_flat_microfacets_show(gap: float) -> None:
    """Seen from far above, a flat micro-facet shows a patch as large as itself, and a little more by perspective."""
    lens = small_lens(3, 3.0, source=24.0, microfacets=4, gap_mm=gap)
    scene = Scene(lens, (grey_view(blotches(360, 8.0), blotches(3 * 16, 5.0, seed=4)),))
    found = matched(Exhaustive(window="6mm", scales=(0.3, 0.6), acceptance=1.0), scene)
    spread = 1 + (THICK / IOR + gap) / (ABOVE[2] - THICK)
    tiles = to_display(scene.views[0].target[..., 0].astype(float))
    for k in (0, 5):
        chosen = Assignment.pick(found, np.full((3, 3), k))
        light = staircase(scene.views[0].source[..., 0], lens, chosen, 3 * 32, spread)
        shows = to_display(light.reshape(48, 2, 48, 2).mean(axis=(1, 3)))
        errors = ((shows - tiles) ** 2).reshape(3, 16, 3, 16).mean(axis=(1, 3))
        m2, r2 = (6 / 0.13) ** 2, (chosen.offsets_mm**2).sum(axis=-1) / 0.13**2
        np.testing.assert_allclose(chosen.errors, errors + 1 / (m2 - r2) - 1 / m2, rtol=2e-3, atol=1e-5)


@pytest.mark.parametrize("matcher", [Exhaustive, MultiViewMatcher])
def test_a_patch_that_reaches_beyond_the_source_is_judged_as_partly_dark(matcher: type[Matcher]) -> None:
    """On a white sheet as large as the lens, errors are what large flat micro-facets show of the dark around it."""
    lens = small_lens(3, 3.0, source=9.0, microfacets=2)
    white = np.ones((180, 180))
    scene = Scene(lens, (grey_view(white, np.ones((48, 48))),))
    found = matcher.model_validate({"window": "4mm", "acceptance": 1.0}).match(scene, np.random.default_rng(0))
    reach = np.abs(lens.facet_centres_mm()[:, :, None] + found.offsets_mm).max(axis=-1)
    spread = np.abs(found.maps[..., [0, 2]]).max(axis=-1) * lens.pitch_mm / 4 + lens.pitch_mm / 4
    inside = np.isfinite(found.errors) & (reach + spread < 4.4)
    beyond = np.isfinite(found.errors) & (reach + lens.pitch_mm / 4 > 4.7)
    assert inside.any()
    assert beyond.any()
    assert found.errors[inside].max() < 0.01
    assert found.errors[beyond].min() > 0.01


# candidates


def busy_candidates(eye: Eye = ABOVE) -> tuple[Lens, Candidates]:
    lens = small_lens(4, 3.0, source=24.0, max_slope_deg=25.0)
    scene = Scene(lens, (grey_view(blotches(240, 4.0), letter_f(64), eye),))
    return lens, matched(Exhaustive(window="14mm", candidates=25), scene)


def test_a_pool_points_y_down_and_gives_candidates_back_as_they_were() -> None:
    rng = np.random.default_rng(0)
    arrays = (rng.normal(size=(2, 2, 5, width)).astype(np.float32) for width in (2, 3))
    given = Candidates(*arrays, np.sort(rng.random((2, 2, 5)), axis=-1).astype(np.float32))
    pool, lens = Pool.of(given), Lens(size_mm=20, source_size_mm=20, facets=2, microfacets=4, thickness_mm=20)
    np.testing.assert_array_equal(pool.offsets.reshape(2, 2, 5, 2) * (1, -1), given.offsets_mm)
    np.testing.assert_array_equal(pool.maps.reshape(2, 2, 5, 3) * (1, -1, 1), given.maps)
    back = pool.candidates(lens, 5)
    for name in ("offsets_mm", "maps", "errors"):
        np.testing.assert_array_equal(getattr(back, name), getattr(given, name))


def test_a_pool_drops_what_is_worse_than_each_facets_best_by_more_than_is_accepted() -> None:
    pool = Pool(2, 2)
    pool.errors[:] = [[0.5, 0.1, 0.31, 0.29], [3.0, 3.1, np.inf, 3.3]]
    pool.drop(0.2)
    np.testing.assert_array_equal(np.isfinite(pool.errors), [[False, True, False, True], [True, True, False, False]])


def test_places_without_a_reachable_patch_stay_empty() -> None:
    """Their errors are infinite; a map of zeros is nobody's."""
    _, found = busy_candidates((100.0, 200.0, THICK + 500.0))
    assert np.abs(found.maps[np.isfinite(found.errors)]).max(axis=-1).min() > 0


def test_candidates_are_sorted_and_empty_places_come_last() -> None:
    _, found = busy_candidates()
    assert found.errors.shape == (4, 4, 25)
    assert np.isinf(found.errors).any()
    assert np.isfinite(found.errors[..., 0]).all()
    assert (np.diff(np.where(np.isinf(found.errors), 9.0, found.errors), axis=-1) >= 0).all()


def test_candidates_lie_in_the_window_and_in_the_source() -> None:
    lens, found = busy_candidates()
    real = np.isfinite(found.errors)
    assert np.abs(found.offsets_mm[real]).max() <= 7.0
    spread = np.abs(found.maps[..., [0, 2]]) + np.abs(found.maps[..., [1]])
    middles = lens.facet_centres_mm()[:, :, None] + found.offsets_mm
    reach = np.abs(middles) + spread * lens.pitch_mm / 2
    assert reach[real].max() <= lens.source_size_mm / 2 + 1e-4


@pytest.mark.parametrize("eye", [ABOVE, (100.0, 200.0, THICK + 500.0)], ids=["eye above", "eye aside"])
def test_patches_that_take_too_steep_facets_are_left_out(eye: Eye) -> None:
    lens, found = busy_candidates(eye)
    steepest = 0.0
    for i, j, k in np.argwhere(np.isfinite(found.errors)):
        centre, (xx, xy, yy) = lens.facet_centres_mm()[i, j], found.maps[i, j, k]
        for p in itertools.product((-1.5, 1.5), repeat=2):
            s = centre + found.offsets_mm[i, j, k] + (xx * p[0] + xy * p[1], xy * p[0] + yy * p[1])
            normal = facet_normal(eye, (*(centre + p), THICK), tuple(s), slab_of(lens))
            steepest = max(steepest, math.degrees(math.acos(normal[2])))
    assert 20.0 < steepest < 25.001


def test_candidates_of_a_plain_tile_are_spread_over_the_window() -> None:
    """On a plain source all offsets tie; the candidates must not be one clump."""
    lens = small_lens(2, 3.0, source=24.0)
    scene = Scene(lens, (grey_view(np.full((240, 240), 0.5), np.full((64, 64), 0.5)),))
    offsets = matched(Exhaustive(window="6mm", candidates=36), scene).offsets_mm
    buckets = np.floor((offsets + 3) / 1.0).astype(int).clip(0, 5)
    for facet in buckets.reshape(4, 36, 2):
        assert len({tuple(b) for b in facet.tolist()}) == 36


def test_a_facet_that_reaches_no_patch_is_named() -> None:
    lens = small_lens(2, 3.0, max_slope_deg=1.0)
    scene = Scene(lens, (grey_view(blotches(120, 4.0), letter_f(64)),))
    with pytest.raises(InputError, match=r"facet \(row 0, column 0\) reaches no patch.*larger.*max_slope"):
        matched(Exhaustive(scales=(0.2,), window="1mm"), scene)


def test_a_row_that_is_matched_alone_is_named_by_its_place_in_the_lens() -> None:
    lens = small_lens(3, 3.0, max_slope_deg=1.0)
    scene = Scene(lens, (grey_view(blotches(120, 4.0), letter_f(64)),))
    with pytest.raises(InputError, match=r"facet \(row 2, column 0\)"):
        Exhaustive(scales=(0.2,), window="1mm").match_rows(scene, 2, 3)


@pytest.mark.parametrize(
    ("key", "least", "less"),
    [("window", "0.1mm", "0.099mm"), ("window", "0.1%", "0.099%"), ("step", "0.01mm", "0.0099mm")],
)
def test_windows_and_steps_have_a_least_and_a_largest_value(key: str, least: str, less: str) -> None:
    for value in (least, "20000mm", "200%"):
        Exhaustive.model_validate({key: value})
    for value in (less, "20001mm", "201%"):
        with pytest.raises(ValidationError, match="must be at"):
            Exhaustive.model_validate({key: value})


def test_magnitudes_of_maps_have_bounds() -> None:
    Exhaustive(scales=(0.01, 100.0))
    for scale in (0.0099, 100.1):
        with pytest.raises(ValidationError, match=r"scales are from 0\.01 to 100"):
            Exhaustive(scales=(scale,))


def test_views_of_different_eyes_need_another_matcher() -> None:
    lens, picture = small_lens(2), np.ones((16, 16))
    for other in (grey_view(picture, picture, ASIDE), grey_view(picture, picture, ASIDE, 90.0)):
        with pytest.raises(InputError, match="share one eye in the lens frame"):
            matched(Exhaustive(), Scene(lens, (grey_view(picture, picture, ABOVE), other)))


# channels, blur, prediction


def test_a_quarter_turn_moves_plus_x_to_plus_y() -> None:
    """What the turned lens shows at the world's +y is seen through its own +x side."""
    dot, plain = np.zeros((32, 32)), np.zeros((32, 32))
    dot[0:2, 15:17] = 1.0
    channels = stack_channels(Scene(small_lens(2), (grey_view(dot, dot), grey_view(dot, dot, ABOVE, 90.0))))
    turned_dot = plain.copy()
    turned_dot[15:17, 30:32] = 1.0
    for stacked in (channels.source, channels.target):
        np.testing.assert_array_equal(stacked, [dot, turned_dot])


def test_pictures_of_different_sizes_are_stacked_as_fine_as_the_finest() -> None:
    fine, coarse = np.random.default_rng(0).random((32, 32)), np.full((8, 8), 0.5)
    views = grey_view(fine, coarse), grey_view(coarse, fine)
    for order in (views, views[::-1]):
        channels = stack_channels(Scene(small_lens(2), order))
        for stacked in (channels.source, channels.target):
            assert sorted(float(np.ptp(plane)) for plane in stacked) == [0.0, pytest.approx(np.ptp(fine))]


def test_colours_and_views_are_channels_in_this_order() -> None:
    picture = ramps(16)
    views = tuple(View("v", picture, picture * g, np.array(ABOVE)) for g in (1.0, 0.5))
    target = stack_channels(Scene(small_lens(2), views)).target
    np.testing.assert_allclose(target, [g * picture[..., c] for g in (1.0, 0.5) for c in range(3)])


def test_tiles_are_means_of_linear_light_in_display_values() -> None:
    lens, target = small_lens(2), np.random.default_rng(0).random((48, 48))
    tiles = stack_channels(Scene(lens, (grey_view(target, target),))).tiles(2, 8)
    mean = target[24:27, 0:3].mean()
    assert tiles.shape == (2, 2, 1, 8, 8)
    assert tiles[1, 0, 0, 0, 0] == pytest.approx(to_display(mean), abs=1e-6)


@pytest.mark.parametrize("width_px", [0.5, 1.0, 1.7, 2.0, 2.5, 3.0, 4.0, 5.3, 8.0])
def test_blurring_keeps_every_point_where_it_is(width_px: float) -> None:
    px = 0.05
    source = np.full((1, 41, 41), 0.2, np.float32)
    source[0, 17, 25] = 1.0
    levels = np.empty((2, 1, 41, 41), np.float32)
    blur_levels(source, px, 1.3 * px, (0.0, width_px * px), levels)
    for level in levels:
        light = to_linear(level[0].astype(float)) - 0.2
        rows, columns = np.indices(light.shape)
        assert light.sum() == pytest.approx(0.8, rel=1e-3)
        assert (light * rows).sum() / light.sum() == pytest.approx(17.0, abs=0.01)
        assert (light * columns).sum() / light.sum() == pytest.approx(25.0, abs=0.01)
    assert light.max() * width_px**2 < 0.9


def test_blurring_a_step_makes_a_ramp_as_wide_as_the_box() -> None:
    px, source = 0.1, np.zeros((1, 8, 40), np.float32)
    source[..., 20:] = 1.0
    levels = np.empty((1, 1, 8, 40), np.float32)
    blur_levels(source, px, 0.0, (0.55,), levels)
    light = to_linear(levels[0, 0, 4].astype(float))
    edges = np.arange(41) - 20.0
    ideal = np.diff(np.where(np.abs(edges) < 2.75, (edges + 2.75) ** 2 / 11, np.maximum(edges, 0)))
    # pixels are boxes themselves: the blurred step runs over 5.5 pixels, give or take half a one
    np.testing.assert_allclose(light, ideal, atol=0.06)
    np.testing.assert_allclose(light + light[::-1], 1.0, atol=1e-5)


def test_identity_shows_the_source_itself() -> None:
    lens = small_lens(4, 3.0, source=12.0)
    source = blotches(96, 2.0)
    scene = Scene(lens, tuple(grey_view(source, source, ABOVE, 90.0 * k) for k in range(4)))
    for picture in predict(scene, assigned(np.zeros((4, 4, 2)), (1, 0, 1)), 96, 1):
        np.testing.assert_allclose(picture[..., 0], source, atol=2e-3)


@pytest.mark.parametrize("turns", range(4))
def test_prediction_follows_offsets_and_maps(turns: int) -> None:
    lens, rng = small_lens(4, 3.0, source=24.0), np.random.default_rng(turns)
    chosen = assigned(rng.uniform(-2, 2, (4, 4, 2)), rng.uniform(-1, 1, (4, 4, 3)))
    source = blotches(200, 3.0)
    scene = Scene(lens, (grey_view(source, source, ABOVE, 90.0 * turns),))
    picture = predict(scene, chosen, 64, 1)[0][..., 0]
    np.testing.assert_allclose(picture, seen(source, lens, chosen, 64, turns), atol=2e-5)


# rematching


@pytest.mark.parametrize("turns", range(4))
def test_rematching_replaces_the_errors_in_use_by_those_of_the_lens_as_built(turns: int) -> None:
    """Facets of the target that are what the lens shows have no error, others do; nothing else changes."""
    lens = small_lens(4, 5.0, source=30.0, microfacets=8)
    source, eye = blotches(300, 6.0), np.array(ABOVE)
    heights = Poisson().integrate(blank_scene(lens), assigned(RNG.uniform(-1, 1, (4, 4, 2)), (0.7, 0.1, 0.5)))
    view = View("v", source[..., None], source[..., None], eye, 90.0 * turns)
    shown = Tracer(resolution=128, samples=2).render(Scene(lens, (view,)), solid_from_heights(heights))[0]
    spoilt = np.rot90(shown, -turns).copy()
    spoilt[32:64, 96:] = 1 - spoilt[32:64, 96:]
    scene = Scene(lens, (replace(view, target=np.rot90(spoilt, turns).copy()),))
    offered = choices(np.zeros((4, 4, 3, 2)), np.ones((4, 4, 3, 3)), np.full((4, 4, 3), 0.7))
    used, errors = Assignment.pick(offered, np.full((4, 4), 1)), facet_errors(scene, heights)
    again = Exhaustive().rematch(scene, offered, used, heights, errors)
    assert again.errors[1, 3, 1] > 0.02
    others = np.delete(again.errors[..., 1].ravel(), 7)
    assert others.max() < 3e-3
    np.testing.assert_array_equal(again.errors[..., [0, 2]], offered.errors[..., [0, 2]])
    np.testing.assert_array_equal(again.offsets_mm, offered.offsets_mm)


@pytest.mark.parametrize("width", [1.0, 1.2, 2.0, 4.5])
def test_boxes_of_any_width_average_over_exactly_that_width(width: float) -> None:
    dot = np.zeros((1, 1, 9))
    dot[0, 0, 4] = 1.0
    whole = np.clip(width / 2 + 0.5 - abs(np.arange(9) - 4), 0, 1)  # how much of each pixel lies in the box
    np.testing.assert_allclose(box_blur(dot, 1.0, width)[0, 0], whole / width, atol=1e-12)


def test_a_tiles_pixel_sees_at_least_half_a_source_pixel() -> None:
    assert resolved_scales((1.0, 0.1, 0.2, 0.5), 0.2, 0.1) == (0.25, 0.5, 1.0)
