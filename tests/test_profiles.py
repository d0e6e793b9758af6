"""Machines and materials: every entry is complete, and what a machine cannot do is not designed."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft7Validator
from pydantic import ValidationError
from ruamel.yaml import YAML

from magiclens.config.fabrication import listed_machine
from magiclens.config.schema import json_schema
from magiclens.contract.errors import InputError
from magiclens.contract.stages import KINDS
from magiclens.plan.compile import Plan, load_plan
from magiclens.plan.describe import describe_plan
from magiclens.plan.registry import NAMED_ART, SCENARIO, STAGE, Registry
from magiclens.profiles.machines import Machine, Mill, Printer, machines, refused_machines
from magiclens.profiles.materials import Material, materials

SPEC = """\
scenario: {type: single, source: {type: circles}, target: {art: panda}}
lens: {size: 30mm, facets: 8}
fabrication:
  machine: milling
pipeline:
  exporters: [{type: stl}]
"""

Loader = Any


@pytest.fixture
def load(tmp_path: Path) -> Loader:
    """Loads the spec above with replacements made in its text, and --set overrides."""

    def loaded(*overrides: str, replace: tuple[str, str] = ("", "")) -> Plan:
        path = tmp_path / "made.yaml"
        path.write_text(SPEC.replace(*replace, 1))
        return load_plan(path, overrides)

    return loaded


@pytest.mark.parametrize("name", ["acrylic", "photopolymer", "photopolymer-sla", "glass", "pdms", "polycarbonate"])
def test_every_material_says_where_its_index_is_from(name: str) -> None:
    material = materials()[name]
    assert re.search(r"1\.[345]\d+", material.source), "the source has the number that was found there"
    nearest = min((float(n) for n in re.findall(r"1\.\d+", material.source)), key=lambda n: abs(n - material.ior))
    assert material.ior == pytest.approx(nearest, abs=0.01)
    assert 0.9 < material.density < 3
    assert material.price > 0


@pytest.mark.parametrize("name", machines())
def test_every_machine_makes_a_lens_without_further_ado(name: str, load: Loader) -> None:
    plan = load(replace=("milling", name))
    profile = machines()[name]
    assert plan.fabrication.machine == profile.machine()
    assert plan.lens.ior == materials()[profile.lens["material"]].ior
    assert plan.lens.max_slope_deg <= plan.fabrication.machine.max_slope
    assert f"machine  {name}: {profile.title}" in describe_plan(plan)


def test_the_polyjet_printer_is_the_one_of_the_paper() -> None:
    machine = machines()["polyjet-600x300"].machine()
    assert isinstance(machine, Printer)
    assert (machine.dpi, machine.layer) == ((600, 300), 0.027)
    assert machine.pixels_mm == pytest.approx((0.04233, 0.08467), abs=1e-5)


def test_a_mill_gets_walls_with_draft(load: Loader) -> None:
    plan = load()
    assert (plan.lens.cells, plan.lens.wall_mm) == ("eye", 0.03)
    assert plan.lens.thickness_mm + plan.lens.relief_mm <= 40
    options = plan.integrator.stage.model_dump()
    assert options["placement"] == "steps"
    assert options["step_limit"] == pytest.approx(0.03 / 0.26795, rel=1e-3), "a wall of 15 degrees draft"
    wider = load("lens.wall=0.1mm", "fabrication.draft=45deg").integrator.stage.model_dump()
    assert wider["step_limit"] == pytest.approx(0.1, rel=1e-6)


def test_a_spec_has_the_last_word_on_stages(load: Loader) -> None:
    plan = load("pipeline.integrator={step_limit: 0.01mm}", "pipeline.annealer={type: metropolis}")
    assert plan.integrator.stage.model_dump()["step_limit"] == 0.01
    assert plan.integrator.stage.model_dump()["placement"] == "steps"
    assert plan.annealer.stage.type == "metropolis"


def test_what_a_scenario_needs_comes_before_what_suits_a_machine(load: Loader) -> None:
    views = "scenario={type: multi-view, source: {type: circles}, views: [{target: {art: bat}, eye: {tilt: 10deg}}]}"
    plan = load(views)
    assert plan.matcher.stage.type == "multi-view"
    options = plan.annealer.stage.model_dump()
    assert (options["screening"], options["step_weight"]) == (1e-3, 1.0)


@pytest.mark.parametrize(("machine", "weight"), [("sla", 1e-5), ("lcd-12k", 1e-5), ("milling", 1.0)])
def test_sheets_are_painted_for_the_steps_that_a_printer_rounds_off_but_a_mill_cannot_make_any(
    machine: str, weight: float, load: Loader
) -> None:
    universal = "scenario={type: universal-animation, frames: {art: worm, length: 2}}"
    plan = load(universal, replace=("milling", machine))
    assert plan.annealer.stage.model_dump()["step_weight"] == weight
    assert (plan.integrator.stage.model_dump()["process"] is None) == (machine == "milling")
    alone = load(replace=("milling", machine))
    assert alone.annealer.stage.model_dump()["step_weight"] == (1.0 if machine == "milling" else 0.02)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "lens.thickness=35mm",
            "lens.thickness: a relief of 9.9mm makes it 44.9mm high; milling makes at most 40mm, "
            "so at most 30.1mm here",
        ),
        ("lens.thickness=12mm", "lens.thickness: at its thinnest the lens would be 2.1mm; milling needs at least 10mm"),
        ("lens.max_slope=50deg", "lens.max_slope: milling can do 45deg at most, got 50deg"),
        ("lens.wall=1um", "lens.wall: milling can do 0.03mm at least, got 0.001mm"),
        ("lens.mark=true", "lens.mark: milling cuts the top alone, so it leaves no mark at the foot; nearest: false"),
        ("lens.facets=20", "lens.facets: facets of 1.5mm are below the 2mm of milling; at most 15 fit"),
        ("lens={size: 250mm, facets: 32}", "lens.size: milling can do 200mm at most, got 250mm"),
        ("lens.relief=11mm", "lens.relief: the top may be 22mm deep, the cutter of milling reaches 20mm; at most 10mm"),
        ("fabrication.machine=miling", "fabrication.machine: unknown machine 'miling'; did you mean 'milling'?"),
        ("fabrication.layer=20um", "fabrication.layer: unknown key; choose one of: angle, bed, cutter"),
        ("fabrication.tipp=20um", "fabrication.tipp: unknown key; did you mean 'tip'?"),
        ("fabrication.reach=10", "fabrication.reach: 10 is a bare number; a length needs a unit, such as '10mm'"),
        ("fabrication={tip: 1mm}", "fabrication.machine: this key is required; choose one of: diamond-turning, "),
        ("fabrication=milling", "fabrication: expected a mapping such as {machine: printing}, got 'milling'"),
        ("fabrication.thickness=[9mm, 8mm]", "fabrication.thickness: goes from thin to thick, such as [8mm, 9mm]"),
        ("fabrication.feed=fast", "fabrication.feed: 'fast' is not allowed here; it must match"),
    ],
)
def test_what_a_machine_cannot_do_is_named_with_its_limit(override: str, message: str, load: Loader) -> None:
    with pytest.raises(InputError, match=re.escape(f"--set {override}: {message}")):
        load(override)


@pytest.mark.parametrize(
    "lens",
    [
        "{thickness: 30mm, relief: 10mm}",
        "{thickness: 15mm, relief: 5mm}",
        "{max_slope: 45deg, wall: 0.03mm}",
        "{size: 30mm, facets: 15}",
        "{size: 200mm, facets: 32}",
    ],
)
def test_what_a_machine_can_just_do_is_allowed(lens: str, load: Loader) -> None:
    """The mill makes 10 to 40 mm, slopes of 45 degrees, facets of 2 mm on a bed of 200 mm; its cutter reaches 20 mm."""
    load(f"lens={lens}")


def test_a_lens_fits_on_the_bed_whatever_the_height_of_the_machine(load: Loader) -> None:
    load("lens={size: 100mm, facets: 8}", "fabrication.bed=[120mm, 110mm, 50mm]")
    with pytest.raises(InputError, match=r"lens\.size: milling can do 110mm at most, got 115mm"):
        load("lens={size: 115mm, facets: 8}", "fabrication.bed=[120mm, 110mm, 300mm]")


def test_a_machine_that_a_command_names_is_found_or_named() -> None:
    assert listed_machine("milling", "--machine") is machines()["milling"]
    with pytest.raises(InputError, match=r"--machine: unknown machine 'miling'; did you mean 'milling'\?"):
        listed_machine("miling", "--machine")
    with pytest.raises(InputError, match=r"--machine: (?!unknown)"):
        listed_machine(next(iter(refused_machines())), "--machine")


def test_a_cutter_that_is_short_or_blunt_makes_a_flatter_lens(load: Loader) -> None:
    plan = load("fabrication.reach=10mm", "fabrication.angle=120deg")
    assert (plan.lens.relief_mm, plan.lens.max_slope_deg) == (4.95, 30)


def test_a_limit_that_a_file_breaks_is_named_with_its_line(load: Loader) -> None:
    with pytest.raises(InputError, match=r"made.yaml:2: lens.wall: milling can do 0.03mm"):
        load(replace=("facets: 8", "facets: 8, wall: 1um"))


SPREAD = {"spread": 0.087727, "levelling": 0.0}
"""What the sla profile evens out: blur and polish together."""
REST = {"process": SPREAD, "tilt": None}


def test_options_of_a_machine_can_be_changed(load: Loader) -> None:
    plan = load("fabrication={machine: sla, layer: 50um, price: 99}", "pipeline.exporters=[{type: slices}]")
    assert (plan.fabrication.machine.layer, plan.fabrication.machine.price) == (0.05, 99)
    wanted = {"dpi_x": 1016.0, "dpi_y": 1016.0, "layer": 0.05, "slicing": "diffused", "grey": None, **REST}
    assert plan.exporters[0].stage.model_dump() == wanted


def test_an_exporters_own_options_come_before_the_machines(load: Loader) -> None:
    plan = load("fabrication={machine: sla}", "pipeline.exporters=[{type: slices, dpi_x: 300}]")
    wanted = {"dpi_x": 300.0, "dpi_y": 1016.0, "layer": 0.025, "slicing": "diffused", "grey": None, **REST}
    assert plan.exporters[0].stage.model_dump() == wanted


@pytest.mark.parametrize(
    ("exporters", "written", "slicing"),
    [
        ("[{type: stl}]", "", "plain"),
        ("[{type: stl}, {type: slices}]", "", "diffused"),
        ("[{type: slices}]", ", slicing: plain", "plain"),
        ("[{type: stl}]", ", slicing: diffused", "diffused"),
    ],
)
def test_layers_are_diffused_where_slices_are_our_own(exporters: str, written: str, slicing: str, load: Loader) -> None:
    plan = load(f"fabrication={{machine: sla{written}}}", f"pipeline.exporters={exporters}")
    assert plan.fabrication.machine.slicing == slicing
    assert [s.stage.slicing for s in plan.exporters if s.stage.type == "slices"] in ([], [slicing])


@pytest.mark.parametrize(
    ("name", "files", "slicing"),
    [
        ("sla", ["stl", "3mf", "sheet"], "plain"),
        ("polyjet-600x300", ["stl", "3mf", "slices", "sheet"], "diffused"),
        ("lcd-12k", ["stl", "3mf", "sl1", "sheet"], "diffused"),
        ("diamond-turning", ["stl", "heightmap", "sheet"], None),
        ("egx-600", ["stl", "rml", "sheet"], None),
    ],
)
def test_a_spec_that_names_no_files_has_those_that_its_machine_reads(
    name: str, files: list[str], slicing: str | None, load: Loader
) -> None:
    plan = load(f"fabrication={{machine: {name}}}", replace=("pipeline:\n  exporters: [{type: stl}]\n", ""))
    assert [step.stage.type for step in plan.exporters] == files
    assert [choice["type"] for choice in plan.resolved()["pipeline"]["exporters"]] == files
    assert getattr(plan.fabrication.machine, "slicing", None) == slicing
    bare = load("fabrication=null", replace=("pipeline:\n  exporters: [{type: stl}]\n", ""))
    assert [step.stage.type for step in bare.exporters] == ["stl"]


def test_facets_follow_from_what_the_process_rounds(load: Loader) -> None:
    machine = "fabrication={machine: sla, polish: 0mm, lacquer: {film: %s}}"
    lens = ("lens.size=100mm", "lens.facets=auto")
    thin, thick = (load(machine % film, *lens).lens for film in ("5um", "20um"))
    assert 8 <= thick.facets < thin.facets < 40
    assert thick.relief_mm > thin.relief_mm == 5.0  # wide facets need more
    milled = load("fabrication={machine: milling}", *lens).lens
    assert milled.pitch_mm > 2.0  # the smallest facet that this mill makes


def test_a_mistake_of_the_machine_is_the_only_one_where_it_would_choose_the_facets(load: Loader) -> None:
    both = "fabrication={machine: sla, lacquer: {film: 20um, wavelength: 1mm}}"
    with pytest.raises(InputError, match=r"fabrication.lacquer: needs either") as caught:
        load(both, "lens.facets=auto")
    assert not caught.value.others


def test_auto_facets_need_a_machine(load: Loader) -> None:
    with pytest.raises(InputError, match=r"lens.facets: auto needs fabrication.machine"):
        load("fabrication=null", "lens.facets=auto")


def test_printers_of_filament_are_refused_with_the_reason(load: Loader) -> None:
    with pytest.raises(InputError, match=r"fabrication.machine: a printer that melts filament cannot .*lcd-12k"):
        load("fabrication.machine=fdm")


def test_profiles_say_what_is_estimated() -> None:
    """Every profile has numbers that nobody has measured, and says which."""
    generic = {"printing", "milling"}
    assert {name for name, each in machines().items() if "estimate" not in each.source} == generic | {"egx-600"}


def test_light_cures_as_deep_as_jacobs_says(load: Loader) -> None:
    cure = "cure: {penetration: 0.2mm, critical: 10, exposure: 27.1828}"
    flat = load(f"fabrication={{machine: sla, layer: 50um, {cure}}}").fabrication.machine
    assert flat.cure.depth_mm == pytest.approx(0.2, rel=1e-5)
    assert flat.growth_mm == 0.0
    tilted = load(f"fabrication={{machine: sla, layer: 50um, {cure}, tilt: {{angle: 60deg}}}}").fabrication.machine
    assert tilted.growth_mm == pytest.approx((0.2 - 0.05) / 2, rel=1e-5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("cure: {penetration: 0.2mm, critical: 10, exposure: 9}", "fabrication.cure: an exposure of 9 mJ/cm2 cures"),
        ("cure: {penetration: 0.2mm, critical: 10}", "fabrication.cure.exposure: "),
        ("tilt: {angle: 80deg}", "fabrication.tilt.angle: must be at most 75deg"),
        ("tilt: {about: z}", "fabrication.tilt.about: "),
    ],
)
def test_what_no_printer_does_is_refused(options: str, message: str, load: Loader) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        load(f"fabrication={{machine: sla, {options}}}")


def test_slices_stand_as_the_machine_makes_them(load: Loader) -> None:
    plan = load("fabrication={machine: sla, tilt: {about: y, angle: 20deg}}", "pipeline.exporters=[{type: slices}]")
    assert plan.exporters[0].stage.tilt == plan.fabrication.machine.tilt
    assert load("fabrication={machine: sla}", "pipeline.exporters=[{type: slices}]").exporters[0].stage.tilt is None


def test_archives_for_a_screen_have_the_machines_grey(load: Loader) -> None:
    plan = load("fabrication.machine=lcd-12k", "pipeline.exporters=[{type: sl1}]")
    exporter = plan.exporters[0].stage
    assert (exporter.slicing, exporter.grey.bits) == ("diffused", 3)
    assert exporter._screen() == (11520, 5120)


def test_a_printed_lens_is_refined_through_its_process(load: Loader) -> None:
    plan = load("fabrication={machine: sla, blur: 0.03mm, polish: 0.04mm}")
    assert plan.lens.cells == "vertical"
    assert plan.integrator.stage.process.spread == pytest.approx(0.05)
    assert plan.lens.bleed_mm > 6 * 0.05  # where the machine rounds the body's edge off


def test_a_lens_that_is_cut_along_eye_rays_keeps_its_facets(load: Loader) -> None:
    assert load("fabrication={machine: sla}", "lens.cells=eye").integrator.stage.process is None


def test_a_thick_coat_levels_longer_waves(load: Loader) -> None:
    # Orchard's equation by hand: 33 mN/m, 1 Pa s, 10 s
    waves = {"5um": 0.38, "20um": 1.08, "50um": 2.15}
    for film, wavelength in waves.items():
        machine = load(f"fabrication={{machine: sla, lacquer: {{film: {film}}}}}").fabrication.machine
        assert machine.linear_process.levelling == pytest.approx(wavelength, abs=0.01)


@pytest.mark.parametrize("kind", ["gcode", "rml"])
def test_programs_for_mills_are_for_the_machines_cutter(kind: str, load: Loader) -> None:
    plan = load("fabrication.tip=0.15mm", "fabrication.spindle=9000", f"pipeline.exporters=[{{type: {kind}}}]")
    options = plan.exporters[0].stage.model_dump()
    assert (options["cutter"]["shape"], options["cutter"]["tip"]) == ("v", 0.15)
    assert options["spindle"] == 9000


def test_an_index_given_in_the_spec_replaces_the_machines_material(load: Loader) -> None:
    assert load("lens.ior=1.6").lens.ior == 1.6
    assert load("lens.material=glass").lens.ior == 1.523
    assert load("lens.ior=null").lens.ior == 1.49


def test_a_resolved_spec_has_the_machine_with_every_option_and_gives_the_same_plan(
    load: Loader, tmp_path: Path
) -> None:
    plan = load("fabrication.tip=0.1mm")
    resolved = plan.resolved()
    assert resolved["fabrication"]["machine"] == "milling"
    assert (resolved["fabrication"]["tip"], resolved["fabrication"]["reach"]) == ("0.1mm", "20mm")
    assert None not in resolved["fabrication"].values()  # what the machine does not have is left out
    YAML().dump(resolved, tmp_path / "again.yaml")
    again = load_plan(tmp_path / "again.yaml")
    assert (again.resolved(), again.lens, again.fabrication) == (resolved, plan.lens, plan.fabrication)


def test_without_a_machine_nothing_changes(load: Loader) -> None:
    plan = load(replace=("fabrication:\n  machine: milling\n", ""))
    assert plan.fabrication is None
    assert "fabrication" not in plan.resolved()
    assert (plan.lens.cells, plan.lens.wall_mm, plan.lens.max_slope_deg) == ("eye", 0.0005, 60.0)


@pytest.fixture(scope="module")
def schema() -> dict[str, Any]:
    registry = Registry.load()
    stages = {kind: registry.classes(STAGE, kind) for kind in KINDS}
    return json_schema(registry.classes(SCENARIO), stages, registry.types(NAMED_ART))


@pytest.mark.parametrize(
    ("fabrication", "valid"),
    [
        ({"machine": "milling"}, True),
        ({"machine": "sla", "layer": "50um", "dpi": [300, 300]}, True),
        ({"machine": "milling", "layer": "50um"}, False),
        ({"machine": "mil"}, False),
        ({"layer": "50um"}, False),
    ],
)
def test_the_schema_knows_machines(fabrication: dict[str, Any], valid: bool, schema: dict[str, Any]) -> None:
    spec = {"scenario": {"type": "single", "source": {"type": "circles"}, "target": {"art": "panda"}}}
    assert Draft7Validator(schema).is_valid({**spec, "fabrication": fabrication}) is valid


@pytest.mark.parametrize("model", [Material, Printer, Mill])
def test_entries_are_checked(model: type[Material] | type[Machine]) -> None:
    with pytest.raises(ValidationError, match="Field required"):
        model.model_validate({})
    with pytest.raises(ValidationError, match="Extra inputs"):
        model.model_validate({"colour": "blue"})
