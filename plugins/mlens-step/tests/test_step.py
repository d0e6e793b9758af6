"""CAD programs find the lens in the file: one closed solid, within a micrometre of the mesh."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from acceptor import read
from mlens_step.exporter import Step
from mlens_step.part21 import DERIVED, YES, Parameter, Ref, encode
from topology import faces

from magiclens import FloatArray, InputError, IntArray, Run, Solid, StageError, load_plan, run_spec
from magiclens.testing import ExporterContract

ONE_EYE = "{type: single, source: {type: circles, seed: 7}, target: {art: heart}}"
TWO_EYES = """{type: multi-view, source: {type: circles, seed: 7, size: 30mm}, views: [
  {target: {art: heart}, eye: {tilt: 10deg, azimuth: 180deg}},
  {target: {art: star}, eye: {tilt: 10deg, azimuth: 0deg}}]}"""
SPEC = """\
scenario: %s
lens: {size: 18mm, facets: 6, microfacets: 24, thickness: 15mm, relief: 3mm}
pipeline:
  exporters: [{type: step}]
  renderers: []
report: {analyses: []}
"""
SMOOTH = "pipeline.integrator={type: poisson, refinement: 0}"
LENSES = {
    "cut along eye rays": (ONE_EYE, []),
    "of smooth lenslets": (ONE_EYE, [SMOOTH]),
    "cut vertically": (ONE_EYE, ["lens.cells=vertical"]),
    "with wide walls": (ONE_EYE, ["lens.wall=20um"]),
    "with a rim for two eyes": (TWO_EYES, ["lens.microfacets=16"]),
    "of one facet": (ONE_EYE, ["lens.facets=1", "lens.size=3mm", "lens.wall=10um"]),
    "of few micro-facets": (ONE_EYE, ["lens.microfacets=2"]),
}
Maker = Callable[[str], Run]
Writer = Callable[[Step, Solid], Path]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Maker:
    """Runs one of the specs above, once."""

    @cache
    def make(lens: str) -> Run:
        scenario, overrides = LENSES[lens]
        folder = tmp_path_factory.mktemp("lens")
        (folder / "tiny.yaml").write_text(SPEC % scenario, encoding="utf-8")
        return run_spec(folder / "tiny.yaml", folder / "out", overrides)

    return make


@pytest.fixture
def run(made: Maker) -> Run:
    """A finished lens that is as most are."""
    return made("cut along eye rays")


@pytest.fixture
def smooth(made: Maker) -> Run:
    """A lens whose facets are the lenslets that free-form refinement starts from."""
    return made("of smooth lenslets")


@pytest.fixture
def write(run: Run, tmp_path: Path) -> Writer:
    """Writes a solid with the lens and the pictures of that run."""

    def export(exporter: Step, solid: Solid) -> Path:
        path = tmp_path / f"lens{exporter.suffix}"
        exporter.export(run.result.scene, solid, path)
        return path

    return export


def facet_vertices(run: Run, inside: int = 0) -> FloatArray:
    """(V, 3) some vertices of facets, so many micro-facets away from their edges."""
    grid = facet_grids(run.result.solid, run)
    within = slice(inside, grid.shape[1] - inside)
    return some(grid[:, within, :, within])


def middles(solid: Solid, run: Run) -> FloatArray:
    """(V, 3) middles of some micro-facets, each on the edge between its two triangles."""
    grid = facet_grids(solid, run)
    return some((grid[:, :-1, :, :-1] + grid[:, 1:, :, 1:]) / 2)


def facet_grids(solid: Solid, run: Run) -> FloatArray:
    """(N, m + 1, N, m + 1, 3) the facets' vertices."""
    n, k = run.result.scene.lens.facets, run.result.scene.lens.microfacets + 1
    assert solid.grid
    return solid.vertices[: solid.grid[0] ** 2].reshape(*solid.grid, 3)[1:-1, 1:-1].reshape(n, k, n, k, 3)


def some(points: FloatArray) -> FloatArray:
    """(60, 3) of many."""
    return np.random.default_rng(3).choice(points.reshape(-1, 3), 60)


def cube(side_mm: float = 1.0, faces: int = 12) -> Solid:
    """A box, or what is left of it without some of its triangles."""
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles: IntArray = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)
    return Solid(corners * side_mm, triangles[:faces])


