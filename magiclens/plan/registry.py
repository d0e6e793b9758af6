"""Finds plugins and keeps what they contribute; no other file uses pluggy's plugin manager.

Built-in stages come through the same group of entry points as those of other packages. Entry points are loaded one by
one. A plugin that fails is recorded and stops nothing; what it prints goes to standard error. Later, plugins are called
inside ``blaming``, so that errors and output name them.
"""

from __future__ import annotations

import os
import re
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import EntryPoint, entry_points
from typing import Any

import numpy as np
import pluggy

from magiclens.config.suggest import unknown
from magiclens.contract import hookspecs
from magiclens.contract.artifacts import FloatArray
from magiclens.contract.errors import InputError, StageError, Terminated
from magiclens.plan.blame import Blamed, blaming
from magiclens.plan.capture import captured_output
from magiclens.plan.flaws import analysis_flaw, art_flaw, executor_flaw, scenario_flaw, stage_flaw
from magiclens.plan.staying import told_when_slow, without_exits

STAGE = "stage"
"""First key of stages in a registry; the second is their kind, the third their type."""

SCENARIO = "scenario"
"""First key of scenarios in a registry; the second is their type."""

NAMED_ART = "art"
"""First key of named pictures in a registry; the second is their name."""

EXECUTOR = "executor"
"""First key of executors in a registry; the second is their type."""

ANALYSIS = "analysis"
"""First key of analyses in a registry; the second is their name."""

_DISABLED_VARIABLE = "MLENS_DISABLE_PLUGINS"
"""Environment variable that names the plugins to leave alone, by package or entry point, between commas or blanks."""


@dataclass(frozen=True)
class Plugin:
    """A plugin that is installed.

    Attributes:
        name: The name of its entry point, such as ``builtin``.
        package: The package that it belongs to, such as ``magiclens``.
        version: The package's version.
    """

    name: str
    package: str
    version: str

    @property
    def built_in(self) -> bool:
        """Whether it comes with magiclens itself."""
        return self.package == "magiclens"

    def __str__(self) -> str:
        return f"{self.package} {self.version}"


_LENT = Plugin("lent", "lent-to-this-run", "0")
"""Where stages come from that were given to ``magiclens.run``."""


@dataclass(frozen=True)
class Failure:
    """A plugin, or one of its contributions, that cannot be used.

    Attributes:
        plugin: The plugin.
        reason: Why: a sentence, or the last lines of a traceback.
    """

    plugin: Plugin
    reason: str

    def __str__(self) -> str:
        return f"plugin {self.plugin.name} ({self.plugin}): {self.reason.splitlines()[-1].strip()}"


@dataclass(frozen=True)
class Contribution:
    """One thing that a plugin contributes.

    Attributes:
        value: The class of a stage, a scenario or an executor, or the function that draws a named picture.
        plugin: The plugin that was loaded first of those that contribute this name.
        rivals: Plugins that contribute another value under the same name.
    """

    value: Any
    plugin: Plugin
    rivals: tuple[Plugin, ...] = ()


