"""Mitsuba's pictures of lenses whose refraction has a closed form.

Sources are colour ramps: red grows with x, green with y, blue is 1 everywhere. Whatever a pixel loses to reflection,
red / blue and green / blue still tell which source point it sees.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from magiclens.contract.artifacts import FloatArray, Lens, Scene, Solid, View
from magiclens.contract.errors import StageError
from magiclens.rendering import variants
from magiclens.rendering.mitsuba import SMALLEST_GAP_MM, Mitsuba

SIZE, SOURCE, THICK, DISTANCE, IOR = 100.0, 300.0, 40.0, 400.0, 1.49
ABOVE = (0.0, 0.0, THICK + DISTANCE)
ASIDE = (120.0, -60.0, THICK + DISTANCE)
PIXELS = 20
PIXEL_MM = SIZE / PIXELS
BOX_FACES = np.array(
    [
        [[3, 1, 0], [2, 3, 0]],
        [[5, 7, 4], [7, 6, 4]],
        [[5, 4, 0], [1, 5, 0]],
        [[6, 7, 2], [7, 3, 2]],
        [[4, 6, 0], [6, 2, 0]],
        [[7, 5, 1], [3, 7, 1]],
    ],
    np.int32,
).reshape(12, 3)


def prism(slope_x: float = 0.0, slope_y: float = 0.0) -> Solid:
    """A slab whose top is the plane z = THICK + slope_x * x + slope_y * y."""
    corners = np.array([(x, y) for z in (1, 0) for y in (1, -1) for x in (-1, 1)], float) * SIZE / 2
    z = np.where(np.arange(8) < 4, THICK + corners @ [slope_x, slope_y], 0.0)
    return Solid(np.column_stack([corners, z]), BOX_FACES)


def ramps(pixels: int = 256) -> FloatArray:
    """(pixels, pixels, 3): red and green are the source's x and y from 0 to 1, blue is 1."""
    centres = (np.arange(pixels) + 0.5) / pixels
    red, green = np.meshgrid(centres, centres[::-1])
    return np.stack([red, green, np.ones_like(red)], axis=-1).astype(np.float32)


def picture(
    solid: Solid,
    source: FloatArray,
    eye: tuple[float, float, float] = ABOVE,
    rotation: float = 0.0,
    gap: float = 0.0,
    source_size: float = SOURCE,
    **options: Any,
) -> FloatArray:
    """What Mitsuba shows of one view."""
    view = View("view", source, source, np.array(eye), rotation)
    lens = Lens(size_mm=SIZE, source_size_mm=source_size, thickness_mm=THICK, gap_mm=gap, ior=IOR)
    settings = {"variant": "scalar_rgb", "resolution": PIXELS, "samples": 256, **options}
    return Mitsuba(**settings).render(Scene(lens, (view,)), solid)[0]


def seen_points(
    solid: Solid, eye: tuple[float, float, float] = ABOVE, rotation: float = 0.0, gap: float = 0.0
) -> FloatArray:
    """(R, R, 2): the source point that each pixel shows by light that goes straight through, mm, +y up."""
    return points_shown(picture(solid, ramps(), eye, rotation, gap, max_depth=3))


def points_shown(image: FloatArray) -> FloatArray:
    """(R, R, 2): the source points whose colours a picture of ``ramps`` shows; black pixels count as its corner."""
    return (image[..., :2] / np.maximum(image[..., 2:], 1e-6) - 0.5) * SOURCE


def plane_points() -> FloatArray:
    """(R, R, 3): the pixels' centres on the reference plane, row 0 at +y."""
    c = ((np.arange(PIXELS) + 0.5) / PIXELS - 0.5) * SIZE
    x, y = np.meshgrid(c, -c)
    return np.stack([x, y, np.full_like(x, THICK)], axis=-1)


def snell(direction: FloatArray, normal: FloatArray, eta: float) -> FloatArray:
    """Unit directions behind a surface whose unit normal faces the incoming light."""
    cosine = -(direction @ normal)[..., None]
    return direction / eta + (cosine / eta - np.sqrt(1 - (1 - cosine**2) / eta**2)) * normal


