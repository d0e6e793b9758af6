"""What a printer makes of a lens: stairs, spreading, polishing, and what that costs the picture."""

from __future__ import annotations

import gc
from typing import Any
from weakref import ref

import numpy as np
import pytest

from fabricated import LENS, bumpy, flat
from magiclens.contract.artifacts import FloatArray, HeightField, Lens, Scene, Solid
from magiclens.geometry.columns import top_heights
from magiclens.geometry.solid import solid_from_heights
from magiclens.geometry.solid import volume as volume_of
from magiclens.meshing.validation import validate
from magiclens.processes.layers import stair_slopes
from magiclens.processes.linear import LinearProcess
from magiclens.profiles.machines import Printer, machines
from magiclens.rendering.tracer import Tracer
from magiclens.simulation.as_made import as_made, rough_pictures
from magiclens.simulation.as_printed import as_printed
from scenes import blotches, grey_view

RAW = {"blur": "0mm", "polish": "0mm"}


def printer(**options: Any) -> Printer:
    """The PolyJet printer with other options."""
    profile = machines()["polyjet-600x300"]
    machine = profile.model.model_validate({**profile.options, **options})
    assert isinstance(machine, Printer)
    return machine


def heights(solid: Solid) -> FloatArray:
    """(rows, columns) z of a top."""
    assert solid.grid is not None
    return np.asarray(solid.vertices[: solid.grid[0] * solid.grid[1], 2].reshape(solid.grid))


def wedge(slope: float = 0.1) -> Solid:
    """A slab whose top rises evenly with x."""
    n, m = LENS.facets, LENS.microfacets
    within = (np.arange(m + 1) / m - 0.5) * (LENS.pitch_mm - LENS.wall_mm)
    x = LENS.facet_centres_mm()[:, :, 0, None, None] + within
    return solid_from_heights(HeightField(LENS, np.broadcast_to(slope * x, (n, n, m + 1, m + 1)), None))


@pytest.mark.parametrize("options", [RAW, {}, {"blur": "0.2mm"}])
def test_a_print_is_a_closed_body_of_the_same_volume(options: dict[str, Any]) -> None:
    solid = bumpy()
    made = as_printed(solid, printer(**options))
    findings = validate(made)
    assert findings.flaws == ()
    assert findings.metrics["bodies"] == 1
    assert volume_of(made) == pytest.approx(volume_of(solid), rel=0.02)


def test_a_body_is_made_once_for_those_who_ask_again_and_forgotten_with_its_solid() -> None:
    solid = bumpy()
    made = as_printed(solid, printer())
    assert as_printed(solid, printer()) is made
    assert as_printed(bumpy(), printer()) is not made
    rough = as_printed(solid, printer(**RAW))
    assert not np.array_equal(heights(rough), heights(made))
    forgotten, remembered = ref(made), ref(rough)
    del made, rough
    gc.collect()
    assert forgotten() is None
    assert remembered() is not None
    del solid
    gc.collect()
    assert remembered() is None


