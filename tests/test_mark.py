"""The mark at the foot of a lens: it stands out on the side that is up, and changes nothing that shows a picture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
import trimesh
from PIL import Image

from magiclens.contract.artifacts import BoolArray, FloatArray, Scene, Solid
from magiclens.exporting.mesh_files import Obj, Ply, Stl
from magiclens.exporting.print_page import pages
from magiclens.exporting.slices import Slices
from magiclens.exporting.three_mf import ThreeMf
from magiclens.geometry.mark import MARK_OUT_MM, MARK_WIDE_MM, mark_of
from magiclens.geometry.solid import solid_from_heights
from magiclens.meshing.validation import validate
from magiclens.preflight.body import check_body
from magiclens.preflight.mesh_file import read_mesh_file
from magiclens.rendering.tracer import trace
from scenes import ABOVE, ASIDE, Eye, grey_view, small_lens, surface

PLAIN = small_lens(4, 4.0, microfacets=10, wall_mm=0.002, thickness_mm=10.0)
MARKED = replace(PLAIN, mark=True)
EYES = pytest.mark.parametrize("eye", [ABOVE, ASIDE, None], ids=["eye", "eye aside", "vertical"])
LEANING = pytest.mark.parametrize("floor", [0.0, 30.0], ids=["steep", "leaning"])
VIEW = grey_view(np.ones((8, 8, 1), np.float32), np.ones((8, 8, 1), np.float32))


def both(eye: Eye | None = ABOVE, floor: float = 0.0) -> tuple[Solid, Solid]:
    """A bumpy lens without and with a mark."""
    heights = np.random.default_rng(0).uniform(-0.3, 0.3, (4, 4, 11, 11))
    one, other = (solid_from_heights(surface(replace(lens, floor_mm=floor), heights, eye)) for lens in (PLAIN, MARKED))
    return one, other


def bottom(solid: Solid) -> FloatArray:
    return solid.vertices[solid.vertices[:, 2] == 0]


def outline(solid: Solid) -> FloatArray:
    """The floor's points below the border of the top."""
    assert solid.grid is not None
    return bottom(solid)[: 2 * sum(solid.grid) - 4]


@EYES
@LEANING
def test_the_mark_stands_out_in_the_middle_of_the_upper_side(eye: Eye | None, floor: float) -> None:
    plain, marked = (outline(solid) for solid in both(eye, floor))
    moved = np.flatnonzero((plain != marked).any(axis=1))
    np.testing.assert_allclose(marked[moved] - plain[moved], np.tile((0.0, MARK_OUT_MM, 0.0), (len(moved), 1)))
    np.testing.assert_allclose(plain[moved, 1], plain[:, 1].max())
    middle = (plain[:, 0].min() + plain[:, 0].max()) / 2
    wide = np.ptp(plain[moved, 0])
    pitch = np.ptp(plain[:, 0]) / 40
    assert MARK_WIDE_MM - 2 * pitch < wide <= MARK_WIDE_MM
    assert plain[moved, 0].mean() == pytest.approx(middle)
    left, low, right, high = mark_of(marked)
    assert (left + right) / 2 == pytest.approx(middle)
    assert wide < right - left < wide + 3 * pitch
    assert high - low == pytest.approx(MARK_OUT_MM)


@EYES
@LEANING
def test_no_point_of_the_top_moves_and_the_body_is_sound(eye: Eye | None, floor: float) -> None:
    plain, marked = both(eye, floor)
    assert marked.grid is not None
    top = marked.grid[0] * marked.grid[1]
    np.testing.assert_array_equal(plain.vertices[:top], marked.vertices[:top])
    assert validate(marked).flaws == ()
    mesh = trimesh.Trimesh(marked.vertices, marked.faces, process=False)
    assert mesh.is_watertight
    assert mesh.euler_number == 2
    assert mesh.volume > trimesh.Trimesh(plain.vertices, plain.faces, process=False).volume


@pytest.mark.parametrize(("facets", "microfacets"), [(1, 1), (1, 2), (2, 1), (3, 1)])
def test_lenses_of_few_vertices_have_a_mark_too(facets: int, microfacets: int) -> None:
    lens = replace(MARKED, size_mm=60.0, facets=facets, microfacets=microfacets)
    solid = solid_from_heights(surface(lens, np.zeros(1), None))
    assert validate(solid).flaws == ()
    assert bottom(solid)[:, 1].max() == pytest.approx(30 + MARK_OUT_MM)
    assert bottom(solid)[:, 0].max() == pytest.approx(30)


def test_it_prints_flat_side_down_without_supports() -> None:
    """Nothing but the bottom faces down: from the foot up the body only gets narrower."""
    _, marked = both()
    normals = trimesh.Trimesh(marked.vertices, marked.faces, process=False).face_normals
    side = (marked.vertices[marked.faces][..., 2] == 0).sum(axis=1) % 3 > 0
    assert normals[side, 2].min() > 0


def test_an_eye_sees_the_same_through_the_lens() -> None:
    hits = [trace(solid, lens, VIEW, 64, 2) for solid, lens in zip(both(), (PLAIN, MARKED), strict=True)]
    np.testing.assert_array_equal(*hits)


def test_the_sheets_outline_is_that_of_the_foot_without_the_mark() -> None:
    plain, marked = both()
    one, other = pages(Scene(PLAIN, (VIEW,)), plain), pages(Scene(MARKED, (VIEW,)), marked)
    assert one[0].outlines == other[0].outlines


@pytest.mark.parametrize("exporter", [Stl(), Ply(), Obj(), ThreeMf()], ids=lambda each: each.type)
def test_mesh_files_hold_it_and_are_closed(exporter: Stl | Ply | Obj | ThreeMf, tmp_path: Path) -> None:
    plain, marked = both()
    exporter.export(Scene(MARKED, (VIEW,)), marked, tmp_path / f"lens{exporter.suffix}")
    file = read_mesh_file(tmp_path / f"lens{exporter.suffix}")
    assert {finding.status for finding in check_body(file, MARKED, np.array(ABOVE))} == {"green"}
    assert file.extent_mm[1, 1] == pytest.approx(plain.vertices[:, 1].max() + MARK_OUT_MM, abs=1e-4)


@pytest.mark.parametrize("slicing", ["plain", "diffused"])
def test_layers_hold_it_from_the_foot_up(slicing: str, tmp_path: Path) -> None:
    _, marked = both(None)
    Slices(dpi_x=127, dpi_y=127, layer="0.5mm", slicing=slicing).export(Scene(MARKED, (VIEW,)), marked, tmp_path / "s")
    with ZipFile(tmp_path / "s") as archive:
        low, high = (beyond(archive, name) for name in ("layer-00000.png", "layer-00017.png"))
    # pixels of 0.2 mm: six rows stand out, 15 pixels wide; near the top about one row is left
    assert (low.any(axis=1).sum(), low[1].sum()) == (6, pytest.approx(15, abs=2))
    assert high.any(axis=1).sum() <= 2


def beyond(archive: ZipFile, name: str) -> BoolArray:
    """The rows of a layer above those that are as wide as the lens."""
    with archive.open(name) as file:
        filled = np.asarray(Image.open(file))
    return filled[: int(np.flatnonzero(filled.sum(axis=1) > 40)[0])]
