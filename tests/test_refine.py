"""Free-form refinement: what its kernels foresee is what the tracer sees, and no facet pays for another's gain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numba
import numpy as np
import pytest
from pydantic import ValidationError

from magiclens.contract.artifacts import Assignment, FloatArray, HeightField, Scene, View
from magiclens.contract.stages import Progress, silent
from magiclens.geometry.solid import solid_from_heights
from magiclens.images import resize, to_display
from magiclens.integration import refinement
from magiclens.integration.laplacian import cosines
from magiclens.integration.poisson import Poisson
from magiclens.integration.refinement import optics_for, pictures_of, predicted_errors, samples_of
from magiclens.integration.refinement_kernels import (
    Shown,
    predict_facet,
    residual_change,
    residual_change_transposed,
    room_for_rays,
    tile_of,
    to_field,
    to_spectrum,
    triangle_slopes,
    triangle_slopes_transposed,
)
from magiclens.integration.surface_metrics import facet_slopes_deg, surface_metrics
from magiclens.matching.exhaustive import Exhaustive
from magiclens.plan.compile import load_plan
from magiclens.rendering.tracer import picture, trace
from magiclens.running.pipeline import run_plan
from magiclens.testing import one_view, two_eyes, two_turns
from magiclens.testing.scenes import an_assignment
from scenes import blotches, plane_points_mm, small_lens, surface
from toys import TOYS, SpecWriter, ToyIntegrator, ToyMatcher, registry_of

RNG = 11
STEADY = Poisson(placement="steps")
"""Does not raise facets once they are refined."""
RAISED_MM = 1.0
"""Of rolling lenses, so that eyes beside the lens see them shifted."""


def with_lens(scene: Scene, **changes: object) -> Scene:
    return replace(scene, lens=replace(scene.lens, **changes))  # type: ignore[arg-type]


SCENES: dict[str, Callable[[], Scene]] = {
    "one eye": one_view,
    "two tilted eyes": two_eyes,
    "air gap": lambda: with_lens(one_view(), gap_mm=8.0),
    "vertical cells": lambda: with_lens(one_view(), cells="vertical"),
    "two eyes over vertical cells": lambda: with_lens(two_eyes(), cells="vertical"),
    "two turns in colour": two_turns,
}
scenes = pytest.mark.parametrize("make", SCENES.values(), ids=list(SCENES))


def rolling(scene: Scene) -> HeightField:
    """One smooth surface over the whole lens: no steps, and facets that no quadratic describes."""
    x, y = plane_points_mm(scene.lens)
    heights = RAISED_MM + 0.12 * (np.sin(1.1 * x + 0.3 * y) + np.cos(0.9 * y - 0.5 * x))
    return surface(scene.lens, heights, scene.cut_eye_mm)


def as_lenslets(built: HeightField) -> HeightField:
    """The quadratic facets that are nearest to given ones."""
    k = built.heights_mm.shape[-1]
    v, u = (a.ravel() for a in np.meshgrid(*[np.linspace(-1, 1, k)] * 2, indexing="ij"))
    basis = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)
    flat = built.heights_mm.reshape(-1, k * k)
    heights = flat @ np.linalg.pinv(basis).T @ basis.T
    return replace(built, heights_mm=heights.reshape(built.heights_mm.shape))


def over_blotches(scene: Scene) -> Scene:
    """The scene over a smooth source of the same colours."""
    colours = scene.views[0].source.shape[2]
    source = np.stack([blotches(256, 4, seed) for seed in range(colours)], axis=-1)
    return replace(scene, views=tuple(replace(view, source=source) for view in scene.views))


def showing(scene: Scene, built: HeightField) -> Scene:
    """The scene whose targets are what a lens shows."""
    views = tuple(replace(view, target=traced(scene, built, view)) for view in scene.views)
    return replace(scene, views=views)


def traced(scene: Scene, built: HeightField, view: View) -> FloatArray:
    """What the built-in tracer sees, in the exposure that makes up for reflection losses; world frame."""
    lens = scene.lens
    hits = trace(solid_from_heights(built), lens, view, lens.facets * samples_of(lens).pixels, 4)
    seen = picture(hits, view.in_lens_frame().source, lens.source_size_mm) / np.median(hits[..., 2])
    return np.ascontiguousarray(np.rot90(seen.clip(0, 1), view.quarter_turns))


def traced_errors(scene: Scene, built: HeightField) -> FloatArray:
    """(N, N) mean squared differences of display values, mean over the views; lens frame."""
    n, errors = scene.lens.facets, []
    for view in scene.views:
        seen = traced(scene, built, view)
        difference = (to_display(seen) - to_display(resize(view.target, seen.shape[:2]))) ** 2
        errors.append(np.rot90(difference, -view.quarter_turns).mean(-1).reshape(n, -1, n, len(seen) // n))
    return np.mean(errors, axis=0).mean(axis=(1, 3))


def db(errors: FloatArray) -> float:
    return float(-10 * np.log10(np.mean(errors)))


@scenes
def test_what_is_foreseen_is_what_the_tracer_sees(make: Callable[[], Scene]) -> None:
    scene = over_blotches(make())
    built = rolling(scene)
    errors = predicted_errors(showing(scene, built), built)
    assert db(errors) > 43
    assert db(errors.max()) > 40


@scenes
def test_from_lenslets_the_shapes_are_found_that_show_what_no_lenslet_can(make: Callable[[], Scene]) -> None:
    scene = over_blotches(make())
    scene = showing(scene, rolling(scene))
    lenslets = as_lenslets(rolling(scene))
    refined = Poisson().refine(scene, lenslets)
    before, after = traced_errors(scene, lenslets), traced_errors(scene, refined)
    assert db(after) > db(before) + 12
    assert (after < before).all()


@pytest.fixture(scope="module")
def matched() -> tuple[Scene, HeightField]:
    """Lenslets at the best patches of a sheet of discs for a letter, with steps between them."""
    scene = one_view()
    found = Exhaustive(candidates=2, polish=2).match(scene, np.random.default_rng(RNG))
    chosen = Assignment.pick(found, np.zeros(found.errors.shape[:2], np.int64))
    return scene, Poisson().integrate(scene, chosen)


def test_a_matched_lens_gains_decibels_and_no_facet_of_it_pays(matched: tuple[Scene, HeightField]) -> None:
    scene, built = matched
    assert built.metrics["step_max_mm"] > 0.1
    refined = Poisson().refine(scene, built)
    before, after = traced_errors(scene, built), traced_errors(scene, refined)
    assert db(after) > db(before) + 5
    assert (after - before).max() < 1e-3
    assert (predicted_errors(scene, refined) <= predicted_errors(scene, built)).all()


@scenes
def test_no_facet_shows_its_tile_worse_than_its_lenslet_did(make: Callable[[], Scene]) -> None:
    """Also where patches have nothing to do with tiles, so that blurred sources lead astray."""
    scene = make()
    built = Poisson().integrate(scene, an_assignment(scene))
    refined = STEADY.refine(scene, built)
    before, after = predicted_errors(scene, built), predicted_errors(scene, refined)
    same = (refined.heights_mm == built.heights_mm).all(axis=(2, 3))
    assert (after[~same] < before[~same]).all()
    assert refined.metrics["facets_refined"] == pytest.approx(1 - same.mean())
    assert same.mean() < 0.5


@pytest.mark.tools
def test_refined_facets_stand_where_walls_take_least_light(matched: tuple[Scene, HeightField]) -> None:
    """Their edges and their rays are not those of the lenslets that were placed before."""
    scene, built = matched
    level = replace(built, heights_mm=built.heights_mm - built.levels_mm[..., None, None])
    steady, placed = (strays(scene, stage.refine(scene, level)) for stage in (STEADY, Poisson()))
    assert placed < 0.5 * steady
    assert steady > 1e-3


def strays(scene: Scene, built: HeightField) -> float:
    """The share of what the eye sees that arrives elsewhere because the lens's facets stand beside each other."""
    n, levels = scene.lens.facets, built.levels_mm
    hits = trace(solid_from_heights(built), scene.lens, scene.views[0], 64 * n, 4).reshape(n, 64, n, 64, -1, 3)
    lost = 0.0
    for i, j in np.ndindex(n, n):  # every facet again, with all its neighbours above it
        high = built.heights_mm - levels[..., None, None] + 2.0
        high[i, j] = built.heights_mm[i, j]
        alone = trace(solid_from_heights(replace(built, heights_mm=high)), scene.lens, scene.views[0], 64 * n, 4)
        alone = alone.reshape(n, 64, n, 64, -1, 3)[i, :, j]
        lost += float((np.abs(alone - hits[i, :, j])[..., :2].max(axis=-1) > 0.01).mean()) / n**2
    return lost


