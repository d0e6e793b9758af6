"""The exact matcher, its facets spread over a cluster in blocks of rows."""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from typing import ClassVar

import numpy as np
from pydantic import Field

from magiclens import Candidates, Exhaustive, Progress, Scene, raising, silent
from mlens_dask.executor import Dask, mapped


class Blocks(Exhaustive):
    """What ``exhaustive`` finds, byte by byte; its options, and where to look for it."""

    type: ClassVar[str] = "dask"

    cluster: Dask = Field(Dask(), description="options of the executor")
    blocks: int | None = Field(None, ge=1, le=1024, description="blocks of rows of facets; as many as workers")

    def match(self, scene: Scene, rng: np.random.Generator, progress: Progress = silent) -> Candidates:
        """Match blocks of rows on the workers; on a worker, in a sweep's task, all rows there.

        Raises InputError when some facet reaches no patch at all, or no scheduler answers.
        """
        if _on_a_worker():
            return super().match(scene, rng, progress)
        with self.cluster.client() as client:
            rows = self._rows(scene.lens.facets, len(client.nthreads()))
            found = []
            for block in raising(mapped(client, partial(_match, self, scene), rows)):
                found.append(block)
                progress(len(found) / len(rows))
        return _joined(found)

    def _rows(self, facets: int, workers: int) -> list[tuple[int, int]]:
        """First row and row after the last of each block; all blocks are about as high."""
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
    """Blocks of rows one below the other."""
    return Candidates(
        np.concatenate([block.offsets_mm for block in blocks]),
        np.concatenate([block.maps for block in blocks]),
        np.concatenate([block.errors for block in blocks]),
    )
