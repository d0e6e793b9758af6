"""Universal lenses from spec to picture: injective as traced, blind to pictures, painted around what is reserved."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from lenses import Lenses
from magiclens import run_spec
from magiclens.images import read_image, score, to_display, write_png
from magiclens.running.pipeline import Run

SPEC = """\
scenario:
  type: universal-animation
  frames: {images: [one.png, two.png]}
  camouflage: {type: texture}
lens: {size: 40mm, facets: 8, microfacets: 24}
pipeline:
  matcher: {type: dart-throwing, reach: 10%}
  exporters: [{type: stl}]
  renderers: [{type: tracer, resolution: 128, samples: 4}]
report: {analyses: [contact-sheet, leaks, overlap, secrecy, warp]}
"""
QUESTIONS = """\
scenario:
  type: question-answer
  pairs:
    - {question: {type: text, text: "Why?", box: [20%, 47%, 80%, 53%]}, answer: {image: one.png}}
    - {question: {type: text, text: "How?", box: [20%, 47%, 80%, 53%]}, answer: {image: two.png}}
  margin: 0.4mm
  camouflage: {type: circles}
lens: {size: 40mm, facets: 8, microfacets: 24}
pipeline:
  matcher: {type: dart-throwing, reach: 20%}
  exporters: [{type: stl}]
  renderers: [{type: tracer, resolution: 128, samples: 4}]
report: {analyses: [leaks, overlap]}
"""
BARE = "report.analyses=[]", "pipeline.renderers=[]"
"""Tests that are about the lens alone draw no figures."""


@pytest.fixture(scope="module", autouse=True)
def coarse() -> Iterator[None]:
    """Small lenses need no large pictures."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("magiclens.rendering.transports.LEAST_RESOLUTION", 192)
        yield


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The spec above, and beside it two unlike pictures: a disc, and soft stripes with a corner cut off."""
    folder = tmp_path_factory.mktemp("universal")
    x, y = np.meshgrid(*[(np.arange(160) + 0.5) / 160] * 2)
    disc = ((x - 0.4) ** 2 + (y - 0.55) ** 2 > 0.09).astype(np.float32)
    stripes = (0.5 + 0.4 * np.sin(14 * x + 5 * y) * (x + y > 0.5)).astype(np.float32)
    for name, picture in (("one", disc), ("two", stripes)):
        write_png(folder / f"{name}.png", picture[..., None])
    (folder / "universal.yaml").write_text(SPEC, encoding="utf-8")
    return folder / "universal.yaml"


@pytest.fixture(scope="module")
def run(spec: Path) -> Run:
    return run_spec(spec, spec.parent / "out")


def test_an_injective_lens_shows_every_frame_and_nothing_strays(run: Run) -> None:
    metrics = run.manifest["metrics"]
    assert metrics["overlap_max"] == 1
    assert metrics["leak"] < 1e-4
    assert run.manifest["views"][0]["psnr_db"] > 24
    assert run.manifest["views"][1]["psnr_db"] > 28
    pictures, targets = run.result.renders["tracer"], [view.target for view in run.result.scene.views]
    assert score(pictures[0], targets[1]).psnr_db < 12
    assert {"overlap.png", "secrecy.png", "warp.png"} <= {path.name for path in (run.folder / "figures").iterdir()}
    for view in run.result.scene.views:  # what is written is what was rendered
        written = read_image(run.folder / "sources" / f"{view.source_name}.png")
        np.testing.assert_allclose(to_display(written), to_display(view.source), atol=0.501 / 255)
        assert score(view.source, view.target).psnr_db < 12


@pytest.mark.tools
def test_the_lens_does_not_depend_on_what_it_will_show(run: Run, spec: Path, tmp_path: Path) -> None:
    others = ["scenario.frames={art: worm, length: 1}", "scenario.source={type: plain, level: 0%}"]
    other = run_spec(spec, tmp_path / "other", [*others, *BARE])
    reseeded = run_spec(spec, tmp_path / "reseeded", ["seed=1", *BARE])
    meshes = [(done.folder / "lens.stl").read_bytes() for done in (run, other, reseeded)]
    assert meshes[0] == meshes[1]
    assert meshes[0] != meshes[2]


@pytest.mark.tools
def test_questions_stay_as_they_were_and_answers_appear(spec: Path, tmp_path: Path) -> None:
    asking = spec.with_name("questions.yaml")
    asking.write_text(QUESTIONS, encoding="utf-8")
    run = run_spec(asking, tmp_path / "out")
    reserved = run.result.scene.reserved
    assert reserved is not None
    assert 0.01 < reserved.mean() < 0.1
    for view in run.result.scene.views:
        given, painted = (read_image(run.folder / kind / f"{view.source_name}.png") for kind in ("given", "sources"))
        np.testing.assert_array_equal(given[reserved], painted[reserved])
        assert (given != painted)[~reserved].mean() > 0.2
        assert given[reserved].min() < 0.1
    assert run.manifest["metrics"]["overlap_max"] == 1
    assert run.manifest["metrics"]["leak_from_reserved"] < 1e-4
    assert min(view["psnr_db"] for view in run.manifest["views"]) > 22


def test_codesign_improves_the_picture_and_keeps_the_source(lenses: Lenses) -> None:
    plain, edited = lenses.shipped("rotating"), lenses.shipped("rotating-codesign")
    before, after = ([view["psnr_db"] for view in run.manifest["views"]] for run in (plain, edited))
    assert all(np.array(after) > np.array(before) + 0.5)
    assert edited.manifest["metrics"]["source_ssim"] > 0.8
    assert (edited.folder / "given").is_dir()
    assert not (plain.folder / "given").exists()


@pytest.mark.tools
def test_the_same_spec_gives_the_same_bytes(run: Run, spec: Path, tmp_path: Path) -> None:
    again = run_spec(spec, tmp_path / "again")
    names = [{p.relative_to(f).as_posix() for p in f.rglob("*") if p.is_file()} for f in (run.folder, again.folder)]
    assert names[0] == names[1]
    for name in names[0] - {"manifest.json"}:
        assert (run.folder / name).read_bytes() == (again.folder / name).read_bytes(), name
