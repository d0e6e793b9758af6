"""What code a result comes from: hashes of the sources of packages, versions of what they require, the machine."""

from __future__ import annotations

import hashlib
import inspect
import os
import platform
import re
import sys
from collections.abc import Iterable
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from types import ModuleType
from typing import Any

_MADE_BY_RUNNING = (".pyc", ".pyo", ".nbi", ".nbc")
"""Endings of files that Python and numba write beside sources."""
_OF_ALL = frozenset({"builtins", "abc", "typing", "functools", "pydantic", "pydantic_core", "enum", "collections"})
"""Packages of bases that every class has; a change of Python or pydantic is seen by their versions."""


class UnknownSources(Exception):
    """Something whose sources cannot be found, such as a class that was written in a notebook."""


def source_hashes(things: Iterable[Any]) -> dict[str, str]:
    """The hash of the sources of each package that brings some of these classes, functions or objects.

    Bases count as well, since a stage may inherit its method from that of another package. The own package always
    does: every plugin calls it.

    Raises:
        UnknownSources: Something has no sources that could be found.
    """
    modules = {"magiclens.cache", *(name for thing in things for name in _modules(thing))}
    return {root: _hash(path) for root, path in sorted({_root(name) for name in modules})}


@cache
def required_versions(distribution: str) -> dict[str, str]:
    """Versions of a distribution and of those that it requires, and of Python.

    Args:
        distribution: Its name as pip has it; one that is not installed requires nothing.
    """
    try:
        wanted = [line for line in requires(distribution) or () if "extra ==" not in line]
    except PackageNotFoundError:
        wanted = []
    names = [distribution, *(re.split(r"[^A-Za-z0-9._-]", line, maxsplit=1)[0] for line in wanted)]
    found = {name: _version(name) for name in sorted(names, key=str.lower)}
    return {"python": platform.python_version(), **{name: v for name, v in found.items() if v}}


@cache
def processor() -> str:
    """The kind of processor, since code compiled for another one may round otherwise."""
    known = [platform.system(), platform.machine()]
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    for key in ("model name", "flags", "Features"):  # the first of many equal cores; x86 has flags, ARM features
        known.append(next((line for line in lines if line.startswith(key)), ""))
    return hashlib.sha256("\n".join(known).encode()).hexdigest()[:16]


def _modules(thing: Any) -> set[str]:
    """Names of the modules that define a class with its bases, a function, or an object with functions."""
    if isinstance(thing, partial):
        return _modules(thing.func).union(*(_modules(each) for each in thing.args if callable(each)))
    if inspect.isclass(thing):
        return {cls.__module__ for cls in thing.__mro__ if cls.__module__.partition(".")[0] not in _OF_ALL}
    if inspect.isroutine(thing):
        return {thing.__module__}
    parts = [getattr(thing, name) for name in getattr(thing, "__dict__", {})]
    return _modules(type(thing)).union(*(_modules(part) for part in parts if inspect.isroutine(part)))


def _root(name: str) -> tuple[str, Path]:
    """The outermost package with a file that a module belongs to, or the module; and its folder or file."""
    parts = name.split(".")
    for end in range(1, len(parts) + 1):
        module = sys.modules.get(".".join(parts[:end]))
        if module is not None and _file(module):
            path = Path(_file(module))
            return module.__name__, path.parent if path.name == "__init__.py" else path
    raise UnknownSources(name)


def _file(module: ModuleType) -> str:
    """Where a module was loaded from; empty for what was typed in, and for packages without an ``__init__``."""
    return getattr(module, "__file__", None) or ""


def unchanged() -> bool:
    """Whether all sources are still those whose hashes were taken.

    Modules are imported when they are needed, so what is edited during a run may have taken part in it.
    """
    return all(_state(path) == state for path, state in _hashed.items())


_hashed: dict[Path, str] = {}
"""Folders and files whose hashes were taken, with their ``_state`` then."""


@cache
def _hash(path: Path) -> str:
    """Hash of a file, or of all files in a folder with their names."""
    _hashed[path] = _state(path)
    found = hashlib.sha256()
    for file in map(Path, _sources(path)):
        found.update(f"{file.relative_to(path).as_posix()}\0{file.stat().st_size}\0".encode() + file.read_bytes())
    return found.hexdigest()[:32]


def _state(path: Path) -> str:
    """Names, sizes and times of the files of ``_hash``, which are found more quickly than their content."""
    stats = ((file, os.stat(file)) for file in _sources(path))
    return str([(file, stat.st_size, stat.st_mtime_ns) for file, stat in stats])


def _sources(path: Path) -> list[str]:
    """A file, or all files in a folder but those that Python and numba write."""
    # by ``os``: this is asked for every result that is kept, and ``pathlib`` takes four times as long
    inside = sorted(os.path.join(folder, name) for folder, _, names in os.walk(path) for name in names)
    files = [str(path)] if path.is_file() else inside
    return [file for file in files if not file.endswith(_MADE_BY_RUNNING) and os.path.isfile(file)]


def _version(distribution: str) -> str | None:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None
