"""Matching in blocks of rows of facets, each done wherever the executor of a run has it done."""

from __future__ import annotations

from typing import Protocol, TypeVar

import numpy as np

from magiclens.contract.artifacts import Candidates
from magiclens.contract.stages import Progress
from magiclens.kernels.spreading import is_spread, shares, spread

_Given = TypeVar("_Given", contravariant=True)


class RowMatcher(Protocol[_Given]):
    """A function of a module that matches some rows of facets."""

    def __call__(self, given: _Given, rows: range, progress: Progress = ...) -> Candidates:
        """Candidates with arrays (rows, N, K, ...); those of a facet must not depend on which other rows there are."""


def match_in_blocks(match_rows: RowMatcher[_Given], given: _Given, facets: int, progress: Progress) -> Candidates:
    """Match all rows of facets: here and at once, or in blocks by whoever does this run's loops.

    Args:
        match_rows: Matches some rows.
        given: Its first argument, see ``spread``.
        facets: N, rows of facets.
        progress: Is told the share that is done.

    Returns:
        Candidates with arrays (N, N, K, ...).
    """
    if not is_spread():
        return match_rows(given, range(facets), progress)
    blocks, found = shares(facets), []
    for done, block in spread(match_rows, given, blocks):
        found.append(block)
        progress((done + 1) / len(blocks))
    return Candidates(
        np.concatenate([block.offsets_mm for block in found]),
        np.concatenate([block.maps for block in found]),
        np.concatenate([block.errors for block in found]),
    )
