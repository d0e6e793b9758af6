"""Plugins: how they are found, what they may contribute, and what happens when they are broken."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from magiclens.config.schema import json_schema
from magiclens.contract.errors import InputError, StageError, Terminated
from magiclens.contract.hookspecs import hookimpl
from magiclens.contract.stages import KINDS, Matcher
from magiclens.plan.blame import blaming
from magiclens.plan.capture import captured_output
from magiclens.plan.compile import load_plan
from magiclens.plan.listing import describe_plugins
from magiclens.plan.registry import NAMED_ART, SCENARIO, STAGE, Plugin, Registry
from magiclens.scenarios.rotating import Rotating
from toys import TOY_PLUGIN, SpecWriter, ToyExporter, ToyMatcher, plugin_of, registry_of

OTHER = Plugin("other", "other-package", "3.4")

GOOD = """
from pathlib import Path
from magiclens import Exporter, hookimpl

class Dots(Exporter):
    type = "dots"
    suffix = ".dots"
    spacing: int = 3

    def export(self, scene, solid, path: Path) -> None:
        path.write_text("." * self.spacing)

@hookimpl
def mlens_stages():
    return [Dots]

@hookimpl
def mlens_art():
    return {"dot": lambda size: None}
"""


def install(folder: Path, name: str, source: str, version: str = "2.1") -> None:
    """Write the files that pip installs for a package of one module that is an entry point."""
    module = name.replace("-", "_")
    (folder / f"{module}.py").write_text(source)
    info = folder / f"{module}-{version}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    (info / "entry_points.txt").write_text(f"[magiclens]\n{module} = {module}\n")


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder on the path that packages can be installed into."""
    monkeypatch.syspath_prepend(tmp_path)
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(tmp_path)):
            del sys.modules[name]


def test_an_installed_package_contributes_through_its_entry_point(site: Path) -> None:
    install(site, "good-dots", GOOD)
    registry = Registry.load()
    found = registry.find(STAGE, "exporter", "dots")
    assert found is not None
    assert found[0].__name__ == "Dots"
    assert found[1] == Plugin("good_dots", "good-dots", "2.1")
    assert "dot" in registry.types(NAMED_ART)


def test_built_in_stages_come_through_the_same_entry_points() -> None:
    registry = Registry.load()
    found = registry.find(SCENARIO, "rotating")
    assert found is not None
    assert (found[1].name, found[1].package) == ("builtin", "magiclens")
    assert registry.failures == []
    assert {"panda", "bat", "penguin", "whale"} <= set(registry.types(NAMED_ART))


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("import no_such_module", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("raise SystemExit(3)", "SystemExit: 3"),
        ("def broken(:", "SyntaxError"),
        (GOOD.replace("return [Dots]", "return 1 / 0"), "ZeroDivisionError"),
        (GOOD.replace("return [Dots]", "return 7"), "TypeError: 'int' object is not iterable"),
        (GOOD.replace("return [Dots]", "return [int]"), "int.type is not text"),
        (GOOD.replace("return [Dots]", "return ['Dots']"), "'Dots' is not a class"),
        (GOOD.replace("def export", "def exprt"), "Dots lacks export"),
        (GOOD.replace('".dots"', '"dots"'), "Dots.suffix is not a file ending"),
        (GOOD.replace("def mlens_stages", "def mlens_stagez"), "unknown hook 'mlens_stagez'"),
        (GOOD.replace("def mlens_stages()", "def mlens_stages(x)"), "hookimpl definition"),
    ],
)
def test_a_broken_plugin_is_recorded_and_stops_nothing(source: str, reason: str, site: Path) -> None:
    install(site, "a-broken-one", source)
    install(site, "good-dots", GOOD.replace('"dots"', '"dots2"').replace('"dot"', '"dot2"'))
    registry = Registry.load()
    assert registry.find(STAGE, "exporter", "dots2") is not None
    assert registry.find(STAGE, "exporter", "dots") is None
    failure = next(f for f in registry.failures if f.plugin.package == "a-broken-one")
    assert reason in failure.reason
    assert failure.plugin.version == "2.1"
    assert len(failure.reason.splitlines()) < 8
    assert reason in describe_plugins(registry)


def test_a_process_that_a_plugin_has_forked_may_end_itself() -> None:
    with blaming("forker"):
        child = os.fork()
        if child == 0:
            os._exit(3)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 3


def test_one_flawed_class_does_not_take_its_neighbours_along() -> None:
    registry = Registry()
    registry.register(plugin_of(ToyMatcher, object, ToyExporter), TOY_PLUGIN)
    assert registry.types(STAGE, "matcher") == registry.types(STAGE, "exporter") == ["toy"]
    assert [f.reason for f in registry.failures] == ["mlens_stages: object.type is not text"]


def test_a_class_that_inherits_nothing_may_be_a_stage() -> None:
    methods = {"model_validate": len, "model_dump": len, "match": lambda self, scene, rng, progress: None}
    duck = type("Duck", (), {"kind": "matcher", "type": "duck", "version": "1", **methods})
    registry = Registry()
    registry.register(plugin_of(duck), TOY_PLUGIN)
    assert registry.find(STAGE, "matcher", "duck") == (duck, TOY_PLUGIN)


