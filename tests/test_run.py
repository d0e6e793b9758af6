"""The loop: what a run folder holds, that equal runs are equal, and that nothing half-written stays behind."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Barrier, Lock
from time import sleep
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from magiclens import Analysis, Findings
from magiclens.contract.artifacts import Assignment, Candidates, HeightField, Scene, Solid
from magiclens.contract.errors import InputError, StageError
from magiclens.contract.hookspecs import hookimpl
from magiclens.contract.stages import Stage
from magiclens.plan.compile import load_plan
from magiclens.plan.registry import Plugin, Registry
from magiclens.running.observers import BarObserver, LineObserver, Observer
from magiclens.running.pipeline import Run, run_plan
from toys import (
    TOYS,
    SpecWriter,
    ToyAnnealer,
    ToyExporter,
    ToyIntegrator,
    ToyMatcher,
    ToyTracer,
    no_timings,
    plugin_of,
    registry_of,
)

Runner = Callable[..., Run]


@pytest.fixture
def run(write_spec: SpecWriter, registry: Registry, tmp_path: Path) -> Runner:
    """Runs the toy spec into a folder of that name."""

    def start(name: str = "out", *overrides: str, stages: Registry = registry, observer: Observer | None = None) -> Run:
        return run_plan(load_plan(write_spec(), overrides, stages), tmp_path / "runs" / name, observer)

    return start


def replaced(*stages: type[Stage]) -> Registry:
    """The toys, some of them replaced by others of the same kind and type."""
    names = {(s.kind, s.type) for s in stages}
    return registry_of(*(t for t in TOYS if (t.kind, t.type) not in names), *stages)


def files(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_run_folder_holds_what_the_contract_says(run: Runner) -> None:
    folder = run().folder
    assert sorted(files(folder)) == [
        "heights.npz",
        "lens.toy",
        "manifest.json",
        "renders/tracer/rotation-000.png",
        "renders/tracer/rotation-090.png",
        "report.html",
        "sources/source.png",
        "spec.yaml",
        "targets/rotation-000.png",
        "targets/rotation-090.png",
    ]


def test_the_manifest_says_what_the_contract_says(run: Runner) -> None:
    done = run()
    manifest = json.loads((done.folder / "manifest.json").read_text())
    assert manifest == done.manifest
    assert manifest["format"] == 1
    assert manifest["scene"] == {
        "size_mm": 20.0,
        "source_size_mm": 20.0,
        "thickness_mm": 40.0,
        "gap_mm": 0.0,
        "ior": 1.49,
        "facets": 4,
        "microfacets": 2,
        "cells": "eye",
    }
    view = manifest["views"][1]
    assert {k: v for k, v in view.items() if k not in ("psnr_db", "ssim")} == {
        "name": "rotation-090",
        "eye_mm": [0.0, 0.0, 440.0],
        "rotation_deg": 90.0,
        "source": "sources/source.png",
        "target": "targets/rotation-090.png",
        "renders": {"tracer": "renders/tracer/rotation-090.png"},
    }
    assert 10 < view["psnr_db"] < 60
    assert 0 < view["ssim"] <= 1
    assert manifest["metrics"] == {
        "matching_psnr_db": 20.0,
        "energy_before": 2.0,
        "energy_after": 1.0,
        "step_max_mm": pytest.approx(done.result.height_field.metrics["step_max_mm"]),
        "volume_mm3": 1.0,
        "width_mm": 20.0,
        "depth_mm": 20.0,
        "height_mm": pytest.approx(done.result.solid.vertices[:, 2].max()),
    }
    assert (manifest["seed"], manifest["versions"]["magiclens-toys"]) == (0, "1.2")


def test_the_manifest_lists_stages_with_their_options(run: Runner) -> None:
    stages = run().manifest["stages"]
    kinds = ["matcher", "annealer", "integrator", "finisher", "exporter", "renderer"]
    assert [s["kind"] for s in stages] == kinds
    assert stages[0] | {"seconds": 0} == {
        "kind": "matcher",
        "type": "toy",
        "version": "1",
        "plugin": "magiclens-toys",
        "options": {"sweeps": 5, "window": "10%", "step": "0.5mm"},
        "seconds": 0,
    }


def test_the_manifest_vouches_for_every_file(run: Runner) -> None:
    done = run()
    found = files(done.folder)
    assert {a["path"] for a in done.manifest["artifacts"]} == set(found) - {"manifest.json"}
    for artifact in done.manifest["artifacts"]:
        content = found[artifact["path"]]
        assert artifact["sha256"] == hashlib.sha256(content).hexdigest()
        assert artifact["bytes"] == len(content)
    assert done.manifest["spec_sha256"] == hashlib.sha256(found["spec.yaml"]).hexdigest()


def test_equal_runs_give_equal_bytes_but_for_timings(run: Runner) -> None:
    one, two = run("one").folder, run("deeper/two").folder
    first, second = files(one), files(two)
    manifests = [no_timings(json.loads(found.pop("manifest.json"))) for found in (first, second)]
    assert first == second
    assert manifests[0] == manifests[1]
    assert "seconds" not in str(manifests[0])


def test_another_seed_gives_another_lens(run: Runner) -> None:
    one, two = run("one"), run("two", "seed=1")
    assert files(one.folder)["lens.toy"] != files(two.folder)["lens.toy"]


def test_one_stages_randomness_does_not_depend_on_anothers(run: Runner) -> None:
    class Thirsty(ToyMatcher):
        def match(self, scene: Scene, rng: np.random.Generator, progress: Any = None) -> Candidates:
            rng.random(1000)
            return super().match(scene, rng)

    plain, thirsty = run("one").result, run("two", stages=replaced(Thirsty)).result
    assert not np.array_equal(plain.candidates.offsets_mm, thirsty.candidates.offsets_mm)
    assert np.array_equal(plain.assignment.choice, thirsty.assignment.choice)


def test_a_run_folders_spec_runs_again_to_the_same_lens(
    write_spec: SpecWriter, registry: Registry, tmp_path: Path, grey_png: Path
) -> None:
    first = run_plan(load_plan(write_spec(("{art: bat}", "{image: grey.png}")), (), registry), tmp_path / "one")
    assert (first.folder / "inputs" / "grey.png").read_bytes() == grey_png.read_bytes()
    grey_png.unlink()
    again = run_plan(load_plan(first.folder / "spec.yaml", (), registry), tmp_path / "two")
    assert no_timings(first.manifest) == no_timings(again.manifest)
    assert str(tmp_path) not in (first.folder / "spec.yaml").read_text()


PANDA_OVER_ITSELF = ("scenario={type: single, source: {type: art, name: panda}, target: {art: panda}}",)


def tilting(*rounds: float) -> tuple[type[Stage], ...]:
    """Stages for a lens that tilts every facet, in each round of rematching as much as is said: less is better."""
    left = iter(rounds)

    class Telling(ToyMatcher):
        def match(self, scene: Scene, rng: np.random.Generator, progress: Any = None) -> Candidates:
            found = super().match(scene, rng)
            return replace(found, offsets_mm=np.full_like(found.offsets_mm, next(left)))

        def rematch(self, scene: Scene, candidates: Candidates, *_: Any) -> Candidates:
            offsets = np.full_like(candidates.offsets_mm, next(left))
            return replace(candidates, offsets_mm=offsets, metrics={"rematched": 1.0})

    class Tilting(ToyIntegrator):
        def integrate(self, scene: Scene, assignment: Assignment, progress: Any = None) -> HeightField:
            lines = scene.lens.microfacets + 1
            tilts = assignment.offsets_mm[..., :1, None] * np.linspace(-0.2, 0.2, lines)
            return HeightField(scene.lens, np.repeat(tilts, lines, axis=2).astype(float), None)

    return Telling, Tilting


def test_rematching_repeats_choice_and_integration(run: Runner) -> None:
    calls: list[str] = []

    class Counting(ToyAnnealer):
        def anneal(self, scene: Scene, candidates: Candidates, rng: Any, progress: Any = None) -> Assignment:
            calls.append("anneal")
            return super().anneal(scene, candidates, rng)

    done = run("out", "pipeline.rematch=2", *PANDA_OVER_ITSELF, stages=replaced(Counting, *tilting(3.0, 2.0, 1.0)))
    assert len(calls) == 3
    assert (done.result.candidates.offsets_mm == 1.0).all()
    assert done.manifest["metrics"]["rematched"] == 1.0
    assert [s["kind"] for s in done.manifest["stages"]].count("annealer") == 1


def test_rematching_stops_when_it_no_longer_helps(run: Runner) -> None:
    stages = replaced(*tilting(3.0, 1.0, 2.0, 0.0))
    done = run("out", "pipeline.rematch=5", *PANDA_OVER_ITSELF, stages=stages)
    assert (done.result.candidates.offsets_mm == 1.0).all()


def test_the_first_choice_is_kept_for_comparison(run: Runner) -> None:
    data = run().result
    assert (data.best_match.choice == 0).all()
    assert not (data.assignment.choice == 0).all()
    assert np.array_equal(data.best_match.offsets_mm, data.candidates.offsets_mm[:, :, 0])


def test_other_renderers_scores_stand_beside_the_tracers(run: Runner) -> None:
    view = run("out", "pipeline.renderers=[{type: tracer}, {type: toy}]").manifest["views"][0]
    assert view["psnr_db"] == view["psnr_db_toy"]
    assert view["renders"]["toy"] == "renders/toy/rotation-000.png"


def test_without_the_tracer_its_scores_are_empty(run: Runner) -> None:
    view = run("out", "pipeline.renderers=[{type: toy}]").manifest["views"][0]
    assert view["psnr_db"] is None
    assert view["ssim_toy"] > 0


def broken(base: type[Any], method: str, result: Callable[..., Any]) -> type[Any]:
    """A stage whose method does something else."""
    return type(f"Broken{base.__name__}", (base,), {method: result, "__module__": __name__})


def nothing(*_: Any) -> None:
    """A stage that forgets to return."""


def divide(*_: Any) -> float:
    return 1 / 0


def nan_candidates(self: ToyMatcher, scene: Scene, rng: Any, progress: Any) -> Candidates:
    good = ToyMatcher.match(self, scene, rng)
    return Candidates(good.offsets_mm * np.nan, good.maps, good.errors)


def no_candidates(self: ToyMatcher, scene: Scene, rng: Any, progress: Any) -> Candidates:
    good = ToyMatcher.match(self, scene, rng)
    errors = good.errors.copy()
    errors[1, 2] = np.inf
    return Candidates(good.offsets_mm, good.maps, errors)


def wrong_choice(self: ToyAnnealer, scene: Scene, candidates: Candidates, rng: Any, progress: Any) -> Assignment:
    good = ToyAnnealer.anneal(self, scene, candidates, rng)
    return Assignment(good.choice + 9, good.offsets_mm, good.maps, good.errors)


def coarse_heights(self: ToyIntegrator, scene: Scene, assignment: Assignment, progress: Any) -> HeightField:
    return HeightField(scene.lens, np.zeros((4, 4, 2, 2)), None)


def nan_heights(self: ToyIntegrator, scene: Scene, assignment: Assignment, progress: Any) -> HeightField:
    return HeightField(scene.lens, np.full((4, 4, 3, 3), np.nan), None)


def one_picture(self: ToyTracer, scene: Scene, solid: Solid, progress: Any) -> list[Any]:
    return ToyTracer.render(self, scene, solid)[:1]


def oblong_picture(self: ToyTracer, scene: Scene, solid: Solid, progress: Any) -> list[Any]:
    return [picture[:5] for picture in ToyTracer.render(self, scene, solid)]


FAULTS: dict[str, tuple[type[Stage], str, Callable[..., Any], str]] = {
    "raises": (ToyMatcher, "match", divide, "failed: ZeroDivisionError: division by zero"),
    "returns nothing": (ToyMatcher, "match", nothing, "broke its contract: it is a NoneType instead of a Candidates"),
    "NaN candidates": (ToyMatcher, "match", nan_candidates, "broke its contract: offsets_mm has NaN"),
    "no candidates": (ToyMatcher, "match", no_candidates, "1 facets have no candidate, the first at row 1, column 2"),
    "choice out of range": (ToyAnnealer, "anneal", wrong_choice, "broke its contract: choice is not within 0 to 2"),
    "coarse heights": (ToyIntegrator, "integrate", coarse_heights, "heights_mm has shape (4, 4, 2, 2) instead of"),
    "NaN heights": (ToyIntegrator, "integrate", nan_heights, "broke its contract: heights_mm has NaN"),
    "exporter writes nothing": (ToyExporter, "export", nothing, "broke its contract: it has not written lens.toy"),
    "one picture for two views": (ToyTracer, "render", one_picture, "broke its contract: 1 pictures for 2 views"),
    "oblong pictures": (ToyTracer, "render", oblong_picture, "broke its contract: rotation-000 has shape"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_stage_is_named_and_leaves_nothing_behind(fault: str, run: Runner, tmp_path: Path) -> None:
    base, method, result, message = FAULTS[fault]
    with pytest.raises(StageError) as caught:
        run("out", stages=replaced(broken(base, method, result)))
    assert str(caught.value).startswith(f"{base.kind} {base.type} (magiclens-toys 1.2) ")
    assert message in str(caught.value)
    assert caught.value.exit_code == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["toy.yaml"]


def test_a_stages_own_complaint_about_the_input_stays_what_it_is(run: Runner) -> None:
    def complain(*_: Any) -> None:
        raise InputError("facet (3, 1) cannot be built")

    with pytest.raises(InputError, match=r"^facet \(3, 1\) cannot be built$"):
        run("out", stages=replaced(broken(ToyIntegrator, "integrate", complain)))


def test_an_older_run_survives_a_run_that_fails(run: Runner) -> None:
    before = files(run("out").folder)
    with pytest.raises(StageError):
        run("out", stages=replaced(broken(ToyTracer, "render", divide)))
    assert files(run("out").folder).keys() == before.keys()


def test_run_folders_have_ordinary_permissions(run: Runner) -> None:
    mask = os.umask(0o022)
    try:
        assert run().folder.stat().st_mode & 0o777 == 0o755
    finally:
        os.umask(mask)


def test_plugins_observe_stages_and_the_end(run: Runner, registry: Registry) -> None:
    seen: list[Any] = []
    observer = SimpleNamespace(
        mlens_stage_done=hookimpl(lambda stage, artifact: seen.append((stage.kind, type(artifact).__name__))),
        mlens_run_done=hookimpl(lambda folder, manifest: seen.append(folder.name)),
    )
    for name, hook in vars(observer).items():
        hook.magiclens_impl["specname"] = name
    registry.register(observer, Plugin("watcher", "watcher", "1"))
    run("out")
    assert seen[:2] == [("matcher", "Candidates"), ("annealer", "Assignment")]
    assert seen[-1] == "out"


def test_a_failing_observer_stops_nothing_and_is_noted(
    run: Runner, registry: Registry, capsys: pytest.CaptureFixture[str]
) -> None:
    observer = SimpleNamespace(mlens_run_done=hookimpl(divide_by, specname="mlens_run_done"))
    registry.register(observer, Plugin("watcher", "watcher", "1"))
    assert run("out").folder.exists()
    assert "note: plugin watcher (watcher 1): mlens_run_done failed: ZeroDivisionError" in capsys.readouterr().err


def divide_by(folder: Path) -> float:
    return 1 / 0


@pytest.mark.parametrize("observer_class", [LineObserver, BarObserver])
def test_progress_names_every_stage(observer_class: type[Any], run: Runner, tmp_path: Path) -> None:
    log = tmp_path / "log"
    with log.open("w") as stream:
        run("out", observer=observer_class(stream))
    text = log.read_text()
    for name in ("pictures", "matcher toy", "annealer toy", "meshing", "exporter toy", "renderer tracer"):
        assert name in text


class Meeting(ToyExporter):
    """Waits until an analysis works."""

    place: ClassVar[Barrier]

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        self.place.wait(20)
        super().export(scene, solid, path)


class OneAtATime(Observer):
    """Fails if two threads tell it something at the same time."""

    def __init__(self) -> None:
        self.told: list[str] = []
        self._talking = Lock()

    def started(self, name: str, facets: int) -> None:
        self._listen(name)

    def finished(self, name: str, seconds: float) -> None:
        self._listen(name)

    def _listen(self, name: str) -> None:
        assert self._talking.acquire(blocking=False)
        sleep(0.02)
        self.told.append(name)
        self._talking.release()


@pytest.mark.parametrize("package", ["magiclens", "another"])
def test_exporters_work_while_analyses_do_unless_a_plugin_takes_part(package: str, run: Runner) -> None:
    Meeting.place = Barrier(2 if package == "magiclens" else 1)

    def meet(plan: Any, result: Any) -> Findings:
        Meeting.place.wait(20)
        return Findings({"met": 1.0})

    registry = registry_of(*(stage for stage in TOYS if stage is not ToyExporter))
    hook = hookimpl(lambda: [Analysis("meeting", compute=meet)], specname="mlens_analyses")
    for contributed in (plugin_of(Meeting), SimpleNamespace(mlens_analyses=hook)):
        registry.register(contributed, Plugin(f"meeting {id(contributed)}", package, "1"))
    observer = OneAtATime()
    made = run(stages=registry, observer=observer)
    assert made.manifest["metrics"]["met"] == 1.0
    assert (made.folder / "lens.toy").is_file()
    told = [name for name in observer.told if name in ("exporter toy", "meeting")]
    assert sorted(told) == ["exporter toy"] * 2 + ["meeting"] * 2
    assert package == "magiclens" or told[:2] == ["exporter toy"] * 2


def test_metrics_that_are_no_numbers_become_null(run: Runner) -> None:
    class Doubtful(ToyExporter):
        type: ClassVar[str] = "doubtful"

    class Unsure(ToyMatcher):
        def match(self, scene: Scene, rng: np.random.Generator, progress: Any = None) -> Candidates:
            found = super().match(scene, rng)
            return Candidates(found.offsets_mm, found.maps, found.errors, {"matching_psnr_db": float("nan")})

    assert run("out", stages=replaced(Unsure)).manifest["metrics"]["matching_psnr_db"] is None
