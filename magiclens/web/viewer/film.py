"""The film for browsers that cannot run the viewer: the lens glides onto its sheet, once for each of some views."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import FloatArray, View
from magiclens.images import resize, to_display
from magiclens.pages.pictures import data_uri
from magiclens.running.open_run import OpenRun

if TYPE_CHECKING:
    from PIL.Image import Image

FILM_BYTES = 190_000
"""Greatest length of the film as text in a page."""
_SIDE_PX = 240
_MOST_VIEWS, _STEPS = 3, 5
_SHEET_MS, _STEP_MS, _PICTURE_MS = 400, 90, 1000
"""Together less than 5 s: longer motion would need a button to stop it."""
_QUALITIES = (70, 55, 40, 25, 10, 0)
_TABLE = 0.62
"""Linear light around the sheet."""
_ASIDE = 0.75
"""How far to the right the lens comes from, in widths of the picture."""
_MOVING, _RESTING = (0.5, 1), (1.0, 2)
"""Share of the pixels along a side, and samples along a side of each, that are traced of a lens that moves, and of one
that lies still: nobody sees what a few hundredths of a second lack, and tracing is most of the work."""


def film_uri(lens: OpenRun) -> str:
    """The film of a finished lens as data URI of an animated WebP that plays once; its rays are traced."""
    frames, holds = zip(*_frames(lens), strict=True)
    tries = (data_uri(_webp(frames, holds, quality), "webp") for quality in _QUALITIES)
    fitting = next((uri for uri in tries if len(uri) <= FILM_BYTES), None)
    return fitting or data_uri(_webp(frames[-1:], holds[-1:], _QUALITIES[1]), "webp")


def _frames(lens: OpenRun) -> Iterator[tuple[Image, int]]:
    """Pictures with how long each is shown, in milliseconds."""
    views = lens.lit_scene.views
    for k in sorted({round(share * (len(views) - 1)) for share in np.linspace(0, 1, _MOST_VIEWS)}):
        frame = _Frame.of(lens, views[k])
        yield frame.without_lens(), _SHEET_MS
        for t in np.linspace(0, 1, _STEPS + 1)[1:]:
            away = _ASIDE * frame.wide_mm * (1 - t * t * (3 - 2 * t))
            yield frame.with_lens(away, _MOVING if t < 1 else _RESTING), _STEP_MS if t < 1 else _PICTURE_MS


@dataclass(frozen=True)
class _Frame:
    """What the eye of a view sees on the plane of the lens's top, without the lens.

    Attributes:
        lens: The lens.
        view: The view, with the light of its sheet.
        sheet: (S, S, 3) the table with the sheet, linear light.
        wide_mm: Its width.
    """

    lens: OpenRun
    view: View
    sheet: FloatArray
    wide_mm: float

    @classmethod
    def of(cls, lens: OpenRun, view: View) -> _Frame:
        plan, (x, y, z) = lens.plan.lens, view.eye_mm.tolist()
        near = z - plan.thickness_mm
        shrinks = near / (z + plan.gap_mm)  # the sheet is farther away than the top of the lens
        side_mm = plan.source_size_mm * shrinks
        wide_mm = 1.1 * min(max(side_mm, plan.size_mm), 1.4 * plan.size_mm)
        frame = cls(lens, view, np.full((_SIDE_PX, _SIDE_PX, 3), _TABLE, np.float32), wide_mm)
        frame._paste(view.source, side_mm, (x - x * shrinks, y - y * shrinks))
        return frame

    def without_lens(self) -> Image:
        """The table with the sheet."""
        return _picture(self.sheet)

    def with_lens(self, away_mm: float, fineness: tuple[float, int]) -> Image:
        """The same with the lens on it, so far to the right and as fine as ``_MOVING`` or ``_RESTING`` say."""
        from magiclens.rendering.poses import Pose

        size_mm = self.lens.plan.lens.size_mm
        share, samples = fineness
        pixels = round(share * _SIDE_PX * size_mm / self.wide_mm)
        seen = self.lens.seen(Pose(shift_x_mm=-away_mm, eye_x_mm=-away_mm), self.view.name, pixels, samples)
        covered = _Frame(self.lens, self.view, self.sheet.copy(), self.wide_mm)
        covered._paste(seen, size_mm, (away_mm, 0.0))
        return _picture(covered.sheet)

    def _paste(self, picture: FloatArray, side_mm: float, middle_mm: tuple[float, float]) -> None:
        """Lay a square picture on the table; what is beyond the edges is cut off."""
        side = round(_SIDE_PX * side_mm / self.wide_mm)
        x, y = (round(_SIDE_PX * (0.5 + at / self.wide_mm) - side / 2) for at in (middle_mm[0], -middle_mm[1]))
        shown = resize(picture, (side, side)) if picture.shape[0] != side else picture
        top, left, low, right = max(y, 0), max(x, 0), min(y + side, _SIDE_PX), min(x + side, _SIDE_PX)
        if top < low and left < right:
            self.sheet[top:low, left:right] = shown[top - y : low - y, left - x : right - x]


def _picture(light: FloatArray) -> Image:
    from PIL import Image

    return Image.fromarray(np.rint(to_display(light) * 255).astype(np.uint8))


def _webp(frames: Sequence[Image], holds: Sequence[int], quality: int) -> bytes:
    content = io.BytesIO()
    first, *others = frames
    first.save(
        content, "WEBP", save_all=True, append_images=others, duration=list(holds), loop=1, quality=quality, method=3
    )
    return content.getvalue()
