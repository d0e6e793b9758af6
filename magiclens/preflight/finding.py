"""Findings of preflight's checks, and how they are graded."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray, IntArray, Lens
from magiclens.images.likeness import Word, word_for

Status = Literal["green", "grey", "amber", "red"]
"""Grade of a finding: the lens is fit to be made; this was not checked; it should be examined first; it should not be
made."""
_ORDER: tuple[Status, ...] = ("green", "grey", "amber", "red")
"""Statuses from the best to the worst."""

_STATUS_OF_WORD: Mapping[Word, Status] = {
    "clear": "green",
    "recognisable": "green",
    "hard to see": "amber",
    "lost": "red",
}
"""How words for pictures are graded."""

ANY_MESH = "lens.*"
"""What stands for the name of a mesh file in texts that are true of every file that holds the lens."""

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
class Verdict:
    """What an eye will make of the worst view of a lens.

    Attributes:
        made: Likeness of the picture as made and its target, see ``likeness``; None if that was not checked.
        designed: The same of the picture as designed; None if the run has taken none.
        unchecked: Why ``made`` is None, and what to do about it.
    """

    made: float | None = None
    designed: float | None = None
    unchecked: str = ""

    @property
    def status(self) -> Status:
        """The grade: grey if the picture as made was not checked, unless even the designed one is hard to see."""
        if self.made is not None:
            return _STATUS_OF_WORD[word_for(self.made)]
        designed: Status = "grey" if self.designed is None else _STATUS_OF_WORD[word_for(self.designed)]
        return "grey" if designed == "green" else designed

    @property
    def text(self) -> str:
        """Both words, in a line."""
        why = f" ({self.unchecked})" if self.unchecked else ""
        return f"as made: {_in_words(self.made)}{why}; as designed: {_in_words(self.designed)}"

    def as_object(self) -> dict[str, Any]:
        """For ``preflight.json``; likeness in three digits."""
        numbers = {"as_made": self.made, "as_designed": self.designed}
        words = {name: {"word": _word(value), "likeness": value and round(value, 3)} for name, value in numbers.items()}
        return {"text": self.text, "status": self.status, **words}


@dataclass(frozen=True)
class Preflight:
    """All findings about a run folder.

    Attributes:
        name: The name of the run.
        made_by: Title of the machine, empty if none is named.
        findings: One finding or more per check, in the order of the page.
        slopes_deg: (N, N) mean slope of each facet, for the map; None if there is no mesh of the right size.
        verdict: Whether the lens will show its picture; the first of the findings is about it, too.
    """

    name: str
    made_by: str
    findings: Sequence[Finding]
    slopes_deg: FloatArray | None
    verdict: Verdict = Verdict()

    @property
    def status(self) -> Status:
        """The status of the worst finding."""
        return worst(self.findings)

    def of_mesh(self, name: str) -> Preflight:
        """The same of a mesh file of this name, for findings about ``ANY_MESH``."""
        return replace(self, findings=[replace(f, text=f.text.replace(ANY_MESH, name)) for f in self.findings])

    def as_plain(self) -> dict[str, Any]:
        """All of it as JSON data."""
        slopes = None if self.slopes_deg is None else self.slopes_deg.tolist()
        return {**asdict(self), "slopes_deg": slopes}

    @classmethod
    def from_plain(cls, data: Mapping[str, Any]) -> Preflight:
        """What ``as_plain`` was called on."""
        slopes = None if data["slopes_deg"] is None else np.array(data["slopes_deg"])
        findings = [
            Finding(**{**each, "facets": tuple((row, column) for row, column in each["facets"])})
            for each in data["findings"]
        ]
        return cls(**{**data, "findings": findings, "slopes_deg": slopes, "verdict": Verdict(**data["verdict"])})


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
    np.maximum.at(found, facet[bad], np.asarray(badness)[bad].astype(float))
    order = np.argsort(-found, kind="stable")[: int(np.isfinite(found).sum())]
    return tuple((int(k) // lens.facets, int(k) % lens.facets) for k in order)


def worst_facet_text(facets: FacetIndices) -> str:
    """The end of a sentence that says which facet is the worst; empty if there is none."""
    if not facets:
        return ""
    row, column = facets[0]
    more = f", and {len(facets) - 1} more" if len(facets) > 1 else ""
    return f"; the worst is facet row {row}, column {column}{more}"


def _word(value: float | None) -> str:
    return "not checked" if value is None else word_for(value)


def _in_words(value: float | None) -> str:
    return _word(value) if value is None else f"{_word(value)}, likeness {value:.2f}"
