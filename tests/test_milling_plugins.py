"""Milling exporters of plugins are simulated as built-in ones are: their own programs are asked of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from magiclens import (
    Cutter,
    InputError,
    Length,
    LineMilling,
    MillingExporter,
    MillingProgram,
    MillingSetup,
    Moves,
    Scene,
    Solid,
    StageError,
    builtin,
    load_plan,
    run_plan,
)
from magiclens.milling.exporter import first_of, numbered
from magiclens.plan.registry import Plugin, Registry
from magiclens.running.milling_simulation import simulate_milling
from toys import TOY_PLUGIN, plugin_of


class Table(LineMilling):
    """The built-in toolpaths as a table: x, y, z, feed and tool of each move."""

    type: ClassVar[str] = "table"
    suffix: ClassVar[str] = ".moves.tsv"
    step_mm: ClassVar[float] = 0.001

    def write(self, program: MillingProgram, comments: list[str]) -> str:
        moves = program.moves
        rows = zip(moves.points.tolist(), moves.feed.tolist(), moves.tool.tolist(), strict=True)
        return "".join(f"{x:.3f}\t{y:.3f}\t{z:.3f}\t{feed:g}\t{tool}\n" for (x, y, z), feed, tool in rows)

    def parse(self, text: str, setup: MillingSetup) -> Moves:
        rows = np.array([line.split("\t") for line in text.splitlines()], float)
        if rows.shape[1] != 5:
            raise InputError(f"{rows.shape[1]} columns instead of 5")
        return Moves(rows[:, :3], rows[:, 3], rows[:, 4].astype(int))


class Planer(MillingExporter):
    """A toolpath of its own, which planes the plate down to the highest point of the lens."""

    type: ClassVar[str] = "planer"
    suffix: ClassVar[str] = ".npy"

    depth: Length = "1mm"
    cutter: ClassVar[Cutter] = Cutter.model_validate({"shape": "flat", "diameter": "2mm"})

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        top = solid.vertices[:, 2].max() + self.depth
        half = scene.lens.size_mm / 2 + 2
        y = np.arange(-half, half, 1.0)
        x = np.where(np.arange(len(y)) % 2, half, -half)
        line = [[(a, b, -self.depth), (-a, b, -self.depth)] for a, b in zip(x, y, strict=True)]
        points = [(x[0], y[0], 5.0), *np.reshape(line, (-1, 3))]
        np.save(path, np.vstack([points, np.full((1, 3), top)]))

    def read_program(self, path: Path) -> MillingProgram:
        *points, (top, _, _) = np.load(path)
        feed = np.r_[0.0, np.full(len(points) - 1, 600.0)]
        moves = Moves(np.array(points), feed, np.ones(len(points), int))
        return MillingProgram(moves, MillingSetup({"finishing": (1, self.cutter)}, (0.0, 0.0, float(top))))


class Broken(Planer):
    """Cannot read what it has written."""

    type: ClassVar[str] = "broken"

    def read_program(self, path: Path) -> MillingProgram:
        raise RuntimeError("worn out")


SPEC = """\
scenario:
  type: single
  source: {type: art, name: heart}
  target: {art: heart}
lens: {size: 8mm, facets: 2, microfacets: 4, thickness: 8mm, relief: 3mm, gap: 20mm}
viewer: {distance: 100mm}
pipeline:
  matcher: {scales: [1.0], candidates: 1}
  exporters: [{type: stl}, %s]
  renderers: []
report: {analyses: []}
"""


@pytest.fixture
def plugins() -> Registry:
    """What is built in, and the exporters above."""
    registry = Registry()
    registry.register(builtin, Plugin("builtin", "magiclens", "0.1.0"))
    registry.register(plugin_of(Table, Planer, Broken), TOY_PLUGIN)
    return registry


def run_with(exporter: str, registry: Registry, folder: Path) -> Path:
    """A run folder that this exporter has written to."""
    (folder / "small.yaml").write_text(SPEC % exporter)
    return run_plan(load_plan(folder / "small.yaml", registry=registry), folder / "out").folder


BALL = "{shape: ball, diameter: 1mm}"


@pytest.mark.tools
def test_a_plugins_language_is_read_back_and_simulated(plugins: Registry, tmp_path: Path) -> None:
    tiled = f"{{type: table, cutter: {BALL}, rougher: null, stepover: 0.2mm, stock: 11mm, bed: [7mm, 20mm]}}"
    folder = run_with(tiled, plugins, tmp_path)
    report = simulate_milling(folder, plugins)
    assert report.programs == ("lens.moves.tsv", "lens.moves-2.tsv")
    assert report.gouge_um < 1.5  # a step of the table is a micrometre
    assert 0 < report.left_um <= report.stated_um
    assert report.faults == ()
    manifest = json.loads((folder / "manifest.json").read_text())
    files = {file["path"] for file in manifest["artifacts"]}
    assert {"lens.moves.tsv", "lens.moves-2.tsv", "lens.moves.tsv.txt", "machined/single.png"} <= files
    assert TOY_PLUGIN.package in manifest["versions"]


@pytest.mark.tools
def test_a_plugins_own_toolpath_is_simulated(plugins: Registry, tmp_path: Path) -> None:
    report = simulate_milling(run_with("{type: planer, depth: 0.5mm}", plugins, tmp_path), plugins)
    assert report.programs == ("lens.npy",)
    assert report.gouge_um < 1e-3
    assert report.left_um > 0
    assert report.length_mm > 8 * 8
    assert set(report.psnr_db["single"]) == {"designed", "as cut", "polished"}


def test_a_plugin_that_cannot_read_its_program_is_named_and_leaves_nothing(plugins: Registry, tmp_path: Path) -> None:
    folder = run_with("{type: broken}", plugins, tmp_path)
    before = sorted(folder.rglob("*"))
    with pytest.raises(StageError, match=r"exporter broken \(magiclens-toys 1\.2\) failed: RuntimeError: worn out"):
        simulate_milling(folder, plugins)
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize("name", ["lens.ngc", "lens.moves.tsv", "lens.two-axis.nc"])
def test_numbered_programs_know_the_first_one(name: str) -> None:
    path = Path("folder", name)
    assert numbered(path, 1) == path
    further = numbered(path, 12)
    assert further.name.startswith("lens")
    assert further.suffix == path.suffix
    assert first_of(further) == first_of(path) == path
