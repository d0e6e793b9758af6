"""A figure before it is a file or a part of a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from magiclens.drawing.tiles import Tile


@dataclass(frozen=True)
class Figure:
    """Rows of tiles. ``name`` is the name of its file without ``.png``; ``caption`` says what the figure shows."""

    name: str
    title: str
    rows: Sequence[Sequence[Tile]]
    caption: str

    @property
    def columns(self) -> int:
        """Number of tiles side by side."""
        return max(map(len, self.rows))

    @property
    def columns_on_a_phone(self) -> int:
        """Number of tiles side by side that can still be read on a narrow screen."""
        if any(tile.scale for row in self.rows for tile in row):
            return 1
        # source, target and photograph stay together, as they are compared with each other
        return self.columns if self.columns <= 3 else 2
