"""The exhaustive matcher with its facets spread over a cluster, which a spec names."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from magiclens import Candidates, Exhaustive, Progress, Scene, silent, spreading_by
from mlens_dask.executor import Dask


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
        with self.cluster.cluster(self.blocks) as cluster, spreading_by(cluster):
            return super().match(scene, rng, progress)


def _on_a_worker() -> bool:
    from distributed import get_worker

    try:
        get_worker()
    except ValueError:
        return False
    return True
