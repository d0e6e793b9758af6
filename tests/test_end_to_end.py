"""Real runs of small lenses: from every shipped spec to a mesh that shows its targets."""

import hashlib
import json

import numpy as np
import pytest
import trimesh

from acceptors import volume_of_self_union
from lenses import SHIPPED, SPECS, Lenses
from magiclens import Run, load_plan
from magiclens.contract.artifacts import Assignment
from magiclens.geometry.solid import solid_from_heights
from magiclens.images import read_image, score
from magiclens.integration.poisson import Poisson
from magiclens.rendering.mitsuba import Mitsuba
from magiclens.rendering.tracer import Tracer


@pytest.fixture(scope="module")
def rotating(lenses: Lenses) -> Run:
    """A lens with two targets, rendered by both renderers."""
    return lenses.shipped("rotating")


LONG = {
    "fine-detail", "multi-pair", "multi-view", "printed-lcd", "printed-rotating", "printed-single",
    "printed-universal", "question-answer-source-optimized", "question-answer-universal", "rotating-codesign",
    "stable-zone",
}  # fmt: skip
"""Specs whose small lenses take longest; each has a sister among the others."""


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.tools] * (n in LONG)) for n in SHIPPED])
def test_the_lens_of_every_spec_is_a_solid_that_shows_its_targets(name: str, lenses: Lenses) -> None:
    run = lenses.shipped(name)
    metrics, views = run.manifest["metrics"], run.result.scene.views
    assert (metrics["watertight"], metrics["self_intersections"], metrics["bodies"]) == (1, 0, 1)
    volume, union = volume_of_self_union(run.folder / "lens.stl")
    assert abs(union / volume - 1) < 1e-6
    for k, picture in enumerate(run.result.renders["tracer"]):
        scores = [score(picture, view.target).psnr_db for view in views]
        assert scores[k] == max(scores)
        assert scores[k] > score(views[k].source, views[k].target).psnr_db


def test_every_rotation_shows_its_own_target_and_no_other(rotating: Run) -> None:
    targets = [read_image(rotating.folder / v["target"]) for v in rotating.manifest["views"]]
    for k, view in enumerate(rotating.manifest["views"]):
        for picture in view["renders"].values():
            scores = [score(read_image(rotating.folder / picture), t).psnr_db for t in targets]
            assert scores[k] > 15
            assert scores[k] > scores[1 - k] + 6


def test_the_tracer_and_mitsuba_see_the_same(rotating: Run) -> None:
    for view in rotating.manifest["views"]:
        ours, theirs = (read_image(rotating.folder / view["renders"][r]) for r in ("tracer", "mitsuba"))
        assert score(theirs, ours).psnr_db > 25


def test_the_folder_holds_what_the_contract_says_and_nothing_else(rotating: Run) -> None:
    folder = rotating.folder
    manifest = json.loads((folder / "manifest.json").read_text())
    names = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()} - {"manifest.json"}
    assert {"lens.stl", "spec.yaml", "report.html", "figures/contact-sheet.png", "figures/height-map.png"} <= names
    assert {a["path"] for a in manifest["artifacts"]} == names
    for artifact in manifest["artifacts"]:
        data = (folder / artifact["path"]).read_bytes()
        assert (hashlib.sha256(data).hexdigest(), len(data)) == (artifact["sha256"], artifact["bytes"])


def test_the_exported_mesh_is_a_solid_of_the_right_size(rotating: Run) -> None:
    mesh = trimesh.load(rotating.folder / "lens.stl")
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(rotating.manifest["metrics"]["volume_mm3"], rel=1e-6)
    top = mesh.vertices[mesh.vertices[:, 2] > 1]
    assert np.abs(top[:, 2] - 40).max() <= 5 + 1e-5


def test_the_run_folders_own_spec_gives_the_same_bytes_again(rotating: Run, lenses: Lenses) -> None:
    anew = Lenses(lenses.folder)
    again = anew.designed((rotating.folder / "spec.yaml").read_text(encoding="utf-8")).folder
    for path in rotating.folder.rglob("*"):
        if path.is_file() and path.name != "manifest.json":
            assert path.read_bytes() == (again / path.relative_to(rotating.folder)).read_bytes(), path.name


@pytest.mark.tools
@pytest.mark.parametrize("cells", ["eye", "vertical"])
def test_every_eye_sees_its_own_target_and_no_other(lenses: Lenses, cells: str) -> None:
    run = lenses.shipped("multi-view", *(["lens.cells=vertical"] if cells == "vertical" else []))
    targets = [view.target for view in run.result.scene.views]
    for k, pictures in enumerate(zip(*run.result.renders.values(), strict=True)):
        for picture in pictures:
            own, other = (score(picture, targets[i]).psnr_db for i in (k, 1 - k))
            assert own > 18
            assert own > other + 10
            # light that is reflected within the slab, which the tracer leaves out, makes black grey in some facets
            assert score(picture, pictures[0]).psnr_db > 20
    shown = np.mean([view["psnr_db"] for view in run.manifest["views"]])
    assert shown > run.manifest["metrics"]["assigned_psnr_db"] + 2, "refined facets show more than lenslets could"


def test_a_milled_lens_has_no_step_above_a_tenth_of_a_millimetre(lenses: Lenses) -> None:
    run = lenses.shipped("milled")
    assert run.manifest["metrics"]["step_max_mm"] < 0.1
    assert run.manifest["views"][0]["psnr_db"] > 15


@pytest.mark.tools
def test_a_colour_picture_comes_out_in_colour(lenses: Lenses) -> None:
    run = lenses.shipped("fine-detail")
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
    (ours,) = Tracer(resolution=64, samples=6).render(scene, solid)
    (theirs,) = Mitsuba(resolution=64, samples=1024).render(scene, solid)
    assert ours.std() > 0.1
    assert score(theirs, ours).psnr_db > 35
