"""Preflight sees what is wrong with the files that were exported, names the facet, and is right about sound ones."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import tracemalloc
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest
from typer.testing import CliRunner

from fabricated import bumpy, flat
from magiclens.cli import app
from magiclens.contract.artifacts import FloatArray, HeightField, Lens, Solid, View
from magiclens.contract.errors import InputError
from magiclens.exporting.mesh_files import STL_HEADER
from magiclens.geometry import solid as solid_module
from magiclens.geometry.solid import solid_from_heights
from magiclens.plan.compile import Plan, load_plan
from magiclens.preflight.checks import run_preflight
from magiclens.preflight.finding import ANY_MESH, Finding, Preflight, Verdict, graded, worst, worst_facet_text
from magiclens.preflight.light import SeenTop, check_fresnel_loss, check_total_reflection, seen_top
from magiclens.preflight.machine import check_as_made, check_bed, check_detail, check_material, check_tool_reach
from magiclens.preflight.mesh_file import MeshFile, SharedCorners, read_mesh_file
from magiclens.preflight.page import STATUS_COLOURS, lens_map, preflight_text, write_preflight
from magiclens.preflight.picture import check_colours
from magiclens.preflight.stairs import check_stairs
from magiclens.preflight.survey import survey
from magiclens.preflight.triangles import TopTriangles, top_triangles, trace_triangles
from magiclens.processes.tilting import Tilt
from magiclens.profiles.machines import Printer, machines
from magiclens.running.pipeline import Run, run_spec

SPEC = """\
name: small
scenario: {type: single, source: {type: circles, radius: [0.3mm, 1.2mm]}, target: {art: heart}}
lens: {size: 24mm, facets: 8, microfacets: 8, thickness: 20mm}
viewer: {distance: 300mm}
fabrication: {machine: polyjet-600x300}
report: {analyses: [as-made]}
pipeline:
  annealer: {type: heat-bath, sweeps: 5}
  exporters: [{type: stl}, {type: 3mf}, {type: ply}, {type: obj}, {type: glb}]
  renderers: [{type: tracer, resolution: 64}]
"""
ALL_FILES = {f"lens.{kind}" for kind in ("stl", "3mf", "ply", "obj", "glb")}
Folder = Callable[[], Path]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A small lens, run for a PolyJet printer."""
    folder = tmp_path_factory.mktemp("small")
    (folder / "small.yaml").write_text(SPEC)
    return run_spec(folder / "small.yaml", folder / "out")


@pytest.fixture
def folder(run: Run, tmp_path: Path) -> Path:
    """A copy of the run folder, to spoil; the STL is its only mesh."""
    copied = shutil.copytree(run.folder, tmp_path / "out")
    for name in ALL_FILES - {"lens.stl"}:
        (copied / name).unlink()
    return copied


def checked(folder: Path, **facts: Any) -> dict[str, Finding]:
    """What preflight finds in a run folder, by check."""
    manifest = json.loads((folder / "manifest.json").read_text())
    plan = load_plan(folder / "spec.yaml")
    return {finding.check: finding for finding in run_preflight(folder, {**manifest, **facts}, plan).findings}


def triangles(folder: Path) -> FloatArray:
    return read_mesh_file(folder / "lens.stl").triangles[:]