@pytest.mark.parametrize("lens", LENSES)
def test_a_run_writes_one_valid_closed_solid_as_large_as_the_mesh(lens: str, made: Maker) -> None:
    run = made(lens)
    body = read(run.folder / "lens.step")
    mesh = run.result.solid
    assert body.valid
    assert body.closed_solid
    box = np.stack([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)])
    off = np.abs(body.box_mm - box)
    assert off[:, :2].max() < 1e-3
    assert off[0, 2] < 1e-6
    assert body.box_mm[1, 2] > box[1, 2] - 0.1e-3


@pytest.mark.parametrize("lens", [name for name in LENSES if name != "of few micro-facets"])
def test_volume_is_the_meshs_but_for_the_bulge_of_facets_beyond_their_micro_facets(lens: str, made: Maker) -> None:
    run = made(lens)
    body = read(run.folder / "lens.step")
    assert body.volume_mm3 == pytest.approx(run.result.solid.metrics["volume_mm3"], rel=1e-4)


@pytest.mark.parametrize("lens", LENSES)
def test_facets_pass_through_the_vertices_of_the_mesh(lens: str, made: Maker) -> None:
    run = made(lens)
    body = read(run.folder / "lens.step")
    assert body.distances_mm(facet_vertices(run)).max() < 0.1e-3 + 1e-8
    assert body.distances_mm(facet_vertices(run, inside=1) + np.array([0.0, 0.0, 1e-3])).min() > 0.3e-3


class TestSplines(ExporterContract):
    stage = Step()


class TestTriangles(ExporterContract):
    stage = Step(surface="triangles")


def assert_shell_closes(path: Path, volume_mm3: float) -> None:
    """Its faces share every edge with one other, which runs along it the other way, and all look outward.

    The polygons of their corners, which the volume is taken of, cut off the lenslets.
    """
    shell = faces(path)
    uses = [use for face in shell for use in face.edges]
    assert len(set(uses)) == len(uses)
    assert {(edge, not along) for edge, along in uses} == set(uses)
    for face in shell:
        assert [end for _, end in face.ends] == [start for start, _ in face.ends[1:] + face.ends[:1]]
        assert face.normal @ face.area > 0.99 * np.linalg.norm(face.normal) * np.linalg.norm(face.area)
    assert sum(face.cone for face in shell) == pytest.approx(volume_mm3, rel=0.05)


@pytest.mark.parametrize("lens", LENSES)
def test_the_shell_needs_no_repair(lens: str, made: Maker) -> None:
    run = made(lens)
    assert_shell_closes(run.folder / "lens.step", run.result.solid.metrics["volume_mm3"])


def test_every_facet_is_one_face_and_flat_sides_are_too(made: Maker) -> None:
    facets, walls, crossings, sides_and_floor = 36, 60, 25, 5
    body = read(made("cut along eye rays").folder / "lens.step")
    assert body.faces == facets + walls + crossings + sides_and_floor


def test_the_run_records_the_plugin_and_its_file(run: Run) -> None:
    assert "lens.step" in [artifact["path"] for artifact in run.manifest["artifacts"]]
    stage = next(stage for stage in run.manifest["stages"] if stage["kind"] == "exporter")
    assert (stage["type"], stage["plugin"].split()[0]) == ("step", "mlens-step")
    assert stage["options"] == {"surface": "splines", "tolerance": "0.0001mm", "departure": "100%"}


@pytest.mark.parametrize("surface", ["splines", "triangles"])
def test_equal_lenses_give_equal_bytes(surface: str, run: Run, write: Writer) -> None:
    exporter = Step.model_validate({"surface": surface})
    solid = run.result.solid if surface == "splines" else cube()
    first = write(exporter, solid).read_bytes()
    assert write(exporter, solid).read_bytes() == first
    assert write(exporter, replace(solid, vertices=solid.vertices * 1.01)).read_bytes() != first


def test_tolerance_buys_control_points_of_smooth_lenslets(smooth: Run, write: Writer) -> None:
    sizes, misses = [], []
    for tolerance_mm in (1e-2, 1e-4, 0.0):
        path = write(Step(tolerance=f"{tolerance_mm}mm"), smooth.result.solid)
        sizes.append(path.stat().st_size)
        misses.append(read(path).distances_mm(facet_vertices(smooth)).max())
        assert misses[-1] <= tolerance_mm + 1e-7
    assert sizes == sorted(set(sizes))
    assert misses[0] > 1e-4 > misses[1] > misses[2]