class Registry:
    """Everything that plugins contribute, by name.

    Attributes:
        failures: Plugins and contributions that cannot be used.
        remarks: What is not as it should be, but keeps nothing from being used.
        disabled: Plugins that were not loaded because the user does not want them.
    """

    def __init__(self) -> None:
        self.failures: list[Failure] = []
        self.remarks: list[Failure] = []
        self.disabled: list[Plugin] = []
        self._plugins: dict[str, Plugin] = {}
        self._contributions: dict[tuple[str, ...], Contribution] = {}
        self._manager = pluggy.PluginManager("magiclens")
        self._manager.add_hookspecs(hookspecs)

    @classmethod
    def load(cls, found: Iterable[EntryPoint] | None = None, disabled: Iterable[str] | None = None) -> Registry:
        """A registry of everything that is installed.

        Args:
            found: The entry points to load, instead of those of all installed packages.
            disabled: Packages and entry points that are not even imported; by default those that the environment
                variable MLENS_DISABLE_PLUGINS names.

        Raises:
            InputError: No plugin has a name that is to be disabled.
        """
        registry = cls()
        installed = entry_points(group=hookspecs.ENTRY_POINT_GROUP)
        # sorted, so that nothing depends on the order in which packages were installed
        points = sorted(installed if found is None else found, key=lambda p: (p.name, p.value))
        plugins = [_provider(point) for point in points]
        names = re.split(r"[,\s]+", os.environ.get(_DISABLED_VARIABLE, "")) if disabled is None else disabled
        unwanted = {_known(name, plugins) for name in names if name}
        for point, plugin in zip(points, plugins, strict=True):
            if unwanted & _names(plugin):
                registry.disabled.append(plugin)
            else:
                registry._load(point, plugin)
        return registry

    def register(self, implementation: object, plugin: Plugin) -> None:
        """Add one plugin. What is wrong with it is recorded, and raises nothing.

        Args:
            implementation: A module or an object with hook implementations.
            plugin: Its name, package and version.
        """
        flaw = hookspecs.contract_flaw(implementation)
        if flaw:
            self._fail(plugin, flaw)
        elif self._accept(implementation, plugin):
            self._collect(implementation, plugin, "mlens_stages", self._add_stages)
            self._collect(implementation, plugin, "mlens_scenarios", self._add_scenarios)
            self._collect(implementation, plugin, "mlens_art", self._add_art)
            self._collect(implementation, plugin, "mlens_executors", self._add_executors)
            self._collect(implementation, plugin, "mlens_analyses", self._add_analyses)

    def lend(self, classes: Iterable[type[Any]]) -> None:
        """Add classes of stages that no plugin brings, for one run from Python. Those that are there stay as they are.

        What is wrong with them is recorded, as in ``register``.
        """
        there = {id(each.value) for each in self._contributions.values()}
        self._add_stages((cls for cls in dict.fromkeys(classes) if id(cls) not in there), _LENT)

    def find(self, *key: str) -> tuple[Any, Plugin] | None:
        """A contribution and its plugin.

        Args:
            key: The keys that lead to it, such as ``STAGE, "matcher", "exhaustive"`` or ``SCENARIO, "single"``.

        Returns:
            Its value and its plugin; None if nothing has this name.

        Raises:
            StageError: Several packages contribute something under this name.
        """
        found = self._contributions.get(key)
        if found is None:
            return None
        if found.rivals:
            claims = " and ".join(str(p) for p in (found.plugin, *found.rivals))
            keep = "keep one of them: uninstall the others, or --disable-plugin NAME"
            raise Blamed(f"the {' '.join(key[:-1])} {key[-1]!r} is claimed by {claims}; {keep}")
        return found.value, found.plugin

    def types(self, *kind: str) -> list[str]:
        """The names to choose from: ``types(STAGE, "matcher")``, ``types(SCENARIO)``, ``types(NAMED_ART)``."""
        return sorted(key[-1] for key in self._contributions if key[:-1] == kind)

    @property
    def absent(self) -> str:
        """A hint that names the plugins that failed or are disabled; empty if there are none."""
        failed = ", ".join(dict.fromkeys(str(f.plugin) for f in self.failures))
        disabled = ", ".join(dict.fromkeys(map(str, self.disabled)))
        parts = [f"failed: {failed}"] if failed else []
        parts += [f"disabled: {disabled}"] if disabled else []
        return f"plugins {'; '.join(parts)}; see 'mlens plugins'" if parts else ""

    @property
    def art(self) -> Mapping[str, Callable[[int], FloatArray]]:
        """Named pictures: functions from a size in pixels to (size, size, C) float32, linear light, C = 1 or 3."""
        return {name: partial(self._draw, name) for name in self.types(NAMED_ART)}

    def classes(self, *kind: str) -> dict[str, Any]:
        """What the names of ``types(*kind)`` stand for, in the order in which plugins list them."""
        return {key[-1]: one.value for key, one in self._contributions.items() if key[:-1] == kind}

    @property
    def contributions(self) -> Mapping[tuple[str, ...], Contribution]:
        """Everything: (STAGE, kind, type), (SCENARIO, type), (NAMED_ART, name), (EXECUTOR, type), (ANALYSIS, name)."""
        return dict(self._contributions)

    def notify(self, hook: str, **arguments: Any) -> list[str]:
        """Call an observing hook of every plugin; an observer that fails stops nothing.

        Args:
            hook: The hook's name, such as ``mlens_run_done``.
            arguments: All of the hook's arguments; implementations get those that they ask for.

        Returns:
            What the observers raised, a message each.
        """
        complaints = []
        # one by one, as pluggy would stop at the first observer that fails
        for implementation in getattr(self._manager.hook, hook).get_hookimpls():
            try:
                plugin = self._plugins[implementation.plugin_name]
                owner = f"plugin {plugin.name} ({plugin}): {hook}"
                with blaming(owner), told_when_slow(f"in {owner}", plugin.name):
                    implementation.function(*(arguments[name] for name in implementation.argnames))
            except StageError as error:
                complaints.append(str(error))
        return complaints

    def _draw(self, name: str, size_px: int) -> FloatArray:
        found = self.find(NAMED_ART, name)
        if found is None:
            raise KeyError(name)
        with blaming(f"art {name} ({found[1]})"):
            # checked here, since a wrong picture would fail in some stage, far from the plugin that drew it
            picture = np.asarray(found[0](size_px), np.float32)
            if picture.shape not in [(size_px, size_px, 1), (size_px, size_px, 3)] or not np.isfinite(picture).all():
                raise ValueError(f"it drew {picture.shape} pixels instead of ({size_px}, {size_px}, 1 or 3), or NaN")
            return picture

    def _load(self, point: EntryPoint, plugin: Plugin) -> None:
        """Import a plugin and add it."""
        loading = f"loading plugin {plugin.name} ({plugin})"
        with captured_output(str(plugin)) as output, told_when_slow(loading, plugin.name), self._recording(plugin):
            self.register(point.load(), plugin)
        if output.first_line:
            self.remarks.append(Failure(plugin, f"prints while it is loaded: {output.first_line!r}"))

    def _accept(self, implementation: object, plugin: Plugin) -> bool:
        """Hand a plugin to pluggy; whether its hooks have the names and arguments of ``hookspecs``."""
        name = f"{plugin.package}:{plugin.name}"
        with self._recording(plugin):
            self._manager.register(implementation, name=name)
            self._manager.check_pending()
            self._plugins[name] = plugin
            if not self._manager.get_hookcallers(implementation):
                self.remarks.append(Failure(plugin, "contributes nothing: none of its functions has @hookimpl"))
            return True
        # pluggy registers a plugin before it checks it, and would go on calling its hooks
        if self._manager.get_name(implementation) == name:
            self._manager.unregister(implementation)
        return False

    def _collect(self, source: object, plugin: Plugin, hook: str, add: Callable[[Any, Plugin], None]) -> None:
        """Call one plugin's implementation of a contributing hook.

        Args:
            source: The plugin's module or object.
            plugin: The plugin.
            hook: The hook's name.
            add: Takes what the hook returns.
        """
        # not through pluggy's own call, which would call the hooks of all plugins
        for implementation in getattr(self._manager.hook, hook).get_hookimpls():
            if implementation.plugin is source:
                with self._recording(plugin, f"{hook}: "):
                    add(implementation.function(), plugin)

    @contextmanager
    def _recording(self, plugin: Plugin, where: str = "") -> Iterator[None]:
        """Record whatever goes wrong inside, even what is meant to end the program, and raise nothing of it."""
        try:
            with without_exits():
                yield
        except (KeyboardInterrupt, Terminated):
            raise
        except BaseException:  # a plugin may call sys.exit() when it is imported
            self._fail(plugin, where + _last_lines())

    def _add_stages(self, classes: Iterable[Any], plugin: Plugin) -> None:
        for cls in self._sound(classes, stage_flaw, plugin, "mlens_stages"):
            self._add((STAGE, cls.kind, cls.type), cls, plugin)

    def _add_scenarios(self, classes: Iterable[Any], plugin: Plugin) -> None:
        for cls in self._sound(classes, scenario_flaw, plugin, "mlens_scenarios"):
            self._add((SCENARIO, cls.type), cls, plugin)

    def _add_executors(self, classes: Iterable[Any], plugin: Plugin) -> None:
        for cls in self._sound(classes, executor_flaw, plugin, "mlens_executors"):
            self._add((EXECUTOR, cls.type), cls, plugin)

    def _add_analyses(self, analyses: Iterable[Any], plugin: Plugin) -> None:
        for analysis in self._sound(analyses, analysis_flaw, plugin, "mlens_analyses"):
            self._add((ANALYSIS, analysis.name), analysis, plugin)

    def _add_art(self, pictures: Mapping[str, Any], plugin: Plugin) -> None:
        for name, draw in self._sound(pictures.items(), lambda picture: art_flaw(*picture), plugin, "mlens_art"):
            self._add((NAMED_ART, name), draw, plugin)

    def _sound(
        self, contributed: Iterable[Any], flaw_of: Callable[[Any], str | None], plugin: Plugin, hook: str
    ) -> Iterator[Any]:
        """What has no flaw; the flaws of the others are recorded."""
        for one in contributed:
            flaw = flaw_of(one)
            if flaw:
                self._fail(plugin, f"{hook}: {flaw}")
            else:
                yield one

    def _add(self, key: tuple[str, ...], value: Any, plugin: Plugin) -> None:
        # of several values under one name none wins: that would depend on what else is installed
        first = self._contributions.get(key)
        rivals = (*first.rivals, plugin) if first else ()
        self._contributions[key] = replace(first, rivals=rivals) if first else Contribution(value, plugin)

    def _fail(self, plugin: Plugin, reason: str) -> None:
        self.failures.append(Failure(plugin, reason))


def _provider(point: EntryPoint) -> Plugin:
    """The plugin of an entry point, as far as its package's metadata tell."""
    name, version = (point.dist.name, point.dist.version) if point.dist else (None, None)
    return Plugin(point.name, name or "(unknown package)", version or "?")


def _names(plugin: Plugin) -> set[str]:
    """Names that a plugin can be disabled by, as they are compared."""
    return {_plain(plugin.name), _plain(plugin.package)}


def _plain(name: str) -> str:
    """A name in lower case with dashes: pip takes ``Mlens_Off`` and ``mlens.off`` for the same package, too."""
    return re.sub(r"[-_.]+", "-", name).lower()


def _known(name: str, plugins: list[Plugin]) -> str:
    """A name as it is compared. Raises InputError if no plugin has it."""
    if not any(_plain(name) in _names(plugin) for plugin in plugins):
        raise InputError(unknown("plugin", name, {n for p in plugins for n in (p.package, p.name)}), "--disable-plugin")
    return _plain(name)


def _last_lines() -> str:
    """The innermost frame and the message of the exception being handled."""
    # the first line is only the heading 'Traceback (most recent call last)'
    return "".join(traceback.format_exc(limit=-1).splitlines(keepends=True)[1:]).strip()
