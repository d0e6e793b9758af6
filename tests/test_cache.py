"""Runs take up where earlier ones ended: what is kept, for whom, and that nothing wrong is ever served."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from magiclens import Analysis, Findings
from magiclens.cache import sources
from magiclens.cache.sources import UnknownSources, source_hashes
from magiclens.cache.store import Cache, new_entry
from magiclens.cache.values import NotPlain, borrowed, described, packed, settled, unpacked
from magiclens.cli import app
from magiclens.contract.artifacts import Assignment, Candidates, HeightField, Lens, Scene, Solid, View
from magiclens.contract.errors import StageError, Terminated
from magiclens.contract.hookspecs import hookimpl
from magiclens.contract.stages import Encoder, Progress, silent
from magiclens.plan.compile import Plan, load_plan
from magiclens.plan.registry import Plugin, Registry
from magiclens.running.forecast import forecast, whole_run_kept
from magiclens.running.ingredients import generator_in, generator_state
from magiclens.running.observers import Observer
from magiclens.running.pipeline import kept_run, run_plan, write_run
from magiclens.sweep.sweeping import sweep_spec
from toys import (
    SPEC,
    TOYS,
    SpecWriter,
    ToyAnnealer,
    ToyExporter,
    ToyIntegrator,
    ToyMatcher,
    ToyRenderer,
    no_timings,
    registry_of,
)

DESIGN = ["matcher toy", "annealer toy", "integrator toy", "integrator toy, refinement", "finisher toy"]
FILES = ["exporter toy", "renderer tracer"]
EVERYTHING = {*DESIGN, *FILES, "size"}
"""What a run of the toy spec does that is kept; the analysis is that of ``asking``."""
STAGED = {"matcher", "annealer", "integrator", "finisher", "encoder", "exporter", "renderer"}
REFINED = [name for name in DESIGN if name != "matcher toy"]


class Watching(Observer):
    """Collects what is done, what is reused, and what is said."""

    def __init__(self) -> None:
        self.done: list[str] = []
        self.reused_names: list[str] = []
        self.notices: list[str] = []

    def finished(self, name: str, seconds: float) -> None:
        self.done.append(name)

    def reused(self, name: str) -> None:
        self.reused_names.append(name)

    def notice(self, text: str) -> None:
        self.notices.append(text)

    @property
    def kept_steps(self) -> set[str]:
        """What was done of the steps whose results are kept."""
        return {name for name in self.done if name == "size" or name.split()[0] in STAGED}


class Painter(Encoder):
    """Paints noise."""

    type: ClassVar[str] = "painter"

    def encode(self, scene: Scene, transports: Any, rng: np.random.Generator, progress: Progress = silent) -> Scene:
        painted = {view.source_name: rng.random(view.source.shape, np.float32) for view in scene.views}
        views = (View(**{**vars(view), "source": painted[view.source_name]}) for view in scene.views)
        return Scene(scene.lens, tuple(views), scene.reserved)


class GoingOn(ToyIntegrator):
    """Makes what it is given a little flatter, again and again."""

    type: ClassVar[str] = "going-on"

    @property
    def goes_on(self) -> bool:
        return True

    def refine(self, scene: Scene, built: HeightField, progress: Progress = silent) -> HeightField:
        return replace(built, heights_mm=built.heights_mm * 0.9)


class OtherExporter(ToyExporter):
    """Writes the same into another file, and one more into a folder."""

    type: ClassVar[str] = "other"
    suffix: ClassVar[str] = ".other"

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        super().export(scene, solid, path)
        (path.parent / "lens.parts").mkdir()
        (path.parent / "lens.parts" / "one.txt").write_text("one")


COARSE_PX = 32
"""Side of the targets that are drawn, pixels: nobody looks at them."""
STAGES = (*TOYS, Painter, GoingOn, OtherExporter)


def size_of(plan: Plan, result: Any) -> Findings:
    return Findings({"size_mm": plan.lens.size_mm}, pictures={"grey": np.full((4, 4, 1), 0.5, np.float32)})


def asking(*analyses: Any, stages: tuple[type[Any], ...] = STAGES) -> Registry:
    """The toys with analyses."""
    registry = registry_of(*stages)
    hook = hookimpl(lambda: list(analyses), specname="mlens_analyses")
    registry.register(SimpleNamespace(mlens_analyses=hook), Plugin("asking", "asking", "1"))
    return registry


@pytest.fixture
def registry() -> Registry:
    return asking(Analysis("size", compute=size_of))


@pytest.fixture(autouse=True)
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Targets are drawn coarsely."""
    monkeypatch.setattr("magiclens.scenarios.pictures.TARGET_ART_PX", COARSE_PX)


