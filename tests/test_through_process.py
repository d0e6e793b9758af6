"""Refinement through the process: its derivatives are right, and the lens as it is made shows more for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from magiclens.contract.artifacts import FloatArray, HeightField, Lens, Scene, View
from magiclens.contract.stages import silent
from magiclens.geometry.solid import solid_from_heights
from magiclens.images import score
from magiclens.integration.limits import limit_rises
from magiclens.integration.poisson import Poisson
from magiclens.integration.refinement import blurred
from magiclens.integration.surface_metrics import facet_slopes_deg
from magiclens.integration.through_process import (
    WholeTop,
    can_be_held,
    extended,
    extended_transposed,
    refine_through,
)
from magiclens.integration.through_process_kernels import (
    MadeRaster,
    change_of_residuals,
    finer,
    finer_transposed,
    forces_of_residuals,
    raster_slopes,
    raster_slopes_transposed,
)
from magiclens.processes.diffusion import FLOYD_STEINBERG, diffusion_weights
from magiclens.processes.layers import Grey, Slicing, layers_of_tops, tops_of
from magiclens.processes.linear import LinearProcess, raster_wavenumbers
from magiclens.profiles.machines import Printer, machines
from magiclens.rendering.tracer import Tracer
from magiclens.simulation.as_printed import as_printed
from scenes import blotches

LENS = Lens(size_mm=12.0, source_size_mm=12.0, facets=4, microfacets=12, thickness_mm=12.0, cells="vertical",
            relief_mm=2.0, bleed_mm=1.0)  # fmt: skip
PROCESS = LinearProcess(spread="0.1mm")
RNG = np.random.default_rng


def a_scene(eyes: int = 1, lens: Lens = LENS) -> Scene:
    """A source of blotches, which fade toward its border; each eye shall see other blotches."""
    source = np.stack([blotches(180, 9, seed=k) for k in range(3)], axis=-1).astype(np.float32)
    rim = np.minimum(np.arange(180) + 0.5, 179.5 - np.arange(180))
    source *= np.clip((np.minimum.outer(rim, rim) - 2) / 20, 0, 1)[..., None].astype(np.float32)
    target = np.stack([blotches(180, 5, seed=9 + k) for k in range(3)], axis=-1).astype(np.float32)
    targets = [np.ascontiguousarray(np.roll(target, 30 * k, axis=0)) for k in range(eyes)]
    places = [np.array([25.0 * k, 0.0, 112.0]) for k in range(eyes)]
    return Scene(lens, tuple(View(f"eye-{k}", source, targets[k], places[k]) for k in range(eyes)))


def a_surface(lens: Lens = LENS, seed: int = 3) -> HeightField:
    """A smooth rough top: each facet a tilted plane, with steps between them."""
    n, m = lens.facets, lens.microfacets
    tilt = RNG(seed).uniform(-0.15, 0.15, (n, n, 2, 1, 1))
    along = (np.arange(m + 1) / m - 0.5) * lens.pitch_mm
    heights = tilt[:, :, 0] * along + tilt[:, :, 1] * along[:, None]
    return HeightField(lens, heights, None)


class TestDerivatives:
    """What the kernels say about small changes is what happens."""

    @pytest.mark.parametrize("eyes", [1, 2])
    def test_residuals_change_as_foreseen(self, eyes: int) -> None:
        top = WholeTop(a_scene(eyes), a_surface(), PROCESS)
        pictures = blurred(top.pictures, 0.3)
        heights = top.heights_of(a_surface())
        before = top.show(heights, pictures)
        kept = top.gradients.copy()
        change = np.zeros_like(heights)
        change[10:30:4, 12:36:3] = 1e-3
        slopes = raster_slopes(top.made(change), top.raster.pitch)
        foreseen = change_of_residuals(slopes, top.raster, kept)
        found = top.show(heights + change, pictures) - before
        # where a pixel is nearly black its display value is not linear in small changes
        right = np.abs(found - foreseen) < 0.05 * np.abs(foreseen).max()
        assert right.mean() > 0.999
        assert np.corrcoef(found[right], foreseen[right])[0, 1] > 0.999

    def test_every_map_has_its_transpose(self) -> None:
        rng = RNG(0)
        raster = MadeRaster(-1.0, 1.0, 0.1, 5, 3, 4, 2)
        z, forces = (rng.standard_normal(s).astype(np.float32) for s in ((24, 24), (2, 24, 24)))
        assert np.vdot(raster_slopes(z, 0.1), forces) == pytest.approx(
            np.vdot(z, raster_slopes_transposed(forces, 0.1)), rel=1e-3
        )
        gradients = rng.standard_normal((4, 4, 2, 4, 4, 2)).astype(np.float32)
        r = rng.standard_normal((4, 4, 2)).astype(np.float32)
        assert np.vdot(change_of_residuals(forces, raster, gradients), r) == pytest.approx(
            np.vdot(forces, forces_of_residuals(r, raster, gradients, z.shape)), rel=1e-3
        )
        w = rng.standard_normal((9, 9)).astype(np.float32)
        assert np.vdot(finer(w, 3), z) == pytest.approx(np.vdot(w, finer_transposed(z, 3)), rel=1e-3)
        wide = extended(w, 4)
        other = rng.standard_normal(wide.shape).astype(np.float32)
        back = extended_transposed(other, 4)
        assert np.vdot(wide, other) == pytest.approx(np.vdot(w, back), rel=1e-3)

    def test_slopes_of_waves_are_exact(self) -> None:
        x = np.arange(40) * 0.07
        z = np.sin(6 * x)[None, :] * np.ones((40, 1)) - np.cos(5 * x)[:, None]
        slopes = raster_slopes(z.astype(np.float32), 0.07)[:, 4:-4, 4:-4]
        x = x[4:-4]
        np.testing.assert_allclose(slopes[0], np.broadcast_to(6 * np.cos(6 * x), (32, 32)), atol=0.01)
        # rows run down, so the slope along +y has the other sign
        np.testing.assert_allclose(slopes[1], np.broadcast_to(-5 * np.sin(5 * x)[:, None], (32, 32)), atol=0.01)

    def test_a_finer_raster_has_the_triangles_of_the_grid(self) -> None:
        w = RNG(1).standard_normal((3, 3)).astype(np.float32)
        fine = finer(w, 4)
        assert fine[2, 2] == pytest.approx((w[0, 0] + w[1, 1]) / 2, abs=1e-6)  # cut from top left to bottom right
        assert fine[0, 2] == pytest.approx((w[0, 0] + w[0, 1]) / 2, abs=1e-6)


class TestRefinement:
    """The lens as it is made."""

    def made_psnr_db(self, scene: Scene, built: HeightField, slicing: str = "diffused") -> float:
        """PSNR of the lens as a printer with this process makes it."""
        profile = machines()["sla"]
        options = {**profile.options, "blur": "0.1mm", "polish": "0mm", "slicing": slicing}
        printer = profile.model.model_validate(options)
        assert isinstance(printer, Printer)
        seen = Tracer(resolution=128, samples=3).render(scene, as_printed(solid_from_heights(built), printer))
        return float(np.mean([score(s, v.target).psnr_db for s, v in zip(seen, scene.views, strict=True)]))

    @pytest.mark.tools
    @pytest.mark.parametrize("eyes", [1, 2])
    def test_it_shows_more_as_made(self, eyes: int) -> None:
        scene, start = a_scene(eyes), a_surface()
        refined = refine_through(scene, start, PROCESS, silent)
        assert self.made_psnr_db(scene, refined) > self.made_psnr_db(scene, start) + 3

    def test_its_own_forecast_is_what_the_tracer_sees(self) -> None:
        scene = a_scene()
        refined = refine_through(scene, a_surface(), PROCESS, silent)
        top = WholeTop(scene, refined, PROCESS)
        residuals = top.show(top.heights_of(refined), top.pictures)
        foreseen_db = -10 * np.log10(np.mean(residuals**2))
        assert self.made_psnr_db(scene, refined) == pytest.approx(foreseen_db, abs=1.0)

    def test_limits_hold_and_no_step_is_left(self) -> None:
        lens = replace(LENS, relief_mm=0.25, max_slope_deg=20.0)
        refined = refine_through(a_scene(lens=lens), a_surface(lens), PROCESS, silent)
        assert np.abs(refined.heights_mm).max() <= 0.25
        assert facet_slopes_deg(refined.facet_points_mm()).max() <= 20.0 + 0.1
        assert refined.metrics["step_max_mm"] == pytest.approx(0, abs=1e-9)

    @pytest.mark.tools
    def test_equal_inputs_give_equal_heights_and_progress_ascends(self) -> None:
        told: list[float] = []
        one, other = (refine_through(a_scene(), a_surface(), PROCESS, t) for t in (told.append, silent))
        assert np.array_equal(one.heights_mm, other.heights_mm)
        assert told == sorted(told)
        assert 0 <= told[0] <= told[-1] <= 1

    def test_two_steps_in_turn_that_help_little_are_the_last(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Every step lowers the error by less than nine tenths, and not by less than a ten-thousandth."""
        scene, start = a_scene(), a_surface()
        for enough, taken in ((0.9, 2), (1e-4, 4)):
            monkeypatch.setattr("magiclens.integration.through_process.ENOUGH", enough)
            told: list[float] = []
            top = WholeTop(scene, start, PROCESS)
            top.descend(top.heights_of(start), 0.25, 4, 0.3, told.append)
            assert told == pytest.approx([(k + 1) / 4 for k in range(taken)])

    @pytest.mark.parametrize("spread", ["0.05mm", "0.1mm", "0.4mm"])
    def test_the_raster_goes_on_as_far_as_the_process_carries(self, spread: str) -> None:
        process = LinearProcess(spread=spread)
        raster = WholeTop(a_scene(), a_surface(), process).raster
        margin = raster.first * raster.pitch
        assert process.reach_mm <= margin < 3 * process.reach_mm + 1.0
        assert -raster.left == pytest.approx(LENS.size_mm / 2 + margin)
        assert raster.top == pytest.approx(LENS.size_mm / 2 + margin)

    def test_heights_are_moved_into_the_relief_before_they_are_cut(self) -> None:
        top = WholeTop(a_scene(), a_surface(), PROCESS)
        ramp = np.linspace(0, 1, 49, dtype=np.float32) * np.ones((49, 1), np.float32)
        for low, high, least, most in ((1.5, 2.5, 1.0, 2.0), (-2.5, -1.5, -2.0, -1.0), (0.5, 1.5, 0.5, 1.5)):
            allowed = top._allowed(low + (high - low) * ramp)
            assert (allowed.min(), allowed.max()) == pytest.approx((least, most), abs=1e-5)

    @pytest.mark.tools
    def test_the_integrator_uses_it_for_vertical_cells_alone(self) -> None:
        scene, start = a_scene(), a_surface()
        options = {"process": {"spread": "0.1mm"}, "refinement": 1}
        refined = Poisson.model_validate(options).refine(scene, start)
        assert np.array_equal(refined.heights_mm, refine_through(scene, start, PROCESS, silent).heights_mm)
        eye = replace(start, eye_mm=np.array([0.0, 0.0, 112.0]))
        assert Poisson.model_validate(options).refine(scene, eye).metrics["step_max_mm"] > 0

    def test_a_process_that_hardly_rounds_is_left_to_single_facets(self) -> None:
        large = replace(LENS, facets=150, size_mm=450.0, source_size_mm=450.0)
        assert can_be_held(LENS, PROCESS)
        assert not can_be_held(LENS, LinearProcess())
        assert not can_be_held(large, PROCESS), "1800 vertices along a side are no raster for waves of 0.17 mm"
        raw = Poisson.model_validate({"process": {}, "refinement": 1}).refine(a_scene(), a_surface())
        assert raw.metrics["step_max_mm"] > 0

    def test_there_is_a_raster_for_every_size_of_cells(self) -> None:
        """What is a seventh of a cell asked for a raster seven times as fine, which no margin makes fast."""
        lens = replace(LENS, facets=2, microfacets=7)
        widest = lens.pitch_mm / lens.microfacets / LinearProcess(spread="1mm").finest_mm
        for times in range(1, 18):
            process = LinearProcess(spread=f"{widest / times}mm")
            top = WholeTop(a_scene(lens=lens), a_surface(lens), process)
            assert top.raster.pitch <= 1.001 * process.finest_mm

    def test_rises_are_limited_alike_on_both_sides(self) -> None:
        heights = np.zeros((6, 6), np.float32)
        heights[:, 3:] = 1.0
        limited = limit_rises(heights, 0.3)
        assert np.abs(np.diff(limited, axis=1)).max() <= 0.3 * 1.001
        assert limited.mean() == pytest.approx(heights.mean(), abs=1e-6)
        assert np.array_equal(limit_rises(heights, 1.0), heights)


