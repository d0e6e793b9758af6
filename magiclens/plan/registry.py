"""Finds plugins and knows what they contribute. The only file that touches pluggy.

Built-in stages come through the same entry point group as everybody else's. Entry points are loaded one by one; what
fails is recorded and stops nothing, what is printed goes to standard error. Later, plugins are called inside
``blaming``, so that failures and prints carry their name.
"""

from __future__ import annotations

import inspect
import os
import re
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.metadata import EntryPoint, entry_points
from typing import Any

import numpy as np
import pluggy

from magiclens.config.suggest import unknown
from magiclens.contract import hookspecs
from magiclens.contract.artifacts import FloatArray
from magiclens.contract.errors import InputError, StageError, Terminated
from magiclens.contract.stages import KINDS
from magiclens.plan.capture import prints_of

STAGE, SCENARIO, ART, EXECUTOR = "stage", "scenario", "art", "executor"
DISABLED = "MLENS_DISABLE_PLUGINS"
"""Environment variable: plugins that are left alone, by package or entry point name, between commas or blanks."""


@dataclass(frozen=True)
class Plugin:
    """Where something comes from: the entry point's name, its distribution and that one's version."""

    name: str
    package: str
    version: str

    def __str__(self) -> str:
        return f"{self.package} {self.version}"


@dataclass(frozen=True)
class Failure:
    """Something of a plugin that cannot be used, or is not as it should be, and why: the last lines of a traceback."""

    plugin: Plugin
    reason: str

    def __str__(self) -> str:
        return f"plugin {self.plugin.name} ({self.plugin}): {self.reason.splitlines()[-1].strip()}"


@dataclass(frozen=True)
class Entry:
    """One contributed thing, its provider, and others who claim the same name."""

    value: Any
    plugin: Plugin
    rivals: tuple[Plugin, ...] = ()