def test_progress_ascends_to_the_end(matched: tuple[Scene, HeightField]) -> None:
    told: list[float] = []
    Poisson(refinement=1).refine(*matched, told.append)
    assert told == sorted(told)
    assert told[0] >= 0
    assert told[-1] == pytest.approx(1.0)
    assert max(np.diff([0.0, *told])) < 0.4


def test_progress_never_descends_however_many_parts_there_are(
    matched: tuple[Scene, HeightField], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(refinement, "FACETS_AT_ONCE", 1)
    told: list[float] = []
    Poisson(refinement=1).refine(*matched, told.append)
    assert len(told) > 20
    assert told == sorted(told)


@pytest.mark.parametrize(("facets", "microfacets", "pixels"), [(32, 22, 16), (4, 12, 18), (200, 40, 14)])
def test_pictures_are_compared_in_512_pixels_or_as_many_as_microfacets_can_show(
    facets: int, microfacets: int, pixels: int
) -> None:
    assert samples_of(small_lens(facets, microfacets=microfacets)).pixels == pixels


@pytest.mark.parametrize("microfacets", [3, 8, 11])
def test_pixels_and_triangles_are_the_sums_of_their_pieces(microfacets: int) -> None:
    lens, m = small_lens(32, microfacets=microfacets), microfacets
    samples = samples_of(lens)
    per_cell = (samples.pixels / m) ** 2
    assert samples.cell_mm == pytest.approx((lens.pitch_mm - lens.wall_mm) / m)
    of_piece = np.concatenate([samples.pixel[:count] for count in np.diff(samples.layers)])
    pixels, triangles = np.bincount(of_piece, samples.share), np.bincount(samples.triangle, samples.share)
    np.testing.assert_allclose(pixels, np.ones(samples.pixels**2), rtol=1e-6)
    np.testing.assert_allclose(triangles, np.full(2 * m * m, 0.5 * per_cell), rtol=1e-6)
    # the centroids of pieces have that of their triangle or pixel in their middle
    half = 0.5 * m * samples.cell_mm
    right = samples.centroids_mm[0, samples.triangle] + samples.right_mm + half
    down = half - samples.centroids_mm[1, samples.triangle] - samples.up_mm
    for way in (samples.right_mm, samples.up_mm):
        np.testing.assert_allclose(np.bincount(samples.triangle, samples.share * way), 0, atol=1e-6)
    for way, middle in zip((down, right), np.divmod(np.arange(samples.pixels**2), samples.pixels), strict=True):
        np.testing.assert_allclose(
            np.bincount(of_piece, samples.share * way), (middle + 0.5) * 2 * half / samples.pixels, rtol=1e-5
        )


def test_measures_are_those_of_the_refined_surface(matched: tuple[Scene, HeightField]) -> None:
    scene, built = matched
    refined = Poisson().refine(scene, built)
    assert {**refined.metrics, **surface_metrics(refined)} == refined.metrics
    assert refined.metrics["integration_rounds"] == built.metrics["integration_rounds"]
    assert not refined.heights_mm.flags.writeable


@pytest.mark.parametrize("light", [0.0, 1.0])
def test_a_picture_that_is_shown_perfectly_is_left_as_it_is(light: float) -> None:
    scene = one_view()
    plain = np.full((64, 64, 1), light, np.float32)
    built = rolling(scene)
    refined = STEADY.refine(replace(scene, views=(replace(scene.views[0], source=plain, target=plain),)), built)
    np.testing.assert_array_equal(refined.heights_mm, built.heights_mm)


def test_borders_stay_bit_for_bit_where_steps_are_limited(matched: tuple[Scene, HeightField]) -> None:
    scene, built = matched
    refined = Poisson(step_limit="0.1mm").refine(scene, built)
    moved = refined.heights_mm != built.heights_mm
    assert moved[:, :, 1:-1, 1:-1].mean() > 0.4
    assert not moved[:, :, [0, -1]].any()
    assert not moved[..., [0, -1]].any()
    assert refined.metrics["step_max_mm"] == built.metrics["step_max_mm"]
    assert db(traced_errors(scene, refined)) > db(traced_errors(scene, built)) + 2


def test_a_facet_that_would_leave_the_relief_stays_a_lenslet_or_finds_another_shape(
    matched: tuple[Scene, HeightField],
) -> None:
    scene, built = matched
    free, tight = (refined_within(scene, built, relief_mm=relief) for relief in (3.0, 2.0))
    assert db(predicted_errors(scene, free)) > 40
    tall = np.abs(free.heights_mm).max(axis=(2, 3)) > 2
    lenslets = (tight.heights_mm == built.heights_mm).all(axis=(2, 3))
    assert tall.any()
    others = tall & ~lenslets
    assert np.all(predicted_errors(scene, tight)[others] < predicted_errors(scene, built)[others])
    np.testing.assert_array_equal(tight.heights_mm[~tall], free.heights_mm[~tall])
    assert np.abs(tight.heights_mm).max() <= 2


def refined_within(scene: Scene, built: HeightField, **limits: float) -> HeightField:
    lens = replace(scene.lens, **limits)  # type: ignore[arg-type]
    return STEADY.refine(replace(scene, lens=lens), replace(built, lens=lens))


@pytest.mark.parametrize("cells", ["eye", "vertical"])
def test_no_facet_gets_steeper_than_the_limit_and_those_that_are_stay(cells: str) -> None:
    scene = over_blotches(with_lens(one_view(), cells=cells))
    scene, lenslets = showing(scene, rolling(scene)), as_lenslets(rolling(scene))
    assert steepest(refined_within(scene, lenslets, max_slope_deg=60)).max() > 16
    for limit in (15.0, 12.0):
        refined = refined_within(scene, lenslets, max_slope_deg=limit)
        steep = steepest(lenslets) > limit + 0.05
        assert steepest(refined)[~steep].max() < limit + 0.05
        assert steepest(refined)[~steep].max() > limit - 0.5
        np.testing.assert_array_equal(refined.heights_mm[steep], lenslets.heights_mm[steep])
        assert steep.any() == (limit == 12)


def steepest(built: HeightField) -> FloatArray:
    """(N, N) the steepest micro-facet of every facet, degrees."""
    points = built.facet_points_mm()
    return np.array([[facet_slopes_deg(points[i : i + 1, j : j + 1]).max() for j in range(4)] for i in range(4)])


def test_no_refinement_is_asked_for_with_zero_steps(matched: tuple[Scene, HeightField]) -> None:
    scene, built = matched
    assert Poisson(refinement=0).refine(scene, built) is built
    with pytest.raises(ValidationError):
        Poisson(refinement=-1)


class Refining(ToyIntegrator):
    """Adds its mark to the heights, and notes how often."""

    calls: ClassVar[list[HeightField]] = []

    def refine(self, scene: Scene, built: HeightField, progress: Progress = silent) -> HeightField:
        self.calls.append(built)
        return replace(built, metrics={**built.metrics, "refined": 1.0})


class Universal(ToyMatcher):
    """Is shown no pictures."""

    uses_pictures: ClassVar[bool] = False


@pytest.mark.parametrize(("matcher", "calls"), [(ToyMatcher, 1), (Universal, 0)])
def test_lenses_are_refined_once_at_the_end_and_universal_ones_never(
    matcher: type[ToyMatcher], calls: int, write_spec: SpecWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Refining, "calls", [])
    stages = registry_of(*(t for t in TOYS if t not in (ToyMatcher, ToyIntegrator)), matcher, Refining)
    run = run_plan(load_plan(write_spec(), ["pipeline.rematch=2"], stages), tmp_path / "out")
    assert len(Refining.calls) == calls
    assert ("refined" in run.manifest["metrics"]) == bool(calls)


def test_views_of_one_eye_share_its_rays_and_equal_sources_are_kept_once() -> None:
    """Four views that turn with the lens; of the eyes beside it, those at -y after half a turn are at +y."""
    (view,) = one_view().views
    poses = {0: (0.0, 5.0), 180: (0.0, -5.0), 90: (3.0, 4.0), 360: (3.0, 4.0)}
    views = [
        replace(view, name=str(400 - turn), eye_mm=np.array([x, y, 220.0]), rotation_deg=float(turn))
        for turn, (x, y) in poses.items()
    ]
    scene = over_blotches(Scene(one_view().lens, tuple(views)))
    pictures = pictures_of(scene, 12)
    assert pictures.eyes_mm[:, :2].tolist() == [[0, 5], [3, 4], [4, -3]]
    assert pictures.first.tolist() == [0, 2, 3, 4]
    assert pictures.sources.shape == (256, 256, 3)
    for at, turns in enumerate((0, 2, 0, 1)):
        np.testing.assert_array_equal(pictures.sources[..., pictures.plane[at]], np.rot90(blotches(256, 4), -turns))
    built = rolling(scene)
    assert db(predicted_errors(showing(scene, built), built)) > 47


class Facet:
    """The facet (1, 2) of a rolling lens over a source that is neither black nor white, as its eyes see it."""

    def __init__(self, make: Callable[[], Scene]):
        scene = over_blotches(make())
        views = tuple(replace(view, source=0.3 + 0.6 * view.source) for view in scene.views)
        built = rolling(scene)
        self.scene = showing(replace(scene, views=views), built)
        self.heights = built.heights_mm[1, 2].copy()
        self.centre, self.optics = scene.lens.facet_centres_mm()[1, 2], optics_for(built)
        self.samples = samples_of(scene.lens)
        self.pictures = pictures_of(self.scene, self.samples.pixels)
        self.triangles, self.channels = 2 * scene.lens.microfacets**2, len(self.pictures.plane)
        self.seen = self.look(self.heights)

    def look(self, heights: FloatArray) -> Shown:
        pixels, pieces = self.samples.pixels**2, len(self.samples.triangle)
        residuals = np.zeros((self.channels, pixels), np.float32)
        gradients = np.zeros((self.channels, 2, pieces), np.float32)
        seen, rays = Shown(np.zeros((2, self.triangles)), residuals, gradients), room_for_rays(self.samples)
        facet = (heights, self.centre, self.samples, self.pictures, self.optics)
        error = predict_facet(*facet, tile_of(*facet), rays, seen)
        assert error == pytest.approx((seen.residuals.astype(float) ** 2).mean(), rel=1e-5)
        return seen

    def slopes(self, heights: FloatArray) -> FloatArray:
        out = np.zeros((2, self.triangles))
        triangle_slopes(heights, self.samples.cell_mm, out)
        return out

    def along(self, slopes: FloatArray) -> FloatArray:
        out = np.zeros_like(self.seen.residuals)
        residual_change(self.samples, self.seen, slopes, out)
        return out


@scenes
def test_gradients_are_the_differences_of_what_is_seen(make: Callable[[], Scene]) -> None:
    facet = Facet(make)
    v, u = np.meshgrid(*[np.linspace(-1, 1, len(facet.heights))] * 2, indexing="ij")
    for shape in (u, v, u * u - v, np.sin(3 * u) * v, np.cos(2 * u - 3 * v)):
        change = 4e-3 * shape
        plus, minus = (facet.look(facet.heights + sign * change).residuals for sign in (1, -1))
        found, expected = facet.along(facet.slopes(change)), (plus - minus) / 2
        assert np.linalg.norm(found - expected) < 0.12 * np.linalg.norm(expected)
        assert (found * expected).sum() == pytest.approx((expected**2).sum(), rel=0.03)


def test_slopes_are_those_along_plus_x_and_plus_y() -> None:
    """Of a plane: rows run downward, columns to the right."""
    facet = Facet(one_view)
    right, down = np.meshgrid(np.arange(9), np.arange(9))
    slopes = facet.slopes(facet.samples.cell_mm * (0.2 * right - 0.3 * down))
    np.testing.assert_allclose(slopes, np.broadcast_to([[0.2], [0.3]], slopes.shape), atol=1e-12)


@scenes
def test_forces_are_pulled_back_the_way_that_changes_go(make: Callable[[], Scene]) -> None:
    """Of heights and slopes, and of slopes and residuals."""
    facet, rng = Facet(make), np.random.default_rng(RNG)
    heights, forces = rng.normal(size=facet.heights.shape), rng.normal(size=(2, facet.triangles))
    pulled = np.zeros_like(heights)
    triangle_slopes_transposed(forces, facet.samples.cell_mm, pulled)
    assert (pulled * heights).sum() == pytest.approx((forces * facet.slopes(heights)).sum(), rel=1e-9)
    residuals, back = rng.normal(size=facet.seen.residuals.shape).astype(np.float32), np.zeros_like(forces)
    residual_change_transposed(facet.samples, facet.seen, residuals, back)
    assert (back * forces).sum() == pytest.approx((residuals * facet.along(forces)).sum(), rel=1e-3)


def test_a_spectrum_has_its_field_and_eigenvalues_of_the_laplacian() -> None:
    """The metric's eigenvalues belong to its cosines: squared differences along both axes."""
    h, k = np.random.default_rng(RNG).normal(size=(9, 9)), 9
    matrix, eigenvalues = cosines(k)
    matrix = np.ascontiguousarray(matrix)
    spectrum, work, out = np.zeros((k, k)), np.zeros((k, k)), np.zeros((k, k))
    to_spectrum(h, matrix, work, spectrum)
    to_field(spectrum, matrix, work, out)
    np.testing.assert_allclose(out, h, atol=1e-12)
    to_field(eigenvalues * spectrum, matrix, work, out)
    assert (h * out).sum() == pytest.approx((np.diff(h, axis=0) ** 2).sum() + (np.diff(h, axis=1) ** 2).sum())


def test_equal_lenses_are_refined_to_equal_bytes_by_any_number_of_threads(matched: tuple[Scene, HeightField]) -> None:
    scene, built = matched
    before, given = numba.get_num_threads(), built.heights_mm.tobytes()
    found = set()
    for count in (1, 1, min(2, numba.config.NUMBA_NUM_THREADS)):
        numba.set_num_threads(count)
        found.add(Poisson().refine(scene, built).heights_mm.tobytes())
    numba.set_num_threads(before)
    assert len(found) == 1
    assert built.heights_mm.tobytes() == given