@pytest.fixture
def cache(tmp_path: Path) -> Cache:
    return Cache(tmp_path / "cache", 10**9)


@pytest.fixture
def traced(monkeypatch: pytest.MonkeyPatch) -> None:
    """Transports that need no tracing; the painter does not look at them."""
    monkeypatch.setattr("magiclens.rendering.transports.transports", lambda scene, solid: [])
    monkeypatch.setattr("magiclens.running.making.save_transports", lambda *_: None)


@pytest.fixture
def run(
    write_spec: SpecWriter, registry: Registry, cache: Cache, tmp_path: Path
) -> Callable[..., tuple[Watching, Path]]:
    """Runs the toy spec, and returns what was seen of it and its folder."""

    def call(out: str, *overrides: str, cache: Cache | None = cache, registry: Registry = registry) -> Any:
        watching = Watching()
        if cache:
            cache._say = watching.notices.append
        plan = load_plan(write_spec(), overrides, registry)
        if not (cache and kept_run(plan, tmp_path / out, watching, cache)):
            run_plan(plan, tmp_path / out, watching, cache)
        return watching, tmp_path / out

    return call


def contents(folder: Path) -> dict[str, Any]:
    """All files of a run folder, and its manifest without timings."""
    found: dict[str, Any] = {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }
    found["manifest.json"] = no_timings(json.loads(found["manifest.json"]))
    return found


def test_a_run_with_a_cache_writes_what_one_without_writes_and_the_next_does_nothing(run: Any) -> None:
    plain = contents(run("plain", cache=None)[1])
    first, folder = run("first")
    assert first.kept_steps == EVERYTHING
    assert contents(folder) == plain
    again, folder = run("again")
    assert again.done == []
    assert again.reused_names == ["the whole run"]
    assert contents(folder) == plain


def test_without_the_whole_run_every_step_is_kept_by_itself(run: Any, cache: Cache) -> None:
    plain = contents(run("first")[1])
    for entry in list(cache.entries()):
        if entry.step == "run":
            cache._entry_path(entry.key).unlink()
    again, folder = run("again")
    assert again.kept_steps == set()
    assert again.reused_names[: len(DESIGN)] == DESIGN
    assert sorted(again.reused_names) == sorted([*DESIGN, *FILES, "size"])
    assert contents(folder) == plain


