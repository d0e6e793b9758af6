"""The sheet on which a sweep's lenses stand side by side: a page, and a picture of the same."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

from magiclens.drawing.scales import Pixels
from magiclens.drawing.tiles import Tile, render_rows, to_pixels, wrap_tiles
from magiclens.pages.base import embedded
from magiclens.report.tables import measure
from magiclens.sweep.table import scores, shown_by

if TYPE_CHECKING:
    from PIL.Image import Image

    from magiclens.sweep.sweeping import Result, Sweep

SIDE = 320
"""Pixels of a combination's picture."""
MOST_VIEWS = 9
"""Of a lens with more views, the first ones are shown."""
GREY = 232
COLUMNS = {"psnr_db": "PSNR", "ssim": "SSIM", "step_mean_mm": "mean step", "step_max_mm": "highest step"}


def pictures(sweep: Sweep) -> list[Pixels]:
    """(SIDE, SIDE, 3) for every combination: what its lens shows, views in rows; grey where there is nothing."""
    return [_picture(sweep.folder / result.combination.folder, result.manifest) for result in sweep.results]


def contact_sheet(sweep: Sweep, shown: Sequence[Pixels]) -> Image:
    """Every combination's pictures with its scores; columns are the values of the last of several keys."""
    both = zip(shown, sweep.results, strict=True)
    tiles = [Tile(picture, result.combination.label, caption(result)) for picture, result in both]
    columns = _columns(sweep)
    rows = [tiles[k : k + columns] for k in range(0, len(tiles), columns)] if columns else wrap_tiles(tiles)
    return render_rows(rows)


def page(sweep: Sweep, shown: Sequence[Pixels]) -> str:
    """The HTML page of a sweep: one file that needs nothing else. Everything that users wrote is escaped."""
    from jinja2 import Environment, StrictUndefined

    source = (files("magiclens.sweep") / "templates" / "sweep.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"embedded": embedded, "quoted": quote}
    best = _best(sweep.results)
    return environment.from_string(source).render(
        sweep=sweep,
        name=sweep.folder.name,
        columns=_columns(sweep),
        headings=[*COLUMNS.values(), "seconds"],
        rows=[(result, _numbers(result), result is best) for result in sweep.results],
        pictures=[(result, picture, caption(result)) for result, picture in zip(sweep.results, shown, strict=True)],
    )


def caption(result: Result) -> str:
    """Scores, step and seconds, or why there are none."""
    if result.manifest is None:
        return result.outcome
    numbers = zip(("", "SSIM", "step", None, ""), _numbers(result), strict=True)
    return ", ".join(f"{name} {number}".strip() for name, number in numbers if name is not None and number != "-")


def _numbers(result: Result) -> list[str]:
    """What stands below the headings."""
    if result.manifest is None:
        return ["-"] * (len(COLUMNS) + 1)
    known = {**result.manifest["metrics"], **scores(result.manifest)}
    found = [measure(key, known[key], 3) if known.get(key) is not None else "-" for key in COLUMNS]
    return [*found, f"{result.manifest['seconds']:.1f} s"]


def _best(results: Sequence[Result]) -> Result | None:
    """The result with the highest PSNR, if there are several with one."""
    rated = [(scores(r.manifest)["psnr_db"], k) for k, r in enumerate(results) if r.manifest]
    known = [(psnr, -k) for psnr, k in rated if psnr is not None]
    return results[-max(known)[1]] if len(known) > 1 else None


def _columns(sweep: Sweep) -> int | None:
    """How many values the last key has, if other keys have several as well."""
    counts = [len({result.combination.values[k] for result in sweep.results}) for k in range(len(sweep.keys))]
    return counts[-1] if counts[-1] > 1 and max(counts[:-1], default=1) > 1 else None


def _picture(run: Path, manifest: Mapping[str, Any] | None) -> Pixels:
    board = np.full((SIDE, SIDE, 3), GREY, np.uint8)
    renderer = shown_by(manifest) if manifest else None
    if manifest is None or renderer is None:
        return board
    views = manifest["views"][:MOST_VIEWS]
    per_side = math.ceil(math.sqrt(len(views)))
    side = SIDE // per_side
    for k, view in enumerate(views):
        top, left = (SIDE * place // per_side for place in divmod(k, per_side))
        shown = _exposed(run / view["renders"][renderer], run / view["target"], side)
        board[top : top + side, left : left + side] = shown
    return board


def _exposed(render: Path, target: Path, side: int) -> Pixels:
    """(side, side, 3): a simulated photograph at the exposure at which it was scored."""
    from magiclens.images.files import read_image
    from magiclens.images.score import score

    seen = read_image(render)
    return to_pixels(np.clip(seen * np.float32(score(seen, read_image(target)).gain), 0, 1), side)
