"""Milling programs as files: read back, judged by LinuxCNC's own interpreter, and run from a finished run folder."""

from __future__ import annotations

import errno
import hashlib
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from fabricated import bumpy, flat, written
from magiclens.cli import app
from magiclens.contract.artifacts import FloatArray, Solid
from magiclens.contract.errors import InputError
from magiclens.images.files import read_image
from magiclens.milling.cutter import Cutter
from magiclens.milling.gcode import Gcode, parse_gcode
from magiclens.milling.job import milling_job
from magiclens.milling.line_milling import LineMilling
from magiclens.milling.rml import Rml, parse_rml
from magiclens.plan.compile import load_plan
from magiclens.running.milling_simulation import simulate_milling
from magiclens.running.pipeline import Run, run_spec
from magiclens.simulation.machining import faults, run_programs
from milled import BALL, FLAT, POINTED, V, cutter, machined, programs_of, waves
from toys import TOYS, SpecWriter, registry_of

COARSE: dict[str, Any] = {"cutter": V, "stepover": "0.2mm"}
CANONICAL = re.compile(r"STRAIGHT_(FEED|TRAVERSE)\((-?[\d.]+), (-?[\d.]+), (-?[\d.]+),")


def rs274(path: Path) -> subprocess.CompletedProcess[str]:
    """LinuxCNC's interpreter by itself (Debian: linuxcnc-uspace), which must be there."""
    program = shutil.which("rs274")
    assert program, "rs274 is missing: apt-get install linuxcnc-uspace"
    return subprocess.run([program, "-g", str(path)], capture_output=True, text=True, timeout=60, check=False)


def canonical(path: Path) -> tuple[FloatArray, FloatArray]:
    """Ends of all moves (M, 3), mm, as LinuxCNC understands them, and which of them are rapid; pauses left out."""
    done = rs274(path)
    assert done.returncode == 0, done.stderr
    assert "USE_LENGTH_UNITS(CANON_UNITS_MM)" in done.stdout
    found = CANONICAL.findall(done.stdout)
    points = np.array([[float(n) for n in move[1:]] for move in found])
    rapid = np.array([move[0] == "TRAVERSE" for move in found])
    moved = np.r_[True, (np.diff(points, axis=0) != 0).any(axis=1)]
    return points[moved], rapid[moved]


@pytest.mark.tools
@pytest.mark.parametrize("shape", [BALL, FLAT, V, POINTED], ids=["ball", "flat", "v", "pointed"])
@pytest.mark.parametrize("axis", ["x", "y"])
def test_linuxcnc_accepts_a_program_and_moves_as_it_is_meant(shape: dict[str, Any], axis: Any, tmp_path: Path) -> None:
    exporter = Gcode(cutter=shape, stepover="0.2mm", axis=axis)
    path = written(exporter, tmp_path, bumpy())
    points, rapid = canonical(path)
    (program,) = milling_job(exporter, bumpy()).programs
    np.testing.assert_allclose(points, program.moves.points, atol=6e-5)
    np.testing.assert_array_equal(rapid, program.moves.rapid)


@pytest.mark.tools
def test_linuxcnc_refuses_a_broken_program(tmp_path: Path) -> None:
    path = written(Gcode(**COARSE), tmp_path, flat())
    path.write_text(path.read_text().replace(" F1200", "").replace(" F300", ""))
    assert rs274(path).returncode != 0


