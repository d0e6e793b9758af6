"""Real runs of small lenses: from a spec to a mesh that shows the target."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from magiclens import load_plan, run_spec
from magiclens.contract.artifacts import Assignment
from magiclens.geometry.solid import solid_from_heights
from magiclens.images import read_image, score
from magiclens.integration.poisson import Poisson
from magiclens.rendering.mitsuba import Mitsuba
from magiclens.rendering.tracer import Tracer

SPECS = Path(__file__).parent.parent / "specs"
SMALL = ["lens.facets=12", "lens.microfacets=16", "lens.size=40mm", "pipeline.finisher={type: pymeshlab}"]
RENDERERS = "[{type: tracer, resolution: 192, samples: 4}, {type: mitsuba, resolution: 192, samples: 256}]"
MITSUBA = f"pipeline.renderers={RENDERERS}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small rotating lens, rendered by both renderers."""
    out = tmp_path_factory.mktemp("run") / "rotating"
    targets = "scenario.targets=[{art: heart}, {art: star}]"
    run_spec(SPECS / "rotating.yaml", out, [*SMALL, targets, "scenario.angles=[0deg, 90deg]", MITSUBA])
    return out


@pytest.fixture(scope="module")
def manifest(folder: Path) -> dict:
    return json.loads((folder / "manifest.json").read_text())


def test_every_rotation_shows_its_own_target_and_no_other(folder: Path, manifest: dict) -> None:
    targets = [read_image(folder / v["target"]) for v in manifest["views"]]
    for k, view in enumerate(manifest["views"]):
        for picture in view["renders"].values():
            scores = [score(read_image(folder / picture), t).psnr_db for t in targets]
            assert scores[k] > 15
            assert scores[k] > scores[1 - k] + 6


def test_the_tracer_and_mitsuba_see_the_same(folder: Path, manifest: dict) -> None:
    for view in manifest["views"]:
        ours, theirs = (read_image(folder / view["renders"][r]) for r in ("tracer", "mitsuba"))
        assert score(theirs, ours).psnr_db > 28


def test_the_folder_holds_what_the_contract_says_and_nothing_else(folder: Path, manifest: dict) -> None:
    names = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()} - {"manifest.json"}
    assert {"lens.stl", "spec.yaml", "report.html", "figures/contact-sheet.png", "figures/height-map.png"} <= names
    assert {a["path"] for a in manifest["artifacts"]} == names
    for artifact in manifest["artifacts"]:
        data = (folder / artifact["path"]).read_bytes()
        assert (hashlib.sha256(data).hexdigest(), len(data)) == (artifact["sha256"], artifact["bytes"])


def test_the_exported_mesh_is_a_solid_of_the_right_size(folder: Path, manifest: dict) -> None:
    mesh = trimesh.load(folder / "lens.stl")
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(manifest["metrics"]["volume_mm3"], rel=1e-6)
    top = mesh.vertices[mesh.vertices[:, 2] > 1]
    assert np.abs(top[:, 2] - 40).max() <= 5 + 1e-5
    assert manifest["metrics"]["self_intersections"] == 0


def test_the_run_folders_own_spec_gives_the_same_bytes_again(folder: Path, tmp_path: Path) -> None:
    run_spec(folder / "spec.yaml", tmp_path / "again")
    for path in folder.rglob("*"):
        if path.is_file() and path.name != "manifest.json":
            assert path.read_bytes() == (tmp_path / "again" / path.relative_to(folder)).read_bytes(), path.name


@pytest.mark.parametrize(
    ("cells", "others"), [("eye", ", {type: mitsuba, resolution: 192, samples: 64}"), ("vertical", "")]
)
def test_every_eye_sees_its_own_target_and_no_other(tmp_path: Path, cells: str, others: str) -> None:
    small = [
        f"lens={{size: 30mm, facets: 12, microfacets: 12, cells: {cells}}}",
        "scenario.source={type: circles, seed: 7, size: 60mm}",
        "scenario.views.0.target={art: heart}",
        "scenario.views.1.target={art: star}",
        "pipeline.matcher={type: multi-view, window: 6mm, step: 0.3mm, scales: [0.15, 0.5], candidates: 25}",
        f"pipeline.renderers=[{{type: tracer, resolution: 192}}{others}]",
    ]
    run = run_spec(SPECS / "multi-view.yaml", tmp_path / "views", small)
    targets = [view.target for view in run.result.scene.views]
    for k, pictures in enumerate(zip(*run.result.renders.values(), strict=True)):
        for picture in pictures:
            own, other = (score(picture, targets[i]).psnr_db for i in (k, 1 - k))
            assert own > 18
            assert own > other + 10
            assert score(picture, pictures[0]).psnr_db > 22
    metrics = run.manifest["metrics"]
    shown = np.mean([view["psnr_db"] for view in run.manifest["views"]])
    assert shown > metrics["assigned_psnr_db"] + 2, "refined facets show more than lenslets could"
    assert metrics["watertight"] == 1
    assert metrics["self_intersections"] == 0


def test_a_milled_lens_has_no_step_above_a_tenth_of_a_millimetre(tmp_path: Path) -> None:
    small = ["lens.facets=12", "lens.size=40mm", "scenario.target={art: heart}"]
    less = ["pipeline.renderers=[{type: tracer}]", "pipeline.exporters=[{type: stl}]"]
    run = run_spec(SPECS / "milled.yaml", tmp_path / "milled", [*small, *less])
    assert run.manifest["metrics"]["step_max_mm"] < 0.1
    assert run.manifest["views"][0]["psnr_db"] > 18


def test_a_colour_picture_comes_out_in_colour(tmp_path: Path) -> None:
    small = ["lens.facets=32", "lens.microfacets=4", "pipeline.renderers=[{type: tracer, resolution: 128}]"]
    run = run_spec(SPECS / "fine-detail.yaml", tmp_path / "colour", small)
    (picture,) = run.result.renders["tracer"]
    assert picture.shape == (128, 128, 3)
    target = run.result.scene.views[0].target
    assert score(picture, target).psnr_db > 3 + score(picture[..., ::-1], target).psnr_db


def test_on_a_smooth_lens_the_tracer_and_mitsuba_are_alike() -> None:
    """One lenslet over the whole slab: no walls, so only Mitsuba's noise and its stray light are left."""
    one = ["lens.facets=1", "lens.microfacets=64", "lens.size=30mm", "scenario.source={type: circles, size: 40mm}"]
    scene = load_plan(SPECS / "single.yaml", one).scene()
    offset, magnified = np.array([[[1.0, 0.5]]]), np.array([[[0.8, 0.05, 0.9]]])
    gentle = Assignment(np.zeros((1, 1), np.int64), offset, magnified, np.zeros((1, 1)))
    solid = solid_from_heights(Poisson().integrate(scene, gentle))
    (ours,) = Tracer(resolution=128, samples=6).render(scene, solid)
    (theirs,) = Mitsuba(resolution=128, samples=1024).render(scene, solid)
    assert ours.std() > 0.1
    assert score(theirs, ours).psnr_db > 35
