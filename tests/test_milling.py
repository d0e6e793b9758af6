"""Cutters on surfaces: where they may go, what they leave, and what whole programs make of a lens."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fabricated import EYE, LENS, Eye, bumpy, flat
from magiclens.contract.artifacts import FloatArray, Solid
from magiclens.geometry.columns import top_heights
from magiclens.milling.border import inner_rectangle, outer_rectangle, top_vertices
from magiclens.milling.cutter import Cutter
from magiclens.milling.gcode import Gcode
from magiclens.milling.offset import Contacts
from magiclens.milling.rml import Rml
from magiclens.milling.scallop import scallop_mm
from magiclens.milling.sweep import swept
from magiclens.simulation.machined_surface import machined_surface, reachable_surface
from magiclens.simulation.machining import run_programs
from milled import BALL, FLAT, POINTED, V, cutter, groove, machined, waves

SHAPES = pytest.mark.parametrize("shape", [BALL, FLAT, V, POINTED], ids=["ball", "flat", "v", "pointed"])
ASIDE = (60.0, 0.0, 60.0)


def rise(shape: Cutter, r: FloatArray) -> FloatArray:
    """Height of a cutter's surface above its tip at a distance from its axis, from its description."""
    radius, tip = shape.diameter / 2, shape.tip_mm / 2
    if shape.shape == "flat":
        z = np.zeros_like(r)
    elif shape.shape == "ball":
        z = radius - np.sqrt(np.maximum(radius**2 - r**2, 0))
    else:
        half = math.radians(shape.angle_deg / 2)
        ball = tip - np.sqrt(np.maximum(tip**2 - r**2, 0))
        knee = tip * math.cos(half)
        z = np.where(r <= knee, ball, tip * (1 - math.sin(half)) + (r - knee) / math.tan(half))
    return np.where(r <= radius, z, np.inf)


def plane(slope: float) -> Solid:
    """A slab whose top climbs along +y."""
    solid = flat()
    return Solid(solid.vertices + solid.vertices[:, 1:2] * [0, 0, slope], solid.faces, solid.grid, None)


@SHAPES
def test_on_a_level_plane_the_tip_is_at_the_surface(shape: dict[str, Any]) -> None:
    x = np.linspace(-2, 2, 9)
    z = Contacts(flat(), cutter(shape).outline()).tips(x, x, 0.0)
    np.testing.assert_allclose(z, LENS.thickness_mm, atol=1e-12)


@pytest.mark.parametrize(
    ("shape", "above"),
    [
        (BALL, lambda s: 0.5 * (math.hypot(1, s) - 1)),
        (FLAT, lambda s: 0.5 * s),
        (V, lambda s: 0.05 * (math.hypot(1, s) - 1)),
        (POINTED, lambda s: 0.0),
    ],
    ids=["ball", "flat", "v", "pointed"],
)
def test_on_a_slope_the_tip_is_as_high_above_it_as_its_shape_demands(shape: dict[str, Any], above: Any) -> None:
    y = np.linspace(-2, 2, 5)
    z = Contacts(plane(0.3), cutter(shape).outline()).tips(np.array([-1.0, 0.0, 1.0]), y, 0.0)
    np.testing.assert_allclose(z, (LENS.thickness_mm + 0.3 * y + above(0.3))[:, None] + [0, 0, 0], atol=1e-9)


def test_ridges_of_a_ball_on_a_plane_are_the_textbooks() -> None:
    assert scallop_mm(cutter(BALL).outline(), 0.1) == pytest.approx(0.5 - math.sqrt(0.25 - 0.05**2), rel=1e-9)