@pytest.mark.parametrize(
    "exporter",
    [Gcode(**COARSE), Gcode(**COARSE, flavour="grbl"), Gcode(**COARSE, bed=("6mm", "7mm")), Rml(**COARSE),
     Rml(**COARSE, bed=("7mm", "6mm"), axis="y", safe_height="2.345mm")],
    ids=["linuxcnc", "grbl", "linuxcnc tiles", "rml", "rml tiles"],
)  # fmt: skip
def test_files_read_back_give_the_same_moves_cutters_and_zeros(exporter: LineMilling, tmp_path: Path) -> None:
    solid = bumpy()
    read, programs = programs_of(exporter, written(exporter, tmp_path, solid)), milling_job(exporter, solid).programs
    assert len(read) == len(programs)
    close = 6e-5 if isinstance(exporter, Gcode) else 1e-6
    for again, program in zip(read, programs, strict=True):
        np.testing.assert_allclose(again.moves.points, program.moves.points, atol=close)
        np.testing.assert_allclose(again.moves.feed, program.moves.feed, rtol=1e-3)
        np.testing.assert_array_equal(again.moves.tool, program.moves.tool)
        assert again.setup.to_text() == program.setup.to_text()
        assert {n: c.outline() for n, c in again.setup.tools.items()} == {
            n: c.outline() for n, c in program.setup.tools.items()
        }
        assert faults(again) == []


def test_rml_follows_the_path_of_gcode_within_its_steps(tmp_path: Path) -> None:
    """Along every line: 0.01 mm for a coordinate's rounding, twice, since heights are rounded up."""
    solid, options = waves(), {"cutter": BALL, "stepover": "0.2mm", "operation": "finishing"}
    exporters = Gcode(**options), Rml(**options)
    fine, coarse = (programs_of(e, written(e, tmp_path / e.type, solid))[0].moves for e in exporters)
    rows = np.unique(coarse.points[:, 1])
    for y in rows[5:-5:7]:
        near = np.unique(fine.points[:, 1])[np.abs(np.unique(fine.points[:, 1]) - y).argmin()]
        profiles = []
        for moves, at in ((fine, near), (coarse, y)):
            cuts = moves.cutting()
            along = cuts[(cuts[:, :, 1] == at).all(axis=1) & (cuts[:, 0, 0] != cuts[:, 1, 0])]
            ends = np.concatenate([along[:, 0], along[:, 1]])
            ends = ends[np.argsort(ends[:, 0])]
            profiles.append(np.interp(np.linspace(-2.5, 2.5, 201), ends[:, 0], ends[:, 2]))
        slope = 0.01 * 0.6  # of lines that are up to half a step of y apart
        assert (profiles[1] - profiles[0]).min() > -slope
        assert (profiles[1] - profiles[0]).max() < 0.02 + slope


def test_rml_is_what_rolands_engravers_take(tmp_path: Path) -> None:
    text = written(Rml(**COARSE, operation="finishing"), tmp_path, flat()).read_text()
    assert re.fullmatch(r"PA;PA;\n!PZ0,500;!MC1;\nPU0,0;\n(PU|VS|!VZ|Z|[-\d.,;\n])+!MC0;\n", text)
    assert "VS5;!VZ5;\n" in text  # 300 mm/min
    assert "VS20;!VZ20;\n" in text


def test_grbl_has_one_cutter_a_file_and_no_word_that_it_does_not_know(tmp_path: Path) -> None:
    exporter = Gcode(**COARSE, flavour="grbl")
    paths = exporter.program_files(written(exporter, tmp_path, bumpy()))
    assert [path.name for path in paths] == ["lens.ngc", "lens-2.ngc"]
    for path in paths:
        code = re.sub(r"\([^)]*\)", "", path.read_text())
        assert not re.search(r"M0?6\b|G43|G61|G64", code)
        assert len(set(re.findall(r"T\d+", code))) == 1
        assert max(map(len, code.splitlines())) < 80


def test_linuxcnc_changes_cutters_within_a_file_and_restates_where_it_is(tmp_path: Path) -> None:
    text = written(Gcode(**COARSE), tmp_path, bumpy()).read_text()
    assert re.findall(r"T\d M6\nG43\nS12000 M3\nG4 P2\nG0 Z5\.0000\nX", text) == [
        f"T{k} M6\nG43\nS12000 M3\nG4 P2\nG0 Z5.0000\nX" for k in (1, 2)
    ]


