"""Finds plugins and knows what they contribute. The only file that touches pluggy.

Built-in stages come through the same entry point group as everybody else's. Entry points are loaded one by one; what
fails is recorded and stops nothing.
"""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.metadata import EntryPoint, entry_points
from typing import Any

import numpy as np
import pluggy

from magiclens import hookspecs
from magiclens.artifacts import FloatArray
from magiclens.errors import MagicLensError, StageError
from magiclens.stages import KINDS

STAGE, SCENARIO, ART = "stage", "scenario", "art"


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
    """Something of a plugin that cannot be used, and why: the last lines of a traceback."""

    plugin: Plugin
    reason: str


@dataclass(frozen=True)
class Entry:
    """One contributed thing, its provider, and others who claim the same name."""

    value: Any
    plugin: Plugin
    rivals: tuple[Plugin, ...] = ()


class Registry:
    """What plugins contribute: stages by (kind, type), scenarios by type, art by name."""

    def __init__(self) -> None:
        self.failures: list[Failure] = []
        self.plugins: list[Plugin] = []
        self._entries: dict[tuple[str, ...], Entry] = {}
        self._manager = pluggy.PluginManager("magiclens")
        self._manager.add_hookspecs(hookspecs)

    @classmethod
    def load(cls, found: Iterable[EntryPoint] | None = None) -> Registry:
        """A registry of everything that is installed (or of the given entry points)."""
        registry = cls()
        points = entry_points(group=hookspecs.ENTRY_POINT_GROUP) if found is None else found
        for point in sorted(points, key=lambda p: (p.name, p.value)):
            registry._load(point)
        return registry

    def register(self, implementation: object, plugin: Plugin) -> None:
        """Add one plugin: a module or object with hook implementations. What is wrong with it is recorded."""
        try:
            self._manager.register(implementation, name=f"{plugin.package}:{plugin.name}")
            self._manager.check_pending()
        except Exception:
            self._fail(plugin, _last_lines())
            if self._manager.is_registered(implementation):
                self._manager.unregister(implementation)
            return
        self.plugins.append(plugin)
        self._collect(implementation, plugin, "mlens_stages", self._add_stages)
        self._collect(implementation, plugin, "mlens_scenarios", self._add_scenarios)
        self._collect(implementation, plugin, "mlens_art", self._add_art)

    def find(self, *key: str) -> tuple[Any, Plugin] | None:
        """What has the name key[-1] among ``types(*key[:-1])``, and its plugin; None if nothing has.

        Raises StageError when several packages claim the name.
        """
        entry = self._entries.get(key)
        if entry is None:
            return None
        if entry.rivals:
            claims = " and ".join(str(p) for p in (entry.plugin, *entry.rivals))
            raise StageError(f"the {' '.join(key[:-1])} {key[-1]!r} is claimed by {claims}; uninstall all but one")
        return entry.value, entry.plugin

    def types(self, *kind: str) -> list[str]:
        """The names to choose from: ``types(STAGE, "matcher")``, ``types(SCENARIO)``, ``types(ART)``."""
        return sorted(key[-1] for key in self._entries if key[:-1] == kind)

    @property
    def art(self) -> Mapping[str, Callable[[int], FloatArray]]:
        """Named pictures: a function from a size in pixels to (size, size, C) linear light, C = 1 or 3."""
        return {name: partial(self._draw, name) for name in self.types(ART)}

    def classes(self, *kind: str) -> dict[str, Any]:
        """What the names of ``types(*kind)`` stand for."""
        return {name: self._entries[*kind, name].value for name in self.types(*kind)}

    @property
    def entries(self) -> Mapping[tuple[str, ...], Entry]:
        """Everything: (STAGE, kind, type), (SCENARIO, type), (ART, name)."""
        return dict(self._entries)

    def tell(self, hook: str, **facts: Any) -> list[str]:
        """Call an observing hook of every plugin; an observer that fails stops nothing, what it raised is returned."""
        complaints = []
        for implementation in getattr(self._manager.hook, hook).get_hookimpls():
            try:
                implementation.function(*(facts[name] for name in implementation.argnames))
            except Exception as error:
                name = implementation.plugin_name
                complaints.append(f"plugin {name}: {hook} failed: {type(error).__name__}: {error}")
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

    def _load(self, point: EntryPoint) -> None:
        package, version = (point.dist.name, point.dist.version) if point.dist else ("(unknown package)", "?")
        plugin = Plugin(point.name, package, version)
        try:
            implementation = point.load()
        except (Exception, SystemExit):
            self._fail(plugin, _last_lines())
        else:
            self.register(implementation, plugin)

    def _collect(self, source: object, plugin: Plugin, hook: str, add: Callable[[Any, Plugin], None]) -> None:
        """Call one plugin's implementation of a contributing hook."""
        for implementation in getattr(self._manager.hook, hook).get_hookimpls():
            if implementation.plugin is source:
                try:
                    add(implementation.function(), plugin)
                except Exception:
                    self._fail(plugin, f"{hook}: {_last_lines()}")

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


@contextmanager
def blaming(who: str) -> Iterator[None]:
    """Whatever goes wrong inside comes out as a StageError that names who did it."""
    try:
        yield
    except MagicLensError:
        raise
    except Exception as error:
        raise StageError(f"{who} failed: {type(error).__name__}: {error}") from error


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
    return _lacks(cls, *_abstract(KINDS[cls.kind]))


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


def _last_lines() -> str:
    """The innermost frame and the message of the exception being handled."""
    return "".join(traceback.format_exc(limit=-1).splitlines(keepends=True)[1:]).strip()