def test_a_stage_without_its_method_is_refused() -> None:
    class Lazy(Matcher):
        type: ClassVar[str] = "lazy"

    registry = Registry()
    registry.register(plugin_of(Lazy), TOY_PLUGIN)
    assert "Lazy lacks match" in registry.failures[0].reason


def test_a_stage_whose_method_takes_other_arguments_is_refused() -> None:
    class Odd(ToyExporter):
        def export(self, solid: Any, path: Any) -> None:  # type: ignore[override]
            pass

    registry = Registry()
    registry.register(plugin_of(Odd), TOY_PLUGIN)
    assert "Odd.export is called with (self, scene, solid, path): too many" in registry.failures[0].reason
    assert registry.types(STAGE, "exporter") == []


@pytest.mark.parametrize(
    ("written", "reason"),
    [
        ("2.1", "it is written for contract 2.1, this magiclens has 2.0: upgrade magiclens"),
        ("3.0", "upgrade magiclens"),
        ("0.9", "it is written for contract 0.9, this magiclens has 2.0: upgrade the plugin"),
        (1.0, "mlens_contract is 1.0; it is text such as '2.0'"),
        ("new", "mlens_contract is 'new'; it is text such as '2.0'"),
    ],
)
def test_a_plugin_written_for_another_contract_is_told_what_to_upgrade(written: Any, reason: str) -> None:
    plugin = plugin_of(ToyMatcher)
    vars(plugin)["mlens_contract"] = written
    registry = Registry()
    registry.register(plugin, TOY_PLUGIN)
    assert registry.failures[0].reason.endswith(reason)
    assert registry.types(STAGE, "matcher") == []


def test_a_plugin_written_for_this_contract_or_an_older_second_number_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("magiclens.contract.hookspecs.CONTRACT", "1.3")
    plugin = plugin_of(ToyMatcher)
    vars(plugin)["mlens_contract"] = "1.2"
    registry = Registry()
    registry.register(plugin, TOY_PLUGIN)
    assert registry.failures == []


def test_a_plugin_that_forgets_to_mark_its_hooks_gets_a_remark() -> None:
    registry = Registry()
    registry.register(SimpleNamespace(mlens_stages=lambda: [ToyMatcher]), TOY_PLUGIN)
    assert registry.failures == []
    assert "none of its functions has @hookimpl" in registry.remarks[0].reason
    assert "none of its functions has @hookimpl" in describe_plugins(registry)


def test_a_module_that_is_registered_twice_counts_once() -> None:
    heard: list[float] = []
    listener = hookimpl(lambda seconds: heard.append(seconds), specname="mlens_stage_done")
    plugin = SimpleNamespace(mlens_stage_done=listener)
    registry = Registry()
    for name in ("a", "b"):
        registry.register(plugin, Plugin(name, "twice", "1"))
    assert [f.plugin.name for f in registry.failures] == ["b"]
    registry.notify("mlens_stage_done", stage=None, artifact=None, seconds=2.0)
    assert heard == [2.0]


@pytest.mark.parametrize("error", [SystemExit(3), type("Odd", (BaseException,), {})("odd")])
def test_what_is_meant_to_end_the_program_is_blamed_on_its_plugin(error: BaseException) -> None:
    with pytest.raises(StageError, match=r"^matcher x \(pack 1\) failed: \w+: (3|odd)$"), blaming("matcher x (pack 1)"):
        raise error


@pytest.mark.parametrize("error", [KeyboardInterrupt(), Terminated(143), InputError("wrong")])
def test_interrupts_signals_and_wrong_input_are_not_blamed_on_a_plugin(error: BaseException) -> None:
    with pytest.raises(type(error)), blaming("matcher x (pack 1)"):
        raise error


def test_a_failure_is_blamed_once_on_the_innermost_plugin() -> None:
    with pytest.raises(StageError, match=r"^inner: no facet$"), blaming("outer"), blaming("inner"):
        raise StageError("no facet")


def test_options_that_json_cannot_describe_do_not_spoil_the_schema_of_the_rest() -> None:
    class Odd(ToyExporter):
        type: ClassVar[str] = "odd"
        shape: Callable[[int], int] = abs

    exporters = {"odd": Odd, "toy": ToyExporter}
    schema = json_schema({}, {kind: exporters if kind == "exporter" else {} for kind in KINDS}, [])
    assert schema["definitions"]["exporter-odd"]["properties"] == {"type": {"const": "odd"}}
    assert "exporter-toy" in schema["definitions"]