class TestLinearProcess:
    """What is left of waves."""

    def test_a_wave_keeps_the_share_that_is_foreseen(self) -> None:
        pitch, wavelength = 0.02, 0.8
        x = (np.arange(400) + 0.5) * pitch
        wave = np.cos(2 * np.pi * x / wavelength) * np.ones((400, 1))
        for process in (LinearProcess(spread="0.1mm"), LinearProcess(levelling="0.7mm", spread="0.05mm")):
            share = float(process.kept(np.array(2 * np.pi / wavelength)))
            left = process.of(wave, (pitch, pitch))[200:-100, 100:-100]
            assert np.abs(left).max() == pytest.approx(share, rel=0.01)

    def test_a_film_leaves_1_e_of_its_wavelength_and_the_mean(self) -> None:
        film = LinearProcess(levelling="1.08mm")
        assert float(film.kept(np.array(2 * np.pi / 1.08))) == pytest.approx(np.exp(-1))
        z = RNG(0).uniform(1, 2, (50, 60))
        assert film.of(z, (0.1, 0.2)).mean() == pytest.approx(z.mean())

    @pytest.mark.parametrize(
        "options", [{"spread": "0.1mm"}, {"levelling": "1mm"}, {"spread": "0.1mm", "levelling": "1mm"}]
    )
    def test_of_the_finest_waves_little_is_left(self, options: dict[str, str]) -> None:
        process = LinearProcess.model_validate(options)
        assert float(process.kept(np.array(np.pi / process.finest_mm))) == pytest.approx(1e-3)

    def test_pixels_may_be_oblong(self) -> None:
        waves = raster_wavenumbers((10, 20), (0.5, 0.25))
        assert waves[0, 1] == pytest.approx(np.pi / 10)
        assert waves[1, 0] == pytest.approx(np.pi / 2.5)


