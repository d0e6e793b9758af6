"""The matcher for several eyes: what it finds both eyes see, and its errors are those of exact refraction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.optimize import brentq

from magiclens.analysis.ideal_picture import predict
from magiclens.contract.artifacts import Assignment, Candidates, FloatArray, Scene, View
from magiclens.contract.errors import InputError
from magiclens.geometry.facets import patches_seen
from magiclens.images import resize, to_display
from magiclens.integration.poisson import Poisson
from magiclens.matching.exhaustive import Exhaustive
from magiclens.matching.multi_view import MultiViewMatcher, _averaged
from magiclens.optics.medium import slab_of
from magiclens.optics.refraction import facet_normal, refract
from magiclens.rendering.facet_errors import facet_errors
from scenes import ABOVE, THICK, assigned, blotches, choices, grey_view, letter_f, small_lens, surface

LEFT_EYE, RIGHT_EYE = (-104.0, 0.0, THICK + 386.0), (104.0, 20.0, THICK + 386.0)
TILE_PX = 48
OPTIONS = MultiViewMatcher(window="6mm", scales=(0.4, 0.6, 0.85), candidates=16)
MAPS = np.array([(0.6, 0, 0.6), (-0.6, 0, 0.6), (0.4, 0, -0.85), (-0.85, 0, -0.4), (0.85, 0, 0.6), (0.6, 0, -0.4)])


def matched(scene: Scene, heights: FloatArray | None = None, options: MultiViewMatcher = OPTIONS) -> Candidates:
    at = np.zeros((scene.lens.facets,) * 2) if heights is None else heights
    return options.match_at(scene, at)


def planted(
    heights: FloatArray | None = None, turns: tuple[int, int] = (0, 0), **options: object
) -> tuple[Scene, Assignment]:
    """A scene whose targets are what ideal facets show to its eyes, and what they were assigned."""
    lens = small_lens(3, 3.0, source=40.0, microfacets=22, **options)
    rng = np.random.default_rng(1)
    chosen = assigned(rng.uniform(-2, 2, (3, 3, 2)), MAPS[rng.integers(len(MAPS), size=(3, 3))])
    source, blank = blotches(600, 5.0), np.ones((3 * TILE_PX, 3 * TILE_PX))
    views = [grey_view(source, blank, eye, 90.0 * k) for eye, k in zip((LEFT_EYE, RIGHT_EYE), turns, strict=True)]
    blind = Scene(lens, tuple(views))
    pictures = predict(blind, chosen, 3 * TILE_PX, 3, heights)
    return Scene(lens, tuple(replace(v, target=p) for v, p in zip(views, pictures, strict=True))), chosen


def assert_found(found: Candidates, cut: Assignment) -> None:
    np.testing.assert_allclose(found.offsets_mm[:, :, 0], cut.offsets_mm, atol=0.02)
    np.testing.assert_allclose(found.maps[:, :, 0], cut.maps, atol=0.05)
    assert (found.errors[:, :, 0] < 2e-3).all()


@pytest.mark.every_third
@pytest.mark.parametrize("turns", [(0, 0), (1, 1), (0, 3)])
@pytest.mark.parametrize("cells", ["eye", "vertical"])
@pytest.mark.parametrize("gap", [0.0, 20.0])
def test_a_patch_that_both_eyes_must_see_is_found(turns: tuple[int, int], cells: str, gap: float) -> None:
    scene, cut = planted(turns=turns, cells=cells, gap_mm=gap)
    assert_found(matched(scene), cut)


def test_progress_tells_of_search_and_polishing_and_ascends() -> None:
    told: list[float] = []
    scene, _ = planted()
    OPTIONS.match_at(scene, np.zeros((3, 3)), told.append)
    assert len(told) >= 2
    assert all(0 < before < after <= 1 for before, after in pairwise(told))


def test_facets_that_stand_high_or_low_are_matched_where_they_are_seen() -> None:
    """Tilted eyes see them displaced in their pictures, and through them other points of the source."""
    heights = np.random.default_rng(5).uniform(-1, 1, (3, 3))
    scene, cut = planted(heights=heights)
    there, elsewhere = matched(scene, heights), matched(scene)
    np.testing.assert_allclose(there.offsets_mm[:, :, 0], cut.offsets_mm, atol=0.06)
    np.testing.assert_allclose(there.maps[:, :, 0], cut.maps, atol=0.1)
    assert np.abs(elsewhere.offsets_mm[:, :, 0] - cut.offsets_mm).max() > 0.1
    assert there.errors[:, :, 0].mean() < 0.6 * elsewhere.errors[:, :, 0].mean()
    np.testing.assert_array_equal(there.heights_mm, heights)


def test_the_search_itself_looks_where_facets_are_seen() -> None:
    """So displaced that polishing could not make up for it."""
    heights = np.random.default_rng(5).uniform(-2, 2, (3, 3))
    scene, cut = planted(heights=heights)
    found = matched(scene, heights, OPTIONS.model_copy(update={"polish": 0}))
    np.testing.assert_allclose(found.offsets_mm[:, :, 0], cut.offsets_mm, atol=0.3)


def test_rematching_finds_the_patches_of_facets_that_have_come_to_stand_high_or_low() -> None:
    heights = np.random.default_rng(5).uniform(-1, 1, (3, 3))
    scene, cut = planted(heights=heights)
    before = matched(scene)
    built = surface(scene.lens, heights[:, :, None, None], ABOVE)
    again = OPTIONS.rematch(scene, before, Assignment.pick(before, np.zeros((3, 3), int)), built, np.zeros((3, 3)))
    np.testing.assert_allclose(again.heights_mm, heights)
    np.testing.assert_allclose(again.offsets_mm[:, :, 0], cut.offsets_mm, atol=0.06)
    assert again.errors[:, :, 0].mean() < 0.6 * before.errors[:, :, 0].mean()
    assert (np.diff(np.where(np.isinf(again.errors), 9.0, again.errors), axis=-1) >= 0).all()


def test_a_facet_that_now_sees_past_the_sources_edge_keeps_its_candidates() -> None:
    lens = small_lens(3, 3.0, source=30.0)
    views = tuple(grey_view(blotches(300, 4.0), letter_f(64), eye) for eye in (LEFT_EYE, RIGHT_EYE))
    scene, small = Scene(lens, views), np.array([0.2, 0.0, 0.2])

    def offsets(right: float) -> FloatArray:
        at = np.zeros((3, 3, 2))
        at[0, 2, 0] = right
        return at

    def room(right: float) -> float:
        """Between the source's edge and what the left eye sees through the facet at the upper right."""
        seen = patches_seen(scene, assigned(offsets(right), small), np.array(LEFT_EYE))
        return float(15.0 - seen.landings_mm[0, 2, 0] - 1.5 * np.abs(seen.maps[0, 2, 0]).sum())

    offset = offsets(brentq(lambda right: room(right) - 0.05, 0.0, 8.0))
    given = choices(offset[:, :, None], np.broadcast_to(small, (3, 3, 1, 3)), np.full((3, 3, 1), 0.9))
    options = MultiViewMatcher(window="20mm", polish=0, acceptance=1.0)
    chosen = Assignment.pick(given, np.zeros((3, 3), int))
    lying, standing = (
        options.rematch(scene, given, chosen, surface(lens, h * np.ones(1)), np.zeros((3, 3))).errors[..., 0]
        for h in (0.0, 1.5)
    )
    assert (lying < 0.8).all()
    assert standing[0, 2] == np.float32(0.9)
    assert (np.delete(standing.ravel(), 2) < 0.8).all()