def test_free_form_facets_have_a_knot_at_every_vertex_and_smooth_ones_a_few(run: Run, smooth: Run) -> None:
    knots = [most_knots(each.folder / "lens.step") for each in (run, smooth)]
    assert knots[0] == run.result.scene.lens.microfacets + 1
    assert knots[1] < knots[0] / 3


def most_knots(path: Path) -> int:
    """How many different knots the finest B-spline surface has along one direction."""
    found = re.findall(r"B_SPLINE_SURFACE_WITH_KNOTS.*?,\(([\d.,]+)\),\(([\d.,]+)\),.UNSPECIFIED.\);", path.read_text())
    return max(len(knots.split(",")) for pair in found for knots in pair)


@pytest.mark.parametrize("lens", [name for name in LENSES if name != "of few micro-facets"])
def test_facets_stay_near_their_micro_facets_between_vertices(lens: str, made: Maker) -> None:
    run = made(lens)
    microfacet_mm = run.result.scene.lens.pitch_mm / run.result.scene.lens.microfacets
    away_mm = read(run.folder / "lens.step").distances_mm(middles(run.result.solid, run))
    assert away_mm.max() <= departure_mm(run.folder / "lens.step") < microfacet_mm
    assert np.median(away_mm) < microfacet_mm / 10


def test_uneven_vertices_are_passed_through_without_swinging_out_between_them(run: Run, write: Writer) -> None:
    mesh, uneven_mm = run.result.solid, 0.02
    assert mesh.grid
    vertices = mesh.vertices.copy()
    inner = vertices[: mesh.grid[0] ** 2].reshape(*mesh.grid, 3)[2:-2, 2:-2]
    inner[..., 2] += np.random.default_rng(5).uniform(-uneven_mm, uneven_mm, inner.shape[:2])
    rough = replace(mesh, vertices=vertices)
    path = write(Step(), rough)
    body = read(path)
    assert body.valid
    assert body.distances_mm(some(facet_grids(rough, run))).max() < 1e-7
    assert (
        body.distances_mm(middles(rough, run)).max()
        <= departure_mm(path)
        < departure_mm(run.folder / "lens.step") + 3 * uneven_mm
    )


def departure_mm(path: Path) -> float:
    """How far facets leave their micro-facets, as the header says."""
    found = re.search(r"([\d.]+)um of its micro-facets", path.read_text())
    assert found
    return float(found[1]) * 1e-3


def test_the_header_says_how_far_from_the_mesh_the_facets_are_and_neither_when_nor_where(smooth: Run) -> None:
    header = (smooth.folder / "lens.step").read_text().split("ENDSEC;")[0]
    assert "18 x 18 mm, index of refraction 1.49" in header
    found = re.search(r"facets within ([\d.]+)um of the mesh''s vertices, ([\d.]+)um of its micro-facets", header)
    assert found
    assert 0.001 < float(found[1]) <= 0.1 < float(found[2]) < 5
    assert re.findall(r"'\d{4}-.*?'", header) == ["'1980-01-01T00:00:00'"]
    assert str(smooth.folder) not in header


def test_triangles_are_the_mesh_itself(made: Maker, tmp_path: Path) -> None:
    run = made("of one facet")
    mesh = run.result.solid
    Step(surface="triangles").export(run.result.scene, mesh, tmp_path / "lens.step")
    body = read(tmp_path / "lens.step")
    assert body.valid
    assert body.closed_solid
    assert body.faces == len(mesh.faces)
    assert body.volume_mm3 == pytest.approx(mesh.metrics["volume_mm3"], rel=1e-7)
    assert_shell_closes(tmp_path / "lens.step", mesh.metrics["volume_mm3"])
    box = np.stack([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)])
    assert np.abs(body.box_mm - box).max() < 1e-6


def test_any_closed_mesh_can_be_triangles(write: Writer) -> None:
    body = read(write(Step(surface="triangles"), cube(2.0)))
    assert body.valid
    assert body.volume_mm3 == pytest.approx(8.0)