class TestLayers:
    """How heights become layers."""

    def ramp(self) -> FloatArray:
        """A gentle slope, which plain rounding turns into wide stairs."""
        return np.broadcast_to(10 + 0.01 * np.arange(300) * 0.05, (200, 300)).astype(np.float32)

    def test_each_column_is_less_than_two_layers_off(self) -> None:
        z = self.ramp()
        for slicing, most in (("plain", 0.501), ("diffused", 1.5)):
            assert np.abs(tops_of(z, 0.025, slicing) - z / 0.025).max() <= most  # type: ignore[arg-type]

    def test_diffused_stairs_are_gone_after_a_blur(self) -> None:
        z, process = self.ramp(), LinearProcess(spread="0.15mm")
        layers = [tops_of(z, 0.025, "plain"), tops_of(z, 0.025, "diffused")]
        made = [process.of(each * 0.025, (0.05, 0.05))[20:-20, 20:-20] for each in layers]
        slopes = [np.diff(each, axis=1) / 0.05 for each in made]
        plain, diffused = (float(np.sqrt(np.mean((s - 0.01) ** 2))) for s in slopes)
        assert diffused < plain / 4

    @pytest.mark.parametrize("name", ["sla", "lcd-12k", "polyjet-600x300", "polyjet-matte"])
    def test_what_is_known_of_the_process_leaves_less_of_the_layers(self, name: str) -> None:
        printer = machines()[name].machine()
        assert isinstance(printer, Printer)
        process, pixels, layer = printer.linear_process, printer.pixels_mm, printer.layer
        across = np.linspace(0, 1, 400)
        z = 10 + 0.5 * across**2 - across * across[:, None]
        weights = diffusion_weights(process, pixels)
        tops = [tops_of(z, layer, "diffused", weights=each) * layer for each in (FLOYD_STEINBERG, weights)]
        inner = slice(60, -60)
        left = [process.of(each - z, pixels)[inner, inner] for each in tops]
        steep = [float(np.hypot(*np.gradient(each, *pixels[::-1])).std()) for each in left]
        assert steep[1] < 0.5 * steep[0]
        assert abs(left[1].mean()) < 0.02 * layer
        assert np.abs(tops[1] - z).max() < 2.5 * layer

    def test_where_nothing_is_evened_out_errors_go_to_the_nearest(self) -> None:
        assert diffusion_weights(LinearProcess(), (0.1, 0.1)) is FLOYD_STEINBERG

    def test_nothing_is_put_beside_the_body(self) -> None:
        z = self.ramp().copy()
        z[:, :40] = 0.0
        assert not tops_of(z, 0.025, "diffused")[:, :40].any()

    @pytest.mark.parametrize("slicing", ["plain", "diffused"])
    def test_grey_comes_nearer_than_whole_layers(self, slicing: Slicing) -> None:
        z, shares = self.ramp(), Grey(bits=3).shares
        near = layers_of_tops(tops_of(z, 0.025, slicing, shares), shares) * 0.025
        far = layers_of_tops(tops_of(z, 0.025, slicing)) * 0.025
        assert np.abs(near - z).mean() < 0.5 * np.abs(far - z).mean()
        assert near.mean() == pytest.approx(z.mean(), abs=2e-4)

    def test_heights_of_tops_have_these_tops(self) -> None:
        shares = Grey(bits=4).shares
        tops = np.arange(1, 300, dtype=np.int32).reshape(13, 23)
        for slicing in ("plain", "diffused"):
            heights = (layers_of_tops(tops, shares) + 1e-4) * 0.05
            assert np.array_equal(tops_of(heights, 0.05, slicing, shares), tops)  # type: ignore[arg-type]

    def test_too_little_light_cures_nothing(self) -> None:
        values, shares = Grey(bits=3).steps()
        assert values.tolist() == [0, 146, 182, 219]  # 1/7 to 3/7 of full exposure give nothing
        assert shares[0] == 0.0
        assert np.all(np.diff(shares) > 0)
        assert shares[-1] < 1.0

    @pytest.mark.parametrize("growth", [[[0.5, 0.1], [1, 1]], [[0.5, 0], [0.4, 0.5], [1, 1]], [[0.5, 0], [1, 0.9]], []])
    def test_growth_rises_from_nothing_to_a_layer(self, growth: list[list[float]]) -> None:
        with pytest.raises(ValidationError, match="must rise from no height"):
            Grey.model_validate({"growth": growth})