def test_errors_are_those_of_the_traced_lens() -> None:
    """Black and white, so that exposure does not matter; flat, as the matcher was told."""
    lens = small_lens(4, 3.0, source=50.0, microfacets=22, floor_mm=50.0, bleed_mm=1.5)
    noise, glyph = blotches(750, 6.0), letter_f(128)
    source = (noise > np.median(noise)).astype(np.float32)
    views = [grey_view(source, t, eye) for t, eye in ((glyph, LEFT_EYE), (glyph.T, RIGHT_EYE))]
    scene = Scene(lens, tuple(views))
    found = matched(scene, options=OPTIONS.model_copy(update={"acceptance": 1.0}))
    chosen = Assignment.pick(found, np.random.default_rng(0).integers(0, 16, (4, 4)))
    built = Poisson(screening=1e3, placement="steps").integrate(scene, chosen)
    assert np.abs(built.levels_mm).max() < 2e-3
    traced = facet_errors(scene, built)
    assert np.corrcoef(traced.ravel(), chosen.errors.ravel())[0, 1] > 0.98
    assert traced.mean() == pytest.approx(chosen.errors.mean(), rel=0.1)


class Slow:
    """What one eye sees of a facet, by refraction point by point and central differences; +y up."""

    def __init__(self, scene: Scene, view: View, centre: FloatArray, height: float, offset: FloatArray, m: FloatArray):
        self.lens, self.eye, self.made_for = scene.lens, view.eye_mm, scene.reference_eye_mm
        self.centre, self.height, self.offset = centre, height, offset
        self.m = m[[0, 1, 1, 2]].reshape(2, 2)
        self.normal = self.normal_at(np.zeros(2), self.lift(np.zeros(2), height))
        u, v = centre - self.made_for[:2]
        along = self.normal @ (u, v, self.lens.thickness_mm - self.made_for[2])
        self.slope = -self.normal[:2] * (self.lens.thickness_mm - self.made_for[2]) / along

    def lift(self, p: FloatArray, height: float) -> FloatArray:
        plane = np.append(self.centre + p, self.lens.thickness_mm)
        far = self.made_for[2] - self.lens.thickness_mm
        return self.made_for + np.exp(-height / far) * (plane - self.made_for)

    def surface(self, p: FloatArray) -> FloatArray:
        return self.lift(p, self.height + self.slope @ p)

    def normal_at(self, p: FloatArray, point: FloatArray) -> FloatArray:
        wanted = self.centre + self.offset + self.m @ p
        return np.array(facet_normal(self.made_for, tuple(point), tuple(wanted), slab_of(self.lens)))

    def through(self, point: FloatArray, normal: FloatArray) -> FloatArray:
        ray = (point - self.eye) / np.linalg.norm(point - self.eye)
        x, y, z = refract(*ray, *normal, self.lens.ior)
        out = refract(x, y, z, 0.0, 0.0, 1.0, 1 / self.lens.ior)
        return point[:2] - np.array([x, y]) * point[2] / z - np.array(out[:2]) * self.lens.gap_mm / out[2]

    def landing(self, p: FloatArray) -> FloatArray:
        return self.through(self.surface(p), self.normal_at(p, self.surface(p)))

    def flat_landing(self, p: FloatArray) -> FloatArray:
        return self.through(self.surface(p), self.normal)

    def place(self, p: FloatArray) -> FloatArray:
        point = self.surface(p)
        share = (self.eye[2] - self.lens.thickness_mm) / (self.eye[2] - point[2])
        return self.eye[:2] + (point[:2] - self.eye[:2]) * share


