"""The sheet that shows the lenses of a sweep side by side: an HTML page, and one picture."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from magiclens.drawing.scales import Pixels
from magiclens.drawing.tiles import Tile, render_rows, to_pixels, wrap_tiles
from magiclens.pages.templating import render_page
from magiclens.report.tables import format_metric
from magiclens.sweep.results import Sweep, SweepResult
from magiclens.sweep.table import compared_renderer, mean_scores

if TYPE_CHECKING:
    from PIL.Image import Image

COMBINATION_SIDE = 320
"""Width and height of the picture of a combination, pixels."""
_MOST_VIEWS = 9
"""Most views in the picture of a combination; the first ones are shown."""
_EMPTY_GREY = 232
"""Display value where there is nothing to show."""
_COLUMNS = {"psnr_db": "PSNR", "ssim": "SSIM", "step_mean_mm": "mean step", "step_max_mm": "highest step"}
"""Headings of the table's columns, by metric."""


def combination_pictures(sweep: Sweep) -> list[Pixels]:
    """Pictures (COMBINATION_SIDE, COMBINATION_SIDE, 3) of all combinations, views in rows; grey if there are none."""
    return [_picture(sweep.folder / result.combination.folder, result.manifest) for result in sweep.results]


def sweep_image(sweep: Sweep, pictures: Sequence[Pixels]) -> Image:
    """The sheet as one picture; if several keys have several values, each column has one value of the last key.

    Args:
        sweep: The finished sweep.
        pictures: One (COMBINATION_SIDE, COMBINATION_SIDE, 3) for each of its results.
    """
    both = zip(pictures, sweep.results, strict=True)
    tiles = [Tile(picture, result.combination.label, _caption(result)) for picture, result in both]
    columns = _columns(sweep)
    rows = [tiles[k : k + columns] for k in range(0, len(tiles), columns)] if columns else wrap_tiles(tiles)
    return render_rows(rows)


def sweep_page(sweep: Sweep, pictures: Sequence[Pixels]) -> str:
    """The sheet as an HTML page: one file that needs nothing else. Everything that users wrote is escaped.

    Args:
        sweep: The finished sweep.
        pictures: One (COMBINATION_SIDE, COMBINATION_SIDE, 3) for each of its results.
    """
    best = _best(sweep.results)
    return render_page(
        "magiclens.sweep/sweep.html",
        sweep=sweep,
        name=sweep.folder.name,
        columns=_columns(sweep),
        headings=[*_COLUMNS.values(), "seconds"],
        rows=[(result, _numbers(result), result is best) for result in sweep.results],
        pictures=[(result, picture, _caption(result)) for result, picture in zip(sweep.results, pictures, strict=True)],
    )


def _caption(result: SweepResult) -> str:
    """Scores, step and seconds, or why there are none."""
    if result.manifest is None:
        return result.outcome
    numbers = zip(("", "SSIM", "step", None, ""), _numbers(result), strict=True)
    return ", ".join(f"{name} {number}".strip() for name, number in numbers if name is not None and number != "-")


def _numbers(result: SweepResult) -> list[str]:
    """The cells below the headings."""
    if result.manifest is None:
        return ["-"] * (len(_COLUMNS) + 1)
    known = {**result.manifest["metrics"], **mean_scores(result.manifest)}
    found = [format_metric(key, known[key], 3) if known.get(key) is not None else "-" for key in _COLUMNS]
    return [*found, f"{result.manifest['seconds']:.1f} s"]


def _best(results: Sequence[SweepResult]) -> SweepResult | None:
    """The result with the highest PSNR, if there are several with one."""
    rated = [(mean_scores(r.manifest)["psnr_db"], k) for k, r in enumerate(results) if r.manifest]
    # of equal ones the first wins
    known = [(psnr, -k) for psnr, k in rated if psnr is not None]
    return results[-max(known)[1]] if len(known) > 1 else None


def _columns(sweep: Sweep) -> int | None:
    """How many values the last key has, if other keys have several as well."""
    counts = [len({result.combination.values[k] for result in sweep.results}) for k in range(len(sweep.keys))]
    return counts[-1] if counts[-1] > 1 and max(counts[:-1], default=1) > 1 else None


def _picture(run: Path, manifest: Mapping[str, Any] | None) -> Pixels:
    board = np.full((COMBINATION_SIDE, COMBINATION_SIDE, 3), _EMPTY_GREY, np.uint8)
    renderer = compared_renderer(manifest) if manifest else None
    if manifest is None or renderer is None:
        return board
    views = manifest["views"][:_MOST_VIEWS]
    per_side = math.ceil(math.sqrt(len(views)))
    side = COMBINATION_SIDE // per_side
    for k, view in enumerate(views):
        top, left = (COMBINATION_SIDE * index // per_side for index in divmod(k, per_side))
        shown = _exposed(run / view["renders"][renderer], run / view["target"], side)
        board[top : top + side, left : left + side] = shown
    return board


def _exposed(render: Path, target: Path, side: int) -> Pixels:
    """A rendered picture (side, side, 3) at the exposure at which it was scored."""
    from magiclens.images.files import read_image
    from magiclens.images.score import score

    seen = read_image(render)
    return to_pixels(np.clip(seen * np.float32(score(seen, read_image(target)).gain), 0, 1), side)