MAKES_ANOTHER_LENS = {"matcher toy", *REFINED, *FILES, "size"}
CHANGES: dict[str, tuple[str, set[str]]] = {
    "name": ("other", set()),
    "seed": ("1", MAKES_ANOTHER_LENS),
    "scenario.source.seed": ("8", MAKES_ANOTHER_LENS),
    "scenario.source.radius": ("[0.5mm, 2mm]", MAKES_ANOTHER_LENS),
    "scenario.source.colours": ("coloured", MAKES_ANOTHER_LENS),
    "scenario.source.layers": ("3", MAKES_ANOTHER_LENS),
    "scenario.targets.0.art": ("owl", MAKES_ANOTHER_LENS),
    "scenario.targets.1.art": ("owl", MAKES_ANOTHER_LENS),
    "scenario.targets.0.invert": ("true", MAKES_ANOTHER_LENS),
    "scenario.angles": ("[0deg, 180deg]", MAKES_ANOTHER_LENS),
    "lens.size": ("21mm", MAKES_ANOTHER_LENS),
    "lens.facets": ("5", MAKES_ANOTHER_LENS),
    "lens.microfacets": ("3", MAKES_ANOTHER_LENS),
    "lens.thickness": ("41mm", MAKES_ANOTHER_LENS),
    "lens.gap": ("1mm", MAKES_ANOTHER_LENS),
    "lens.material": ("glass", MAKES_ANOTHER_LENS),
    "lens.wall": ("1um", MAKES_ANOTHER_LENS),
    "lens.relief": ("6mm", MAKES_ANOTHER_LENS),
    "lens.max_slope": ("59deg", MAKES_ANOTHER_LENS),
    "lens.cells": ("vertical", MAKES_ANOTHER_LENS),
    "lens.mark": ("true", MAKES_ANOTHER_LENS),
    "viewer.distance": ("401mm", MAKES_ANOTHER_LENS),
    "viewer.x": ("1mm", MAKES_ANOTHER_LENS),
    "viewer.y": ("1mm", MAKES_ANOTHER_LENS),
    "medium.black": ("5%", MAKES_ANOTHER_LENS),
    "medium.glass": ("1mm", MAKES_ANOTHER_LENS),
    "fabrication.machine": ("printing", MAKES_ANOTHER_LENS),
    "pipeline.matcher.sweeps": ("6", MAKES_ANOTHER_LENS),
    "pipeline.matcher.window": ("11%", MAKES_ANOTHER_LENS),
    "pipeline.matcher.step": ("0.4mm", MAKES_ANOTHER_LENS),
    "pipeline.exporters": ("[{type: toy}, {type: other}]", {"exporter other"}),
    "pipeline.renderers": ("[{type: tracer}, {type: toy}]", {"renderer toy", "size"}),
    "report.analyses": ("[]", set()),
}
"""By key of the spec: another value, and what a run then does again."""
NO_VALUES = {
    "scenario.type", "scenario.source.type", "scenario.source.size", "pipeline.matcher.type", "pipeline.annealer.type",
    "pipeline.integrator.type", "pipeline.finisher.type", "pipeline.exporters.0.type", "pipeline.renderers.0.type",
    "pipeline.rematch", "pipeline.codesign", "medium.white",
}  # fmt: skip
"""Keys that are tested elsewhere, or for which there is one value only."""


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a cache in which the toy spec has been run."""
    folder = tmp_path_factory.mktemp("filled")
    (folder / "toy.yaml").write_text(SPEC)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("magiclens.scenarios.pictures.TARGET_ART_PX", COARSE_PX)
        plan = load_plan(folder / "toy.yaml", (), asking(Analysis("size", compute=size_of)))
        run_plan(plan, folder / "out", Watching(), Cache(folder / "cache", 10**9))
    return folder / "cache"


@pytest.mark.every_third
@pytest.mark.parametrize("key", CHANGES)
def test_another_value_of_one_key_does_what_depends_on_it_and_nothing_else(
    key: str, run: Any, write_spec: SpecWriter, registry: Registry, cache: Cache, filled: Path
) -> None:
    shutil.copytree(filled, cache.folder)
    value, expected = CHANGES[key]
    plan = load_plan(write_spec(), [f"{key}={value}"], registry)
    assert {each.step for each in forecast(plan, cache) if not each.kept} == expected
    again, folder = run("again", f"{key}={value}")
    assert again.kept_steps == expected
    assert contents(folder) == contents(run("plain", f"{key}={value}", cache=None)[1])


def test_another_exporter_reads_no_result_but_those_that_it_writes(
    run: Any, write_spec: SpecWriter, registry: Registry, cache: Cache, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run("first")
    change = "pipeline.exporters=[{type: other}]"
    plain = contents(run("plain", change, cache=None)[1])
    read: list[str] = []
    value = Cache.value

    def watched(self: Cache, entry: Any, *given: Any) -> Any:
        read.append(entry.step)
        return value(self, entry, *given)

    monkeypatch.setattr(Cache, "value", watched)
    monkeypatch.setattr(sys.modules["magiclens.images.score"], "score", None)  # nor is a picture compared again
    write_run(load_plan(write_spec(), [change], registry), tmp_path / "again", Watching(), cache)
    assert contents(tmp_path / "again") == plain
    # the mesh, and heights whose arrays it shares
    assert set(read) == {"integrator toy", "integrator toy, refinement", "finisher toy"}


def test_all_keys_of_a_spec_are_among_those(write_spec: SpecWriter, registry: Registry) -> None:
    def leaves(data: Any, at: str) -> Iterator[str]:
        if isinstance(data, dict):
            for key, each in data.items():
                yield from leaves(each, f"{at}.{key}")
        elif isinstance(data, list) and data and isinstance(data[0], dict):
            for k, each in enumerate(data):
                yield from leaves(each, f"{at}.{k}")
        else:
            yield at.lstrip(".")

    keys = set(leaves(load_plan(write_spec(), ["medium.black=1%", "medium.glass=1mm"], registry).resolved(), ""))
    assert keys <= {*CHANGES, *NO_VALUES}, keys - {*CHANGES, *NO_VALUES}


def test_comments_order_and_names_of_files_make_no_difference(
    run: Any, write_spec: SpecWriter, registry: Registry, cache: Cache, grey_png: Path, tmp_path: Path
) -> None:
    picture = ("{art: bat}", "{image: grey.png}")
    run_plan(load_plan(write_spec(picture), (), registry), tmp_path / "first", Watching(), cache)
    grey_png.rename(grey_png.with_name("gray.png"))
    head, _, tail = SPEC.partition("lens:\n")
    text = f"# a comment\nlens:\n{tail}\nname: renamed\n{head}"
    again, spec = Watching(), write_spec(("{art: bat}", "{image: gray.png}"), text=text)
    run_plan(load_plan(spec, (), registry), tmp_path / "again", again, cache)
    assert again.kept_steps == set()


def test_another_content_of_a_picture_does(
    write_spec: SpecWriter, registry: Registry, cache: Cache, grey_png: Path, tmp_path: Path
) -> None:
    from magiclens.images.files import write_png

    spec = write_spec(("{art: bat}", "{image: grey.png}"))
    run_plan(load_plan(spec, (), registry), tmp_path / "first", Watching(), cache)
    write_png(grey_png, np.full((40, 60, 1), 0.9, np.float32))
    again = Watching()
    plan = load_plan(spec, (), registry)
    assert not whole_run_kept(plan, cache)
    run_plan(plan, tmp_path / "again", again, cache)
    assert again.kept_steps == EVERYTHING


ROUNDS = ("pipeline.rematch=3", "pipeline.codesign=2", "pipeline.encoder={type: painter}")
"""Stages are called again and again, and their random numbers go on."""


@pytest.fixture
def falling(monkeypatch: pytest.MonkeyPatch) -> None:
    """Traced errors that fall for two rounds of rematching and then rise, as functions of the heights."""
    seen: dict[bytes, float] = {}

    def errors(scene: Scene, heights: HeightField) -> Any:
        key = heights.heights_mm.tobytes() + scene.views[0].source.tobytes()
        value = (3.0, 2.0, 1.0, 4.0)[len(seen) % 4]
        return np.full((scene.lens.facets,) * 2, seen.setdefault(key, value))

    monkeypatch.setattr("magiclens.rendering.facet_errors.facet_errors", errors)


@pytest.mark.usefixtures("traced")
@pytest.mark.parametrize(("integrator", "designs"), [("toy", 3), ("going-on", 1)])
def test_codesign_refines_the_same_lens_further_where_the_integrator_can(
    run: Any, integrator: str, designs: int
) -> None:
    watching, _ = run("rounds", "pipeline.codesign=2", *ROUNDS[2:], f"pipeline.integrator={{type: {integrator}}}")
    count = watching.done.count
    assert count("matcher toy") == count("annealer toy") == designs
    assert count("encoder painter") == 3
    assert count(f"integrator {integrator}") == designs
    assert count(f"integrator {integrator}, refinement") == 3  # for the source and both edits of it


@pytest.mark.tools
@pytest.mark.usefixtures("traced", "falling")
def test_killed_after_any_step_a_run_goes_on_there_and_ends_with_the_same_bytes(
    run: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    whole, folder = run("plain", *ROUNDS, cache=None)
    plain, steps = contents(folder), [name for name in whole.done if name.split()[0] in STAGED]
    assert len(steps) > 30
    for killed_at in range(0, len(steps), 5):
        own = Cache(tmp_path / f"cache-{killed_at}", 10**9)
        done: list[str] = []

        def count(self: Any, name: str, seconds: float, done: list[str] = done, last: int = killed_at) -> None:
            if name.split()[0] in STAGED:
                done.append(name)
                if len(done) > last:
                    raise Terminated

        with monkeypatch.context() as patch:
            patch.setattr(Watching, "finished", count)
            with pytest.raises(Terminated):
                run("killed", *ROUNDS, cache=own)
        assert not (tmp_path / "killed").exists()
        again, folder = run("again", *ROUNDS, cache=own)
        assert contents(folder) == plain
        redone = [name for name in again.done if name.split()[0] in STAGED]
        assert len(redone) == len(steps) - killed_at  # of what was done, only the step in which it was killed


@pytest.mark.usefixtures("traced", "falling")
def test_random_numbers_go_on_where_they_were_if_only_some_results_are_left(run: Any, cache: Cache) -> None:
    plain = contents(run("plain", *ROUNDS)[1])
    for k, kept in enumerate(cache.files()):
        if k % 3 == 0:
            kept.path.unlink()
    _, folder = run("again", *ROUNDS)
    assert contents(folder) == plain


@pytest.mark.parametrize("damage", ["flip", "cut", "empty"])
def test_whatever_is_damaged_is_made_again_and_said_aloud(damage: str, run: Any, cache: Cache) -> None:
    plain = contents(run("first")[1])
    for kept in cache.files():
        before = kept.path.read_bytes()
        middle = len(before) // 2
        flipped = before[:middle] + bytes([before[middle] ^ 1]) + before[middle + 1 :]
        kept.path.write_bytes({"flip": flipped, "cut": before[:middle], "empty": b""}[damage])
    again, folder = run("again")
    assert contents(folder) == plain
    assert len(again.notices) >= len(EVERYTHING)
    assert all("is damaged and will be made again" in text for text in again.notices)
    healed, folder = run("healed")
    assert healed.notices == []
    assert healed.done == []


def test_verify_finds_and_removes_what_is_damaged(run: Any, cache: Cache) -> None:
    run("first")
    assert cache.verify() == []
    victims = [cache.files()[0].path, next((cache.folder / "files-1").iterdir())]
    for victim in victims:
        content = bytearray(victim.read_bytes())
        content[len(content) // 2] ^= 1
        victim.write_bytes(content)
    assert len(cache.verify()) == 2
    assert not any(victim.exists() for victim in victims)
    assert cache.verify() == []


class Moody(ToyMatcher):
    """Finds something else every time."""

    repeatable: ClassVar[bool] = False
    calls: ClassVar[list[int]] = []
    answers: ClassVar[list[float]] = []

    def match(self, scene: Scene, rng: np.random.Generator, progress: Progress = silent) -> Candidates:
        found = super().match(scene, rng)
        self.calls.append(1)
        return Candidates(found.offsets_mm + np.float32(self.answers.pop()), found.maps, found.errors)


def test_a_stage_that_is_not_repeatable_is_never_served_from_the_cache(run: Any) -> None:
    moody = asking(Analysis("size", compute=size_of), stages=(*(s for s in STAGES if s is not ToyMatcher), Moody))
    Moody.answers[:] = [0.0, 1.0, 0.0]
    assert run("first", registry=moody)[0].kept_steps == EVERYTHING
    assert run("second", registry=moody)[0].kept_steps == EVERYTHING
    # the first answer once more: what follows from it is kept
    assert run("third", registry=moody)[0].kept_steps == {"matcher toy"}


def test_an_analysis_that_is_not_repeatable_answers_every_time(run: Any) -> None:
    asked = asking(Analysis("size", compute=size_of, repeatable=False))
    run("first", registry=asked)
    again, _ = run("again", registry=asked)
    assert again.kept_steps == {"size"}


class Placed(ToyRenderer):
    """Depends on the machine."""

    type: ClassVar[str] = "placed"
    place: ClassVar[list[str]] = ["here"]

    def surroundings(self) -> object:
        return {"place": self.place[0]}


def test_a_stage_says_what_else_it_depends_on(run: Any) -> None:
    placed = asking(stages=(*STAGES, Placed))
    more = "pipeline.renderers=[{type: tracer}, {type: placed}]"
    run("first", more, registry=placed)
    assert run("again", more, registry=placed)[0].done == []
    Placed.place[:] = ["there"]
    assert run("moved", more, registry=placed)[0].kept_steps == {"renderer placed"}
    Placed.place[:] = ["here"]


@pytest.mark.parametrize("answer", [lambda: 1 / 0, object])
def test_a_stage_that_cannot_say_that_is_named(answer: Any, run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ToyMatcher, "surroundings", lambda self: answer())
    with pytest.raises(StageError, match=r"^matcher toy \(magiclens-toys 1.2\): surroundings failed"):
        run("out")


def test_another_version_of_a_stage_is_another_stage(run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    run("first")
    monkeypatch.setattr(ToyIntegrator, "version", "2")
    assert run("again")[0].kept_steps == {*REFINED, *FILES, "size"} - {"annealer toy"}


PLUGIN = """
from magiclens import Exporter

