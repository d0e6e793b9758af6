"""What a spec may say, and what its author hears when it says something else."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft7Validator
from typer.testing import CliRunner

from magiclens.cli import app
from magiclens.config.document import read_document
from magiclens.config.load import load_spec
from magiclens.config.model import PipelineSpec
from magiclens.config.schema import json_schema
from magiclens.contract.errors import InputError
from magiclens.contract.stages import KINDS
from magiclens.images.files import write_png
from magiclens.plan.compile import load_plan
from magiclens.plan.registry import NAMED_ART, SCENARIO, STAGE, Registry
from magiclens.profiles.materials import materials
from toys import SPEC, SpecWriter

SPECS = sorted((Path(__file__).parent.parent / "specs").glob("*.yaml"))

CIRCLES = "{type: circles, seed: 7}"
GAP = ("  facets: 4", "  facets: 4\n  gap: 100")
WRONG: dict[str, tuple[tuple[str, str], str]] = {
    "bare number": (GAP, "9: lens.gap: 100 is a bare number; a length needs a unit, such as '100mm'"),
    "unknown unit": (("size: 20mm", "size: 20mn"), "7: lens.size: unknown unit 'mn' in '20mn'; a length is in mm, cm"),
    "wrong unit": (("90deg]", "90mm]"), "5: scenario.angles.1: unknown unit 'mm' in '90mm'; an angle is in deg, rad"),
    "unknown key": (("viewer:", "viewr:"), "10: viewr: unknown key; did you mean 'viewer'?"),
    "unknown key far from all": (("viewer:", "zzz:"), "10: zzz: unknown key; choose one of: fabrication, lens, medium"),
    "unknown lens key": (("facets", "facetts"), "8: lens.facetts: unknown key; did you mean 'facets'?"),
    "unknown stage option": (
        ("    sweeps", "    swepes"),
        "14: pipeline.matcher.swepes: unknown option; did you mean 'sweeps'?",
    ),
    "stage option out of range": (("sweeps: 5", "sweeps: 101"), "14: pipeline.matcher.sweeps: must be at most 100"),
    "stage option of wrong type": (
        ("sweeps: 5", "sweeps: many"),
        "14: pipeline.matcher.sweeps: expected a whole number, got 'many'",
    ),
    "stage option without unit": (
        ("sweeps: 5", "step: 1"),
        "14: pipeline.matcher.step: 1 is a bare number; a length needs a unit, such as '1mm'",
    ),
    "negative stage option": (("sweeps: 5", "step: -1mm"), "14: pipeline.matcher.step: must be more than 0mm"),
    "unknown stage": (
        ("annealer: {type: toy}", "annealer: {type: toi}"),
        "15: pipeline.annealer.type: unknown annealer 'toi'; did you mean 'toy'?",
    ),
    "unknown exporter": (
        ("exporters: [{type: toy}]", "exporters: [{type: 7}]"),
        "18: pipeline.exporters.0.type: unknown exporter 7; choose one of: toy",
    ),
    "exporter without type": (
        ("exporters: [{type: toy}]", "exporters: [{}]"),
        "18: pipeline.exporters.0.type: this key is required; choose one of: toy",
    ),
    "stage that is no mapping": (
        ("annealer: {type: toy}", "annealer: toy"),
        "15: pipeline.annealer: expected a mapping such as {type: toy}, got 'toy'",
    ),
    "exporters that are no list": (
        ("exporters: [{type: toy}]", "exporters: {type: toy}"),
        "18: pipeline.exporters: expected a list such as [a, b], got a mapping",
    ),
    "two exporters of one file": (
        ("exporters: [{type: toy}]", "exporters:\n    - {type: toy}\n    - {type: toy}"),
        "20: pipeline.exporters.1: an earlier one writes lens.toy already",
    ),
    "unknown scenario": (
        ("type: rotating", "type: rotation"),
        "2: scenario.type: unknown scenario 'rotation'; did you mean 'rotating'?",
    ),
    "no scenario type": (("  type: rotating\n", ""), "1: scenario.type: this key is required; choose one of: "),
    "no targets": (
        ("  targets: [{art: panda}, {art: bat}]\n", ""),
        "1: scenario.targets: this key is required",
    ),
    "unknown art": (
        ("{art: bat}", "{art: batt}"),
        "4: scenario.targets.1.art: unknown art 'batt'; did you mean 'bat'?",
    ),
    "missing file": (
        ("{art: bat}", "{image: gray.png}"),
        "4: scenario.targets.1.image: there is no file '{folder}/gray.png'; did you mean '{folder}/grey.png'?",
    ),
    "no picture": (
        ("{art: bat}", "{image: toy.yaml}"),
        "4: scenario.targets.1.image: '{folder}/toy.yaml' is not an image file that can be read",
    ),
    "folder for a picture": (("{art: bat}", "{image: .}"), "4: scenario.targets.1.image: '{folder}' is a folder"),
    "number for a path": (("{art: bat}", "{image: 3}"), "4: scenario.targets.1.image: expected the path of a file"),
    "neither image nor art": (("{art: bat}", "{}"), "4: scenario.targets.1: name a picture: {image: file.png}, {art"),
    "both image and art": (
        ("{art: bat}", "{image: grey.png, art: bat}"),
        "4: scenario.targets.1.art: give one of image and art, not both",
    ),
    "both image and text": (
        ("{art: bat}", "{image: grey.png, text: bat}"),
        "4: scenario.targets.1.text: give one of image and text, not both",
    ),
    "both art and text": (
        ("{art: bat}", "{text: bat, art: bat}"),
        "4: scenario.targets.1.text: give one of art and text, not both",
    ),
    "number for a text": (
        ("{art: bat}", "{text: 42}"),
        "4: scenario.targets.1.text: expected text, got 42; write it in quotes",
    ),
    "list for a text": (("{art: bat}", "{text: [a]}"), "4: scenario.targets.1.text: expected text, got a list"),
    "empty text": (("{art: bat}", "{text: ' '}"), "4: scenario.targets.1.text: the text is empty; write at least one"),
    "empty text source": ((CIRCLES, "{type: text, text: ''}"), "3: scenario.source.text: the text is empty; write"),
    "text source without text": ((CIRCLES, "{type: text}"), "3: scenario.source.text: this key is required"),
    "unknown text option": (
        (CIRCLES, "{type: text, txt: Who}"),
        "3: scenario.source.txt: unknown key; did you mean 'text'?",
    ),
    "letters that the font has not": (
        (CIRCLES, "{type: text, text: 谁}"),
        "3: scenario.source.text: the font has no '谁'; write the text in other letters",
    ),
    "a box of three": (
        (CIRCLES, "{type: text, text: Who, box: [0%, 0%, 50%]}"),
        "3: scenario.source.box: needs at least 4, has 3",
    ),
    "a box without unit": (
        (CIRCLES, "{type: text, text: Who, box: [0%, 0%, 50%, 0.5]}"),
        "3: scenario.source.box.3: 0.5 is a bare number; a share needs a unit, such as '50%'",
    ),
    "a box inside out": (
        (CIRCLES, "{type: text, text: Who, box: [90%, 0%, 10%, 50%]}"),
        "3: scenario.source.box: write left, top, right and bottom of a box inside the square, such as [10%,",
    ),
    "target that is no mapping": (
        ("{art: bat}", "bat"),
        "4: scenario.targets.1: expected a mapping such as {key: value}, got 'bat'",
    ),
    "unknown source": (
        ("type: circles", "type: cirles"),
        "3: scenario.source: unknown type 'cirles'; did you mean 'circles'?",
    ),
    "source without type": (("type: circles, ", ""), "3: scenario.source: the key 'type' is required; choose one of:"),
    "unknown source option": (("seed: 7", "sed: 7"), "3: scenario.source.sed: unknown key; did you mean 'seed'?"),
    "radius without unit": (
        ("seed: 7", "radius: [0.5, 2mm]"),
        "3: scenario.source.radius.0: 0.5 is a bare number; a length needs a unit, such as '0.5mm'",
    ),
    "radii in the wrong order": (("seed: 7", "radius: [2mm, 1mm]"), "3: scenario.source.radius: write the smallest"),
    "one radius": (("seed: 7", "radius: [2mm]"), "3: scenario.source.radius: needs at least 2, has 1"),
    "more angles than targets": (
        ("90deg]", "90deg, 180deg]"),
        "5: scenario.angles: 3 angles for 2 targets; write one angle per target",
    ),
    "no quarter turn": (
        ("90deg]", "80deg]"),
        "5: scenario.angles.1: '80deg' is no quarter turn; the nearest is '90deg'",
    ),
    "an angle twice": (("90deg]", "360deg]"), "5: scenario.angles: two targets have the same angle"),
    "five targets": (
        ("{art: bat}]", "{art: bat}, {art: owl}, {art: cat}, {art: fish}]"),
        "4: scenario.targets: takes at most 4, has 5",
    ),
    "unknown material": (
        ("size: 20mm", "material: acrilic"),
        "7: lens.material: unknown material 'acrilic'; did you mean 'acrylic'?",
    ),
    "material and ior": (
        ("size: 20mm", "material: glass\n  ior: 1.5"),
        "8: lens.ior: give a material or an ior, not both",
    ),
    "ior of nothing": (("size: 20mm", "ior: 1.0"), "7: lens.ior: must be more than 1"),
    "no facets": (("facets: 4", "facets: 0"), "8: lens.facets: must be at least 1, got 0"),
    "half a facet": (("facets: 4", "facets: 4.5"), "8: lens.facets: expected a whole number, got 4.5"),
    "true for a number": (("facets: 4", "facets: true"), "8: lens.facets: expected a whole number, got True"),
    "no thickness": (("size: 20mm", "thickness: 0mm"), "7: lens.thickness: must be at least 0.1mm, got '0mm'"),
    "a slope over the edge": (("size: 20mm", "max_slope: 90deg"), "7: lens.max_slope: must be less than 90deg"),
    "a wall wider than a facet": (
        ("size: 20mm", "size: 20mm\n  wall: 3mm"),
        "8: lens.wall: the wall is wider than half",
    ),
    "a relief through the slab": (("size: 20mm", "relief: 50mm"), "7: lens.relief: the relief would cut through"),
    "unknown cells": (("size: 20mm", "cells: eyes"), "7: lens.cells: 'eyes' is not allowed; did you mean 'eye'?"),
    "nothing where a mapping belongs": (
        ("viewer: {distance: 400mm}", "viewer:"),
        "10: viewer: expected a mapping such as {key: value}, got nothing",
    ),
    "a name that is no folder": (("scenario:", "name: a/b\nscenario:"), "1: name: 'a/b' is not allowed here"),
    "a negative seed": (("scenario:", "seed: -1\nscenario:"), "1: seed: must be at least 0, got -1"),
    "a duplicate key": (("  facets: 4", "  facets: 4\n  facets: 8"), "9: the key 'facets' appears twice"),
    "a tab": (("  facets: 4", "\tfacets: 4"), "8: a tab indents this line; YAML is indented with spaces"),
    "no YAML": (("[{art: panda}, {art: bat}]", "[{art: panda}"), "5: this is not YAML"),
    "two documents": (("viewer:", "---\nviewer:"), "10: this is not YAML: but found another document"),
    "an alias in itself": (
        ("viewer: {distance: 400mm}", "viewer: &a {x: *a}"),
        "10: '*a' is inside what it stands for",
    ),
}


@pytest.fixture
def cli(registry: Registry, monkeypatch: pytest.MonkeyPatch) -> CliRunner:
    monkeypatch.setattr(Registry, "load", lambda: registry)
    return CliRunner()


@pytest.mark.parametrize("mistake", WRONG)
def test_a_mistake_is_named_with_file_line_and_choice(
    mistake: str, cli: CliRunner, write_spec: SpecWriter, grey_png: Path
) -> None:
    replacement, expected = WRONG[mistake]
    path = write_spec(replacement)
    result = cli.invoke(app, ["check", str(path)])
    where, _, rest = expected.partition(": ") if expected[0].isdigit() else ("", "", expected)
    expected = (f"{path}:{where}: " if where else "") + rest.replace("{folder}", str(path.parent))
    assert result.exit_code == 2
    assert expected in result.stderr
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert "Traceback" not in result.output


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", ":1: the file is empty; a spec starts with a line such as 'scenario:'"),
        (b"# only a comment\n", ":1: the file is empty"),
        (b"- a\n- b\n", ":1: the file holds a list instead of a mapping"),
        (b"just text", ":1: the file holds text instead of a mapping"),
        (b"\x89PNG\r\n\x1a\n\x00\xff", ":1: this is not a text file"),
        (b"a: \x00", ":1: this is not YAML"),
        (b"[" * 700, ":1: this is nested too deeply"),
        (b"name: x\n", ":1: scenario: this key is required"),
    ],
)
def test_a_file_that_is_no_spec_is_named(content: bytes, expected: str, tmp_path: Path, registry: Registry) -> None:
    path = tmp_path / "bad.yaml"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        load_plan(path, registry=registry)
    assert f"{path}{expected}" in str(caught.value)


def test_a_spec_that_is_not_there_brings_a_similar_name(write_spec: SpecWriter) -> None:
    path = write_spec()
    with pytest.raises(InputError, match=r"there is no file .*toi.yaml'; did you mean '.*toy.yaml'"):
        load_spec(path.with_name("toi.yaml"))


def test_a_folder_is_no_spec(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="this is a folder"):
        load_spec(tmp_path)


def test_of_several_mistakes_the_first_in_the_file_is_named(write_spec: SpecWriter, registry: Registry) -> None:
    mistakes = [("{art: bat}", "{art: batt}"), ("facets: 4", "facets: 0"), ("sweeps", "swepes"), ("toy}", "toi}")]
    for mistake, line in zip(mistakes, [4, 8, 14, 15], strict=True):
        with pytest.raises(InputError, match=f"toy.yaml:{line}: "):
            load_plan(write_spec(*mistakes[mistakes.index(mistake) :]), registry=registry)


def test_a_misspelt_key_is_named_before_the_key_that_is_missing_for_it(write_spec: SpecWriter) -> None:
    with pytest.raises(InputError, match=r"toy.yaml:1: scenari: unknown key; did you mean 'scenario'"):
        load_spec(write_spec(("scenario:", "scenari:")))


def test_everything_but_the_scenario_has_a_default(tmp_path: Path) -> None:
    path = tmp_path / "my lens.v2.yaml"
    path.write_text("scenario: {type: single}\n")
    spec = load_spec(path)
    assert (spec.name, spec.seed, spec.viewer.distance) == ("my lens.v2", 0, 400.0)
    assert spec.lens.build().ior == materials()["acrylic"].ior
    assert spec.pipeline.choice("integrator", {}) == {"type": "poisson"}
    assert spec.pipeline.choice("encoder", {}) is None


@pytest.mark.parametrize(
    ("stem", "name"),
    [("größe & co", "gr--e - co"), ("..hidden", "hidden"), ("鍵", "lens"), ("._ -", "lens"), ("a_b.c-d", "a_b.c-d")],
)
def test_a_spec_without_a_name_is_called_like_its_file_but_for_what_folders_cannot_have(
    stem: str, name: str, tmp_path: Path
) -> None:
    path = tmp_path / f"{stem}.yaml"
    path.write_text("scenario: {type: single}\n")
    assert load_spec(path).name == name


def test_options_without_a_type_go_to_the_default_stage(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("scenario: {type: single}\npipeline: {matcher: {window: 5%}}\n")
    assert load_spec(path).pipeline.choice("matcher", {}) == {"type": "exhaustive", "window": "5%"}


def test_a_scenario_says_what_suits_it_and_a_spec_has_the_last_word() -> None:
    suited = {"matcher": {"type": "darts", "cuts": 2}}
    pipeline = PipelineSpec.model_validate({"matcher": {"cuts": 3}, "codesign": 1})
    assert pipeline.choice("matcher", suited) == {"type": "darts", "cuts": 3}
    assert pipeline.choice("encoder", suited) == {"type": "least-squares"}
    other = PipelineSpec.model_validate({"matcher": {"type": "exhaustive"}})
    assert other.choice("matcher", suited) == {"type": "exhaustive"}


def test_ior_takes_the_place_of_a_material(write_spec: SpecWriter) -> None:
    lens = load_spec(write_spec(("size: 20mm", "ior: 1.7"))).lens
    assert (lens.build().ior, lens.material) == (1.7, None)


@pytest.mark.parametrize(
    ("lens", "relief"),
    [
        ("{size: 20mm, facets: 4}", 5.0),
        ("{size: 100mm, facets: 4}", 15.0),
        ("{size: 200mm, facets: 4}", 20.0),
        ("{size: 100mm, facets: 4, thickness: 20mm}", 10.0),
        ("{size: 100mm, facets: 4, relief: 3mm}", 3.0),
    ],
)
def test_wide_facets_have_more_relief_up_to_half_the_thickness(lens: str, relief: float, tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(f"scenario: {{type: single}}\nlens: {lens}\n")
    assert load_spec(path).lens.relief == relief


def test_a_wall_may_take_half_a_facet_and_a_relief_nearly_the_thickness(write_spec: SpecWriter) -> None:
    assert load_spec(write_spec(), ["lens.wall=2.5mm"]).lens.wall == 2.5
    assert load_spec(write_spec(), ["lens.relief=39.99mm"]).lens.relief == 39.99
    with pytest.raises(InputError, match="less than 40mm"):
        load_spec(write_spec(), ["lens.relief=40mm"])


@pytest.mark.parametrize("wrong", ["facets: 0", "size: 0mm"])
def test_what_follows_from_a_mistake_is_no_mistake_of_its_own(wrong: str, write_spec: SpecWriter) -> None:
    given = {"size": "20mm", "facets": "1", "wall": "9mm", **dict([wrong.split(": ")])}
    lens = "lens={" + ", ".join(f"{key}: {value}" for key, value in given.items()) + "}"
    with pytest.raises(InputError, match=wrong.split(":")[0]) as raised:
        load_spec(write_spec(), [lens])
    assert raised.value.others == ()


def test_a_picture_that_is_tiny_is_refused(write_spec: SpecWriter, tmp_path: Path, registry: Registry) -> None:
    write_png(tmp_path / "dot.png", np.full((1, 1, 1), 0.5, np.float32))
    with pytest.raises(InputError, match=r"toy\.yaml:4: scenario\.targets.1.image: "):
        load_plan(write_spec(("{art: bat}", "{image: dot.png}")), registry=registry)


def test_what_is_not_in_a_spec_is_none(write_spec: SpecWriter) -> None:
    document = read_document(write_spec())
    assert document.get(("scenario", "targets", 1)) == {"art": "bat"}
    for keys in (("scenario", "targets", 2), ("scenario", "targets", "art"), ("scenario", "type", 0), ("lens", "gap")):
        assert document.get(keys) is None


def test_a_tab_that_is_allowed_is_not_blamed(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("a: [\n\tb: 1: 2]\n")
    with pytest.raises(InputError, match=r"a\.yaml:2: this is not YAML: expected ','"):
        read_document(path)


@pytest.mark.parametrize("text", ["a: 1\n\tb: 2\nc: 3\n", "a:\n\tb: 2\nc: 3\n", "a:\n  - 1\n\t- 2\n  - 3\n"])
def test_a_tab_before_anything_else_is_named_as_such(text: str, tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=rf":{text[: text.index(chr(9))].count(chr(10)) + 1}: a tab indents this line"):
        read_document(path)


@pytest.mark.parametrize(
    ("override", "keys", "value"),
    [
        ("lens.facets=64", ("lens", "facets"), 64),
        ("lens.gap=10cm", ("lens", "gap"), "10cm"),
        ("name=other", ("name",), "other"),
        ("scenario.targets.1.art=whale", ("scenario", "targets", 1, "art"), "whale"),
        ("pipeline.matcher={type: toy, sweeps: 9}", ("pipeline", "matcher", "sweeps"), 9),
        ("pipeline.exporters=[]", ("pipeline", "exporters"), []),
        ("new.deep.key=true", ("new", "deep", "key"), True),
    ],
)
def test_overrides_change_values(
    override: str, keys: tuple[str | int, ...], value: Any, write_spec: SpecWriter
) -> None:
    assert read_document(write_spec(), [override]).get(keys) == value


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("lens.facets=0", "--set lens.facets=0: lens.facets: must be at least 1, got 0"),
        ("lens.facetts=8", "--set lens.facetts=8: lens.facetts: unknown key; did you mean 'facets'?"),
        ("lens={facets: 0}", "--set lens={facets: 0}: lens.facets: must be at least 1"),
        ("scenario.targets.1.art=wale", "--set scenario.targets.1.art=wale: scenario.targets.1.art: unknown art"),
        ("scenario.targets.7.art=bat", "--set scenario.targets.7.art=bat: 'scenario.targets' is a list of 2; choose"),
        ("lens.facets.x=1", "--set lens.facets.x=1: 'lens.facets' is a number, it has no 'x'"),
        ("lens.facets", "--set lens.facets: write key.path=value, such as lens.facets=64"),
        ("=3", "--set =3: write key.path=value"),
        ("lens..facets=8", "--set lens..facets=8: write key.path=value"),
        ("lens.gap=[1", "--set lens.gap=[1:1: this is not YAML"),
        ("pipeline.matcher.swepes=3", "pipeline.matcher.swepes: unknown option; did you mean 'sweeps'?"),
    ],
)
def test_a_wrong_override_is_named(override: str, message: str, write_spec: SpecWriter, registry: Registry) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        load_plan(write_spec(), [override], registry)


def test_mistakes_in_the_file_come_before_mistakes_in_overrides(write_spec: SpecWriter, registry: Registry) -> None:
    with pytest.raises(InputError, match=r"toy\.yaml:14"):
        load_plan(write_spec(("sweeps: 5", "sweeps: 0")), ["name=a/b"], registry)


def test_an_override_is_validated_together_with_the_file(write_spec: SpecWriter, registry: Registry) -> None:
    plan = load_plan(write_spec(("size: 20mm", "ior: 1.5")), ["lens.ior=null", "lens.material=glass"], registry)
    assert plan.lens.ior == materials()["glass"].ior


def test_anchors_and_merges_are_plain_yaml(write_spec: SpecWriter) -> None:
    anchored = (("lens:\n", "lens:\n  <<: &base {gap: 5mm}\n"), ("viewer: {", "viewer: {"))
    assert load_spec(write_spec(*anchored)).lens.gap == 5.0


@pytest.fixture(scope="module")
def schema() -> dict[str, Any]:
    registry = Registry.load()
    stages = {kind: registry.classes(STAGE, kind) for kind in KINDS}
    return json_schema(registry.classes(SCENARIO), stages, registry.types(NAMED_ART))


def test_the_schema_is_draft_7_and_all_its_references_lead_somewhere(schema: dict[str, Any]) -> None:
    Draft7Validator.check_schema(schema)
    text = str(schema)
    assert "$defs" not in text
    assert "prefixItems" not in text
    for reference in re.findall(r"'\$ref': '#/([^']*)'", text):
        node: Any = schema
        for key in reference.split("/"):
            node = node[key]


@pytest.mark.parametrize("path", SPECS, ids=lambda p: p.name)
def test_the_schema_accepts_the_specs_in_the_repository(path: Path, schema: dict[str, Any]) -> None:
    assert list(Draft7Validator(schema).iter_errors(read_document(path).data)) == []


@pytest.mark.parametrize(
    ("facets", "valid"), [(1, True), (1024, True), ("auto", True), (0, False), (1025, False), ("x", False)]
)
def test_the_schema_bounds_facets_or_leaves_them_to_the_machine(
    facets: int | str, valid: bool, schema: dict[str, Any]
) -> None:
    good = {"scenario": {"type": "single", "source": {"type": "circles"}, "target": {"art": "panda"}}}
    assert Draft7Validator(schema).is_valid({**good, "lens": {"facets": facets}}) == valid


def test_the_schema_explains_what_a_plugin_fills_in_and_has_no_words_of_openapi(schema: dict[str, Any]) -> None:
    for key in ("scenario", "fabrication"):
        assert schema["properties"][key]["description"]
        assert "additionalProperties" not in schema["properties"][key]
    pipeline = schema["definitions"]["PipelineSpec"]["properties"]
    assert pipeline["matcher"]["description"] == "finds candidates for every facet"
    assert not list(beside(schema, "oneOf", "discriminator"))


def beside(node: Any, key: str, other: str) -> Iterator[Any]:
    """Mappings that have both keys."""
    if isinstance(node, dict):
        if key in node and other in node:
            yield node
        for value in node.values():
            yield from beside(value, key, other)
    if isinstance(node, list):
        for value in node:
            yield from beside(value, key, other)


def test_the_schema_asks_for_types_where_there_is_no_default(schema: dict[str, Any]) -> None:
    required = {name: found["required"] for name, found in schema["definitions"].items() if "required" in found}
    assert "type" in required["exporter-stl"]
    assert "type" in required["renderer-tracer"]
    assert "type" not in required["matcher-exhaustive"]


@pytest.mark.parametrize("path", SPECS, ids=lambda p: p.name)
def test_the_specs_in_the_repository_compile_and_read_back_resolved(path: Path) -> None:
    assert load_plan(path).spec.name == path.stem


@pytest.mark.parametrize(
    "wrong",
    [
        {"lens": {"gap": 100}},
        {"lens": {"facetts": 3}},
        {"scenario": {"type": "rotatin"}},
        {"scenario": {"type": "single", "source": {"type": "circles"}, "target": {"art": "nobody"}}},
        {"scenario": {"type": "single", "source": {"type": "circles"}, "target": {"text": 42}}},
        {"scenario": {"type": "single", "source": {"type": "circles"}, "target": {"text": "a", "art": "bat"}}},
        {"scenario": {"type": "single", "source": {"type": "text"}, "target": {"art": "bat"}}},
        {"scenario": {"type": "single", "source": {"type": "text", "text": ""}, "target": {"art": "bat"}}},
        {"scenario": {"type": "single", "source": {"type": "text", "text": "a", "box": []}, "target": {"art": "bat"}}},
        {"pipeline": {"matcher": {"type": "exhaustive", "windw": "10%"}}},
        {"pipeline": {"exporters": [{"type": "nothing"}]}},
        {"pipeline": {"exporters": [{}]}},
        {"pipeline": {"renderers": [{"resolution": 64}]}},
    ],
)
def test_the_schema_refuses_what_the_program_refuses(wrong: dict[str, Any], schema: dict[str, Any]) -> None:
    good = {"scenario": {"type": "single", "source": {"type": "circles"}, "target": {"art": "panda"}}}
    assert Draft7Validator(schema).is_valid(good)
    assert not Draft7Validator(schema).is_valid({**good, **wrong})


def test_text_is_written_in_a_spec_and_read_back_resolved(
    write_spec: SpecWriter, registry: Registry, schema: dict[str, Any]
) -> None:
    question = '{type: text, text: "Who was it?", box: [0%, 0%, 100%, 50%]}'
    path = write_spec((CIRCLES, question), ("{art: bat}", "{text: Lincoln}"))
    resolved = load_plan(path, registry=registry).resolved()["scenario"]
    assert resolved["source"] == {"type": "text", "text": "Who was it?", "box": ["0%", "0%", "100%", "50%"]}
    assert resolved["targets"] == [{"art": "panda"}, {"text": "Lincoln"}]
    assert Draft7Validator(schema).is_valid({"scenario": resolved})


def test_the_spec_of_these_tests_is_right(write_spec: SpecWriter, registry: Registry) -> None:
    assert SPEC.startswith("scenario")
    assert load_plan(write_spec(), registry=registry).lens.facets == 4
