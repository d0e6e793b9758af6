"""A short film of a finished lens to share: the sheet, and the pictures into which it snaps."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from magiclens.drawing.scales import Pixels

if TYPE_CHECKING:
    from PIL.Image import Image

_SIDE_PX, _TILES, _STEPS = 360, 20, 8
_STEP_MS, _SHEET_MS, _PICTURE_MS = 70, 900, 1600
_MOST_VIEWS = 8


def film_to_share(run: Path, views: Sequence[dict[str, Any]]) -> bytes:
    """A GIF that begins with the sheet; tile by tile each view appears in it, as made if that is known.

    Args:
        run: The run folder.
        views: Its views, as ``run_summary`` has them.
    """
    frames: list[Pixels] = []
    holds: list[int] = []
    for view in views[:_MOST_VIEWS]:
        sheet, seen = (_square(run / path) for path in (view["source"], view["made"] or view["designed"]))
        frames += [sheet, *_snapping(sheet, seen), seen]
        holds += [_SHEET_MS, *[_STEP_MS] * _STEPS, _PICTURE_MS]
    return _gif(frames, holds)


def _square(path: Path) -> Pixels:
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image.convert("RGB").resize((_SIDE_PX, _SIDE_PX), Image.Resampling.LANCZOS))


def _snapping(sheet: Pixels, seen: Pixels) -> list[Pixels]:
    """Frames in which more and more tiles show the picture, in an order that is always the same."""
    turn = np.random.default_rng(0).permutation(_TILES**2).reshape(_TILES, _TILES) / _TILES**2
    when = np.kron(turn, np.ones((_SIDE_PX // _TILES,) * 2))[..., None]
    return [np.where(when < (k + 1) / (_STEPS + 1), seen, sheet) for k in range(_STEPS)]


def _gif(frames: Sequence[Pixels], holds: Sequence[int]) -> bytes:
    from PIL import Image

    first, *others = (_reduced(Image.fromarray(frame)) for frame in frames)
    content = io.BytesIO()
    first.save(content, "GIF", save_all=True, append_images=others, duration=list(holds), loop=0)
    return content.getvalue()


def _reduced(image: Image) -> Image:
    """In few colours, which are enough for what is seen through a lens."""
    from PIL import Image

    return image.quantize(64, dither=Image.Dither.NONE)
