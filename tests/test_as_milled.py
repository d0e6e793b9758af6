"""What a mill makes of a lens: fillets where its cutter does not fit, polishing, and what that costs the picture.

Tools tier: its kernels take longest to compile, and are no other file's.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fabricated import Eye, bumpy, flat
from magiclens.contract.artifacts import FloatArray, HeightField, Lens, Solid
from magiclens.geometry.columns import top_heights
from magiclens.geometry.solid import solid_from_heights
from magiclens.meshing.validation import validate
from magiclens.milling.border import outer_rectangle, top_vertices
from magiclens.profiles.machines import Mill, machines
from magiclens.rendering.tracer import Tracer
from magiclens.simulation.as_made import as_made
from magiclens.simulation.as_milled import COARSE_MM, as_milled
from magiclens.simulation.machined_surface import reachable_surface
from magiclens.simulation.strips import seen_in_strips, traceable
from milled import BALL, FLAT, V, cutter, waves
from milled import WAVES as SMALL
from test_printed import scene_of

SHAPES = pytest.mark.parametrize("shape", [BALL, FLAT, V], ids=["ball", "flat", "v"])


def mill(shape: dict[str, Any], stepover: str = "0.001mm") -> Mill:
    """The EGX-600 with another cutter; polishing its lines away evens out over half a stepover."""
    profile = machines()["egx-600"]
    options = {name: value for name, value in profile.options.items() if name not in ("tip", "angle")}
    named = {"cutter" if name == "shape" else name: value for name, value in shape.items()}
    machine = profile.model.model_validate({**options, **named, "stepover": stepover})
    assert isinstance(machine, Mill)
    return machine


def top(solid: Solid | None) -> tuple[FloatArray, FloatArray, FloatArray]:
    """x (columns,), y (rows,) and z (rows, columns) of a top's grid."""
    assert solid is not None
    points = top_vertices(solid)
    return points[0, :, 0], points[:, 0, 1], points[..., 2]


def cliff(step_mm: float) -> Solid:
    """Two columns of flat facets, the right ones higher."""
    heights = np.zeros((2, 2, 9, 9))
    heights[:, 1] = step_mm
    return solid_from_heights(HeightField(SMALL, heights, None))


@SHAPES
@pytest.mark.parametrize(
    "solid",
    [pytest.param(waves(), id="waves", marks=pytest.mark.tools), pytest.param(bumpy(None, 3, SMALL), id="steps")],
)
@pytest.mark.tools
def test_a_raster_agrees_with_the_exact_envelope(solid: Solid, shape: dict[str, Any]) -> None:
    """The closing by lines, of the mesh itself, on a patch; steps fall between the raster's points."""
    x, y, z = top(as_milled(solid, mill(shape)))
    columns, rows = (slice(k, k + 20) for k in (len(x) // 3, len(y) // 3))
    exact = reachable_surface(solid, cutter(shape), x[columns], y[rows])
    off = np.abs(z[rows, columns] - exact)
    assert np.median(off) < 0.005
    assert off.mean() < 0.01


@pytest.mark.tools
def test_at_a_cliffs_foot_the_tips_ball_leaves_its_own_arc() -> None:
    """A tip of radius r that leans on a cliff of height h < r touches the ground sqrt(2 r h - h^2) away from it."""
    radius, step = 0.25, 0.1
    x, _, z = top(as_milled(cliff(step), mill({**BALL, "diameter": "0.5mm"})))
    profile = z[len(z) // 2] - SMALL.thickness_mm
    foot = -((2 * radius * step - step**2) ** 0.5)

    def arc(beside: FloatArray) -> FloatArray:
        return np.asarray(radius - np.sqrt(radius**2 - np.clip(beside - foot, 0, -foot) ** 2))

    low = (x < -COARSE_MM) & (x > -2.9)
    assert (profile[low] <= arc(x + COARSE_MM)[low] + 1e-5).all()
    assert (profile[low] >= arc(x - COARSE_MM)[low] - 1e-5).all()
    assert profile[(x > COARSE_MM) & (x < 2.9)] == pytest.approx(step, abs=1e-5)


@pytest.mark.tools
def test_what_fits_is_cut_as_designed_and_polishing_rounds_it() -> None:
    inside = slice(30, -30)
    x, y, z = top(as_milled(flat(SMALL), mill(BALL)))
    assert z[inside, inside] == pytest.approx(SMALL.thickness_mm, abs=1e-5)
    x, y, raw = top(as_milled(waves(), mill(V)))
    assert np.abs(raw - top_heights(waves(), x, y))[inside, inside].max() < 1e-3
    sharp, round_ = (top(as_milled(cliff(0.1), mill(V, over)))[2][:, inside] for over in ("0.001mm", "0.1mm"))
    assert np.abs(np.diff(round_)).max() < 0.5 * np.abs(np.diff(sharp)).max()


@pytest.mark.tools
def test_a_milled_lens_is_a_closed_body() -> None:
    made = as_milled(bumpy(lens=SMALL), mill(V, "0.04mm"))
    assert made is not None
    findings = validate(made)
    assert findings.flaws == ()
    assert findings.metrics["bodies"] == 1


@pytest.mark.parametrize("eye", [(0.0, 0.0, 108.0), (30.0, -20.0, 108.0)], ids=["above", "aside"])
@pytest.mark.tools
def test_strips_put_together_are_the_whole_picture(eye: Eye) -> None:
    """Light bends from one strip into the next, and an eye aside sees a strip's rows elsewhere at other heights."""
    design, scene, tracer = waves(), scene_of(SMALL), Tracer(resolution=96, samples=2)
    views = tuple(replace(scene.views[0], eye_mm=np.array(eye), rotation_deg=turn) for turn in (0.0, 90.0))
    scene = replace(scene, views=views)
    asked = []

    def surface(x: FloatArray, y: FloatArray) -> list[FloatArray]:
        asked.append(len(y))
        z = top_heights(design, x, y)
        return [z, z - 0.4]

    low, high = seen_in_strips(scene, design, surface, (0.02, 0.02), tracer, strip_points=20_000)
    assert len(asked) > 4
    x0, x1, y0, y1 = outer_rectangle(design)
    floor = design.vertices[top_vertices(design)[..., 0].size :]
    x, y = np.arange(x0, x1, 0.02), np.arange(y0, y1, 0.02)[::-1]
    for seen, lift in ((low, 0.0), (high, -0.4)):
        whole = tracer.render(scene, traceable(x, y, top_heights(design, x, y) + lift, floor))
        for part, picture in zip(seen, whole, strict=True):
            assert (np.abs(part - picture) > 1e-4).mean() < 1e-3
    assert np.abs(low[0] - high[0]).mean() > 1e-3


@pytest.mark.tools
def test_what_would_be_too_coarse_to_be_true_is_not_simulated() -> None:
    large = Lens(size_mm=200.0, source_size_mm=200.0, facets=2, microfacets=2, thickness_mm=8.0)
    assert as_made(mill(V), scene_of(large), flat(large)) is None


@pytest.mark.sweep
def test_blunt_cutters_cost_more() -> None:
    design = bumpy(lens=SMALL, seed=1)
    scene = scene_of(SMALL)
    costs = [as_made(mill({**V, "tip": tip}, "0.05mm"), scene, design) for tip in ("0.02mm", "0.2mm", "1mm")]
    shown = [np.abs(c.pictures[0] - costs[0].pictures[0]).mean() for c in costs if c and costs[0]]
    assert shown[0] < shown[1] < shown[2]
