"""A plugin for magiclens: the exporter ``step``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from magiclens import hookimpl

if TYPE_CHECKING:
    from magiclens import Stage

mlens_contract = "2.0"


@hookimpl
def mlens_stages() -> Sequence[type[Stage]]:
    """The exporter."""
    from mlens_step.exporter import Step

    return [Step]