class Written(Exporter):
    type = "written"
    suffix = ".written"

    def export(self, scene, solid, path):
        path.write_text(WORDS)
"""


def test_other_sources_of_a_plugin_make_its_stages_work_again(
    run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path / "site")
    monkeypatch.setattr("sys.dont_write_bytecode", True)  # it would be taken for that of the second one
    (tmp_path / "site" / "mlens_written").mkdir(parents=True)
    more = "pipeline.exporters=[{type: toy}, {type: written}]"
    for words, done in (("one", {*DESIGN, *FILES, "exporter written"}), ("two", {"exporter written"})):
        (tmp_path / "site" / "mlens_written" / "__init__.py").write_text(f"{PLUGIN}\nWORDS = '{words}'\n")
        # as a new process would begin
        sys.modules.pop("mlens_written", None)
        sources._hash.cache_clear()
        sources._hashed.clear()
        stage = __import__("mlens_written").Written
        registry = asking(stages=(*STAGES, stage))
        again, folder = run(words, more, registry=registry)
        assert again.kept_steps - {"size"} == done
        assert (folder / "lens.written").read_text() == words


def test_what_was_made_while_sources_were_edited_is_not_kept(run: Any, cache: Cache, tmp_path: Path) -> None:
    edited = tmp_path / "edited.py"
    edited.write_text("x = 1\n")
    sources._hash(edited)
    edited.write_text("x = 22\n")
    try:
        run("first")
        assert list(cache.entries()) == []
    finally:
        del sources._hashed[edited]


def test_code_that_is_in_no_file_is_not_kept(run: Any) -> None:
    typed_in = type("TypedIn", (ToyMatcher,), {"__module__": "nowhere"})
    with pytest.raises(UnknownSources):
        source_hashes([typed_in])
    registry = asking(stages=(*(s for s in STAGES if s is not ToyMatcher), typed_in))
    run("first", registry=registry)
    assert run("again", registry=registry)[0].kept_steps == {"matcher toy"}


def test_bases_from_other_packages_count_and_so_does_our_own() -> None:
    assert source_hashes([ToyAnnealer]).keys() == {"magiclens", "toys"}
    assert source_hashes([Painter]).keys() == {"magiclens", __name__}
    assert source_hashes([]).keys() == {"magiclens"}


def refuse_writing(cache: Cache, error: OSError, monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on, no file of the cache gets its name."""
    replace_anywhere = os.replace

    def replace_elsewhere(old: Path, new: Path, **options: Any) -> None:
        if Path(new).is_relative_to(cache.folder):
            raise error
        replace_anywhere(old, new, **options)

    monkeypatch.setattr("magiclens.cache.store.os.replace", replace_elsewhere)


