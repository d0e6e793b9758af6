"""numba's ``njit``, which keeps what it compiles in ``cache_folder``; all kernels import it from here."""

from __future__ import annotations

import gc
import os
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba import config
from numba.core.caching import CompileResultCacheImpl, _CacheLocator
from numba.core.event import Event, Listener, register

from magiclens.kernels.cache_folder import PACKAGE, cache_folder
from magiclens.kernels.linking import TARGET

_UNUSED_DAYS = 30
"""Kernels of other states of the sources are removed when nobody has used them for so long."""
_COMPILER = f"numba-{numba.__version__}-numpy-{np.__version__}" + "-svml" * bool(config.USING_SVML)  # type: ignore[attr-defined]
"""What machine code depends on besides the sources and the processor, which numba itself looks at."""


def njit(*, fastmath: bool | set[str] = False, forceinline: bool = False, **options: Any) -> Callable[..., Any]:
    """numba's ``njit``, with a value for every option that numba else takes from the caller that is compiled first.

    So what a kernel computes does not depend on what the process has compiled before. A division by zero gives infinity
    or nan, as in numpy.

    Args:
        fastmath: which rounding may be relaxed, see numba.
        forceinline: whether callers take in the kernel's code.
        options: others of numba's.
    """
    numba_njit: Callable[..., Callable[..., Any]] = numba.njit  # its types leave out the last of these options
    # nobody calls kernels from C, for which numba would compile one more function
    return numba_njit(
        fastmath=fastmath,
        forceinline=forceinline,
        error_model="numpy",
        no_cfunc_wrapper=True,
        _target=TARGET,
        **options,
    )


@cache
def _hash_of(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()


class _PackageLocator(_CacheLocator):
    """Finds a kernel by the place of its file in the package, and by what the file says.

    numba's own locators go by the path on the disk. So a package that is installed would share nothing with its clone,
    nor one virtual environment with another.
    """

    def __init__(self, kernel: Callable[..., Any], file: Path):
        self._py_file = str(file)  # numba names it in warnings
        self._line = kernel.__code__.co_firstlineno
        self._hash = _hash_of(file)
        self._folder = _folder / _COMPILER / file.relative_to(PACKAGE).parent

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return self._hash

    def get_disambiguator(self) -> str:
        return str(self._line)

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> _PackageLocator | None:
        """``None`` for kernels of others, and where nothing can be written: numba then asks its own locators."""
        file = Path(py_file).resolve()
        if not file.is_relative_to(PACKAGE):
            return None
        with suppress(OSError):
            locator = cls(py_func, file)
            locator.ensure_cache_path()
            return locator
        return None


class _Collection(Listener):
    """Keeps Python's garbage collector waiting during a compilation: of millions of objects it would find few to free.

    numba compiles one kernel at a time, and within it those that it calls.
    """

    def __init__(self) -> None:
        self._depth, self._goes_on = 0, False

    def on_start(self, event: Event) -> None:
        if self._depth == 0:
            self._goes_on = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: Event) -> None:
        self._depth -= 1
        if self._depth == 0 and self._goes_on:
            gc.enable()


def _prepare(folder: Path) -> None:
    """Make the folder, and remove those that have not been used for long."""
    if not folder.exists():
        folder.mkdir(parents=True, exist_ok=True)
        for other in folder.parent.glob("kernels-*"):
            if time.time() - other.stat().st_mtime > _UNUSED_DAYS * 86400:
                shutil.rmtree(other, ignore_errors=True)
    os.utime(folder)


register("numba:compile", _Collection())
with suppress(OSError):  # numba then looks for a place itself, or compiles for every run; see 'mlens doctor'
    _folder = cache_folder()
    _prepare(_folder)
    config.CACHE_DIR = str(_folder)  # type: ignore[attr-defined]
    CompileResultCacheImpl._locator_classes = [_PackageLocator, *CompileResultCacheImpl._locator_classes]