def test_equal_lenses_give_equal_bytes(tmp_path: Path) -> None:
    for exporter in (Gcode(**COARSE, bed=("6mm", "7mm")), Rml(**COARSE)):
        one, two, other = tmp_path / f"1{exporter.type}", tmp_path / f"2{exporter.type}", tmp_path / f"3{exporter.type}"
        for folder, seed in ((one, 5), (two, 5), (other, 6)):
            written(exporter, folder, bumpy(seed=seed))
        files = sorted(path.name for path in one.iterdir())
        assert f"lens{exporter.suffix}.txt" in files
        assert all((one / name).read_bytes() == (two / name).read_bytes() for name in files)
        assert (one / files[0]).read_bytes() != (other / files[0]).read_bytes()


def test_the_sheet_tells_the_maker_what_to_know(tmp_path: Path) -> None:
    exporter = Gcode(**COARSE, bed=("6mm", "7mm"), stock="8.7mm")
    written(exporter, tmp_path, bumpy())
    text = (tmp_path / "lens.ngc.txt").read_text()
    for part in (
        "x 8.70 mm, of clear acrylic",
        "Lines: every 0.2mm along x.",
        "milled in 6 tiles",
        "lens-6.ngc:\n  zero: x = ",
        "roughing: cutter 1, 3mm ball, reach 15mm",
        "finishing: cutter 2, 2mm v, 60deg, round tip 0.1mm, reach 15mm",
        "stock left where the cutter reaches: at most ",
        " m of cutting, about 0 h ",
    ):
        assert part in text


def test_cutters_are_read_back_from_their_text() -> None:
    for options in (BALL, FLAT, V, POINTED, {**V, "tip_form": "flat", "reach": "7.5mm"}):
        tool = cutter(options)
        assert Cutter.parse(str(tool)).outline() == tool.outline()
    with pytest.raises(ValueError, match="'a spoon' describes no cutter"):
        Cutter.parse("a spoon")


def test_other_cutters_than_the_stated_ones_can_be_tried(tmp_path: Path) -> None:
    """A worn tip: the lens keeps more than it should where it was sharp, and loses where it is fatter."""
    solid = waves()
    made = machined(Gcode(**COARSE, rougher=None), tmp_path, solid)
    fat = run_programs([program.with_cutters({1: cutter(BALL)}) for program in made.programs], solid)
    assert made.fit.gouge_mm < 0.001 < fat.fit.gouge_mm


