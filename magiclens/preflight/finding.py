"""What a check has found."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from magiclens.contract.artifacts import BoolArray, IntArray, Lens

Status = Literal["green", "amber", "red"]
"""Fit; look at it first; do not make it."""
ORDER: tuple[Status, ...] = ("green", "amber", "red")

Facets = tuple[tuple[int, int], ...]
"""(row, column) each: row 0 at +y, column 0 at -x."""


@dataclass(frozen=True)
class Finding:
    """One line of the page. ``facets`` are those at fault, the worst first."""

    check: str
    status: Status
    text: str
    facets: Facets = ()


def worst(findings: Iterable[Finding]) -> Status:
    """The status of all together."""
    return max((finding.status for finding in findings), key=ORDER.index, default="green")


def graded(value: float, amber: float, red: float) -> Status:
    """Green up to ``amber``, amber up to ``red``, then red."""
    return "green" if value <= amber else "amber" if value <= red else "red"


def facets_with(bad: BoolArray, facet: IntArray, badness: Sequence[float] | np.ndarray, lens: Lens) -> Facets:
    """The facets in which something is bad, the worst first.

    bad: (F,). facet: (F,) row * N + column. badness: (F,), by which facets are sorted.
    """
    found = np.full(lens.facets**2, -np.inf)
    np.maximum.at(found, facet[bad], np.asarray(badness, float)[bad])
    order = np.argsort(-found, kind="stable")[: int(np.isfinite(found).sum())]
    return tuple((int(k) // lens.facets, int(k) % lens.facets) for k in order)


def first_of(facets: Facets) -> str:
    """Where the worst one is, in words; nothing if there is none."""
    if not facets:
        return ""
    row, column = facets[0]
    more = f", and {len(facets) - 1} more" if len(facets) > 1 else ""
    return f"; the worst is facet row {row}, column {column}{more}"
