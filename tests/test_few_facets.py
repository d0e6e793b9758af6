"""Lenses of few, wide facets, which their relief limits: whatever picture they are to show, they can be built."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

from magiclens.contract.artifacts import FloatArray, Lens
from magiclens.integration.orientation_kernels import rises_along_edges
from magiclens.integration.poisson import lenslets
from magiclens.matching.reachability_kernels import _SPARE, reachable
from magiclens.optics.lenslets import tallest
from magiclens.optics.medium import Cut, Optics, optics_of
from magiclens.plan.compile import load_plan
from magiclens.running.pipeline import run_plan

SCENARIOS = {
    "single": "{type: single, source: {type: circles, seed: 7}, target: {image: a.png}}",
    "rotating": "{type: rotating, source: {type: circles, seed: 7}, targets: [{image: a.png}, {image: b.png}]}",
    "multi-view": "{type: multi-view, source: {type: circles, seed: 7}, views: ["
    "{target: {image: a.png}, eye: {tilt: 12deg, azimuth: 0deg}}, "
    "{target: {image: b.png}, eye: {tilt: 12deg, azimuth: 180deg}}]}",
}
QUICK = (
    "lens.microfacets=6",
    "pipeline.integrator.refinement=0",
    "pipeline.exporters=[{type: stl}]",
    "pipeline.renderers=[{type: tracer, resolution: 64, samples: 2}]",
    "report.analyses=[]",
)


def picture(path: Path, seed: int) -> None:
    """Blocks, clouds or discs, by chance."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:128, :128]
    if seed % 3 == 0:
        values = np.kron(rng.integers(0, 2, (8, 8)), np.ones((16, 16)))
    elif seed % 3 == 1:
        values = gaussian_filter(rng.random((128, 128)), 6)
    else:
        values = np.ones((128, 128))
        for _ in range(6):
            x, y, radius = *rng.uniform(16, 112, 2), rng.uniform(6, 30)
            values[(columns - x) ** 2 + (rows - y) ** 2 < radius**2] = rng.random()
    values = (values - values.min()) / np.ptp(values)
    Image.fromarray((255 * values).astype(np.uint8)).save(path)


def designed(scenario: str, facets: int, seed: int, folder: Path, *overrides: str) -> dict[str, float]:
    """The metrics of a lens for random pictures."""
    for k, name in enumerate(("a.png", "b.png")):
        picture(folder / name, 2 * seed + k)
    (folder / "spec.yaml").write_text(f"scenario: {SCENARIOS[scenario]}\n")
    plan = load_plan(folder / "spec.yaml", [f"lens.facets={facets}", *QUICK, *overrides])
    found: dict[str, float] = run_plan(plan, folder / "out", cache=None).manifest["metrics"]
    return found


@pytest.mark.tools
@pytest.mark.parametrize(("scenario", "facets"), [("single", 8), ("multi-view", 4)])
def test_few_facets_are_built_within_the_usual_relief(scenario: str, facets: int, tmp_path: Path) -> None:
    metrics = designed(scenario, facets, 0, tmp_path)
    assert metrics["z_max_mm"] - metrics["z_min_mm"] > 3


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("scenario", "facets"), [*itertools.product(SCENARIOS, (4, 8, 12, 20))])
def test_whatever_they_show(scenario: str, facets: int, seed: int, tmp_path: Path) -> None:
    designed(scenario, facets, seed, tmp_path)


@pytest.mark.tools
def test_a_small_relief_that_is_written_is_kept(tmp_path: Path) -> None:
    metrics = designed("single", 8, 1, tmp_path, "lens.relief=3mm", "pipeline.matcher.scales=[0.35, 1.0]")
    assert metrics["z_max_mm"] - 40 <= 3
    assert 40 - metrics["z_min_mm"] <= 3.03  # heights are measured along the eye's rays


def needed(lens: Lens, optics: Optics, offsets: FloatArray, maps: FloatArray) -> FloatArray:
    """(F,) how far the lenslets that show patches rise or fall from their means when they are integrated, mm."""
    m = lens.microfacets + 1
    heights: FloatArray = np.zeros((len(offsets), m, m))
    for _ in range(12):
        rows, columns, _held = rises_along_edges(
            heights, lens.facet_centres_mm().reshape(-1, 2), offsets, maps, lens.pitch_mm - lens.wall_mm, optics
        )
        heights = lenslets(rows, columns)
    found: FloatArray = np.abs(heights).max(axis=(1, 2))
    return found


@pytest.mark.every_third
@pytest.mark.parametrize("vertical", [False, True])
@pytest.mark.parametrize("gap", [0.0, 20.0])
@pytest.mark.parametrize("facets", [4, 8, 16])
def test_nine_points_tell_how_tall_a_lenslet_becomes(facets: int, gap: float, vertical: bool) -> None:
    rng = np.random.default_rng(facets)
    lens = Lens(100.0, 100.0, facets, 22, 40.0, gap_mm=gap, relief_mm=20.0)
    optics = optics_of(lens, Cut(np.array([*rng.uniform(-50, 50, 2), 440.0]), vertical))
    centres, half = lens.facet_centres_mm().reshape(-1, 2), lens.pitch_mm / 2
    told, true = [], []
    for _ in range(256 // facets**2 + 1):
        offsets = rng.uniform(-8, 8, centres.shape)
        scales = rng.uniform(0.15, 1.4, centres.shape) * rng.choice([-1, 1], centres.shape)
        maps = np.stack([scales[:, 0], rng.uniform(-0.3, 0.3, len(centres)), scales[:, 1]], axis=-1)
        tall = needed(lens, optics, offsets, maps)
        for f in range(len(centres)):
            patch = tuple(centres[f]), tuple(offsets[f]), tuple(maps[f])
            if reachable(*patch, half, optics):
                told.append(tallest(centres[f], offsets[f], maps[f], half, optics))
                true.append(tall[f])
                assert tall[f] <= optics.relief
                assert not reachable(*patch, half, optics._replace(relief=0.9 * told[-1]))
    ratio = np.array(true) / np.array(told)
    assert len(ratio) > 20
    assert ratio.max() < _SPARE
    assert 0.9 < np.median(ratio) <= 1.01


def test_relief_that_facets_do_not_need_changes_nothing() -> None:
    """Facets of usual lenses are too narrow to leave the usual relief, however steep they are."""
    lens = Lens(100.0, 100.0, 32, 22, 40.0)
    optics = optics_of(lens, Cut(np.array([0.0, 0.0, 440.0]), False))
    rng = np.random.default_rng(0)
    for _ in range(2000):
        centre, offset = tuple(rng.uniform(-48, 48, 2)), tuple(rng.uniform(-30, 30, 2))
        patch = centre, offset, (rng.uniform(-1.5, 1.5), rng.uniform(-0.5, 0.5), rng.uniform(-1.5, 1.5))
        free = reachable(*patch, lens.pitch_mm / 2, optics._replace(relief=1e6))
        assert reachable(*patch, lens.pitch_mm / 2, optics) == free
