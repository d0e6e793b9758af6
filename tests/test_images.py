"""Colour, files, resampling, scores and generated sources."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from skimage.metrics import structural_similarity as reference_similarity

from magiclens.contract.artifacts import FloatArray
from magiclens.contract.errors import InputError
from magiclens.images import (
    COLOURED,
    art,
    circles,
    grey,
    luminance,
    padded_to_square,
    read_image,
    resize,
    score,
    to_display,
    to_linear,
    write_png,
)
from magiclens.images.likeness import likeness, resolved_px, word_for
from magiclens.images.resample import pixels_touching
from magiclens.images.score_kernels import structural_similarity


def noise(*shape: int) -> FloatArray:
    return np.random.default_rng(1).uniform(0, 1, shape).astype(np.float32)


# Colour


def test_display_values_survive_the_way_to_light_and_back() -> None:
    values = np.linspace(0, 1, 256)
    assert np.allclose(to_display(to_linear(values)), values, atol=1e-7)


@pytest.mark.parametrize(("display", "light"), [(0.0, 0.0), (0.04, 0.04 / 12.92), (0.5, 0.21404114), (1.0, 1.0)])
def test_the_curve_is_srgb(display: float, light: float) -> None:
    assert to_linear(np.array([display]))[0] == pytest.approx(light, abs=1e-8)


def test_what_is_outside_the_range_is_clipped() -> None:
    outside = np.array([-0.5, 1.5])
    assert to_linear(outside) == pytest.approx([0, 1])
    assert to_display(outside) == pytest.approx([0, 1])


def test_equal_channels_become_one_and_a_single_coloured_pixel_keeps_three() -> None:
    image = np.repeat(noise(4, 5, 1), 3, axis=2)
    assert grey(image).shape == (4, 5, 1)
    image[2, 3, 0] += 0.01
    assert grey(image).shape == (4, 5, 3)


def test_green_is_the_brightest_primary_and_white_has_luminance_one() -> None:
    assert np.argmax(luminance(np.eye(3)[None])) == 1
    assert luminance(np.ones((2, 2, 3))) == pytest.approx(1.0)
    assert luminance(np.full((2, 2, 1), 0.3)) == pytest.approx(0.3)


# Files


def saved(image: Image.Image, path: Path, **options: object) -> FloatArray:
    image.save(path, **options)  # type: ignore[arg-type]
    return read_image(path)


def test_orientation_row_zero_is_the_top_and_column_zero_the_left(tmp_path: Path) -> None:
    light = np.zeros((3, 4, 3), np.float32)
    light[0, 3] = (1, 0, 0)
    write_png(tmp_path / "a.png", light)
    assert Image.open(tmp_path / "a.png").getpixel((3, 0)) == (255, 0, 0)
    assert np.array_equal(read_image(tmp_path / "a.png"), light)


def test_a_written_picture_is_read_back_within_one_level(tmp_path: Path) -> None:
    light = noise(20, 30, 3)
    write_png(tmp_path / "a.png", light)
    back = read_image(tmp_path / "a.png")
    assert back.dtype == np.float32
    assert np.abs(to_display(back) - to_display(light)).max() < 0.51 / 255


def test_equal_pixels_give_equal_bytes_without_a_time(tmp_path: Path) -> None:
    for name in "ab":
        write_png(tmp_path / name, noise(9, 9, 3))
    data = (tmp_path / "a").read_bytes()
    assert data == (tmp_path / "b").read_bytes()
    assert b"tIME" not in data
    assert b"tEXt" not in data


def test_a_grey_picture_is_stored_and_read_with_one_channel(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", np.full((2, 3, 3), 0.5))
    assert Image.open(tmp_path / "a.png").mode == "L"
    assert read_image(tmp_path / "a.png").shape == (2, 3, 1)


def test_a_picture_can_know_its_size_on_paper(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", np.ones((2, 2, 1)), px_per_mm=15)
    assert Image.open(tmp_path / "a.png").info["dpi"][0] == pytest.approx(381, abs=0.1)


def test_half_transparent_black_lets_half_of_the_papers_light_through(tmp_path: Path) -> None:
    light = saved(Image.new("RGBA", (2, 2), (0, 0, 0, 128)), tmp_path / "a.png")
    assert light == pytest.approx(1 - 128 / 255, abs=1e-6)


@pytest.mark.parametrize("mode", ["LA", "RGBA"])
def test_what_is_fully_transparent_is_white(tmp_path: Path, mode: str) -> None:
    assert saved(Image.new(mode, (2, 2), 0), tmp_path / "a.png").tolist() == [[[1.0]] * 2] * 2


def test_sixteen_bit_greys_keep_their_fine_steps(tmp_path: Path) -> None:
    values = np.array([[0, 32768, 32769, 65535]], np.uint16)
    light = saved(Image.fromarray(values), tmp_path / "a.png")
    assert light.shape == (1, 4, 1)
    assert to_display(light)[0, :, 0] == pytest.approx(values[0] / 65535, abs=1e-6)
    assert light[0, 1, 0] < light[0, 2, 0]


def test_palette_one_bit_and_cmyk_files_are_understood(tmp_path: Path) -> None:
    red = Image.new("RGB", (4, 4), (255, 0, 0))
    assert saved(red.quantize(4), tmp_path / "p.png")[0, 0].tolist() == [1, 0, 0]
    assert saved(Image.new("1", (4, 4), 1), tmp_path / "1.png")[0, 0].tolist() == [1]
    assert saved(Image.new("CMYK", (8, 8), (0, 255, 255, 0)), tmp_path / "c.tif")[0, 0].tolist() == [1, 0, 0]


def test_a_transparent_palette_entry_is_paper(tmp_path: Path) -> None:
    image = Image.new("P", (2, 1), 0)
    image.putpalette([0, 0, 0, 0, 0, 255])
    image.putpixel((1, 0), 1)
    assert saved(image, tmp_path / "a.png", transparency=0)[0].tolist() == [[1, 1, 1], [0, 0, 1]]


def test_a_photograph_held_sideways_is_turned_upright(tmp_path: Path) -> None:
    image = Image.fromarray(np.array([[255, 0, 0]], np.uint8))
    exif = Image.Exif()
    exif[0x0112] = 6  # the camera's top is the picture's right
    assert saved(image, tmp_path / "a.png", exif=exif)[:, 0, 0].tolist() == [1, 0, 0]


def truncated(folder: Path) -> Path:
    write_png(folder / "whole.png", noise(64, 64, 3))
    (folder / "cut.png").write_bytes((folder / "whole.png").read_bytes()[:3000])
    return folder / "cut.png"


def text(folder: Path) -> Path:
    (folder / "notes.png").write_text("not a picture")
    return folder / "notes.png"


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda folder: folder / "none.png", "there is no image file"),
        (lambda folder: folder, "folder"),
        (text, "not an image"),
        (truncated, "cannot be read"),
    ],
)
def test_a_file_that_cannot_be_read_is_named_in_one_sentence(
    tmp_path: Path, make: Callable[[Path], Path], words: str
) -> None:
    path = make(tmp_path)
    with pytest.raises(InputError, match=words) as caught:
        read_image(path)
    assert repr(str(path)) in str(caught.value)
    assert "\n" not in str(caught.value)


# Resampling


def test_shrinking_averages_light_not_display_values() -> None:
    stripes = np.tile(np.array([0.0, 1.0], np.float32), (8, 4))[..., None]
    assert resize(stripes, (4, 4)) == pytest.approx(0.5)


def test_shrinking_takes_the_exact_area_of_cut_pixels() -> None:
    row = np.array([0.0, 0.9, 0.3], np.float32)[None, :, None]
    assert resize(row, (1, 2))[0, :, 0] == pytest.approx([0.3, (0.45 + 0.3) / 1.5])


@pytest.mark.parametrize("shape", [(1, 1), (7, 11), (36, 5)])
def test_shrinking_keeps_the_amount_of_light(shape: tuple[int, int]) -> None:
    image = noise(37, 41, 3)
    small = resize(image, shape)
    assert small.shape == (*shape, 3)
    assert small.dtype == np.float32
    assert small.mean((0, 1)) == pytest.approx(image.mean((0, 1)), abs=1e-5)


def test_enlarging_never_leaves_the_range_and_keeps_plain_areas_plain() -> None:
    edge = np.zeros((8, 8, 3), np.float32)
    edge[:, 4:] = 1
    large = resize(edge, (40, 40))
    assert large.min() == 0
    assert large.max() == 1
    assert large[:, 0] == pytest.approx(0)
    assert large[:, -1] == pytest.approx(1)
    assert resize(np.full((3, 3, 1), 0.3), (10, 10)) == pytest.approx(0.3, abs=1e-6)


def test_each_axis_is_shrunk_or_enlarged_on_its_own() -> None:
    ramp = np.linspace(0, 1, 12, dtype=np.float32)[:, None, None] * np.ones((1, 3, 1), np.float32)
    out = resize(ramp, (4, 9))
    assert out.shape == (4, 9, 1)
    assert out[:, 0, 0] == pytest.approx(ramp[:, 0, 0].reshape(4, 3).mean(1), abs=1e-6)


def test_the_same_shape_changes_nothing() -> None:
    image = noise(5, 6, 3)
    assert np.array_equal(resize(image, (5, 6)), image)


def test_a_wide_picture_is_centred_on_white_paper() -> None:
    out = padded_to_square(np.zeros((2, 6, 3), np.float32))
    assert out.shape == (6, 6, 3)
    assert out[:, 0, 0].tolist() == [1, 1, 0, 0, 1, 1]


# Scores


def test_a_picture_scores_full_marks_against_itself() -> None:
    result = score(noise(32, 32, 3), noise(32, 32, 3))
    assert result.psnr_db == pytest.approx(120)
    assert result.ssim == pytest.approx(1)
    assert result.gain == pytest.approx(1)


def test_structural_similarity_is_that_of_scikit_image() -> None:
    rng = np.random.default_rng(0)
    wanted = rng.random((40, 57))
    seen = np.clip(wanted + rng.normal(0, 0.2, wanted.shape), 0, 1)
    seen[:15] = wanted[:12] = 1.0
    expected = reference_similarity(seen, wanted, data_range=1.0)
    assert structural_similarity(seen, wanted) == pytest.approx(expected, abs=1e-12)


def test_exposure_does_not_count() -> None:
    result = score(0.25 * noise(32, 32, 1), noise(32, 32, 1))
    assert result.gain == pytest.approx(4)
    assert result.psnr_db > 100


def test_psnr_is_of_display_values() -> None:
    target = np.full((16, 16, 1), 0.5)
    target[:8] = to_linear(np.array(0.6))
    render = target.copy()
    render[::2] = to_linear(to_display(render[::2]) + 0.1)
    result = score(render, target)
    gained = to_display(render * result.gain) - to_display(target)
    assert result.psnr_db == pytest.approx(10 * np.log10(1 / np.mean(gained**2)))
    assert result.gain == pytest.approx((render * target).sum() / (render**2).sum())


def test_the_target_is_resized_to_the_render_in_linear_light() -> None:
    checks = np.indices((64, 64)).sum(0)[..., None] % 2
    assert score(np.full((32, 32, 1), 0.5), checks.astype(np.float32)).psnr_db > 100


def test_a_grey_target_and_its_colour_copy_score_alike() -> None:
    render, target = noise(24, 24, 3), noise(24, 24, 1) * 0.5
    one, three = score(render, target), score(render, np.repeat(target, 3, axis=2))
    assert one == three


def test_more_noise_scores_less() -> None:
    target = resize(noise(8, 8, 1), (64, 64))
    scores = [score(np.clip(target + k * (noise(64, 64, 1) - 0.5), 0, 1), target) for k in (0.05, 0.2, 0.8)]
    assert scores[0].psnr_db > scores[1].psnr_db > scores[2].psnr_db
    assert scores[0].ssim > scores[1].ssim > scores[2].ssim


def test_a_black_render_is_scored_without_dividing_by_zero() -> None:
    assert score(np.zeros((16, 16, 1)), np.ones((16, 16, 1))).psnr_db == pytest.approx(0)


# Sources


def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def test_the_same_seed_drops_the_same_discs() -> None:
    assert np.array_equal(circles(20, 15, rng()), circles(20, 15, rng()))
    assert not np.array_equal(circles(20, 15, rng()), circles(20, 15, np.random.default_rng(8)))


def test_about_half_of_the_source_is_dark_and_edges_are_smooth() -> None:
    source = circles(60, 15, rng())
    assert source.shape == (900, 900, 1)
    assert source.dtype == np.float32
    assert 0.4 < source.mean() < 0.6
    assert 0.01 < ((source > 0.02) & (source < 0.98)).mean() < 0.1


def test_the_source_has_large_plain_patches_of_both_kinds_and_fine_structure() -> None:
    source = circles(60, 15, rng())
    patches = source.reshape(30, 30, 30, 30).swapaxes(1, 2).reshape(900, 900)  # 2 mm each
    assert (patches.max(1) < 0.01).sum() > 20
    assert (patches.min(1) > 0.99).sum() > 20
    assert (patches.std(1) > 0.35).mean() > 0.3


def test_a_lone_disc_has_its_true_area() -> None:
    shares = [1 - circles(10, 15, np.random.default_rng(k), (0.8, 0.8), ((0.0,),), 0.015).mean() for k in range(60)]
    assert max(shares) == pytest.approx(np.pi * 0.8**2 / 100, rel=0.01)


def test_the_spacing_of_pixels_does_not_move_the_discs() -> None:
    fine, coarse = circles(30, 20, rng()), circles(30, 10, rng())
    assert np.abs(resize(fine, (300, 300)) - coarse).mean() < 0.01


def test_coloured_discs_use_the_whole_palette() -> None:
    source = circles(40, 5, rng(), colours=COLOURED)
    assert source.shape == (200, 200, 3)
    for ink in COLOURED:
        assert (np.abs(source - np.array(ink, np.float32)).max(2) < 1e-3).mean() > 0.03


def test_importing_the_package_loads_nothing_heavy() -> None:
    heavy = {"scipy", "numba", "matplotlib", "skimage", "PIL"}
    code = "import sys, magiclens.images; print(' '.join(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not heavy & set(loaded)


@pytest.mark.parametrize("sides", [(6, 6), (6, 3), (6, 4), (4, 6), (5, 50), (50, 7)])
def test_a_mask_on_another_raster_covers_all_that_it_covered(sides: tuple[int, int]) -> None:
    old, new = sides
    mask = np.random.default_rng(3).random((old, old)) < 0.2
    found = pixels_touching(mask, (new, new))
    fine = np.kron(mask, np.ones((new, new), bool))  # so fine that both rasters divide it
    expected = fine.reshape(new, old, new, old).any(axis=(1, 3))
    np.testing.assert_array_equal(found, expected)


def test_a_picture_is_like_itself_at_any_exposure_and_size() -> None:
    target = art("panda", 200)
    assert likeness(target, target) == pytest.approx(1)
    assert likeness(0.4 * target, target) == pytest.approx(1, abs=1e-6)
    assert likeness(resize(target, (64, 64)), target) > 0.8


def test_what_is_finer_than_the_eye_resolves_does_not_count() -> None:
    target = resize(art("panda", 400), (400, 400))
    dither = target * np.where(np.indices((400, 400)).sum(axis=0) % 2, 0.2, 1.0)[..., None].astype(np.float32)
    assert likeness(dither, target, 200) > likeness(dither, target) + 0.02
    assert likeness(dither, target, 200) > 0.99


def test_a_shape_that_only_its_colours_show_is_lost_without_them() -> None:
    heart = art("heart", 180)[..., :1] > 0.5
    red, green = (np.array(colour, np.float32) for colour in ((1, 0, 0), (0, 0.2126 / 0.7152, 0)))
    target = np.where(heart, green, red)
    assert likeness(target, target) == pytest.approx(1)
    assert word_for(likeness(luminance(target)[..., None], target)) == "lost"
    assert word_for(likeness(np.where(heart, red, green), target)) == "lost"
    assert word_for(likeness(0.8 * target + 0.2 * noise(180, 180, 1), target)) in ("recognisable", "clear")


def test_colours_of_a_grey_target_are_errors_and_those_of_a_coloured_one_count() -> None:
    panda = art("panda", 180)
    coloured = panda * np.array([1.0, 0.5, 0.2], np.float32)
    assert likeness(coloured, panda) < 0.99
    assert 0.84 < likeness(panda, coloured) < 0.99, "a bold shape is clear without its colours, and not perfect"
    assert likeness(coloured[..., ::-1].copy(), coloured) < likeness(panda, coloured)


def test_an_eye_resolves_one_arc_minute() -> None:
    assert resolved_px(100, 100 / np.tan(np.radians(1 / 60))) == pytest.approx(1)
    assert resolved_px(50, 300) == pytest.approx(573, abs=1)


def test_a_target_without_contrast_has_a_likeness_too() -> None:
    grey_paper = np.full((180, 180, 1), 0.5, np.float32)
    assert likeness(grey_paper, grey_paper) == pytest.approx(1)
