"""Which variant of Mitsuba works here: compiled by an LLVM library that it gets along with, or scalar; or on a GPU."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterable
from ctypes.util import find_library
from functools import cache
from pathlib import Path

from magiclens.contract.errors import StageError

LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
"""Environment variable that tells Dr.Jit, which compiles Mitsuba's variants, where its LLVM library is."""

_CHOSEN_BY_USER = os.environ.get(LLVM_VARIABLE, "")
"""What it says before ``usable_variant`` sets it."""

PROBE = f"""
import ctypes, os, sys
variant, library = sys.argv[1:]
try:
    ctypes.CDLL(library)
except OSError:
    sys.exit(f"cannot load {{library}}")
if variant.startswith("llvm"):
    os.environ["{LLVM_VARIABLE}"] = library
import mitsuba as mi
mi.set_variant(variant)
view = mi.ScalarTransform4f().look_at(origin=[0, 0, 3], target=[0, 0, 0], up=[0, 1, 0])
scene = mi.load_dict({{
    "type": "scene",
    "integrator": {{"type": "path", "max_depth": 4}},
    "ball": {{"type": "sphere", "radius": 0.5, "bsdf": {{"type": "dielectric"}}}},
    "light": {{"type": "constant"}},
    "sensor": {{"type": "perspective", "to_world": view, "film": {{"type": "hdrfilm", "width": 8, "height": 8}}}},
}})
brightness = float(sum(mi.render(scene, spp=4).array) / (8 * 8 * 3))
sys.exit(0 if 0.9 < brightness < 1.1 else f"a clear ball in a white world is {{brightness}} bright")
"""
"""Program that renders a clear ball in a white world with the variant of Mitsuba and the library that it is given.

It fails if that does not work. It runs in a process of its own, because libraries that are too old abort the process
that tries them.
"""

_CUDA_LIBRARIES = ("libcuda.so.1", "nvcuda.dll")
"""What drivers of NVIDIA's GPUs bring along, on Linux and on Windows."""

_PATIENCE_S = 120
"""Seconds after which a library counts as one that does not work."""


@cache
def working_llvm() -> str | None:
    """The LLVM library that Mitsuba works with here, or None. Tried once per process."""
    return first_working(installed_libraries())


@cache
def working_gpu() -> str | None:
    """The library of the driver of a GPU with which Mitsuba works here, or None. Tried once per process."""
    return first_working(_CUDA_LIBRARIES, "cuda_ad_rgb")


def usable_variant(
    variant: str, find: Callable[[], str | None] = working_llvm, find_gpu: Callable[[], str | None] = working_gpu
) -> str:
    """The variant of Mitsuba to use, with Dr.Jit told which LLVM library works.

    A GPU is never chosen by itself: it adds up what arrives in a pixel in no order, so that pictures of equal seeds are
    only nearly equal.

    Args:
        variant: `auto`, `llvm_ad_rgb`, `scalar_rgb` or `cuda_ad_rgb`, as asked for.
        find: finds the library.
        find_gpu: finds that of the driver of a GPU.

    Raises:
        StageError: LLVM or a GPU is asked for, and none works.
    """
    if variant == "scalar_rgb":
        return variant
    if variant == "cuda_ad_rgb":
        if find_gpu() is not None:
            return variant
        raise StageError(
            f"Mitsuba's {variant} does not work here: it needs an NVIDIA GPU and a driver with OptiX; "
            "'variant: auto' needs neither"
        )
    library = find()
    if library is not None:
        os.environ[LLVM_VARIABLE] = library
        return "llvm_ad_rgb"
    if variant == "auto":
        return "scalar_rgb"
    raise StageError(
        f"Mitsuba's {variant} does not work here: install LLVM 17 or newer, or name its library in {LLVM_VARIABLE}; "
        "'variant: scalar_rgb' needs neither"
    )


def first_working(libraries: Iterable[str], variant: str = "llvm_ad_rgb", probe: str = PROBE) -> str | None:
    """The first library with which a child process that runs ``probe`` with this variant succeeds, or None."""
    return next((library for library in libraries if _works(variant, library, probe)), None)


def installed_libraries() -> list[str]:
    """What the user has set, else the names under which LLVM 17 or newer is installed, tried versions first."""
    chosen = os.environ.get(LLVM_VARIABLE)
    if chosen:
        return [chosen]
    names = [name for version in (19, 20, 18, 21, 22, 17) for name in _sonames(version)]
    generic = find_library("LLVM") or find_library("LLVM-C")
    return [*names, generic] if generic else names


def library_files() -> list[str]:
    """What the user has set, and the files of LLVM libraries in the usual folders: found at once, but not tried."""
    folders = [Path(root) for root in ("/usr/lib", "/usr/lib64", "/usr/local/lib", "/opt/homebrew/opt/llvm/lib")]
    found = {str(path) for folder in folders for pattern in ("libLLVM*", "*/libLLVM*") for path in folder.glob(pattern)}
    return [_CHOSEN_BY_USER, *sorted(found)]


def _sonames(version: int) -> tuple[str, str]:
    """What Linux distributions call the library of one LLVM version."""
    return f"libLLVM.so.{version}.1", f"libLLVM-{version}.so.1"


def _works(variant: str, library: str, probe: str) -> bool:
    command = [sys.executable, "-c", probe, variant, library]
    try:
        return subprocess.run(command, capture_output=True, timeout=_PATIENCE_S).returncode == 0
    except subprocess.TimeoutExpired:
        return False
