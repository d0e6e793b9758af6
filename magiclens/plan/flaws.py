"""Checks what a plugin contributes when it is loaded, so that a flaw is reported then and not in the middle of a run.

A contribution is checked by what it has, not by what it inherits. Every function here returns what is wrong, in a
sentence, or None.
"""

from __future__ import annotations

import inspect
from typing import Any

from magiclens.contract.stages import KINDS


def stage_flaw(cls: Any) -> str | None:
    """What keeps a class from being a stage: a class variable, a method, or a method's arguments."""
    flaw = _class_flaw(cls)
    if flaw:
        return flaw
    if getattr(cls, "kind", None) not in KINDS:
        return f"{cls.__name__}.kind is not one of {', '.join(KINDS)}"
    if not isinstance(getattr(cls, "version", None), str):
        return f"{cls.__name__}.version is not text"
    if cls.kind == "exporter" and not str(getattr(cls, "suffix", "")).startswith("."):
        return f"{cls.__name__}.suffix is not a file ending such as '.stl'"
    # a class need not inherit from the base of its kind, so its methods are looked for by name
    methods = _abstract_methods(KINDS[cls.kind])
    return _lacks(cls, *methods) or next(filter(None, (_arguments_flaw(cls, name) for name in methods)), None)


def scenario_flaw(cls: Any) -> str | None:
    """What keeps a class from being a scenario."""
    return _class_flaw(cls) or _lacks(cls, "shots", "fitted_lens", "make_views")


def executor_flaw(cls: Any) -> str | None:
    """What keeps a class from being an executor."""
    return _class_flaw(cls) or _lacks(cls, "map", "spreader")


def analysis_flaw(analysis: Any) -> str | None:
    """What keeps an object from being an analysis."""
    if not isinstance(getattr(analysis, "name", None), str):
        return f"{analysis!r} has no name"
    missing = [part for part in ("applies", "compute", "figures") if not callable(getattr(analysis, part, None))]
    return f"{analysis.name} lacks {', '.join(missing)}" if missing else None


def art_flaw(name: Any, draw: Any) -> str | None:
    """What keeps a name and a function from being a named picture."""
    if isinstance(name, str) and callable(draw):
        return None
    return f"{name!r} is not the name of a function from pixels to a picture"


def _class_flaw(cls: Any) -> str | None:
    if not inspect.isclass(cls):
        return f"{cls!r} is not a class"
    if not isinstance(getattr(cls, "type", None), str):
        return f"{cls.__name__}.type is not text"
    if inspect.isabstract(cls):
        return f"{cls.__name__} lacks {', '.join(_abstract_methods(cls))}"
    return _lacks(cls, "model_validate", "model_dump")


def _abstract_methods(cls: type[Any]) -> list[str]:
    return sorted(getattr(cls, "__abstractmethods__", ()))


def _lacks(cls: type[Any], *methods: str) -> str | None:
    missing = [name for name in methods if not callable(getattr(cls, name, None))]
    return f"{cls.__name__} lacks {', '.join(missing)}" if missing else None


def _arguments_flaw(cls: type[Any], method: str) -> str | None:
    """What is wrong if a stage's method does not take the arguments that runs call it with, in their order."""
    # by position: a plugin may call its parameters what it likes
    given = list(inspect.signature(getattr(KINDS[cls.kind], method)).parameters)
    try:
        inspect.signature(getattr(cls, method)).bind(*given)
    except TypeError as error:
        return f"{cls.__name__}.{method} is called with ({', '.join(given)}): {error}"
    return None
