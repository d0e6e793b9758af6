"""Candidates under construction."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import Candidates, Lens
from magiclens.contract.errors import InputError
from magiclens.matching.tuples import Found


class Pool:
    """The candidates of a search: flat facets, one bucket per candidate, image frame (y down)."""

    def __init__(self, facets: int, buckets: int):
        k = buckets * buckets
        self.buckets = buckets
        self.errors = np.full((facets, k), np.inf, np.float32)
        self.offsets = np.zeros((facets, k, 2), np.float64)
        self.maps = np.zeros((facets, k, 3), np.float64)

    @classmethod
    def of(cls, candidates: Candidates, rows: slice = slice(None)) -> Pool:
        """A pool of candidates that there are already, those of the facets in some rows or all."""
        k = candidates.errors.shape[2]
        pool = cls(0, 0)
        pool.errors = candidates.errors[rows].reshape(-1, k).copy()
        pool.offsets = candidates.offsets_mm[rows].reshape(-1, k, 2).astype(np.float64) * (1, -1)
        pool.maps = candidates.maps[rows].reshape(-1, k, 3).astype(np.float64) * (1, -1, 1)
        return pool

    @property
    def found(self) -> Found:
        """The arrays as kernels fill them."""
        return Found(self.errors, self.offsets, self.maps)

    def restore(self, known: Pool) -> None:
        """Give facets that have no candidate left those of another pool of this size."""
        empty = ~np.isfinite(self.errors).any(axis=1)
        self.errors[empty], self.offsets[empty], self.maps[empty] = (
            known.errors[empty], known.offsets[empty], known.maps[empty]
        )  # fmt: skip

    def sort(self) -> None:
        """Put the best candidates first."""
        order = np.argsort(self.errors, axis=1, kind="stable")
        self.errors = np.take_along_axis(self.errors, order, 1)
        self.offsets = np.take_along_axis(self.offsets, order[..., None], 1)
        self.maps = np.take_along_axis(self.maps, order[..., None], 1)

    def drop(self, acceptance: float) -> None:
        """Give up candidates whose error exceeds their facet's best by more than ``acceptance``."""
        self.errors[self.errors > self.errors.min(axis=1, keepdims=True) + acceptance] = np.inf

    def candidates(self, lens: Lens, most: int) -> Candidates:
        """The best ``most`` of every facet, +y up."""
        errors = self.errors[:, :most]
        shape = (-1, lens.facets, errors.shape[1])
        return Candidates(
            (self.offsets[:, :most] * (1, -1)).reshape(*shape, 2).astype(np.float32),
            (self.maps[:, :most] * (1, -1, 1)).reshape(*shape, 3).astype(np.float32),
            errors.reshape(shape),
        )

    def require_all(self, lens: Lens, first_row: int = 0) -> None:
        """Raise InputError naming the first facet without a candidate, if there is one."""
        empty = np.flatnonzero(~np.isfinite(self.errors).any(axis=1))
        if len(empty):
            row, column = divmod(int(empty[0]) + first_row * lens.facets, lens.facets)
            raise InputError(
                f"facet (row {row}, column {column}) reaches no patch of the source: "
                "use a smaller window or scales, a thicker lens, a larger gap, max_slope or relief, or a larger source",
                keys=("lens.max_slope", "lens.relief", "window", "scales", "lens.thickness", "scenario.source.size"),
            )
