"""What a figure is, before it is a file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from PIL.Image import Image


@dataclass(frozen=True)
class Figure:
    """``name`` is its file's, without ``.png``; ``caption`` is one sentence on what one sees."""

    name: str
    title: str
    image: Image
    caption: str