def test_threads_print_under_their_own_names(capfd: pytest.CaptureFixture[str]) -> None:
    meet = threading.Barrier(4)

    def work(name: str) -> None:
        with captured_output(name):
            meet.wait()
            for k in range(20):
                print(f"line {k} of {name}")
            meet.wait()

    threads = [threading.Thread(target=work, args=(name,)) for name in "abcd"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    print("clean")
    said = capfd.readouterr()
    assert said.out == "clean\n"
    assert sorted(said.err.splitlines()) == sorted(f"{n}: line {k} of {n}" for n in "abcd" for k in range(20))


@pytest.mark.parametrize(
    ("hook", "contribution", "reason"),
    [
        ("mlens_scenarios", [SimpleNamespace], "SimpleNamespace.type is not text"),
        ("mlens_scenarios", [ToyMatcher], "ToyMatcher lacks shots, fitted_lens, make_views"),
        ("mlens_art", {"face": "not callable"}, "'face' is not the name of a function"),
        ("mlens_art", ["face"], "AttributeError"),
    ],
)
def test_other_contributions_are_checked_too(hook: str, contribution: Any, reason: str) -> None:
    registry = Registry()
    implementation = hookimpl(lambda: contribution, specname=hook)
    registry.register(SimpleNamespace(**{hook: implementation}), TOY_PLUGIN)
    assert reason in registry.failures[0].reason


def test_a_name_claimed_twice_is_an_error_naming_both_packages(registry: Registry, write_spec: SpecWriter) -> None:
    registry.register(plugin_of(ToyMatcher), OTHER)
    with pytest.raises(StageError, match=r"matcher 'toy' is claimed by magiclens-toys 1.2 and other-package 3.4"):
        load_plan(write_spec(), registry=registry)
    assert "claimed twice" in describe_plugins(registry)


def art_plugin(**art: Any) -> object:
    return SimpleNamespace(mlens_art=hookimpl(lambda: art, specname="mlens_art"))


def test_art_claimed_twice_is_an_error_naming_both_packages(registry: Registry, write_spec: SpecWriter) -> None:
    registry.register(art_plugin(panda=np.zeros), OTHER)
    plan = load_plan(write_spec(), registry=registry)
    with pytest.raises(StageError, match=r"art 'panda' is claimed by magiclens 0.1.0 and other-package 3.4"):
        plan.scene()


@pytest.mark.parametrize(
    ("draw", "reason"),
    [
        (lambda size: 1 / 0, "failed: ZeroDivisionError"),
        (lambda size: np.zeros((size, 3)), r"it drew \(1024, 3\) pixels"),
        (lambda size: np.full((size, size, 1), np.nan), "or NaN"),
    ],
)
def test_art_that_cannot_be_drawn_is_named(draw: Any, reason: str, registry: Registry, write_spec: SpecWriter) -> None:
    registry.register(art_plugin(face=draw), OTHER)
    plan = load_plan(write_spec(("art: bat", "art: face")), registry=registry)
    with pytest.raises(StageError, match=rf"^art face \(other-package 3.4\) .*{reason}"):
        plan.scene()


def test_a_scenario_that_fails_is_named(registry: Registry, write_spec: SpecWriter) -> None:
    class Faulty(Rotating):
        type: ClassVar[str] = "faulty"

        def make_views(self, *_: Any) -> Any:
            raise RuntimeError("no view")

    scenarios = hookimpl(lambda: [Faulty], specname="mlens_scenarios")
    registry.register(SimpleNamespace(mlens_scenarios=scenarios), OTHER)
    plan = load_plan(write_spec(("type: rotating", "type: faulty")), registry=registry)
    with pytest.raises(StageError, match=r"scenario faulty \(other-package 3.4\) failed: RuntimeError: no view"):
        plan.scene()


def test_a_missing_stage_points_to_failed_plugins(write_spec: SpecWriter) -> None:
    registry = registry_of(ToyMatcher)
    registry.register(plugin_of(object), OTHER)
    with pytest.raises(InputError, match=r"unknown annealer 'toy'; .*plugins failed: other-package 3.4; see 'mlens"):
        load_plan(write_spec(), registry=registry)


def test_an_observer_that_fails_is_reported_and_the_next_one_is_called() -> None:
    heard: list[float] = []

    def deaf(seconds: float) -> None:
        raise RuntimeError("no ears")

    registry = Registry()
    for name, listener in (("a", deaf), ("b", lambda seconds: heard.append(seconds))):
        implementation = hookimpl(listener, specname="mlens_stage_done")
        registry.register(SimpleNamespace(mlens_stage_done=implementation), Plugin(name, name, "1"))
    complaints = registry.notify("mlens_stage_done", stage=None, artifact=None, seconds=2.0)
    assert heard == [2.0]
    assert complaints == ["plugin a (a 1): mlens_stage_done failed: RuntimeError: no ears"]


def test_the_listing_shows_kind_name_package_version_and_options(registry: Registry) -> None:
    lines = describe_plugins(registry).splitlines()
    assert lines[0].split() == ["KIND", "NAME", "PACKAGE", "VERSION", "OPTIONS"]
    assert lines[1].split(maxsplit=4) == ["matcher", "toy", "magiclens-toys", "1.2", "sweeps, window, step"]
    assert any(line.split()[:3] == ["art", "panda", "magiclens"] for line in lines)