def turned(points: FloatArray, degrees: float) -> FloatArray:
    """Points turned counter-clockwise about z."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    x, y = points[..., 0], points[..., 1]
    return np.stack([c * x - s * y, s * x + c * y, *np.moveaxis(points[..., 2:], -1, 0)], axis=-1)


def refracted_points(
    slope: tuple[float, float] = (0.0, 0.0),
    eye: tuple[float, float, float] = ABOVE,
    rotation: float = 0.0,
    gap: float = 0.0,
) -> FloatArray:
    """(R, R, 2): where the rays through the pixels meet the source, by Snell's law at a prism's two planes.

    NaN where one of the slab's sides is in the way.
    """
    eye_in_lens, pixel = turned(np.array(eye), -rotation), turned(plane_points(), -rotation)
    direction = pixel - eye_in_lens
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    upright = np.array([-slope[0], -slope[1], 1.0])
    height = (np.array([0, 0, THICK]) - pixel) @ upright
    top = pixel + direction * (height / (direction @ upright))[..., None]
    inside = snell(direction, upright / np.linalg.norm(upright), IOR)
    bottom = top - inside * (top[..., 2:] / inside[..., 2:])
    below = snell(inside, np.array([0.0, 0.0, 1.0]), 1 / IOR)
    end = bottom - below * (max(gap, SMALLEST_GAP_MM) / below[..., 2:])
    outermost = np.maximum(np.abs(top), np.abs(bottom))[..., :2].max(axis=-1)
    end[outermost > SIZE / 2 - PIXEL_MM] = np.nan
    return turned(end, rotation)[..., :2]


def largest_miss(seen: FloatArray, expected: FloatArray) -> float:
    """Largest distance (mm) along an axis, over the pixels for which something is expected."""
    assert np.isfinite(expected).mean() > 0.5
    return float(np.nanmax(np.abs(seen - expected)))


@pytest.mark.parametrize("gap", [0.0, 60.0])
@pytest.mark.parametrize("eye", [ABOVE, ASIDE])
def test_flat_slab_shows_the_source_shifted_by_perspective(eye: tuple[float, float, float], gap: float) -> None:
    seen = seen_points(prism(), eye, gap=gap)
    assert largest_miss(seen, refracted_points(eye=eye, gap=gap)) < 0.2


def test_straight_below_an_eye_a_slab_moves_nothing() -> None:
    eye = (17.5, -22.5, THICK + DISTANCE)
    seen = seen_points(prism(), eye)
    assert seen[14, 13] == pytest.approx(eye[:2], abs=0.1)


@pytest.mark.parametrize("rotation", [0.0, 90.0, 180.0, 270.0])
@pytest.mark.parametrize("eye", [ABOVE, ASIDE])
def test_prism_bends_rays_by_snells_law_at_every_rotation(eye: tuple[float, float, float], rotation: float) -> None:
    seen = seen_points(prism(0.2, -0.1), eye, rotation)
    assert largest_miss(seen, refracted_points((0.2, -0.1), eye, rotation)) < 0.2


def test_quarter_turn_moves_what_points_to_plus_x_to_plus_y() -> None:
    shift = [seen_points(prism(0.2), rotation=r) - plane_points()[..., :2] for r in (0.0, 90.0)]
    along_x, along_y = (s[5:-5, 5:-5].mean(axis=(0, 1)) for s in shift)
    assert along_x[0] > 2
    assert abs(along_x[1]) < 0.1
    assert along_y == pytest.approx([-along_x[1], along_x[0]], abs=0.1)


def test_row_zero_is_plus_y_and_column_zero_is_minus_x() -> None:
    source = np.zeros((64, 64, 3), np.float32)
    source[:32, :32] = 1.0
    seen = picture(prism(), source)[..., 0]
    half = PIXELS // 2
    assert seen[: half - 1, : half - 1].min() > 0.8
    assert seen[half + 1 :].max() < 0.05
    assert seen[:, half + 1 :].max() < 0.05


def test_mirrored_lens_source_and_eye_show_the_mirrored_picture() -> None:
    solid = prism(0.2, 0.1)
    mirror_image = Solid(solid.vertices * [-1, 1, 1], solid.faces[:, ::-1])
    x, y, z = ASIDE
    one = picture(solid, ramps(), ASIDE, max_depth=3)
    other = picture(mirror_image, ramps()[:, ::-1], (-x, y, z), max_depth=3)
    expected = np.where(np.isfinite(refracted_points((0.2, 0.1), ASIDE)), points_shown(one), np.nan)
    assert largest_miss(points_shown(other), expected[:, ::-1]) < 0.3


def test_slab_transmits_what_fresnel_leaves() -> None:
    reflected = ((IOR - 1) / (IOR + 1)) ** 2
    through = (1 - reflected) / (1 + reflected)
    brightness = picture(prism(), ramps())[8:-8, 8:-8, 2].mean()
    assert brightness == pytest.approx(through, abs=0.004)


def test_source_brighter_than_one_stays_so() -> None:
    dim, bright = (picture(prism(), gain * ramps()) for gain in (1.0, 5.0))
    assert bright == pytest.approx(5 * dim, rel=1e-5)


def test_pixels_outside_the_source_are_black() -> None:
    seen = picture(prism(), ramps(), source_size=SIZE / 2)[..., 2]
    assert seen[:3].max() == 0
    assert seen[PIXELS // 2, PIXELS // 2] > 0.8


def test_grey_source_gives_one_channel() -> None:
    colour = picture(prism(0.2), ramps())
    grey = picture(prism(0.2), ramps()[..., :1])
    assert grey.shape == (PIXELS, PIXELS, 1)
    assert grey == pytest.approx(colour[..., :1], abs=1e-5)


def test_equal_seeds_give_equal_pictures_and_others_do_not() -> None:
    one, same, other = (picture(prism(0.2), ramps(), seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


def test_solid_is_rendered_as_a_float32_file_holds_it() -> None:
    exact = prism(0.2)
    shifted = Solid(exact.vertices + np.array([1e-7, -1e-7, 0]), exact.faces)
    rounded = Solid(exact.vertices.astype(np.float32).astype(float), exact.faces)
    assert np.array_equal(picture(shifted, ramps(), rotation=90.0), picture(rounded, ramps(), rotation=90.0))


def test_rough_surface_blurs_what_lies_below_and_keeps_most_light() -> None:
    source = np.zeros((64, 64, 1), np.float32)
    source[:, 32:] = 1.0
    smooth, rough = (
        picture(prism(), source, roughness=r, resolution=100, samples=16)[..., 0].mean(axis=0) for r in (0.0, 0.1)
    )
    assert smooth[47] < 0.02
    assert 0.05 < rough[47] < 0.45
    assert rough[20] < 0.02
    assert rough.mean() == pytest.approx(smooth.mean(), rel=0.06)


def test_pictures_come_in_the_order_of_the_views_and_progress_ends_at_one() -> None:
    sources = (ramps(), 0.5 * ramps(100))
    views = tuple(View(str(k), source, source, np.array(ABOVE)) for k, source in enumerate(sources))
    scene = Scene(Lens(source_size_mm=SOURCE), views)
    told: list[float] = []
    settings = Mitsuba(variant="scalar_rgb", samples=4, resolution=4)
    first, second = settings.render(scene, prism(), told.append)
    assert told == [0.5, 1.0]
    assert second.mean() == pytest.approx(first.mean() / 2, rel=0.1)


def test_sample_counts_are_powers_of_four() -> None:
    assert Mitsuba(samples=256).samples == 256
    with pytest.raises(ValidationError, match="power of four; the nearest are 16 and 64"):
        Mitsuba(samples=32)


class TestVariants:
    """The choice of a variant. Libraries are tried in a child process since the wrong ones abort theirs."""

    def test_library_that_cannot_be_loaded_leaves_scalar(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "libno-such-library.so")
        assert variants.installed_libraries() == ["libno-such-library.so"]
        found = variants.first_working(variants.installed_libraries())
        assert variants.usable_variant("auto", lambda: found) == "scalar_rgb"

    def test_library_that_aborts_its_process_does_not_work(self) -> None:
        assert variants.first_working(["any"], probe="import os; os.abort()") is None

    def test_asking_for_llvm_without_one_says_what_to_do(self) -> None:
        with pytest.raises(StageError, match="install LLVM 17 or newer, or name its library in DRJIT_LIBLLVM_PATH"):
            variants.usable_variant("llvm_ad_rgb", lambda: None)

    def test_first_library_that_works_is_used(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "")
        probe = "import sys; sys.exit(sys.argv[2] == 'bad')"
        found = variants.first_working(["bad", "good", "better"], probe=probe)
        assert variants.usable_variant("auto", lambda: found) == "llvm_ad_rgb"
        assert os.environ["DRJIT_LIBLLVM_PATH"] == "good"

    def test_a_gpu_is_used_if_it_is_asked_for_and_works(self) -> None:
        probe = "import sys; sys.exit(sys.argv[1:] != ['cuda_ad_rgb', 'driver'])"
        found = variants.first_working(["driver"], "cuda_ad_rgb", probe)
        assert variants.usable_variant("cuda_ad_rgb", find_gpu=lambda: found) == "cuda_ad_rgb"
        assert variants.usable_variant("auto", lambda: None, find_gpu=lambda: found) == "scalar_rgb"

    def test_asking_for_a_gpu_without_one_says_what_to_do(self) -> None:
        found = variants.first_working(["libno-such-driver.so"], "cuda_ad_rgb")
        with pytest.raises(StageError, match="an NVIDIA GPU and a driver with OptiX; 'variant: auto' needs neither"):
            variants.usable_variant("cuda_ad_rgb", find_gpu=lambda: found)

    def test_scalar_needs_no_library(self) -> None:
        assert variants.usable_variant("scalar_rgb", lambda: pytest.fail("searched")) == "scalar_rgb"


@pytest.mark.tools
def test_llvm_shows_what_scalar_shows() -> None:
    assert variants.working_llvm(), "no LLVM that Mitsuba works with: apt install libllvm19"
    scalar, compiled = (picture(prism(0.2), ramps(), variant=v) for v in ("scalar_rgb", "auto"))
    assert np.abs(compiled - scalar)[2:-2, 2:-2].max() < 0.1
    assert compiled.mean() == pytest.approx(scalar.mean(), rel=0.01)
    assert np.array_equal(compiled, picture(prism(0.2), ramps(), variant="auto"))
