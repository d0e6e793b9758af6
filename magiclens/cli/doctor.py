"""The command that looks for everything that magiclens can use, and says how to get what is missing."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from magiclens.cli.common import AsJson, print_result, reporting

if TYPE_CHECKING:
    from magiclens.plan.registry import Registry

_LEAST_INK, _MOST_INK = 0.01, 0.9
"""Share of dark pixels of a line of text; a font without letters draws nothing, or a box for each of them."""


@dataclass(frozen=True)
class Diagnosis:
    """What was found of one thing that magiclens uses.

    Attributes:
        name: The thing, such as a package or a program.
        status: ``ok``, ``missing``, or ``broken``: it is there and does not work.
        found: Its version, its path, or what is wrong with it.
        needed: Whether magiclens cannot work without it.
        help: What it is for and how to get it; printed unless it is ok.
    """

    name: str
    status: Literal["ok", "missing", "broken"]
    found: str
    needed: bool = False
    help: str = ""


@dataclass(frozen=True)
class _Program:
    """A program that magiclens or its tests run: the names it may have, what it is for, how to install it."""

    title: str
    names: tuple[str, ...]
    use: str
    get: str


_OPTIONAL = {"pymeshlab": "smooths meshes; without it, the finisher is manifold, which only checks them"}
"""Packages that a default install brings and that magiclens can do without, and what they are for."""

_PROGRAMS = (
    _Program("PrusaSlicer", ("prusa-slicer",), "the tests check meshes with it", "apt install prusa-slicer"),
    _Program("admesh", ("admesh",), "the tests check STL files with it", "apt install admesh"),
    _Program("rs274", ("rs274",), "the tests run milling programs with it", "apt install linuxcnc-uspace"),
    _Program(
        "Chromium",
        ("chromium", "chromium-browser", "google-chrome", "chrome"),
        "shows `mlens view`; any browser with WebGL 2 does",
        "apt install chromium, or playwright install chromium",
    ),
)


def doctor_command(
    as_json: AsJson = False,
    warm: Annotated[bool, typer.Option("--warm", help="Also compile all kernels now, so that no run has to.")] = False,
) -> None:
    """Look for all that magiclens can use, and say how to get what is missing. Exit code 1: it cannot work."""
    with reporting(False):
        from magiclens.plan.registry import Registry

        found = examine(Registry.load())
        if warm:
            from magiclens.running.compilation import compile_all_kernels

            found.append(compiled_kernels(compile_all_kernels))
        print_result(lambda: diagnoses_text(found), lambda: diagnoses_data(found), as_json=as_json)
        if unfit(found):
            raise typer.Exit(1)


def examine(registry: Registry) -> list[Diagnosis]:
    """Look for everything that magiclens and its tests use, most important first; nothing is changed."""
    return [
        _python(),
        *_packages(),
        _plugins(registry),
        _kernel_cache(),
        _kept_results(),
        _llvm(),
        _movies(),
        _font(),
        *(_program(program) for program in _PROGRAMS),
    ]


def compiled_kernels(compile_all: Callable[[], None]) -> Diagnosis:
    """Compile all kernels, which numba keeps, and tell how long that took."""
    from time import perf_counter

    began = perf_counter()
    compile_all()
    return Diagnosis("kernels", "ok", f"compiled, or found in the cache, in {perf_counter() - began:.0f} s")


def diagnoses_text(diagnoses: Iterable[Diagnosis]) -> str:
    """Diagnoses as people read them: a line for each, with advice below those that are not ok."""
    lines = []
    for diagnosis in diagnoses:
        lines.append(f"{diagnosis.status:8} {diagnosis.name:16} {diagnosis.found}".rstrip())
        if diagnosis.status != "ok" and diagnosis.help:
            lines.append(f"{'':25} {diagnosis.help}")
    return "\n".join(lines)


def diagnoses_data(diagnoses: Iterable[Diagnosis]) -> dict[str, Any]:
    """Diagnoses as ``mlens doctor --json`` prints them."""
    found = list(diagnoses)
    return {"status": "broken" if unfit(found) else "ok", "findings": [asdict(diagnosis) for diagnosis in found]}


def unfit(diagnoses: Iterable[Diagnosis]) -> bool:
    """Whether something that magiclens needs is missing or broken."""
    return any(diagnosis.needed and diagnosis.status != "ok" for diagnosis in diagnoses)


def _python() -> Diagnosis:
    import platform

    # pip refuses older versions, but an environment that was copied may still have one
    known = sys.version_info >= (3, 11)
    what = f"{platform.python_version()}, {platform.system()} {platform.machine()}"
    return Diagnosis("python", "ok" if known else "broken", what, True, "magiclens needs Python 3.11 or newer")


def _packages() -> list[Diagnosis]:
    """The package magiclens and those that it requires."""
    from importlib.metadata import requires

    names = [requirement for requirement in requires("magiclens") or () if "extra ==" not in requirement]
    return [_package("magiclens"), *(_package(_bare(name)) for name in sorted(names, key=str.lower))]


def _bare(requirement: str) -> str:
    """The package's name in a requirement: ``numpy`` in ``numpy>=1.26``."""
    end = next((k for k, letter in enumerate(requirement) if not (letter.isalnum() or letter in "-_.")), None)
    return requirement[:end]