def test_the_acceptor_notices_a_missing_face(run: Run, tmp_path: Path) -> None:
    text = (run.folder / "lens.step").read_text()
    faces = text[text.index("CLOSED_SHELL('',(") + len("CLOSED_SHELL('',(") :].split(")")[0]
    (tmp_path / "open.step").write_text(text.replace(faces, faces.partition(",")[2]))
    assert not read(tmp_path / "open.step").closed_solid


def test_an_unknown_option_is_named_with_the_one_that_was_meant(tmp_path: Path) -> None:
    spec = tmp_path / "tiny.yaml"
    spec.write_text((SPEC % ONE_EYE).replace("{type: step}", "{type: step, surfaces: splines}"), encoding="utf-8")
    with pytest.raises(InputError, match=r"tiny.yaml:4: .*surfaces.*did you mean 'surface'"):
        load_plan(spec)


def without_grid(solid: Solid) -> Solid:
    return replace(solid, grid=None)


def with_a_dent_in_its_floor(solid: Solid) -> Solid:
    vertices = solid.vertices.copy()
    vertices[-1, 2] += 0.1
    return replace(solid, vertices=vertices)


def with_a_crooked_foot(solid: Solid) -> Solid:
    vertices = solid.vertices.copy()
    assert solid.grid
    vertices[solid.grid[0] ** 2 + 5, :2] += 0.1
    return replace(solid, vertices=vertices)


def with_a_hole(solid: Solid) -> Solid:
    return replace(solid, faces=solid.faces[:-1])


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (without_grid, "has lost the facets' grid"),
        (with_a_dent_in_its_floor, "does not stand on a flat rectangle"),
        (with_a_crooked_foot, "does not stand on a flat rectangle"),
        (with_a_hole, "does not stand on a flat rectangle"),
    ],
)
def test_splines_need_a_slab(spoil: Callable[[Solid], Solid], why: str, run: Run, write: Writer) -> None:
    with pytest.raises(InputError, match=f"exporter step: surface: .*{why}; the nearest is 'surface: triangles'"):
        write(Step(), spoil(run.result.solid))


def test_a_surface_too_far_from_its_micro_facets_names_the_facet_and_what_would_do(run: Run, write: Writer) -> None:
    mesh = run.result.solid
    vertices = mesh.vertices.copy()
    assert mesh.grid
    inside = 1 + 2 * 25 + 12, 1 + 4 * 25 + 12
    vertices[inside[0] * mesh.grid[1] + inside[1], 2] += 0.8
    rough = replace(mesh, vertices=vertices)
    with pytest.raises(
        InputError, match=r"departure: .*facet row 2, column 4 .*'departure: [\d.]+um' allows it"
    ) as error:
        write(Step(), rough)
    allowed = str(error.value).split("'departure: ")[1].split("'")[0]
    assert read(write(Step.model_validate({"departure": allowed}), rough)).valid


def test_too_many_triangles_are_refused(run: Run, write: Writer) -> None:
    with pytest.raises(InputError, match=r"\d+ triangles, at most 50000 .*'surface: splines'"):
        write(Step(surface="triangles"), replace(run.result.solid, faces=np.tile(cube().faces, (5000, 1))))


@pytest.mark.parametrize(
    ("mesh", "why"),
    [
        (cube(faces=11), "not closed"),
        (replace(cube(), faces=np.concatenate([cube().faces[:-1], cube().faces[-1:, ::-1]])), "not oriented"),
        (replace(cube(), vertices=cube().vertices * (1, 1, 0)), "without area"),
    ],
)
def test_triangles_must_enclose_a_solid(mesh: Solid, why: str, write: Writer) -> None:
    with pytest.raises(StageError, match=why):
        write(Step(surface="triangles"), mesh)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (Ref(12), "#12"),
        (12, "12"),
        (1.0, "1.0"),
        (-2.5e-7, "-2.5E-07"),
        (1e-7, "1.E-07"),
        (None, "$"),
        (DERIVED, "*"),
        (YES, ".T."),
        ("the mesh's", "'the mesh''s'"),
        ((1.5, [Ref(1), Ref(2)]), "(1.5,(#1,#2))"),
    ],
)
def test_parameters_are_written_as_the_standard_says(value: Parameter, text: str) -> None:
    assert encode(value) == text