def linear(function: Callable[[FloatArray], FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Value at 0 and derivative (2, 2)."""
    step = 1e-3 * np.eye(2)
    return function(np.zeros(2)), np.stack([function(e) - function(-e) for e in step], axis=-1) / 2e-3


def bilinear(picture: FloatArray, size_mm: float, points: FloatArray) -> FloatArray:
    """Of an (H, W) picture that covers ``size_mm`` at points (..., 2) mm, +y up."""
    x, y = np.moveaxis(points, -1, 0) * len(picture) / size_mm
    middle = len(picture) / 2 - 0.5
    return map_coordinates(picture, [middle - y, middle + x], order=1, mode="nearest")


def slow_error(
    scene: Scene, options: MultiViewMatcher, facet: tuple[int, int], height: float, offset: FloatArray, m: FloatArray
) -> float:
    """Mean squared difference of display values that flat micro-facets show all eyes, and the distance term."""
    lens, pixels, total = scene.lens, 2 * options.pixels, 0.0
    at = ((np.arange(2 * pixels) + 0.5) / (2 * pixels) - 0.5) * lens.pitch_mm
    p = np.stack(np.meshgrid(at, -at), axis=-1)
    cell = lens.pitch_mm / lens.microfacets
    middles = (np.floor((p + lens.pitch_mm / 2) / cell) + 0.5) * cell - lens.pitch_mm / 2
    for view in scene.views:
        slow = Slow(scene, view, lens.facet_centres_mm()[facet], height, offset, m)
        (start, along), (place, shear), (_, flat) = map(linear, (slow.landing, slow.place, slow.flat_landing))
        light = bilinear(view.source[..., 0], lens.source_size_mm, start + middles @ along.T + (p - middles) @ flat.T)
        seen = to_display(light.reshape(pixels, 2, pixels, 2).mean(axis=(1, 3)))
        tiles = to_display(resize(view.target, (lens.facets * pixels,) * 2))[..., 0]
        here = p.reshape(pixels, 2, pixels, 2, 2).mean(axis=(1, 3))
        total += ((seen - bilinear(tiles, lens.size_mm, place + here @ shear.T)) ** 2).mean() / len(scene.views)
    m2 = (options.window.mm(lens.source_size_mm) / options.step.mm(lens.source_size_mm)) ** 2
    return total + 1 / (m2 - (offset**2).sum() / options.step.mm(lens.source_size_mm) ** 2) - 1 / m2


@pytest.mark.parametrize("gap", [0.0, 20.0])
def test_errors_are_those_of_refraction_point_by_point(gap: float) -> None:
    lens = small_lens(3, 3.0, source=40.0, microfacets=6, gap_mm=gap)
    source, eyes = blotches(600, 5.0), (LEFT_EYE, RIGHT_EYE, ABOVE)
    views = [grey_view(source, blotches(200, 8.0, seed), eye) for seed, eye in enumerate(eyes)]
    scene, heights = Scene(lens, tuple(views)), np.random.default_rng(3).uniform(-0.5, 0.5, (3, 3))
    options = OPTIONS.model_copy(update={"acceptance": 1.0})
    found = matched(scene, heights, options)
    for i, j, k in [(0, 0, 0), (1, 2, 3), (2, 1, 8), (1, 1, 15)]:
        offset, m = found.offsets_mm[i, j, k].astype(float), found.maps[i, j, k].astype(float)
        slow = slow_error(scene, options, (i, j), heights[i, j], offset, m)
        assert found.errors[i, j, k] == pytest.approx(slow, rel=1e-3)


def test_for_one_eye_it_finds_what_the_exhaustive_matcher_finds() -> None:
    scene = Scene(small_lens(4, 3.0, source=24.0), (grey_view(blotches(360, 6.0), blotches(128, 8.0, seed=3)),))
    ours, theirs = (
        kind(window="6mm", candidates=25).match(scene, np.random.default_rng(0)).errors[..., 0]
        for kind in (MultiViewMatcher, Exhaustive)
    )
    assert ours.mean() == pytest.approx(theirs.mean(), rel=0.1)
    assert np.corrcoef(ours.ravel(), theirs.ravel())[0, 1] > 0.98


def test_a_facet_whose_patches_one_of_the_eyes_cannot_see_whole_is_named() -> None:
    """Each eye alone reaches the source, but where one sees it the other looks past its edge."""
    lens = small_lens(3, 3.0, source=14.0)
    views = [grey_view(blotches(140, 4.0), letter_f(64), eye) for eye in (LEFT_EYE, RIGHT_EYE)]
    for view in views:
        assert np.isfinite(matched(Scene(lens, (view,))).errors[..., 0]).all()
    with pytest.raises(InputError, match=r"facet \(row 0, column 0\) reaches no patch.*larger source"):
        matched(Scene(lens, tuple(views)))


def test_boxes_are_as_wide_and_as_tall_as_a_patchs_pixel() -> None:
    edge = np.broadcast_to(np.arange(16) >= 8, (1, 1, 16, 16)).astype(np.float32)  # upright
    np.testing.assert_allclose(_averaged(edge, (1.0, 5.0)), to_display(edge), atol=1e-6)
    assert abs(_averaged(edge, (5.0, 1.0)) - to_display(edge)).max() > 0.05