def _package(name: str) -> Diagnosis:
    from importlib.metadata import PackageNotFoundError, version

    needed, use = name not in _OPTIONAL, f"{_OPTIONAL[name]}: " if name in _OPTIONAL else ""
    try:
        return Diagnosis(name, "ok", version(name), needed)
    except PackageNotFoundError:
        return Diagnosis(name, "missing", "", needed, f"{use}pip install {name}")


def _plugins(registry: Registry) -> Diagnosis:
    packages = sorted({str(contribution.plugin) for contribution in registry.contributions.values()})
    if registry.failures:
        failed = ", ".join(sorted({str(failure.plugin) for failure in registry.failures}))
        return Diagnosis("plugins", "broken", f"failed: {failed}", False, "see 'mlens plugins'; the others work")
    return Diagnosis("plugins", "ok", ", ".join(packages))


def _kernel_cache() -> Diagnosis:
    """Whether compiled kernels can be kept; else they are compiled for every run."""
    from magiclens.kernels.cache_folder import VARIABLE, caches_folder

    advice = f"every run compiles for a minute: set {VARIABLE} to a folder that can be written"
    return _folder_of("compiled kernels", caches_folder(), advice)


def _kept_results() -> Diagnosis:
    """Whether results of runs can be kept; else every run does everything."""
    from magiclens.cache.folder import FOLDER_VARIABLE, SIZE_VARIABLE, results_folder

    name = "kept results"
    if os.environ.get(SIZE_VARIABLE, "").strip() == "0":
        return Diagnosis(name, "ok", f"none: {SIZE_VARIABLE} is 0")
    advice = f"every run does everything: set {FOLDER_VARIABLE} to a folder that can be written"
    return _folder_of(name, results_folder(), advice)


def _folder_of(name: str, folder: Path, advice: str) -> Diagnosis:
    """Whether the folder of something that runs keep can be written."""
    if _writable(folder):
        return Diagnosis(name, "ok", str(folder))
    return Diagnosis(name, "broken", f"cannot write in {folder}", False, advice)


def _writable(folder: Path) -> bool:
    """Whether files can be made there, or in the nearest folder above that exists."""
    nearest = next((parent for parent in (folder, *folder.parents) if parent.exists()), folder)
    return nearest.is_dir() and os.access(nearest, os.W_OK)


def _llvm() -> Diagnosis:
    """Whether Mitsuba finds an LLVM; tried in a child process, since one that is too old aborts the process."""
    from magiclens.rendering.variants import LLVM_VARIABLE, working_llvm

    library = working_llvm()
    advice = f"Mitsuba is slow without LLVM 17 or newer: apt install libllvm19, or name its library in {LLVM_VARIABLE}"
    return _optional("LLVM for Mitsuba", library, advice)


def _movies() -> Diagnosis:
    """GIF and MP4 are read and written by the FFmpeg libraries that PyAV brings along."""

    def try_movies() -> str:
        import av

        av.codec.Codec("h264", "w")
        libraries = av.library_versions
        return f"libavcodec {'.'.join(map(str, libraries['libavcodec']))}, with H.264"

    return _tried("FFmpeg (av)", try_movies, "pip install --force-reinstall av")


def _font() -> Diagnosis:
    """The font in which texts are written comes with matplotlib."""

    def try_text() -> str:
        from magiclens.images.text import text

        ink = 1 - text("magic lens", 64).mean()
        if not _LEAST_INK < ink < _MOST_INK:
            raise ValueError("letters leave no ink")
        return "writes text"

    return _tried("font", try_text, "pip install --force-reinstall matplotlib")


def _tried(name: str, attempt: Callable[[], str], advice: str) -> Diagnosis:
    """Whether an attempt to use a library works; whatever it raises is the library's fault."""
    try:
        return Diagnosis(name, "ok", attempt(), True)
    except Exception as error:
        return Diagnosis(name, "broken", f"{type(error).__name__}: {error}", True, advice)


def _program(program: _Program) -> Diagnosis:
    found = next((path for path in map(shutil.which, program.names) if path), None)
    return _optional(program.title, found, f"{program.use}: {program.get}")


def _optional(name: str, found: str | None, advice: str) -> Diagnosis:
    return Diagnosis(name, "ok" if found else "missing", found or "", False, advice)
