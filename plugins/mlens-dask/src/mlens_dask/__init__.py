"""A plugin for magiclens: the executor ``dask``, and the matcher ``dask``, which spreads facets over a cluster."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from magiclens import hookimpl

if TYPE_CHECKING:
    from magiclens import Executor, Stage


@hookimpl
def mlens_executors() -> Sequence[type[Executor]]:
    """Contribute the executor."""
    from mlens_dask.executor import Dask

    return [Dask]


@hookimpl
def mlens_stages() -> Sequence[type[Stage]]:
    """Contribute the matcher."""
    from mlens_dask.matcher import Blocks

    return [Blocks]
