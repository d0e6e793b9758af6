"""Is everything here that magiclens can use, and if not, how to get it."""

from __future__ import annotations

import os
import platform
import shutil
import sys
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from magiclens.plan.registry import Registry

Status = Literal["ok", "missing", "broken"]


@dataclass(frozen=True)
class Finding:
    """One thing that was looked for. needed: magiclens cannot do without. help: what it is for, how to get it."""

    name: str
    status: Status
    found: str
    needed: bool = False
    help: str = ""


@dataclass(frozen=True)
class Program:
    """A program of somebody else's; ``names`` it may have, ``use`` it is of, ``get`` is how to install it."""

    title: str
    names: tuple[str, ...]
    use: str
    get: str


PROGRAMS = (
    Program("PrusaSlicer", ("prusa-slicer",), "the tests judge meshes by it", "apt install prusa-slicer"),
    Program("admesh", ("admesh",), "the tests judge STL files by it", "apt install admesh"),
    Program("rs274", ("rs274",), "the tests run milling programs with it", "apt install linuxcnc-uspace"),
    Program(
        "Chromium",
        ("chromium", "chromium-browser", "google-chrome", "chrome"),
        "shows `mlens view`; any browser with WebGL 2 does",
        "apt install chromium, or playwright install chromium",
    ),
)


def examine(registry: Registry | None = None) -> list[Finding]:
    """Everything that was looked for, most important first. Nothing is written but a trial file in numba's cache."""
    return [
        _python(),
        *_packages(),
        _plugins(registry or Registry.load()),
        _numba_cache(),
        _llvm(),
        _movies(),
        _font(),
        *(_program(program) for program in PROGRAMS),
    ]


def as_text(findings: Iterable[Finding]) -> str:
    """A line for each, with advice below those that are not well."""
    lines = []
    for finding in findings:
        lines.append(f"{finding.status:8} {finding.name:16} {finding.found}".rstrip())
        if finding.status != "ok" and finding.help:
            lines.append(f"{'':25} {finding.help}")
    return "\n".join(lines)


def as_facts(findings: Iterable[Finding]) -> dict[str, Any]:
    """For programs."""
    found = list(findings)
    return {"status": "broken" if unfit(found) else "ok", "findings": [asdict(finding) for finding in found]}


def unfit(findings: Iterable[Finding]) -> bool:
    """Whether something is not well that magiclens cannot do without."""
    return any(finding.needed and finding.status != "ok" for finding in findings)


def _python() -> Finding:
    known = sys.version_info >= (3, 11)
    what = f"{platform.python_version()}, {platform.system()} {platform.machine()}"
    return Finding("python", "ok" if known else "broken", what, True, "magiclens needs Python 3.11 or newer")


def _packages() -> list[Finding]:
    """magiclens itself and what it requires."""
    names = [requirement for requirement in requires("magiclens") or () if "extra ==" not in requirement]
    return [_package("magiclens"), *(_package(_bare(name)) for name in sorted(names, key=str.lower))]


def _bare(requirement: str) -> str:
    """A requirement's package: ``numpy`` of ``numpy>=1.26``."""
    end = next((k for k, letter in enumerate(requirement) if not (letter.isalnum() or letter in "-_.")), None)
    return requirement[:end]


def _package(name: str) -> Finding:
    try:
        return Finding(name, "ok", version(name), True)
    except PackageNotFoundError:
        return Finding(name, "missing", "", True, f"pip install {name}")


def _plugins(registry: Registry) -> Finding:
    packages = sorted({str(entry.plugin) for entry in registry.entries.values()})
    if registry.failures:
        failed = ", ".join(sorted({str(failure.plugin) for failure in registry.failures}))
        return Finding("plugins", "broken", f"failed: {failed}", False, "see 'mlens plugins'; the others work")
    return Finding("plugins", "ok", ", ".join(packages))


def _numba_cache() -> Finding:
    """Compiled code is kept beside the sources, or where NUMBA_CACHE_DIR says; else it is compiled for every run."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    spec = find_spec("magiclens")
    places = [Path(chosen)] if chosen else [Path(spec.origin).parent] if spec and spec.origin else []
    if not chosen:
        places.append(Path.home() / ".cache")
    writable = next((place for place in places if _writable(place)), None)
    advice = "every run compiles for a minute: set NUMBA_CACHE_DIR to a folder that can be written"
    if writable is None:
        return Finding("numba cache", "broken", f"cannot write in {', '.join(map(str, places))}", False, advice)
    return Finding("numba cache", "ok", str(writable))


def _writable(folder: Path) -> bool:
    """Whether files can be made there, or in the nearest folder above that exists."""
    there = next((place for place in (folder, *folder.parents) if place.exists()), folder)
    return there.is_dir() and os.access(there, os.W_OK)


def _llvm() -> Finding:
    """Tried in a child process, since an LLVM that is too old aborts the process that tries."""
    from magiclens.rendering.mitsuba import LLVM_VARIABLE, working_llvm

    library = working_llvm()
    advice = f"Mitsuba is slow without LLVM 17 or newer: apt install libllvm19, or name its library in {LLVM_VARIABLE}"
    return _optional("LLVM for Mitsuba", library, advice)


def _movies() -> Finding:
    """GIF and MP4 are read and written by the FFmpeg libraries that PyAV brings along."""

    def look() -> str:
        import av

        av.codec.Codec("h264", "w")
        libraries = av.library_versions
        return f"libavcodec {'.'.join(map(str, libraries['libavcodec']))}, with H.264"

    return _tried("FFmpeg (av)", look, "pip install --force-reinstall av")


def _font() -> Finding:
    """The font in which texts are written comes with matplotlib."""

    def look() -> str:
        from magiclens.images.text import text

        ink = 1 - text("magic lens", 64).mean()
        if not 0.01 < ink < 0.9:
            raise ValueError("letters leave no ink")
        return "writes text"

    return _tried("font", look, "pip install --force-reinstall matplotlib")


def _tried(name: str, look: Callable[[], str], advice: str) -> Finding:
    try:
        return Finding(name, "ok", look(), True)
    except Exception as error:
        return Finding(name, "broken", f"{type(error).__name__}: {error}", True, advice)


def _program(program: Program) -> Finding:
    found = next((path for path in map(shutil.which, program.names) if path), None)
    return _optional(program.title, found, f"{program.use}: {program.get}")


def _optional(name: str, found: str | None, advice: str) -> Finding:
    return Finding(name, "ok" if found else "missing", found or "", False, advice)