def rewrite(folder: Path, faces: FloatArray) -> None:
    """Put other triangles into the folder's STL."""
    record = np.zeros(len(faces), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    record["corners"] = faces
    (folder / "lens.stl").write_bytes(STL_HEADER + len(faces).to_bytes(4, "little") + record.tobytes())


def test_a_sound_lens_is_fit_to_be_made(run: Run) -> None:
    findings = checked(run.folder)
    assert {name: f.text for name, f in findings.items() if f.status != "green" and name != "as made"} == {}
    for name in ALL_FILES:
        assert name in findings["files"].text
    assert set(findings) >= {
        "watertight", "one body", "self-intersection", "thickness", "slopes", "Fresnel loss", "total reflection",
        "detail", "bed", "material", "mirror image", "source",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("ours", "theirs"), [(b'"/>\n', b'" />\n'), (b' x="', b'  x="'), (b"vertices>", b"vertices >")]
)
def test_a_3mf_that_another_program_wrote_holds_the_same_triangles(
    run: Run, tmp_path: Path, ours: bytes, theirs: bytes
) -> None:
    with ZipFile(run.folder / "lens.3mf") as archive, ZipFile(tmp_path / "lens.3mf", "w") as other:
        for name in archive.namelist():
            other.writestr(name, archive.read(name).replace(ours, theirs))
    own, foreign = (read_mesh_file(folder / "lens.3mf").triangles[:] for folder in (run.folder, tmp_path))
    np.testing.assert_array_equal(own, foreign)


def test_every_format_is_recognised_as_the_lens_that_was_finished(run: Run) -> None:
    solid, moved = run.result.solid, run.result.solid.vertices.copy()
    moved[7, 2] += 1e-4
    for suffix in ("stl", "ply", "3mf"):
        file = read_mesh_file(run.folder / f"lens.{suffix}")
        assert file.same_as(solid)
        assert not file.same_as(replace(solid, vertices=moved))


def test_a_run_ends_with_its_preflight(run: Run) -> None:
    facts = json.loads((run.folder / "preflight.json").read_text())
    assert facts["machine"] == "a PolyJet printer, 600 x 300 dpi, layers of 27 micrometres"
    by_check = {check["check"]: check for check in facts["checks"]}
    assert by_check["watertight"] == {
        "check": "watertight", "status": "green", "text": "lens.stl is closed, its faces look outward", "facets": [],
    }  # fmt: skip
    assert "preflight.html" in {a["path"] for a in run.manifest["artifacts"]}
    assert (run.folder / "figures" / "as-made-single.png").is_file()


def test_a_run_states_what_the_machine_costs(run: Run) -> None:
    metrics, text = run.manifest["metrics"], checked(run.folder)["as made"].text
    assert metrics["fabrication_loss_db"] < 0
    assert f"{metrics['as_made_psnr_db']:.1f} dB" in text
    assert "designed for how it is made" in text


@pytest.mark.parametrize(
    ("made", "designed", "status", "word"),
    [
        (0.9, 0.1, "green", "as made: clear"),
        (0.5, 0.9, "green", "as made: recognisable"),
        (0.3, 0.9, "amber", "as made: hard to see"),
        (0.1, 0.9, "red", "as made: lost"),
        (None, 0.9, "grey", "as made: not checked"),
        (None, 0.3, "amber", "as designed: hard to see"),
        (None, 0.1, "red", "as designed: lost"),
        (None, None, "grey", "as designed: not checked"),
    ],
)
def test_what_counts_is_the_picture_as_made(made: float | None, designed: float | None, status: str, word: str) -> None:
    verdict = Verdict(made, designed)
    metrics = {} if made is None else {"as_made_psnr_db": 20.0, "fabrication_loss_db": 2.0}
    finding = check_as_made(metrics, verdict)
    assert finding.status == verdict.status == status
    assert word in finding.text
    assert Preflight("x", "", [finding], None, verdict).status == status


def test_the_verdict_comes_first_and_is_the_same_on_every_page(run: Run) -> None:
    facts = json.loads((run.folder / "preflight.json").read_text())
    words = facts["verdict"]["text"]
    assert next(iter(facts)) == "verdict"
    assert facts["checks"][0]["check"] == "as made"
    for page in ("preflight.html", "report.html"):
        assert words.capitalize() in (run.folder / page).read_text(), page
    made = f"{run.manifest['metrics']['as_made_psnr_db']:.1f} dB"
    assert made in facts["checks"][0]["text"]
    assert f"{made}, SSIM" in (run.folder / "report.html").read_text(), "the figure's caption has the same number"


def test_without_a_machine_the_picture_as_made_is_not_checked(run: Run, folder: Path) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    del manifest["metrics"]["as_made_psnr_db"]
    plan = load_plan(folder / "spec.yaml")
    assert "was not simulated" in run_preflight(folder, manifest, plan).verdict.text
    found = run_preflight(folder, manifest, replace(plan, fabrication=None))
    assert found.verdict.made is None
    assert "name one: fabrication: {machine: sla}" in preflight_text(found).splitlines()[0]
    assert found.findings[0].status == "grey"
    assert found.status != "green"


def test_the_quick_check_agrees_with_the_thorough_one(run: Run) -> None:
    quick = {c["check"]: c["status"] for c in json.loads((run.folder / "preflight.json").read_text())["checks"]}
    thorough = {name: finding.status for name, finding in checked(run.folder).items() if name != "files"}
    assert quick == thorough


def test_equal_runs_have_equal_pages(run: Run, tmp_path: Path) -> None:
    manifest = json.loads((run.folder / "manifest.json").read_text())
    shutil.copytree(run.folder / "figures", tmp_path / "figures")
    write_preflight(
        run_preflight(run.folder, manifest, load_plan(run.folder / "spec.yaml"), run.result.solid), tmp_path
    )
    for name in ("preflight.html", "preflight.json"):
        assert (tmp_path / name).read_bytes() == (run.folder / name).read_bytes()
    page = (run.folder / "preflight.html").read_text()
    assert page.count("data:image/webp") == 2, "the map, and what the lens shows as made"


@pytest.mark.tools
def test_what_was_found_about_the_lens_is_true_of_every_file_that_holds_it(run: Run, folder: Path) -> None:
    """It is not searched for again, and kept as JSON it gives the same page."""
    manifest, plan = json.loads((folder / "manifest.json").read_text()), load_plan(folder / "spec.yaml")
    kept: list[str] = []

    def keep(check: Callable[[], Preflight]) -> Preflight:
        kept[:] = kept or [json.dumps(check().as_plain())]
        return Preflight.from_plain(json.loads(kept[0]))

    (folder / "lens.stl").unlink()
    for suffix in ("stl", "ply", "3mf"):
        shutil.copy(run.folder / f"lens.{suffix}", folder)
        pages = []
        for way in (keep, lambda check: check()):
            found = run_preflight(folder, manifest, plan, run.result.solid, way)
            assert f"lens.{suffix} is closed" in preflight_text(found)
            assert ANY_MESH not in preflight_text(found)
            write_preflight(found, folder)
            pages.append((folder / "preflight.html").read_bytes() + (folder / "preflight.json").read_bytes())
        assert pages[0] == pages[1]
        (folder / f"lens.{suffix}").unlink()


def test_the_quick_check_looks_again_when_the_file_holds_something_else(run: Run, folder: Path) -> None:
    rewrite(folder, triangles(folder)[1:])
    manifest = json.loads((folder / "manifest.json").read_text())
    never = lambda check: pytest.fail("that was found about another mesh")  # noqa: E731
    found = run_preflight(folder, manifest, load_plan(folder / "spec.yaml"), run.result.solid, never)
    assert found.status == "red"


Spoiler = Callable[[FloatArray], FloatArray]
SPOILT: dict[str, tuple[Spoiler, str, str]] = {
    "a hole": (lambda t: t[1:], "watertight", "lens.stl has edges that bound one face only"),
    "inside out": (lambda t: t[:, ::-1], "watertight", "lens.stl has faces that point inward"),
    "two bodies": (lambda t: np.concatenate([t, t + np.float32([0, 0, 90])]), "one body", "2 separate bodies"),
    "mirrored": (lambda t: (t * np.float32([-1, 1, 1]))[:, ::-1], "mirror image", "if the file is mirrored"),
    "in metres": (lambda t: t / 1000, "size", "wrong unit?"),
    "in inches": (lambda t: t * np.float32(25.4), "size", "wrong unit?"),
    "too high": (lambda t: t * np.float32([1, 1, 20]), "thickness", "2 to 200 mm is fit"),
}


@pytest.mark.parametrize("name", SPOILT)
def test_a_spoilt_file_is_red(name: str, folder: Path) -> None:
    spoil, check, text = SPOILT[name]
    rewrite(folder, spoil(triangles(folder)))
    finding = checked(folder)[check]
    assert finding.status == "red"
    assert text in finding.text


def test_a_turned_file_is_red(folder: Path) -> None:
    faces = triangles(folder)
    rewrite(folder, np.stack([-faces[..., 1], faces[..., 0], faces[..., 2]], axis=-1))
    finding = checked(folder)["mirror image"]
    assert finding.status == "red"
    assert "another lens, or turned?" in finding.text


def test_a_hole_is_in_the_facet_that_is_named(folder: Path) -> None:
    faces = triangles(folder)
    middle = faces.mean(axis=1)
    wanted = [(middle[:, 0] - 4.5) ** 2 + (middle[:, 1] - 7.5) ** 2 + (middle[:, 2] - 20) ** 2]
    rewrite(folder, np.delete(faces, int(np.argmin(wanted)), axis=0))
    finding = checked(folder)["watertight"]
    assert finding.facets == ((1, 5),), "x = 4.5 mm is column 5 of 3 mm, y = 7.5 mm is row 1"
    assert "facet row 1, column 5" in finding.text


def test_a_facet_that_is_too_steep_is_named(folder: Path) -> None:
    faces = triangles(folder)
    corner = (abs(faces[..., 0] + 4.5) < 1.2) & (abs(faces[..., 1] + 1.5) < 1.2) & (faces[..., 2] > 1)
    faces[corner, 2] += 3 * (faces[corner, 0] + 4.5)
    rewrite(folder, faces)
    finding = checked(folder)["slopes"]
    assert finding.status == "red"
    assert finding.facets[0] == (4, 2)


def test_a_face_that_cuts_others_is_found(folder: Path) -> None:
    faces = triangles(folder)
    highest = faces[..., 2].max()
    spot = (faces == faces.reshape(-1, 3)[np.argmax(faces[..., 2].ravel())]).all(axis=-1)
    faces[spot] = [0, 0, -highest / 4]
    rewrite(folder, faces)
    assert checked(folder)["self-intersection"].status == "red"


def test_a_file_that_is_cut_short_is_red(folder: Path) -> None:
    path = folder / "lens.stl"
    path.write_bytes(path.read_bytes()[:-10])
    assert "cut short" in checked(folder)["mesh"].text


def test_what_is_found_does_not_depend_on_how_many_triangles_are_looked_at_at_once(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = checked(run.folder)
    monkeypatch.setattr(solid_module, "FACES_AT_ONCE", 777)
    assert checked(run.folder) == whole


def test_files_that_differ_are_red(run: Run, tmp_path: Path) -> None:
    copied = shutil.copytree(run.folder, tmp_path / "out")
    rewrite(copied, triangles(copied) * np.float32([1, 1, 1.01]))
    finding = checked(copied)["files"]
    assert (finding.status, finding.text) == ("red", "lens.ply holds another body than lens.stl")


@pytest.mark.tools
def test_a_coarse_source_is_amber_then_red(folder: Path) -> None:
    from magiclens.images import read_image, resize, write_png

    picture = read_image(folder / "sources" / "source.png")
    for per_mm, status in ((20, "green"), (8, "amber"), (3, "red")):
        write_png(folder / "sources" / "source.png", resize(picture, (24 * per_mm, 24 * per_mm)))
        assert checked(folder)["source"].status == status


def test_without_a_mesh_there_is_nothing_to_check(folder: Path) -> None:
    (folder / "lens.stl").unlink()
    with pytest.raises(InputError, match="no mesh file to be made; add an exporter such as stl"):
        checked(folder)


LENS = Lens(size_mm=12.0, source_size_mm=12.0, facets=4, microfacets=4, thickness_mm=10.0, wall_mm=0.002)
EYE = np.array([0.0, 0.0, 110.0])


def top_of(solid: Solid, lens: Lens = LENS, eye: FloatArray | None = EYE) -> TopTriangles:
    return top_triangles(whole_top(as_file(solid), lens), lens, eye)


def whole_top(file: MeshFile, lens: Lens = LENS) -> FloatArray:
    return np.concatenate(list(file.top_parts(lens)))


def as_file(solid: Solid) -> MeshFile:
    return MeshFile(Path("lens.stl"), solid.vertices[solid.faces].astype(np.float32))


def tilted(slope: float, facets: Iterable[tuple[int, int]], lens: Lens = LENS) -> Solid:
    """A slab whose top is flat but for some facets that rise with x."""
    k = lens.microfacets + 1
    heights = np.zeros((lens.facets, lens.facets, k, k))
    for facet in facets:
        heights[facet] = slope * (np.arange(k) / lens.microfacets - 0.5) * (lens.pitch_mm - lens.wall_mm)
    return solid_from_heights(HeightField(lens, heights, None if lens.cells == "vertical" else EYE))


def test_an_eye_sees_the_square_and_a_flat_slab_magnified() -> None:
    seen = trace_triangles(whole_top(as_file(flat(LENS, (0.0, 0.0, 110.0)))), LENS, EYE)
    assert seen.area.sum() == pytest.approx(144, rel=1e-4)
    ray = np.hypot(seen.u, seen.v)
    depth = np.hypot(seen.x, seen.y) - ray
    np.testing.assert_allclose(depth, ray / np.hypot(ray, 100) / 1.49 * 10, rtol=0.01)
    assert seen.through == pytest.approx(0.96**2, abs=0.005)


@pytest.mark.parametrize("slope", [0.2, 0.5])
def test_what_is_lost_to_fresnel_and_total_reflection_is_counted(slope: float) -> None:
    steep = tilted(2.5, [(0, 3), (2, 1)])
    loss = check_fresnel_loss(*_light(steep, LENS))
    assert loss.status == "red"
    assert set(loss.facets) == {(0, 3), (2, 1)}
    assert "12 % of the picture is seen at more than 60 deg" in loss.text
    lost = check_total_reflection(*_light(steep, LENS))
    assert lost.status == "green", "what enters at 1.49 leaves an even bottom"
    assert check_total_reflection(*_light(steep, replace(LENS, ior=2.5))).facets
    assert check_fresnel_loss(*_light(tilted(slope, [(0, 3)]), LENS)).status == "green"


def _light(solid: Solid, lens: Lens) -> tuple[TopTriangles, SeenTop, FloatArray, Lens]:
    top = top_of(solid)
    return top, *seen_top(top.wall, [trace_triangles(whole_top(as_file(solid)), lens, EYE)]), lens


def test_what_is_known_of_a_triangle_takes_few_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("numba.get_num_threads", lambda: 1)  # each thread looks at some triangles, too
    lens = replace(LENS, facets=48, microfacets=11)
    solid, grey = flat(lens, (0.0, 0.0, 110.0)), np.ones((64, 64, 1), np.float32)
    file = MeshFile(Path("lens.stl"), SharedCorners(solid.vertices.astype(np.float32), solid.faces))
    views = [View("view", grey, grey, EYE)]
    survey(file, lens, EYE, views)  # which compiles
    tracemalloc.start()
    survey(file, lens, EYE, views)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 60 * len(solid.faces)


def test_walls_do_not_count_as_facets() -> None:
    solid = bumpy(lens=LENS, eye=(0.0, 0.0, 110.0))
    top = top_of(solid)
    assert top.slope_deg[top.wall].max() > 80
    assert (~top.wall).sum() == 2 * (LENS.facets * LENS.microfacets) ** 2


MILLED = replace(LENS, cells="vertical", wall_mm=0.1)
MILL = machines()["milling"].machine()


def test_a_mill_cannot_undercut_and_does_not_reach_deep_holes() -> None:
    assert check_tool_reach(*_body(tilted(0.15, [(1, 1)], MILLED), None), MILLED, MILL).status == "green"
    under = check_tool_reach(*_body(bumpy(lens=LENS, eye=(0.0, 0.0, 110.0)), EYE), LENS, MILL)
    assert (under.status, "undercut" in under.text) == ("red", True)
    short = MILL.model_copy(update={"reach": 0.5})
    deep = check_tool_reach(*_body(tilted(0.8, [(1, 1)], MILLED), None), MILLED, short)
    assert deep.status == "red"
    assert deep.facets[0] == (1, 1)
    cliff = check_tool_reach(*_body(tilted(1.9, [(1, 1)], MILLED), None), MILLED, MILL)
    assert cliff.status == "amber"
    assert "steeper than the cutter's 75 deg" in cliff.text


def _body(solid: Solid, eye: FloatArray | None) -> tuple[MeshFile, TopTriangles]:
    return as_file(solid), top_of(solid, MILLED if eye is None else LENS, eye)


@pytest.mark.parametrize(
    ("machine", "bed", "status"),
    [
        ("sla", ["12.5mm", "13mm", "20mm"], "green"),
        ("sla", ["11mm", "30mm", "20mm"], "red"),
        ("sla", ["30mm", "30mm", "9mm"], "red"),
        ("milling", ["11mm", "30mm", "20mm"], "amber"),
        ("milling", ["30mm", "30mm", "9mm"], "red"),
    ],
)
def test_the_bed_holds_the_lens_or_not(machine: str, bed: list[str], status: str) -> None:
    profile = machines()[machine]
    body = as_file(flat(LENS))
    assert check_bed(body, profile.model.model_validate({**profile.options, "bed": bed})).status == status


def test_a_tilted_lens_needs_a_higher_bed() -> None:
    profile, body = machines()["sla"], as_file(flat(LENS))  # 12 x 12 x 10 mm
    low = {**profile.options, "bed": ["40mm", "40mm", "12mm"]}
    assert check_bed(body, profile.model.model_validate(low)).status == "green"
    stood = check_bed(body, profile.model.model_validate({**low, "tilt": {"angle": "30deg"}}))
    assert stood.status == "red"
    assert "12 x 15.39 x 14.66 mm on a bed" in stood.text


def test_the_bill_is_volume_times_density_times_price() -> None:
    from magiclens.profiles.materials import materials

    body = as_file(flat(LENS))
    printer = machines()["sla"].machine().model_copy(update={"price": 1000.0})
    text = check_material(body, printer, materials()["photopolymer-sla"]).text
    assert text.startswith("1.44 cm3; 0.0017 kg")
    assert "about 2 EUR at 1000 EUR/kg" in text
    assert "out of a block of 1.44 cm3" in check_material(body, MILL, materials()["acrylic"]).text
    assert check_material(body, MILL, None).status == "grey"


def test_micro_facets_finer_than_the_printer_are_amber_and_small_facets_red() -> None:
    printer = machines()["polyjet-600x300"].machine()
    assert check_detail(LENS, printer).status == "green"
    assert check_detail(replace(LENS, microfacets=50), printer).status == "amber"
    assert check_detail(replace(LENS, facets=24), printer).status == "red"


def test_gentle_slopes_are_advised_to_be_tilted() -> None:
    printer = machines()["sla"].machine()
    assert isinstance(printer, Printer)
    everywhere = [(i, j) for i in range(LENS.facets) for j in range(LENS.facets)]
    upright = replace(LENS, cells="vertical")
    body, thick = tilted(0.05, everywhere, upright), replace(upright, thickness_mm=40.0)  # thick, rays bend far
    found = check_stairs(*_body_of(body), thick, printer)
    assert (found.status, found.check) == ("amber", "layers")
    wish = re.search(r"fabrication.tilt: \{about: (.), angle: (\S+)\} it would be (\S+) mm", found.text)
    assert wish is not None
    as_advised = Tilt.model_validate({"about": wish[1], "angle": wish[2]})
    better = check_stairs(*_body_of(body), thick, printer.model_copy(update={"tilt": as_advised}))
    assert better.status == "green"
    assert f"throw rays off by {wish[3]} mm rms" in better.text
    assert "its flat side grows by" in better.text
    own = check_stairs(*_body_of(body), thick, printer.model_copy(update={"slicing": "diffused"}))
    assert own.status == "green"
    stairs = re.search(r"throw rays off by \S+ mm rms", found.text)
    assert stairs is not None
    assert f"{stairs[0]}; the verdict is of its own slices" in own.text
    low = printer.model_copy(update={"bed": (30.0, 30.0, 9.0)})
    assert "fabrication.tilt" not in check_stairs(*_body_of(body), thick, low).text, "there is no room for it"


def _body_of(solid: Solid) -> tuple[MeshFile, TopTriangles]:
    return as_file(solid), top_of(solid, LENS, None)


def test_verdicts_are_those_of_the_worst_finding() -> None:
    green, amber, red = (Finding("x", graded(value, 1, 2), "") for value in (0.5, 1.5, 2.5))
    assert [worst(found) for found in ([], [green], [green, amber], [red, amber])] == ["green", "green", "amber", "red"]
    assert worst_facet_text(((3, 4), (0, 0))) == "; the worst is facet row 3, column 4, and 1 more"


def test_the_map_frames_the_facets_at_fault() -> None:
    bad = Finding("slopes", "red", "", ((0, 3),))
    fine = Finding("loss", "green", "", ((3, 0),))
    picture = lens_map(Preflight("x", "", [bad, fine], np.zeros((4, 4))))
    assert picture is not None
    red = (picture == STATUS_COLOURS["red"]).all(axis=-1)
    assert red[:160, -160:].any()
    red[:160, -160:] = False
    assert not red.any()
    assert (picture == 245).any(), "flat facets are bright"


def test_the_page_is_whole_and_escapes_names(tmp_path: Path) -> None:
    found = Preflight("<b>", "a & b", [Finding("slopes", "amber", "1 < 2", ((0, 0),))], np.zeros((2, 2)))
    write_preflight(found, tmp_path)
    page = (tmp_path / "preflight.html").read_text()
    assert "&lt;b&gt;" in page
    assert "1 &lt; 2" in page
    assert "data:image/webp;base64," in page
    assert "http" not in page
    assert "prefers-color-scheme: dark" in page
    first = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    write_preflight(found, tmp_path)
    assert first == {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    assert preflight_text(found).splitlines() == [
        "as made: not checked; as designed: not checked", "",
        "amber  slopes             1 < 2", "", "amber: Can be made; look at what is amber first.",
    ]  # fmt: skip


@pytest.mark.tools
def test_the_command_ends_with_0_or_1_and_keeps_the_manifest_true(folder: Path) -> None:
    done = CliRunner().invoke(app, ["preflight", str(folder)])
    assert done.exit_code == 0, done.output
    assert "green  watertight" in done.stdout
    assert (folder / "figures" / "as-made-rough-single.png").is_file()
    listed = {a["path"]: a["sha256"] for a in json.loads((folder / "manifest.json").read_text())["artifacts"]}
    page = folder / "preflight.html"
    assert listed["preflight.html"] == hashlib.sha256(page.read_bytes()).hexdigest()
    again, before = CliRunner().invoke(app, ["preflight", str(folder)]), page.read_bytes()
    assert (again.stdout, page.read_bytes()) == (done.stdout, before)
    facts = CliRunner().invoke(app, ["preflight", str(folder), "--json"])
    assert json.loads(facts.stdout) == json.loads((folder / "preflight.json").read_text())
    rewrite(folder, triangles(folder)[1:])
    assert CliRunner().invoke(app, ["preflight", str(folder)]).exit_code == 1


def test_the_command_wants_a_run_folder(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["preflight", str(tmp_path)])
    assert done.exit_code == 2
    assert "is not a run folder: it has no manifest.json" in done.stderr


def test_a_plan_of_a_run_folder_keeps_its_machine(run: Run) -> None:
    plan: Plan = load_plan(run.folder / "spec.yaml")
    assert plan.fabrication is not None
    assert plan.fabrication.name == "polyjet-600x300"


@pytest.mark.parametrize(("source", "target", "said"), [(1, 3, True), (3, 3, False), (1, 1, False), (3, 1, False)])
def test_a_grey_source_below_a_coloured_target_is_said(source: int, target: int, said: bool) -> None:
    paper, picture = np.ones((8, 8, source), np.float32), np.ones((8, 8, target), np.float32)
    plain = View("plain", np.ones((8, 8, 1), np.float32), np.ones((8, 8, 1), np.float32), np.array([0, 0, 440.0]))
    found = check_colours([plain, View("v", paper, picture, np.array([0, 0, 440.0]), 0.0, "dots", "logo")])
    assert [each.status for each in found] == ["amber"] * said
    assert all("logo has colours, dots has none" in each.text for each in found)