@pytest.mark.parametrize(
    ("parse", "text", "message"),
    [
        (parse_gcode, "G21\nG2 X1 Y1 I1\n", "line 2: G2 is not understood in 'G2 X1 Y1 I1'"),
        (parse_gcode, "G0 Z5\nG1 X1\n", "line 2: a feed move before any feed speed"),
        (parse_gcode, "G0 X=3\n", "line 1: not a line of words"),
        (parse_gcode, "G0 Z5\nP2\n", "line 2: P is not understood"),
        (parse_rml, "PA;\nPU0,0;\n", "line 2: the raised height is not known yet in 'PU0,0'"),
        (parse_rml, "!PZ0,500;\nZ1,2,3;\n", "line 2: a move before any speed"),
        (parse_rml, "PA;SPLINE;\n", "line 1: not understood in 'SPLINE'"),
        (parse_rml, "Z1,2;\n", "line 1: 2 numbers in 'Z1,2'"),
    ],
)
def test_what_is_not_understood_is_named(parse: Any, text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse(text)
    assert message in str(caught.value)


def test_files_that_lack_what_must_be_known_are_named(tmp_path: Path) -> None:
    path = written(Gcode(**COARSE), tmp_path, flat())
    path.write_text(re.sub(r"\(.*\)\n", "", path.read_text()))
    with pytest.raises(InputError, match=r"lens\.ngc: it is not said where zero is or what cuts"):
        Gcode(**COARSE).read_program(path)
    path = written(Rml(**COARSE), tmp_path, flat())
    (tmp_path / "lens.rml.txt").unlink()
    with pytest.raises(InputError, match=r"lens\.rml: cannot be read"):
        Rml(**COARSE).read_program(path)


def test_faults_are_found(tmp_path: Path) -> None:
    exporter = Gcode(**COARSE, rougher=None)
    path = written(exporter, tmp_path, bumpy())
    good = path.read_text()
    path.write_text(good.replace("M5\n", "G0 X0 Y0 Z-0.5\n", 1))
    (fault,) = faults(exporter.read_program(path))
    assert "rapid at z = -0.5000, below the plate's top" in fault
    path.write_text(good.replace("reach 15mm", "reach 0.5mm"))
    assert re.search(r"cutter 1 goes [\d.]+ mm deep but reaches 0.5", faults(exporter.read_program(path))[0])
    path.write_text(good)
    assert "more than the bed of 5 x 5" in faults(exporter.read_program(path), (5.0, 5.0))[0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cutter": {**V, "reach": "0.5mm"}}, "the cutter for finishing reaches 0.5mm deep,"),
        ({"rougher": {**BALL, "reach": "0.5mm"}}, "the cutter for roughing reaches 0.5mm deep, the lens needs"),
        ({"stock": "8mm"}, "the plate of 8mm is thinner than the lens; it needs 8.5mm"),
        ({"bed": ("1mm", "1mm")}, "a bed of 1mm x 1mm would take more than 64 tiles; use"),
        ({"bed": ("0.1mm", "9mm")}, "a bed of 0.1mm x 9mm would take more than 64 tiles"),
    ],
)
def test_what_cannot_be_milled_is_refused(options: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        written(Gcode(**{**COARSE, **options}), tmp_path, bumpy())
    assert message in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_a_free_mesh_is_refused(tmp_path: Path) -> None:
    solid = flat()
    with pytest.raises(InputError, match="milling needs the top's regular grid"):
        written(Gcode(), tmp_path, Solid(solid.vertices, solid.faces))


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("stepover: 0.03", "stepover: 0.03 is a bare number; a length needs a unit, such as '0.03mm'"),
        ("stepover: 4mm", "a stepover of 4mm leaves strips between the lines of a 3mm cutter; at most 3mm"),
        ("rough_stepover: 4mm", "a rough_stepover of 4mm leaves strips between the lines of a 3mm cutter"),
        ("feed: 800", "feed: 800 is a bare number; a speed needs a unit, such as '800mm/min'"),
        ("cutter: {shape: bal}", "cutter.shape:"),
        ("cutter: {shape: ball, tip: 1mm}", "only a v cutter has tip; this one is ball"),
        ("cutter: {shape: v, diameter: 1mm, tip: 2mm}", "a tip of 2mm does not fit a cutter of 1mm"),
        ("cutter: {shape: ball, number: 1}", "cutter and rougher are different tools with the same number 1"),
        ("stepovr: 1mm", "stepovr: unknown option; did you mean 'stepover'"),
    ],
)
def test_wrong_options_are_explained(option: str, message: str, write_spec: SpecWriter) -> None:
    spec = write_spec(("exporters: [{type: toy}]", f"exporters: [{{type: gcode, {option}}}]"))
    with pytest.raises(InputError) as caught:
        load_plan(spec, registry=registry_of(*TOYS, Gcode))
    assert message in str(caught.value)


SPEC = """\
scenario:
  type: single
  source: {type: art, name: heart}
  target: {art: heart}
lens: {size: 12mm, facets: 4, microfacets: 4, thickness: 8mm, relief: 3mm, gap: 20mm}
viewer: {distance: 100mm}
pipeline:
  matcher: {scales: [1.0], candidates: 1}
  exporters:
    - {type: gcode, cutter: {shape: ball, diameter: 1mm}, stepover: 0.1mm, stock: 11mm}
  renderers: [{type: tracer}]
report: {analyses: []}
"""
"""The lens turns out nearly flat; the plate is thicker, so that all of it is milled."""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("milled")
    (folder / "small.yaml").write_text(SPEC)
    return run_spec(folder / "small.yaml", folder / "out")