def test_what_cannot_be_written_is_not_kept_and_that_is_said_once(
    run: Any, cache: Cache, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = contents(run("plain", cache=None)[1])
    refuse_writing(cache, PermissionError(13, "Permission denied"), monkeypatch)
    for out in ("first", "again"):
        seen, folder = run(out, cache=Cache(cache.folder, 10**9))
        assert contents(folder) == plain
        assert seen.notices == [
            f"nothing is kept in the cache '{cache.folder}': Permission denied; see MLENS_CACHE_DIR"
        ]


def test_a_folder_that_can_only_be_read_is_used(run: Any, cache: Cache, monkeypatch: pytest.MonkeyPatch) -> None:
    error = OSError(30, "Read-only file system")

    def refuse(*_: Any, **__: Any) -> None:
        raise error

    run("first")
    monkeypatch.setattr("magiclens.cache.store.os.utime", refuse)
    refuse_writing(cache, error, monkeypatch)
    again, _ = run("again")
    assert (again.done, again.notices) == ([], [])


def test_what_was_used_last_stays_when_room_is_made(run: Any, cache: Cache) -> None:
    run("first")
    run("second", "lens.size=21mm")
    for kept in cache.files():
        os.utime(kept.path, (1e9, 1e9))
    run("again")
    used = sum(kept.size_bytes for kept in cache.files() if kept.used > 1e9)
    gone = cache.make_room(used)
    assert gone
    assert all(kept.used == 1e9 for kept in gone)
    assert run("still", cache=cache)[0].done == []
    assert run("other", "lens.size=21mm")[0].kept_steps == EVERYTHING


def test_a_run_keeps_within_the_limit_and_removes_what_killed_ones_left(run: Any, tmp_path: Path) -> None:
    small = Cache(tmp_path / "small", 30_000)
    run("first", cache=small)
    assert 0 < sum(kept.size_bytes for kept in small.files()) <= 30_000
    left = small.folder / "entries-1" / ".partly-x"
    left.touch()
    small.make_room()
    assert left.exists()  # another process may be writing it
    os.utime(left, (1e9, 1e9))
    small.make_room()
    assert not left.exists()


SCRIPT = """
import os, sys
from pathlib import Path
import toys
from magiclens.plan.compile import load_plan
from magiclens.running.pipeline import kept_run, run_plan

class Waiting(toys.ToyIntegrator):
    def integrate(self, *args, **more):
        if os.environ.get("KILL"):
            os.kill(os.getpid(), 9)
        return super().integrate(*args, **more)

spec, out = sys.argv[1:]
registry = toys.registry_of(*(s for s in toys.TOYS if s is not toys.ToyIntegrator), Waiting)
plan = load_plan(spec, (), registry)
kept = kept_run(plan, out)
print("kept" if kept else "run", "numba" in sys.modules)
kept or run_plan(plan, out)
"""


def script(tmp_path: Path, spec: Path, out: str, **environment: str) -> subprocess.Popen[str]:
    (tmp_path / "script.py").write_text(SCRIPT)
    command = [sys.executable, str(tmp_path / "script.py"), str(spec), str(tmp_path / out)]
    paths = os.pathsep.join(sys.path)
    variables = {"MLENS_CACHE_SIZE": "1GB", "MLENS_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": paths}
    return subprocess.Popen(command, env={**os.environ, **variables, **environment}, stdout=subprocess.PIPE, text=True)


@pytest.mark.tools
def test_after_sigkill_a_plain_run_goes_on_and_the_one_after_that_does_nothing(
    write_spec: SpecWriter, tmp_path: Path, cache: Cache
) -> None:
    spec = write_spec()
    killed = script(tmp_path, spec, "out", KILL="1")
    assert killed.wait() == -signal.SIGKILL
    assert [entry.step for entry in cache.entries() if entry.step in DESIGN] == ["annealer toy", "matcher toy"]
    outs = []
    for out in ("out", "again"):
        done = script(tmp_path, spec, out)
        outs.append(done.communicate()[0].split())
    assert outs == [["run", "False"], ["kept", "False"]]
    assert contents(tmp_path / "out") == contents(tmp_path / "again")


@pytest.mark.tools
def test_two_processes_share_it(write_spec: SpecWriter, tmp_path: Path, cache: Cache) -> None:
    spec = write_spec()
    both = [script(tmp_path, spec, out) for out in ("one", "two")]
    assert [each.wait() for each in both] == [0, 0]
    assert contents(tmp_path / "one") == contents(tmp_path / "two")
    assert cache.verify() == []


def test_plan_says_what_would_run_and_why(run: Any, write_spec: SpecWriter, registry: Registry, cache: Cache) -> None:
    def lines(*overrides: str) -> dict[str, str]:
        expected = forecast(load_plan(write_spec(), overrides, registry), cache)
        return {each.step: "; ".join(each.why) if not each.kept else "kept" for each in expected}

    assert lines()["matcher toy"] == "nothing of it is kept yet"
    run("first")
    assert set(lines().values()) == {"kept"}
    assert whole_run_kept(load_plan(write_spec(), (), registry), cache)
    assert lines("pipeline.matcher.sweeps=7")["matcher toy"] == "sweeps: 5 -> 7"
    assert lines("pipeline.matcher.sweeps=7")["annealer toy"] == "candidates is another one"
    assert lines("lens.thickness=41mm")["matcher toy"].startswith("scene.lens.thickness_mm: 40.0 -> 41.0")
    assert lines("seed=3")["matcher toy"] == "seed: 0 -> 3; the seed, or what was drawn before, differs"
    assert "scene.views.1 rotation-090.target is another one" in lines("scenario.targets.1.art=owl")["matcher toy"]


@pytest.mark.usefixtures("traced", "falling")
def test_plan_knows_rounds_too(run: Any, write_spec: SpecWriter, registry: Registry, cache: Cache) -> None:
    run("first", *ROUNDS)
    assert all(each.kept for each in forecast(load_plan(write_spec(), ROUNDS, registry), cache))
    changed = forecast(load_plan(write_spec(), [*ROUNDS, "pipeline.matcher.sweeps=7"], registry), cache)
    assert not any(each.kept for each in changed)


def test_generators_go_on_from_their_states() -> None:
    rng = np.random.default_rng(np.random.SeedSequence(3).spawn(2)[1])
    rng.random(5), rng.integers(9, dtype=np.int32), rng.spawn(2)
    again = generator_in(json.loads(json.dumps(generator_state(rng))))
    assert generator_state(again) == generator_state(rng)
    assert again.random() == rng.random()
    assert again.spawn(1)[0].random() == rng.spawn(1)[0].random()


def test_values_come_back_as_they_were() -> None:
    shared, turned = np.arange(6.0).reshape(1, 2, 3), np.arange(24.0).reshape(2, 3, 4).transpose(2, 0, 1)
    eye = np.array([0.0, 0.0, 400.0])
    views = tuple(View(name, shared, shared + 1, eye) for name in ("a", "b"))
    scene = Scene(Lens(), views, np.ones((2, 2), bool))
    solid = Solid(turned, np.zeros((4, 3), np.int32), (2, 2), None, {"volume_mm3": float("nan"), "n": np.int64(3)})
    value = [scene, solid, (1, 2.5, "x", None, True)]
    document, arrays = packed(value, [scene])
    assert borrowed(document) == {0}
    assert len(arrays) == 2  # the scene's arrays are those of the input
    back = unpacked(json.loads(json.dumps(document)), arrays, {0: scene})
    assert json.dumps(described(back)) == json.dumps(described(value))  # as text, since NaN is not equal to itself
    assert back[0].views[0].source is back[0].views[1].source
    assert back[1].vertices.strides == turned.strides
    assert type(back[2]) is tuple


def test_arrays_with_gaps_are_copied_and_others_stay() -> None:
    whole = np.arange(24.0).reshape(4, 6)
    assert settled(whole) is whole
    assert np.shares_memory(settled(whole.T), whole)
    for gaps in (whole[:, :3], whole[::2], np.broadcast_to(whole[0], (3, 6)), whole[:, ::-1]):
        assert settled(gaps).flags.c_contiguous
        np.testing.assert_array_equal(settled(gaps), gaps)


def test_the_order_of_views_and_the_type_of_arrays_count() -> None:
    eye, picture = np.array([0.0, 0.0, 400.0]), np.ones((1, 1, 1), np.float32)
    a, b = (View(name, picture, picture, eye) for name in "ab")
    assert described(Scene(Lens(), (a, b))) != described(Scene(Lens(), (b, a)))
    assert described(picture) != described(picture.astype(float))


class Odd(Assignment):
    """An artifact of a class that only its plugin knows."""


class OddAnnealer(ToyAnnealer):
    def anneal(self, *args: Any, **more: Any) -> Assignment:
        found = super().anneal(*args, **more)
        return Odd(found.choice, found.offsets_mm, found.maps, found.errors)


def test_artifacts_of_unknown_classes_are_made_every_time(run: Any) -> None:
    with pytest.raises(NotPlain):
        packed(object(), [])
    odd = asking(stages=(*(s for s in STAGES if s is not ToyAnnealer), OddAnnealer))
    run("first", "report.analyses=[]", registry=odd)
    again, _ = run("again", "report.analyses=[]", "name=other", registry=odd)
    assert again.kept_steps == {"annealer toy"}


def test_entries_are_small_and_hold_what_they_were_made_of(cache: Cache) -> None:
    entry = new_entry("step", {"step": "step", "a": 1}, 2.0)
    cache.keep(entry, [np.zeros(3)])
    found = cache.find(entry.key)
    assert found is not None
    assert (found.step, found.made_of, found.seconds) == ("step", {"step": "step", "a": 1}, 2.0)
    np.testing.assert_array_equal(cache.value(found)[0], np.zeros(3))
    assert cache.find("0" * 64) is None


@pytest.fixture
def mlens(registry: Registry, cache: Cache, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Result]:
    """Runs a command with the toys, and with a cache of its own."""
    monkeypatch.setattr(Registry, "load", lambda: registry)
    monkeypatch.setenv("MLENS_CACHE_SIZE", "1GB")
    monkeypatch.setenv("MLENS_CACHE_DIR", str(cache.folder))
    return lambda *arguments: CliRunner().invoke(app, [str(a) for a in arguments])


def test_the_command_line_keeps_shows_and_removes_results(mlens: Any, write_spec: SpecWriter, tmp_path: Path) -> None:
    spec, out = write_spec(), tmp_path / "out"
    assert mlens("run", spec, "--out", out, "--no-cache").exit_code == 0
    assert not (tmp_path / "cache").exists()
    os.environ["MLENS_CACHE_SIZE"] = "1GB"  # which --no-cache has changed, for processes that it would start
    assert "runs  matcher toy" in mlens("plan", spec, "--why").stdout
    first = mlens("run", spec, "--out", out)
    again = mlens("run", spec, "--out", out)
    assert "the whole run" in again.stderr
    assert again.stdout == first.stdout
    assert "the whole run is kept" in mlens("plan", spec, "--why").stdout
    assert all(step["kept"] for step in json.loads(mlens("plan", spec, "--why", "--json").stdout)["steps"])
    assert "matcher toy" in mlens("cache", "ls").stdout
    listed = json.loads(mlens("cache", "ls", "--json").stdout)
    assert {"matcher toy", "run"} <= {result["step"] for result in listed["results"]}
    assert listed["limit_bytes"] == 10**9
    assert mlens("cache", "verify").exit_code == 0
    next((tmp_path / "cache" / "files-1").iterdir()).write_bytes(b"")
    assert mlens("cache", "verify").exit_code == 1
    assert json.loads(mlens("cache", "gc", "--size", "0", "--json").stdout)["files"] == 0
    assert "0 files" in mlens("cache", "ls").stdout


def test_sizes_that_are_none_are_refused(mlens: Any, write_spec: SpecWriter, monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = mlens("cache", "gc", "--size", "much")
    assert (wrong.exit_code, wrong.stderr) == (2, "error: --size: 'much' is no size; write one such as 500MB or 20GB\n")
    monkeypatch.setenv("MLENS_CACHE_SIZE", "5")
    wrong = mlens("run", write_spec())
    assert wrong.exit_code == 2
    assert "MLENS_CACHE_SIZE: '5' is no size" in wrong.stderr


def test_sweeps_take_what_they_share_from_the_cache(
    write_spec: SpecWriter, registry: Registry, cache: Cache, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MLENS_CACHE_SIZE", "1GB")
    monkeypatch.setenv("MLENS_CACHE_DIR", str(cache.folder))
    calls: list[str] = []
    match = ToyMatcher.match
    monkeypatch.setattr(ToyMatcher, "match", lambda *args, **more: calls.append("match") or match(*args, **more))
    settings = ["pipeline.renderers=[{type: tracer}],[{type: toy}]"]
    done = sweep_spec(write_spec(), settings, tmp_path / "sweep", None, registry)
    assert not done.failed
    assert calls == ["match"]
