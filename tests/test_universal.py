"""Universal lenses from spec to picture: injective as traced, blind to pictures, painted around what is reserved."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from magiclens import run_spec
from magiclens.images import read_image, score, to_display, write_png
from magiclens.running.pipeline import Run
from toys import SpecWriter

SPEC = """\
scenario:
  type: universal-animation
  frames: {images: [one.png, two.png]}
  camouflage: {type: noise}
lens: {size: 40mm, facets: 8, microfacets: 24}
pipeline:
  matcher: {type: dart-throwing, reach: 10%}
  exporters: [{type: stl}]
  renderers: [{type: tracer, resolution: 192, samples: 4}]
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
  renderers: [{type: tracer, resolution: 192, samples: 4}]
"""
CODESIGN = """\
scenario:
  type: rotating
  source: {type: circles, seed: 7}
  targets: [{art: heart}, {art: star}]
lens: {size: 40mm, facets: 8, microfacets: 12}
pipeline:
  matcher: {type: exhaustive, candidates: 16, polish: 8}
  renderers: [{type: tracer, resolution: 160, samples: 3}]
"""


@pytest.fixture(autouse=True)
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small lenses need no large pictures."""
    monkeypatch.setattr("magiclens.rendering.transports.LEAST_RESOLUTION", 192)


@pytest.fixture
def pictures(tmp_path: Path) -> None:
    """Two unlike pictures beside the spec: a disc, and soft stripes with a corner cut off."""
    x, y = np.meshgrid(*[(np.arange(160) + 0.5) / 160] * 2)
    disc = ((x - 0.4) ** 2 + (y - 0.55) ** 2 > 0.09).astype(np.float32)
    stripes = (0.5 + 0.4 * np.sin(14 * x + 5 * y) * (x + y > 0.5)).astype(np.float32)
    for name, picture in (("one", disc), ("two", stripes)):
        write_png(tmp_path / f"{name}.png", picture[..., None])


BARE = "report.analyses=[]"
"""Tests that are about the lens alone draw no figures."""


def made(write_spec: SpecWriter, tmp_path: Path, text: str, out: str, *overrides: str) -> Run:
    return run_spec(write_spec(text=text), tmp_path / out, overrides)


@pytest.mark.usefixtures("pictures")
def test_an_injective_lens_shows_every_frame_and_nothing_strays(write_spec: SpecWriter, tmp_path: Path) -> None:
    run = made(write_spec, tmp_path, SPEC, "out")
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


@pytest.mark.usefixtures("pictures")
def test_the_lens_does_not_depend_on_what_it_will_show(write_spec: SpecWriter, tmp_path: Path) -> None:
    one = made(write_spec, tmp_path, SPEC, "one", BARE)
    black = "scenario.source={type: plain, level: 0%}"
    other = made(write_spec, tmp_path, SPEC, "other", "scenario.frames={art: worm, length: 1}", black, BARE)
    reseeded = made(write_spec, tmp_path, SPEC, "reseeded", "seed=1", BARE)
    meshes = [(run.folder / "lens.stl").read_bytes() for run in (one, other, reseeded)]
    assert meshes[0] == meshes[1]
    assert meshes[0] != meshes[2]


@pytest.mark.usefixtures("pictures")
def test_questions_stay_as_they_were_and_answers_appear(write_spec: SpecWriter, tmp_path: Path) -> None:
    run = made(write_spec, tmp_path, QUESTIONS, "out")
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


def test_codesign_improves_the_picture_and_keeps_the_source(write_spec: SpecWriter, tmp_path: Path) -> None:
    plain = made(write_spec, tmp_path, CODESIGN, "plain")
    encoder = "pipeline.encoder={type: least-squares, change: 30%}"
    edited = made(write_spec, tmp_path, CODESIGN, "edited", "pipeline.codesign=1", encoder)
    before, after = ([view["psnr_db"] for view in run.manifest["views"]] for run in (plain, edited))
    assert all(np.array(after) > np.array(before) + 0.5)
    assert edited.manifest["metrics"]["source_ssim"] > 0.85
    assert (edited.folder / "given").is_dir()
    assert not (plain.folder / "given").exists()


@pytest.mark.usefixtures("pictures")
def test_the_same_spec_gives_the_same_bytes(write_spec: SpecWriter, tmp_path: Path) -> None:
    texture = "scenario.camouflage={type: texture}"
    folders = [made(write_spec, tmp_path, SPEC, out, texture, BARE).folder for out in ("a", "b")]
    names = [{p.relative_to(f).as_posix() for p in f.rglob("*") if p.is_file()} for f in folders]
    assert names[0] == names[1]
    for name in names[0] - {"manifest.json"}:
        assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes(), name
