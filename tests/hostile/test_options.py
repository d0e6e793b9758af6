"""Options at values that no lens can have are refused by ``mlens check``, not found out by a run."""

from __future__ import annotations

from pathlib import Path

import pytest

from magiclens.contract.errors import InputError
from magiclens.plan.compile import load_plan
from magiclens.plan.registry import Registry
from magiclens.running.feasible import require_feasible

SPEC = Path(__file__).parents[2] / "specs" / "single.yaml"
BAD = [
    "pipeline.matcher.window=0%", "pipeline.matcher.window=1um", "pipeline.matcher.step=0mm",
    "pipeline.matcher.step=1e-9mm", "pipeline.matcher.step=-1mm", "pipeline.matcher.scales=[-1.0]",
    "pipeline.matcher.scales=[0]", "pipeline.matcher.scales=[.nan]", "pipeline.matcher.scales=[1e9]",
    "lens.size=100m", "lens.size=0mm", "lens.size=1e-300mm", "lens.thickness=1e9mm", "lens.thickness=0mm",
    "lens.gap=-1mm", "lens.gap=1e300mm", "lens.wall=1e-300mm", "lens.wall=0mm", "lens.relief=0mm", "lens.relief=1e9mm",
    "lens.facets=0", "lens.facets=1e9", "lens.facets=.inf", "lens.microfacets=-1", "lens.max_slope=90deg",
    "lens.ior=1", "lens.ior=.nan", "viewer.distance=1um", "viewer.distance=1e300mm", "viewer.x=1e308mm",
    "viewer.y=-1e308mm", "scenario.source.radius=[0.0001mm, 0.0002mm]", "scenario.source.radius=[2mm, 1mm]",
    "scenario.source.size=1um", "scenario.source.size=1e9mm", "scenario.source.layers=0", "scenario.source.seed=-1",
    f"name={'x' * 300}", "name=CON", "name=nul", "name=com1.old", "name=a.", "name='a '", "seed=-1", "seed=1e300",
    "fabrication={machine: sla, lacquer: {film: 1mm, viscosity: 0.001, time: 1e5}}",
]  # fmt: skip


@pytest.fixture(scope="module")
def installed() -> Registry:
    return Registry.load()


@pytest.mark.parametrize("override", BAD, ids=[override[:60] for override in BAD])
def test_a_value_that_no_lens_can_have_is_refused_at_its_key(override: str, installed: Registry) -> None:
    key = override.split("=")[0]
    with pytest.raises(InputError) as raised:
        load_plan(SPEC, [override], installed)
    assert str(raised.value).startswith(f"--set {override}: {key}")
    assert "\n" not in str(raised.value)


FILES = {
    "{type: sl1, layer: 0.1um}": "layer: there would be",
    "{type: slices, layer: 1um, tilt: {angle: 70deg}}": "layer: there would be",
    "{type: slices, dpi_x: 10000, dpi_y: 10000}": "dpi_x: a layer would have",
    "{type: sl1, bed: [20mm, 20mm, 20mm]}": "bed: the lens has",
    "{type: heightmap, pixel: 0.1um}": "pixel: '0.0001mm' gives",
    "{type: heightmap, pixel: 1m}": "pixel: '1000mm' gives",
    "{type: monitor, ppi: 2000}": "ppi: 400 mm at 2000 ppi",
    "{type: sheet, paper: a4}": "paper: the sheet needs",
    "{type: gcode, stock: 0.1mm}": "stock: the plate of 0.1mm is thinner",
    "{type: gcode, stock: 1m}": "rougher: the cutter for roughing reaches",
    "{type: gcode, stepover: 1um}": "stepover: there would be 400,000 lines",
    "{type: rml, rough_stepover: 2um}": "rough_stepover: there would be 200,000 lines",
    "{type: rml, bed: [1mm, 1mm]}": "bed: a bed of 1mm x 1mm",
}
"""Files that cannot be, and what is said of them."""


@pytest.mark.parametrize("exporter", FILES)
def test_a_file_that_cannot_be_is_refused_before_the_run(exporter: str, installed: Registry) -> None:
    settings = ["lens.size=400mm", "lens.thickness=40mm", f"pipeline.exporters=[{exporter}]"]
    plan = load_plan(SPEC, settings, installed)
    with pytest.raises(InputError) as raised:
        require_feasible(plan)
    assert str(raised.value).startswith(f"--set {settings[-1]}: pipeline.exporters.0.{FILES[exporter]}")
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    "override", ["lens.size=1mm", "lens.size=2m", "viewer.distance=1000m", "name=con-1"]
)
def test_unusual_values_are_allowed(override: str, installed: Registry) -> None:
    load_plan(SPEC, [override, "lens.relief=0.1mm", "lens.wall=0.1um"], installed)