class Registry:
    """What plugins contribute: stages by (kind, type), scenarios and executors by type, art by name."""

    def __init__(self) -> None:
        self.failures: list[Failure] = []
        self.remarks: list[Failure] = []
        self.disabled: list[Plugin] = []
        self._plugins: dict[str, Plugin] = {}
        self._entries: dict[tuple[str, ...], Entry] = {}
        self._manager = pluggy.PluginManager("magiclens")
        self._manager.add_hookspecs(hookspecs)

    @classmethod
    def load(cls, found: Iterable[EntryPoint] | None = None, disabled: Iterable[str] | None = None) -> Registry:
        """A registry of everything that is installed (or of the given entry points).

        disabled: packages and entry points that are not even imported; by default what the environment variable
        MLENS_DISABLE_PLUGINS names. Raises InputError for a name that nothing has.
        """
        registry = cls()
        installed = entry_points(group=hookspecs.ENTRY_POINT_GROUP)
        points = sorted(installed if found is None else found, key=lambda p: (p.name, p.value))
        plugins = [_provider(point) for point in points]
        names = re.split(r"[,\s]+", os.environ.get(DISABLED, "")) if disabled is None else disabled
        unwanted = {_known(name, plugins) for name in names if name}
        for point, plugin in zip(points, plugins, strict=True):
            if unwanted & _names(plugin):
                registry.disabled.append(plugin)
            else:
                registry._load(point, plugin)
        return registry

    def register(self, implementation: object, plugin: Plugin) -> None:
        """Add one plugin: a module or object with hook implementations. What is wrong with it is recorded."""
        flaw = hookspecs.contract_flaw(implementation)
        if flaw:
            self._fail(plugin, flaw)
        elif self._accept(implementation, plugin):
            self._collect(implementation, plugin, "mlens_stages", self._add_stages)
            self._collect(implementation, plugin, "mlens_scenarios", self._add_scenarios)
            self._collect(implementation, plugin, "mlens_art", self._add_art)
            self._collect(implementation, plugin, "mlens_executors", self._add_executors)

    def find(self, *key: str) -> tuple[Any, Plugin] | None:
        """What has the name key[-1] among ``types(*key[:-1])``, and its plugin; None if nothing has.

        Raises StageError when several packages claim the name.
        """
        entry = self._entries.get(key)
        if entry is None:
            return None
        if entry.rivals:
            claims = " and ".join(str(p) for p in (entry.plugin, *entry.rivals))
            keep = "keep one of them: uninstall the others, or --disable-plugin NAME"
            raise Blamed(f"the {' '.join(key[:-1])} {key[-1]!r} is claimed by {claims}; {keep}")
        return entry.value, entry.plugin

    def types(self, *kind: str) -> list[str]:
        """The names to choose from: ``types(STAGE, "matcher")``, ``types(SCENARIO)``, ``types(ART)``."""
        return sorted(key[-1] for key in self._entries if key[:-1] == kind)

    @property
    def absent(self) -> str:
        """Which plugins could not be used, or were not to be; nothing if there are none."""
        failed = ", ".join(dict.fromkeys(str(f.plugin) for f in self.failures))
        disabled = ", ".join(dict.fromkeys(map(str, self.disabled)))
        parts = [f"failed: {failed}"] if failed else []
        parts += [f"disabled: {disabled}"] if disabled else []
        return f"plugins {'; '.join(parts)}; see 'mlens plugins'" if parts else ""

    @property
    def art(self) -> Mapping[str, Callable[[int], FloatArray]]:
        """Named pictures: a function from a size in pixels to (size, size, C) linear light, C = 1 or 3."""
        return {name: partial(self._draw, name) for name in self.types(ART)}

    def classes(self, *kind: str) -> dict[str, Any]:
        """What the names of ``types(*kind)`` stand for."""
        return {name: self._entries[*kind, name].value for name in self.types(*kind)}

    @property
    def entries(self) -> Mapping[tuple[str, ...], Entry]:
        """Everything: (STAGE, kind, type), (SCENARIO, type), (ART, name), (EXECUTOR, type)."""
        return dict(self._entries)

    def tell(self, hook: str, **facts: Any) -> list[str]:
        """Call an observing hook of every plugin; an observer that fails stops nothing, what it raised is returned."""
        complaints = []
        for implementation in getattr(self._manager.hook, hook).get_hookimpls():
            try:
                plugin = self._plugins[implementation.plugin_name]
                with blaming(f"plugin {plugin.name} ({plugin}): {hook}"):
                    implementation.function(*(facts[name] for name in implementation.argnames))
            except StageError as error:
                complaints.append(str(error))
        return complaints

    def _draw(self, name: str, size_px: int) -> FloatArray:
        found = self.find(ART, name)
        if found is None:
            raise KeyError(name)
        with blaming(f"art {name} ({found[1]})"):
            picture = np.asarray(found[0](size_px), np.float32)
            if picture.shape not in [(size_px, size_px, 1), (size_px, size_px, 3)] or not np.isfinite(picture).all():
                raise ValueError(f"it drew {picture.shape} pixels instead of ({size_px}, {size_px}, 1 or 3), or NaN")
            return picture

    def _load(self, point: EntryPoint, plugin: Plugin) -> None:
        """Import a plugin and add it."""
        with prints_of(str(plugin)) as prints, self._recording(plugin):
            self.register(point.load(), plugin)
        if prints.first:
            self.remarks.append(Failure(plugin, f"prints while it is loaded: {prints.first!r}"))

    def _accept(self, implementation: object, plugin: Plugin) -> bool:
        """Whether the hooks are those of ``hookspecs``."""
        name = f"{plugin.package}:{plugin.name}"
        with self._recording(plugin):
            self._manager.register(implementation, name=name)
            self._manager.check_pending()
            self._plugins[name] = plugin
            if not self._manager.get_hookcallers(implementation):
                self.remarks.append(Failure(plugin, "contributes nothing: none of its functions has @hookimpl"))
            return True
        if self._manager.get_name(implementation) == name:
            self._manager.unregister(implementation)
        return False

    def _collect(self, source: object, plugin: Plugin, hook: str, add: Callable[[Any, Plugin], None]) -> None:
        """Call one plugin's implementation of a contributing hook."""
        for implementation in getattr(self._manager.hook, hook).get_hookimpls():
            if implementation.plugin is source:
                with self._recording(plugin, f"{hook}: "):
                    add(implementation.function(), plugin)

    @contextmanager
    def _recording(self, plugin: Plugin, where: str = "") -> Iterator[None]:
        """Whatever goes wrong inside is noted, even what is meant to end the program, and nothing is raised."""
        try:
            yield
        except (KeyboardInterrupt, Terminated):
            raise
        except BaseException:
            self._fail(plugin, where + _last_lines())

    def _add_stages(self, classes: Iterable[Any], plugin: Plugin) -> None:
        for cls in classes:
            flaw = stage_flaw(cls)
            if flaw:
                self._fail(plugin, f"mlens_stages: {flaw}")
            else:
                self._add((STAGE, cls.kind, cls.type), cls, plugin)

    def _add_scenarios(self, classes: Iterable[Any], plugin: Plugin) -> None:
        for cls in classes:
            flaw = _class_flaw(cls) or _lacks(cls, "shots", "fit", "compiled")
            if flaw:
                self._fail(plugin, f"mlens_scenarios: {flaw}")
            else:
                self._add((SCENARIO, cls.type), cls, plugin)

    def _add_executors(self, classes: Iterable[Any], plugin: Plugin) -> None:
        for cls in classes:
            flaw = _class_flaw(cls) or _lacks(cls, "map")
            if flaw:
                self._fail(plugin, f"mlens_executors: {flaw}")
            else:
                self._add((EXECUTOR, cls.type), cls, plugin)

    def _add_art(self, pictures: Mapping[str, Any], plugin: Plugin) -> None:
        for name, draw in pictures.items():
            if isinstance(name, str) and callable(draw):
                self._add((ART, name), draw, plugin)
            else:
                self._fail(plugin, f"mlens_art: {name!r} is not the name of a function from pixels to a picture")

    def _add(self, key: tuple[str, ...], value: Any, plugin: Plugin) -> None:
        old = self._entries.get(key)
        self._entries[key] = Entry(old.value, old.plugin, (*old.rivals, plugin)) if old else Entry(value, plugin)

    def _fail(self, plugin: Plugin, reason: str) -> None:
        self.failures.append(Failure(plugin, reason))


