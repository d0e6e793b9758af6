"""Can this machine run a plan? Asked before anything is computed, so that what passes ``mlens check`` can be run."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from magiclens.cache.folder import size_in_bytes, size_text
from magiclens.config.document import dotted
from magiclens.contract.errors import InputError
from magiclens.plan.blame import blaming, locating, place_of
from magiclens.plan.compile import Plan
from magiclens.running.estimate import Estimate, Need, estimate

MEMORY_VARIABLE = "MLENS_MEMORY"
"""The variable of the environment that says how much memory runs may take, such as 64GB, instead of what there is."""

_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")
"""Files in which Linux says how much memory a container may take."""

_LONGEST_YEARS = 1.0
"""Processor time of a run that nobody can be waiting for."""

_YEAR_S = 365.0 * 24 * 3600


def require_feasible(plan: Plan) -> Estimate:
    """What a run needs, if this machine can do it.

    Raises:
        InputError: It cannot: a stage lacks something, a file cannot be, or there is too little memory or time. The
            message has the line of the key to change.
    """
    for step in plan.steps:
        ask = getattr(step.stage, "lacks", None)  # a stage need not inherit from our base
        with blaming(f"{step}: lacks"):
            lack = ask() if ask else None
        if lack:
            at = plan.place(step)
            raise InputError(f"{dotted(at)}: {lack}", plan.document.where(at))
    for exporter in plan.exporters:
        require = getattr(exporter.stage, "require_possible", None)
        with locating(plan.document, plan.place(exporter)), blaming(f"{exporter}: require_possible"):
            if require:
                require(plan.lens)
    needs, room = estimate(plan), memory_bytes()
    if room is not None and needs.bytes > room:
        there = f"of {size_text(needs.bytes)} of memory, this machine has {size_text(room)}"
        raise _too_much(plan, needs.largest, f"would take about {size_text(needs.largest.bytes)} {there}")
    if needs.seconds > _LONGEST_YEARS * _YEAR_S:
        raise _too_much(plan, needs.longest, f"would take about {duration_text(needs.longest.seconds)}")
    return needs


def memory_bytes() -> float | None:
    """How much memory runs may take: what the environment says, else what there is; None if that is not known."""
    said = os.environ.get(MEMORY_VARIABLE)
    if said:
        return size_in_bytes(said, MEMORY_VARIABLE)
    found = []
    with suppress(AttributeError, OSError, ValueError):  # Windows does not know ``sysconf``
        found.append(float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")))
    for path in _LIMITS:
        with suppress(OSError, ValueError):  # ``max`` is no number
            found.append(float(Path(path).read_text(encoding="ascii")))
    return min(found, default=None)


def estimate_text(needs: Estimate) -> str:
    """A line for people."""
    files = "".join(f", {name} of {size_text(size)}" for name, size in needs.files.items())
    return f"estimate {size_text(needs.bytes)} of memory, {duration_text(needs.seconds)}{files}"


def duration_text(seconds: float) -> str:
    """Processor time in a unit that suits it, with one digit, since it is a guess."""
    units = {"years": _YEAR_S, "days": 86400.0, "hours": 3600.0, "minutes": 60.0, "seconds": 1.0}
    unit = next((name for name, size in units.items() if seconds >= 2 * size), "seconds")
    return f"{float(f'{max(seconds / units[unit], 1):.1g}'):,.0f} {unit} of processor time"


def _too_much(plan: Plan, part: Need, why: str) -> InputError:
    place = place_of(part.keys, plan.document, part.at)
    return InputError(f"{dotted(place)}: the {part.name} {why}; use {part.advice}", plan.document.where(place))
