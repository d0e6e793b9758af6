"""Findings of preflight's checks, and how they are graded."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray, IntArray, Lens

Status = Literal["green", "amber", "red"]
"""Grade of a finding: the lens is fit to be made; it should be examined first; it should not be made."""
_ORDER: tuple[Status, ...] = ("green", "amber", "red")
"""Statuses from the best to the worst."""

FacetIndices = tuple[tuple[int, int], ...]
"""(row, column) of facets; row 0 is at +y, column 0 at -x."""


@dataclass(frozen=True)
class Finding:
    """The result of one check: a line of the preflight page.

    Attributes:
        check: The name of the check.
        status: The grade.
        text: What was found, in a sentence.
        facets: Facets at fault, the worst first.
    """

    check: str
    status: Status
    text: str
    facets: FacetIndices = ()


@dataclass(frozen=True)
class Preflight:
    """All findings about a run folder.

    Attributes:
        name: The name of the run.
        made_by: Title of the machine, empty if none is named.
        findings: One finding or more per check, in the order of the page.
        slopes_deg: (N, N) mean slope of each facet, for the map; None if there is no mesh of the right size.
    """

    name: str
    made_by: str
    findings: Sequence[Finding]
    slopes_deg: FloatArray | None

    @property
    def status(self) -> Status:
        """The status of the worst finding."""
        return worst(self.findings)


def worst(findings: Iterable[Finding]) -> Status:
    """The status of the worst finding; green if there is none."""
    return max((finding.status for finding in findings), key=_ORDER.index, default="green")


def graded(value: float, amber: float, red: float) -> Status:
    """Green if the value is at most ``amber``, amber if it is at most ``red``, else red."""
    return "green" if value <= amber else "amber" if value <= red else "red"


def facets_where(bad: BoolArray, facet: IntArray, badness: Sequence[float] | np.ndarray, lens: Lens) -> FacetIndices:
    """The facets that hold bad triangles, the worst first.

    Args:
        bad: (F,) triangles at fault.
        facet: (F,) facet of each triangle, row * N + column.
        badness: (F,) how bad each triangle is; a facet is as bad as its worst triangle.
        lens: Says how many facets there are.
    """
    found = np.full(lens.facets**2, -np.inf)
    # not found[facet[bad]] = ...: of several triangles of a facet that would keep the last one
    np.maximum.at(found, facet[bad], np.asarray(badness, float)[bad])
    order = np.argsort(-found, kind="stable")[: int(np.isfinite(found).sum())]
    return tuple((int(k) // lens.facets, int(k) % lens.facets) for k in order)


def worst_facet_text(facets: FacetIndices) -> str:
    """The end of a sentence that says which facet is the worst; empty if there is none."""
    if not facets:
        return ""
    row, column = facets[0]
    more = f", and {len(facets) - 1} more" if len(facets) > 1 else ""
    return f"; the worst is facet row {row}, column {column}{more}"
