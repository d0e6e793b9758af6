"""The exhaustive matcher with its facets spread over a cluster, in blocks of rows."""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from typing import ClassVar

import numpy as np
from pydantic import Field

from magiclens import Candidates, Exhaustive, Progress, Scene, raising, silent
from mlens_dask.executor import Dask, mapped


class Blocks(Exhaustive):
    """Finds what ``exhaustive`` finds, byte by byte, on the workers of a cluster."""

    type: ClassVar[str] = "dask"

    cluster: Dask = Field(Dask(), description="options of the executor")
    blocks: int | None = Field(None, ge=1, le=1024, description="blocks of rows of facets; as many as workers")

    def match(self, scene: Scene, rng: np.random.Generator, progress: Progress = silent) -> Candidates:
        """Match blocks of rows on the workers.

        In a task of a sweep, which is on a worker already, all rows are matched there.

        Raises:
            InputError: Some facet reaches no patch at all, no scheduler answers, or no worker comes.
        """
        # a worker that waits for other workers would keep its own task's turn
        if _on_a_worker():
            return super().match(scene, rng, progress)
        with self.cluster.client() as client:
            rows = self._rows(scene.lens.facets, len(client.nthreads()))
            found = []
            for block in raising(mapped(client, partial(_match, self, scene), rows, self.cluster.wait_s)):
                found.append(block)
                progress(len(found) / len(rows))
        return _joined(found)

    def _rows(self, facets: int, workers: int) -> list[tuple[int, int]]:
        """The first row and the row after the last of each block; all blocks have about the same number of rows."""
        edges = np.linspace(0, facets, min(self.blocks or max(workers, 1), facets) + 1).round().astype(int).tolist()
        return list(pairwise(edges))


def _on_a_worker() -> bool:
    from distributed import get_worker

    try:
        get_worker()
    except ValueError:
        return False
    return True


def _match(options: Blocks, scene: Scene, rows: tuple[int, int]) -> Candidates:
    return options.match_rows(scene, *rows)


def _joined(blocks: list[Candidates]) -> Candidates:
    """The candidates of all blocks, which are given from top to bottom."""
    return Candidates(
        np.concatenate([block.offsets_mm for block in blocks]),
        np.concatenate([block.maps for block in blocks]),
        np.concatenate([block.errors for block in blocks]),
    )
