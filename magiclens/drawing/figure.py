"""What a figure is, before it is a file or part of a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from magiclens.drawing.sheet import Tile


@dataclass(frozen=True)
class Figure:
    """Rows of tiles. ``name`` is its file's, without ``.png``; ``caption`` is a sentence on what one sees."""

    name: str
    title: str
    rows: Sequence[Sequence[Tile]]
    caption: str

    @property
    def columns(self) -> int:
        """Tiles side by side."""
        return max(map(len, self.rows))

    @property
    def columns_on_a_phone(self) -> int:
        """Tiles side by side that stay legible on a narrow screen; three pictures of a row stay together."""
        if any(tile.scale for row in self.rows for tile in row):
            return 1
        return self.columns if self.columns <= 3 else 2