def test_raw_prints_have_whole_layers_each_half_a_layer_off_at_most() -> None:
    made = heights(as_printed(wedge(), printer(**RAW, layer="0.1mm", dpi=[508, 508])))
    np.testing.assert_allclose(made / 0.1, np.rint(made / 0.1), atol=1e-9)
    x = np.arange(made.shape[1]) * 0.05
    x -= x.mean()
    middle = made[made.shape[0] // 2]
    assert np.abs(middle - (LENS.thickness_mm + 0.1 * x)).max() <= 0.0501
    assert len(np.unique(middle)) == pytest.approx(1 / 0.1, abs=1), "a rise of 1 mm in layers of 0.1 mm"


def test_pixels_are_those_of_the_printer() -> None:
    made = as_printed(flat(), printer())
    points = made.vertices[: made.grid[0] * made.grid[1]].reshape(*made.grid, 3)  # type: ignore[index,misc]
    assert np.diff(points[0, :, 0]) == pytest.approx(25.4 / 600)
    assert np.diff(points[:, 0, 1]) == pytest.approx(-25.4 / 300)


def test_polishing_takes_the_stairs_away_and_keeps_the_slope() -> None:
    raw, even = (heights(as_printed(wedge(), printer(blur="0mm", layer="0.1mm", polish=p))) for p in ("0mm", "1mm"))
    inner = slice(even.shape[1] // 3, -even.shape[1] // 3)
    steepest = [np.abs(np.diff(z[len(z) // 2, inner])).max() for z in (raw, even)]
    pixel = 25.4 / 600
    assert steepest[0] == pytest.approx(0.1), "a whole layer from one pixel to the next"
    assert steepest[1] == pytest.approx(0.1 * pixel, rel=0.15), "the wedge's own slope"


def test_spreading_is_as_wide_as_its_sigma() -> None:
    lens = Lens(size_mm=10, source_size_mm=10, facets=2, microfacets=2, thickness_mm=8, wall_mm=1e-4)
    step = np.zeros((2, 2, 3, 3))
    step[:, 1] = 1.0
    spreading = printer(blur="0.3mm", polish="0.4mm", layer="1um")
    made = as_printed(solid_from_heights(HeightField(lens, step, None)), spreading)
    z = heights(made)[made.grid[0] // 4] - 8  # type: ignore[index]
    x = made.vertices[: len(z), 0]
    density = np.gradient(z, x)[abs(x) < 3]
    spread = np.sqrt(np.sum(density * x[abs(x) < 3] ** 2) / density.sum())
    assert spread == pytest.approx(0.5, rel=0.03), "blur and polish add as variances"


def scene_of(lens: Lens) -> Scene:
    source = blotches(256, 8)
    return Scene(lens, (grey_view(source, source, (0.0, 0.0, 108.0)),))


@pytest.mark.sweep
def test_a_very_fine_printer_costs_nothing_and_a_coarse_one_does() -> None:
    rough = bumpy(seed=1)
    scene = scene_of(LENS)
    target = Tracer(resolution=128, samples=2).render(scene, rough)[0]
    view = scene.views[0]
    scene = Scene(LENS, (grey_view(view.source[..., 0], target[..., 0], (0.0, 0.0, 108.0)),))
    fine = printer(**RAW, layer="0.1um", dpi=[2400, 2400])
    losses = [as_made(p, scene, rough).loss_db for p in (fine, printer(polish="0.1mm"), printer(polish="0.5mm"))]  # type: ignore[union-attr]
    assert losses == sorted(losses)
    assert losses[2] > losses[1] + 1
    assert losses[1] > losses[0] + 1


@pytest.mark.tools
def test_a_flat_print_shows_the_source_as_the_design_does() -> None:
    lens = Lens(size_mm=10, source_size_mm=10, facets=3, microfacets=4, thickness_mm=8.1, wall_mm=0.002)
    design = flat(lens, (0.0, 0.0, 108.1))
    made = as_made(printer(), scene_of(lens), design)
    assert made is not None
    inner = slice(20, -20)  # the rim is rounded
    wanted = Tracer().render(scene_of(lens), design)[0][inner, inner]
    assert np.abs(made.pictures[0][inner, inner] - wanted).max() < 0.02


@pytest.mark.tools
def test_a_rough_surface_blurs_what_is_seen() -> None:
    lens = Lens(size_mm=10, source_size_mm=10, facets=3, microfacets=4, thickness_mm=8, wall_mm=0.002)
    smooth, rough = (
        rough_pictures(printer(dpi=[150, 150], roughness=r), scene_of(lens), flat(lens))[0] for r in (0.0, 0.2)
    )
    assert rough.std() < 0.8 * smooth.std()


def rolling() -> Solid:
    """A slab with a smooth top that is not its own mirror image."""
    within = (np.arange(LENS.microfacets + 1) / LENS.microfacets - 0.5) * (LENS.pitch_mm - LENS.wall_mm)
    centres = LENS.facet_centres_mm()[:, :, None, None]
    x, y = centres[..., 0] + within, centres[..., 1] - within[:, None]
    return solid_from_heights(HeightField(LENS, 0.3 * np.sin(0.7 * x + 0.3) + 0.2 * np.cos(0.9 * y - 0.2), None))


def off_by(made: Solid, wanted: Solid, rim: int = 0) -> FloatArray:
    """How much higher one top is than another, without so many points at its rim."""
    points = made.vertices[: made.grid[0] * made.grid[1]].reshape(*made.grid, 3)  # type: ignore[index,misc]
    whole = points[..., 2] - top_heights(wanted, points[0, :, 0], points[:, 0, 1])
    return whole[rim : len(whole) - rim, rim : whole.shape[1] - rim]


@pytest.mark.parametrize("about", ["x", "y"])
@pytest.mark.parametrize("angle", ["25deg", "-40deg"])
def test_a_part_that_is_printed_tilted_by_fine_layers_is_as_designed(about: str, angle: str) -> None:
    made = as_printed(rolling(), printer(**RAW, layer="2um", tilt={"about": about, "angle": angle}))
    assert validate(made).flaws == ()
    assert np.abs(off_by(made, rolling())).max() < 0.004
    assert made.vertices[:, :2].max() == pytest.approx(5, abs=0.2)


def test_stairs_of_a_tilted_part_are_fine_and_polished_away() -> None:
    """A level top has no stairs while it lies flat, but a gentle wedge has wide ones."""
    solid, coarse = wedge(0.02), {"blur": "0mm", "polish": "0.15mm", "layer": "0.1mm", "dpi": [1200, 1200]}
    flat_mm, tilted_mm = (
        off_by(as_printed(solid, printer(**coarse, tilt=tilt)), solid, 20).std()
        for tilt in (None, {"about": "x", "angle": "30deg"})
    )
    assert flat_mm > 0.02
    assert tilted_mm < 0.002


def test_light_below_a_tilted_part_makes_it_thicker() -> None:
    cure = {"penetration": "0.2mm", "critical": 10, "exposure": 30}
    thin, thick = (
        heights(as_printed(flat(), printer(layer="20um", tilt={"angle": "30deg"}, cure=each))) for each in (None, cure)
    )
    grown = (0.2 * np.log(3) - 0.02) * np.cos(np.radians(30))
    assert (thick - thin).mean() == pytest.approx(grown, rel=1e-6)
    lying = (heights(as_printed(flat(), printer(layer="20um", cure=each))) for each in (None, cure))
    np.testing.assert_array_equal(*lying)


@pytest.mark.parametrize("pixel", [0.002, 0.02])
@pytest.mark.parametrize("degrees", [2.0, 5.0, 29.0])
def test_the_slopes_of_stairs_are_foreseen(degrees: float, pixel: float) -> None:
    """The formula against stairs of a wedge, blurred; coarse columns of pixels show waves that are not there."""
    rise, layer, process = np.tan(np.radians(degrees)), 0.027, LinearProcess(spread="0.08mm")
    x = np.arange(0, 40, pixel)
    off = process.of((np.rint(rise * x / layer) * layer - rise * x)[None], (pixel, pixel))[0]
    found = np.sqrt((np.gradient(off, pixel)[round(1 / pixel) : -round(1 / pixel)] ** 2).mean())
    foreseen = stair_slopes(process, layer, (pixel, pixel), np.array([rise, 0.0]))
    assert foreseen == pytest.approx(found, rel=0.06, abs=1e-3)