class Blamed(StageError):
    """A StageError that says who it was."""


@contextmanager
def blaming(who: str) -> Iterator[None]:
    """Whatever goes wrong inside comes out as a StageError that names who did it; what is printed is named too.

    What is wrong with the user's input (InputError) passes, and so do an interrupt and a signal to end.
    """
    try:
        with prints_of(who):
            yield
    except (InputError, Blamed, KeyboardInterrupt, Terminated):
        raise
    except StageError as error:
        raise Blamed(f"{who}: {error}") from error
    except BaseException as error:
        raise Blamed(f"{who} failed: {type(error).__name__}: {error}") from error


def _provider(point: EntryPoint) -> Plugin:
    """Where an entry point comes from, as far as its package's metadata tell."""
    name, version = (point.dist.name, point.dist.version) if point.dist else (None, None)
    return Plugin(point.name, name or "(unknown package)", version or "?")


def _names(plugin: Plugin) -> set[str]:
    """What a plugin can be disabled by; packages are spelt with - or _ or ., in capitals or not."""
    return {_plain(plugin.name), _plain(plugin.package)}


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _known(name: str, plugins: list[Plugin]) -> str:
    """The name as it is compared. Raises InputError if no plugin has it."""
    if not any(_plain(name) in _names(plugin) for plugin in plugins):
        raise InputError(unknown("plugin", name, {n for p in plugins for n in (p.package, p.name)}), "--disable-plugin")
    return _plain(name)


def stage_flaw(cls: Any) -> str | None:
    """What keeps a class from being a stage, judged by what it has, not by what it inherits."""
    flaw = _class_flaw(cls)
    if flaw:
        return flaw
    if getattr(cls, "kind", None) not in KINDS:
        return f"{cls.__name__}.kind is not one of {', '.join(KINDS)}"
    if not isinstance(getattr(cls, "version", None), str):
        return f"{cls.__name__}.version is not text"
    if cls.kind == "exporter" and not str(getattr(cls, "suffix", "")).startswith("."):
        return f"{cls.__name__}.suffix is not a file ending such as '.stl'"
    methods = _abstract(KINDS[cls.kind])
    return _lacks(cls, *methods) or next(filter(None, (_miscalled(cls, name) for name in methods)), None)


def _class_flaw(cls: Any) -> str | None:
    if not inspect.isclass(cls):
        return f"{cls!r} is not a class"
    if not isinstance(getattr(cls, "type", None), str):
        return f"{cls.__name__}.type is not text"
    if inspect.isabstract(cls):
        return f"{cls.__name__} lacks {', '.join(_abstract(cls))}"
    return _lacks(cls, "model_validate", "model_dump")


def _abstract(cls: type[Any]) -> list[str]:
    return sorted(getattr(cls, "__abstractmethods__", ()))


def _lacks(cls: type[Any], *methods: str) -> str | None:
    missing = [name for name in methods if not callable(getattr(cls, name, None))]
    return f"{cls.__name__} lacks {', '.join(missing)}" if missing else None


def _miscalled(cls: type[Any], method: str) -> str | None:
    """What is wrong if a stage's method does not take what runs give it, in this order."""
    given = list(inspect.signature(getattr(KINDS[cls.kind], method)).parameters)
    try:
        inspect.signature(getattr(cls, method)).bind(*given)
    except TypeError as error:
        return f"{cls.__name__}.{method} is called with ({', '.join(given)}): {error}"
    return None


def _last_lines() -> str:
    """The innermost frame and the message of the exception being handled."""
    return "".join(traceback.format_exc(limit=-1).splitlines(keepends=True)[1:]).strip()