@pytest.mark.parametrize(
    ("shape", "slope", "height"),
    [
        (POINTED, 0.0, 0.05 * math.sqrt(3)),
        (FLAT, 0.0, 0.0),
        (FLAT, 0.2, 0.02),
        (BALL, 0.75, (0.5 - math.sqrt(0.25 - 0.0625**2)) * 1.25),
        ({**BALL, "diameter": "0.05mm"}, 0.0, math.inf),
    ],
    ids=["pointed", "flat", "flat on a slope", "ball on a slope", "strips between"],
)
def test_ridges_in_closed_form(shape: dict[str, Any], slope: float, height: float) -> None:
    assert scallop_mm(cutter(shape).outline(), 0.1, slope) == pytest.approx(height, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(
    ("shape", "slope", "left"),
    [
        (POINTED, 1.0, 0.0),
        (POINTED, 2.0, None),
        (V, 1.0, 0.05 * (math.sqrt(2) - 1)),
        (BALL, 1.0, 0.5 * (math.sqrt(2) - 1)),
        (FLAT, 1.0, 0.5),
    ],
    ids=["pointed fits", "pointed is too blunt", "round tip", "ball", "flat"],
)
def test_what_a_cutter_leaves_in_a_groove(shape: dict[str, Any], slope: float, left: float | None) -> None:
    """Flanks of a 60 degree cutter have a slope of 1.73: in a steeper groove its rim touches first."""
    expected = 1.0 * (2.0 - math.sqrt(3)) if left is None else left
    lines = np.linspace(-0.05, 0.05, 5)
    z = reachable_surface(groove(slope), cutter(shape), lines, -lines)
    assert z[:, 2].max() - LENS.thickness_mm == pytest.approx(expected, abs=2e-3)


@SHAPES
def test_swept_surfaces_are_the_minimum_over_all_positions(shape: dict[str, Any]) -> None:
    tool, rng = cutter(shape), np.random.default_rng(3)
    moves = rng.uniform([-1, -1, 0], [1, 1, 0.5], (12, 2, 3))
    moves[0, 1, :2] = moves[0, 0, :2]  # a plunge
    x = np.linspace(-1.2, 1.2, 23)
    z = swept(tool.outline(), moves, x, x, np.full((23, 23), 2.0))
    way = np.linspace(0, 1, 4001)[:, None]
    at = np.concatenate([start + way * (end - start) for start, end in moves])
    px, py = np.meshgrid(x, x)
    expected = np.full(px.shape, 2.0)
    for k, (u, v) in enumerate(zip(px.ravel(), py.ravel(), strict=True)):
        lowest = (at[:, 2] + rise(tool, np.hypot(at[:, 0] - u, at[:, 1] - v))).min()
        expected.ravel()[k] = min(2.0, lowest)
    tight = np.abs(z - expected) < 2e-3
    assert (z <= expected + 1e-9).all()
    assert tight.mean() > 0.97  # rims are upright: there, samples miss what the true sweep cuts


@pytest.mark.every_third
@SHAPES
@pytest.mark.parametrize("eye", [None, EYE, ASIDE], ids=["vertical", "eye", "undercut"])
def test_nothing_of_a_rough_lens_is_cut_away(shape: dict[str, Any], eye: Eye, tmp_path: Path) -> None:
    fit = machined(Gcode(cutter=shape, stepover="0.1mm"), tmp_path, bumpy(eye)).fit
    assert fit.gouge_mm <= 0.001
    assert 0 < fit.left_mm <= fit.stated_mm
    assert fit.unreached_share > 0.05


def test_a_gouge_is_noticed(tmp_path: Path) -> None:
    """Else the test above would prove nothing: a program for another lens, which is lower here and there."""
    other = machined(Gcode(stepover="0.1mm"), tmp_path, bumpy(None, seed=6)).programs
    assert run_programs(other, bumpy(None)).fit.gouge_mm > 0.1


@pytest.mark.every_third
@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("shape", [BALL, FLAT, V], ids=["ball", "flat", "v"])
def test_a_smooth_lens_is_reached_but_for_the_stated_ridges(shape: dict[str, Any], axis: Any, tmp_path: Path) -> None:
    made = machined(Gcode(cutter=shape, stepover="0.08mm", axis=axis), tmp_path, waves())
    assert made.fit.gouge_mm <= 0.001
    assert made.fit.left_mm <= made.fit.stated_mm < 0.06
    cuts = made.programs[0].moves.cutting(2)
    along = np.abs(cuts[:, 1] - cuts[:, 0]).sum(axis=0)
    assert along["xy".index(axis)] > 20 * along["yx".index(axis)]


def test_ridges_between_lines_have_their_height(tmp_path: Path) -> None:
    """A plate that is thicker than a flat lens, so that the whole lens is planed down."""
    exporter = Gcode(cutter=BALL, stepover="0.2mm", stock="9mm", rougher=None)
    made = machined(exporter, tmp_path, flat())
    z = top_vertices(made.solid)[..., 2]
    ridge = scallop_mm(cutter(BALL).outline(), 0.2)
    assert z.min() == pytest.approx(LENS.thickness_mm, abs=2e-4)
    assert z.max() - z.min() == pytest.approx(ridge, rel=0.03)
    assert made.fit.left_mm <= made.fit.stated_mm <= ridge + 0.001


@SHAPES
def test_roughing_leaves_its_allowance(shape: dict[str, Any], tmp_path: Path) -> None:
    solid = bumpy(None)
    exporter = Gcode(operation="roughing", rougher=shape, cutter=shape, allowance="0.2mm", rough_stepover="0.1mm")
    made = machined(exporter, tmp_path, solid)
    x0, x1, y0, y1 = inner_rectangle(solid)
    x, y = np.linspace(x0, x1, 40), np.linspace(y1, y0, 40)
    above = machined_surface(made.programs, x, y) - top_heights(solid, x, y)
    top = made.programs[0].setup.zero_mm[2]
    kept = np.minimum(0.2, top - top_heights(solid, x, y))
    assert (above >= kept - 1e-3).all()
    assert made.fit.stated_mm == math.inf


def test_roughing_takes_no_more_than_a_level_at_a_time(tmp_path: Path) -> None:
    exporter = Gcode(operation="roughing", rougher=BALL, rough_stepdown="0.15mm")
    made = machined(exporter, tmp_path, bumpy(None))
    moves = made.programs[0].moves
    lifted = np.flatnonzero(moves.points[:, 2] >= exporter.safe_height)
    depths = [-moves.points[a:b, 2].min() for a, b in pairwise(lifted) if b > a + 1]
    assert len(depths) > 5
    assert depths[0] == pytest.approx(0.15)
    deepest = np.maximum.accumulate(depths)
    assert (np.diff(deepest) <= 0.15 + 1e-9).all()


@pytest.mark.parametrize("exporter", [Gcode, Rml])
def test_tiles_join_to_the_same_lens(exporter: Any, tmp_path: Path) -> None:
    solid, options = waves(), {"cutter": BALL, "stepover": "0.1mm", "rougher": None}
    whole = machined(exporter(**options), tmp_path / "whole", solid)
    tiled = machined(exporter(**options, bed=("4mm", "3.5mm")), tmp_path / "tiled", solid)
    assert (len(whole.programs), len(tiled.programs)) == (1, 4)
    for program in tiled.programs:
        assert (np.ptp(program.moves.points[:, :2], axis=0) <= [4.0, 3.5]).all()
    assert tiled.fit.left_mm <= tiled.fit.stated_mm
    x0, x1, y0, y1 = outer_rectangle(solid)
    x, y = np.linspace(x0, x1, 61), np.linspace(y1, y0, 61)
    a, b = (machined_surface(made.programs, x, y) for made in (whole, tiled))
    np.testing.assert_allclose(a, b, atol=2 * exporter.step_mm + 0.001)


def test_the_machined_solid_is_closed_and_stands_where_the_lens_stood(tmp_path: Path) -> None:
    from trimesh import Trimesh

    solid = waves()
    made = machined(Gcode(cutter=BALL, stepover="0.2mm"), tmp_path, solid).solid
    mesh = Trimesh(made.vertices, made.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(Trimesh(solid.vertices, solid.faces, process=False).volume, rel=0.01)
    assert outer_rectangle(made) == pytest.approx(outer_rectangle(solid))


def test_a_finer_tolerance_takes_more_moves(tmp_path: Path) -> None:
    """Straight runs are one move each, however finely the surface was looked at."""
    counts = []
    for k, tolerance in enumerate(("0.01mm", "0.001mm", "0.0002mm")):
        exporter = Gcode(cutter=BALL, stepover="0.2mm", rougher=None, tolerance=tolerance)
        made = machined(exporter, tmp_path / str(k), waves())
        assert made.fit.left_mm <= made.fit.stated_mm
        counts.append(len(made.programs[0].moves.points))
    assert counts[0] < counts[1] < counts[2]
    planed = machined(Gcode(cutter=BALL, stepover="0.2mm", stock="9mm", rougher=None), tmp_path / "plane", flat())
    lines = len(np.unique(planed.programs[0].moves.points[:, 1]))
    assert len(planed.programs[0].moves.points) < 12 * lines