@pytest.mark.tools
def test_a_run_folders_programs_are_run_and_their_lens_is_looked_through(run: Run) -> None:
    done = CliRunner().invoke(app, ["machined", str(run.folder)])
    assert done.exit_code == 0, done.output
    numbers = dict(re.findall(r"^(\w[\w ]*?)  +(.*)$", done.output, re.M))
    assert numbers["programs"] == "lens.ngc"
    assert float(numbers["gouge"].split()[0]) < 1
    left = re.match(r"([\d.]+) um where the cutter reaches \(stated: at most ([\d.]+) um\)", numbers["stock left"])
    assert left
    assert float(left[1]) <= float(left[2])
    assert numbers["faults"].startswith("none")
    designed, cut, polished = (float(n) for n in numbers["single"].split())
    assert designed == pytest.approx(run.manifest["views"][0]["psnr_db"], abs=0.5)
    assert designed > polished > cut
    facts = json.loads(CliRunner().invoke(app, ["machined", str(run.folder), "--json"]).stdout)
    assert facts["psnr_db"]["single"]["polished"] == pytest.approx(polished, abs=0.01)
    assert facts["gouge_um"] < 1
    pictures = {name: read_image(run.folder / "machined" / f"{name}.png") for name in ("single", "single-polished")}
    assert {picture.shape for picture in pictures.values()} == {(512, 512, 1)}
    assert np.abs(pictures["single"] - pictures["single-polished"]).mean() > 0.01


@pytest.mark.tools
def test_pictures_of_the_machined_lens_are_listed_in_the_manifest(run: Run, tmp_path: Path) -> None:
    folder = shutil.copytree(run.folder, tmp_path / "copy", ignore=shutil.ignore_patterns("machined"))
    simulate_milling(folder)
    listed = {file["path"]: file["sha256"] for file in json.loads((folder / "manifest.json").read_text())["artifacts"]}
    for name in ("machined/single.png", "machined/single-polished.png"):
        assert listed[name] == hashlib.sha256((folder / name).read_bytes()).hexdigest()
    assert set(listed) == {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()} - {"manifest.json"}


@pytest.mark.tools
def test_pictures_of_the_machined_lens_appear_together_or_not_at_all(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = shutil.copytree(run.folder, tmp_path / "copy", ignore=shutil.ignore_patterns("machined"))
    (folder / "machined").mkdir()
    (folder / "machined" / "old.png").write_bytes(b"of an earlier simulation")
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}

    def full_disk(path: Path, *_: Any) -> None:
        if "polished" in path.name:
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        path.write_bytes(b"half of the pictures")

    with monkeypatch.context() as patch:
        patch.setattr("magiclens.images.files.write_png", full_disk)
        with pytest.raises(OSError, match="No space left"):
            simulate_milling(folder)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    simulate_milling(folder)
    assert sorted(path.name for path in (folder / "machined").iterdir()) == ["single-polished.png", "single.png"]


def test_a_folder_without_programs_says_what_to_do(run: Run, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(run.folder, folder)
    (folder / "lens.ngc").unlink()
    done = CliRunner().invoke(app, ["machined", str(folder)])
    assert done.exit_code == 2
    assert "there is no milling program; run its spec with --set 'pipeline.exporters=[{type: gcode}]'" in done.output
    assert CliRunner().invoke(app, ["machined", str(tmp_path)]).exit_code == 2


def test_programs_count_as_files_of_the_run(run: Run) -> None:
    assert {"lens.ngc", "lens.ngc.txt"} <= {artifact["path"] for artifact in run.manifest["artifacts"]}
