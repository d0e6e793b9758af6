"""The pages of a print sheet, drawn. Lengths are in mm; (0, 0) is the middle of the source and of the lens, +y up."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import FloatArray, Lens, Scene, Solid, View
from magiclens.exporting.sources import distinct_sources, eight_bit
from magiclens.geometry.mark import foot_of, lowest_points

if TYPE_CHECKING:
    from reportlab.pdfgen.canvas import Canvas

_POINTS = 72 / 25.4
"""Points per millimetre: PDF counts in points, 72 to the inch."""
_FONT, _BOLD = "Helvetica", "Helvetica-Bold"
_TITLE, _TEXT, _SMALL = 4.5, 3.0, 2.2
"""Heights of letters of the title, of text, and of the numbers at rulers."""
_LINE = 0.1
"""Width of all lines."""
_MARGIN, _AWAY, _MARK, _LABEL, _RULER, _ROW = 8.0, 2.0, 6.0, 14.0, 10.0, 5.0
"""Margin of the page; distance from picture to mark; length of a mark; depth of marks with labels; of a ruler; of a row
of text."""
_RULED, _ROOM = 100, 60
"""Length of the rulers, and least room for a label."""
_ADVICE = "Print at 100 %, without fitting to the page: both rulers must measure 100 mm. The lens's top is its {}."
_Box = tuple[float, float, float, float]
"""Left, bottom, right and top."""


@dataclass(frozen=True)
class Page:
    """A page of the print sheet: a source, the views that use it, and where the lens lies.

    Attributes:
        title: The page's first line.
        lens: The lens.
        source: (H, W, C) linear light.
        views: The views that use the source.
        outlines: Outlines of the lens's bottom, mm, world frame: one for each way in which it lies on the source.
    """

    title: str
    lens: Lens
    source: FloatArray
    views: Sequence[View]
    outlines: Sequence[_Box]

    @property
    def middle(self) -> _Box:
        """The box that source and outlines cover."""
        half = self.lens.source_size_mm / 2
        boxes = np.array([(-half, -half, half, half), *self.outlines])
        left, bottom = boxes[:, :2].min(axis=0).tolist()
        right, top = boxes[:, 2:].max(axis=0).tolist()
        return left, bottom, right, top

    @property
    def corner(self) -> tuple[float, float]:
        """x of the upright ruler and y of the level one, mm: beside marks and labels."""
        left, bottom, _, _ = self.middle
        return min(-_RULED / 2 - _TEXT, left - _LABEL), min(-_RULED / 2 - _TEXT, bottom - _LABEL)

    @property
    def extent(self) -> _Box:
        """The box that everything covers, with rows of text above and below."""
        (left, low), (_, _, right, top) = self.corner, self.middle
        beside, above = max(_RULED / 2 + _TEXT, right + _LABEL), max(_RULED / 2 + _TEXT, top + _LABEL)
        # above: the three lines of ``_head`` and half a row of space
        return left - _RULER, low - _RULER - _ROW, beside, above + 3.5 * _ROW

    @property
    def needs_mm(self) -> tuple[float, float]:
        """Width and height of the smallest paper that has room for the page."""
        left, bottom, right, top = self.extent
        return right - left + 2 * _MARGIN, top - bottom + 2 * _MARGIN


def pages(scene: Scene, solid: Solid) -> list[Page]:
    """A page for every source of a scene, in the order of the views."""
    sources = distinct_sources(scene)
    bottom = _bottom(solid, scene.lens)
    out = []
    for k, (name, source) in enumerate(sources.items()):
        views = [view for view in scene.views if view.source_name == name]
        outlines = {_turned(bottom, view.quarter_turns): None for view in views}
        title = f"Magic lens: {name} ({k + 1} of {len(sources)})" if len(sources) > 1 else f"Magic lens: {name}"
        out.append(Page(title, scene.lens, source, views, list(outlines)))
    return out


def write_pages(drawn: Sequence[Page], paper_mm: tuple[float, float], path: Path) -> None:
    """Write a PDF, each page in the middle of its paper; equal pages give equal bytes.

    Args:
        drawn: the pages.
        paper_mm: width and height of the paper.
        path: of the file.
    """
    from reportlab.pdfgen.canvas import Canvas

    width, height = paper_mm
    # invariant: without a date and a random id
    canvas = Canvas(str(path), (width * _POINTS, height * _POINTS), pageCompression=1, invariant=1)
    canvas.setTitle(drawn[0].title.partition(" (")[0])
    canvas.setCreator("magiclens")
    for page in drawn:
        left, bottom, right, top = page.extent
        canvas.scale(_POINTS, _POINTS)
        canvas.translate((width - left - right) / 2, (height - bottom - top) / 2)
        _draw(canvas, page)
        canvas.showPage()
    canvas.save()


def _bottom(solid: Solid, lens: Lens) -> _Box:
    """The rectangle that the lowest vertices span, without the lens's mark, lens frame, to the nanometre."""
    left, bottom, right, top = foot_of(lowest_points(solid), lens.mark)
    return round(left, 6), round(bottom, 6), round(right, 6), round(top, 6)


def _turned(box: _Box, quarter_turns: int) -> _Box:
    """A box after counter-clockwise quarter turns about the origin."""
    left, bottom, right, top = box
    return box if quarter_turns == 0 else _turned((-top, left, -bottom, right), quarter_turns - 1)


def _draw(canvas: Canvas, page: Page) -> None:
    canvas.setLineWidth(_LINE)
    _picture(canvas, page)
    for box in page.outlines:
        _marks(canvas, box, page.middle)
        # above a gap, slanting rays reach beyond the outline, so a line inside the source would be seen
        if page.lens.gap_mm == 0 or max(map(abs, box)) >= page.lens.source_size_mm / 2:
            _outline(canvas, box)
    for turn in range(4):
        _label(canvas, page, turn)
    x, y = page.corner
    _ruler(canvas, 0.0, y, 0)
    _ruler(canvas, x, 0.0, -90)
    start, low, end, above = page.extent
    for k, (text, font, size) in enumerate(_head(page)):
        _write(canvas, text, font, size, start, above - _TITLE - k * _ROW, end - start)
    advice = _ADVICE.format("side with the mark" if page.lens.mark else "+y side")
    _write(canvas, advice, _FONT, _TEXT, start, low + _ROW - _TEXT, end - start)


def _picture(canvas: Canvas, page: Page) -> None:
    """The source's own pixels, without loss."""
    from reportlab.lib.utils import ImageReader

    size = page.lens.source_size_mm
    canvas.drawImage(ImageReader(eight_bit(page.source)), -size / 2, -size / 2, size, size)


def _outline(canvas: Canvas, box: _Box) -> None:
    """The rectangle, drawn just outside itself: on the lens's bottom no line is seen."""
    left, bottom, right, top = box
    canvas.rect(left - _LINE / 2, bottom - _LINE / 2, right - left + _LINE, top - bottom + _LINE)


def _marks(canvas: Canvas, box: _Box, middle: _Box) -> None:
    """Lines at a rectangle's corners, outside all pictures, on which its sides lie."""
    left, bottom, right, top = box
    for x in (left - _LINE / 2, right + _LINE / 2):
        canvas.line(x, middle[1] - _AWAY, x, middle[1] - _AWAY - _MARK)
        canvas.line(x, middle[3] + _AWAY, x, middle[3] + _AWAY + _MARK)
    for y in (bottom - _LINE / 2, top + _LINE / 2):
        canvas.line(middle[0] - _AWAY, y, middle[0] - _AWAY - _MARK, y)
        canvas.line(middle[2] + _AWAY, y, middle[2] + _AWAY + _MARK, y)


def _label(canvas: Canvas, page: Page, turn: int) -> None:
    """An arrow and the names of views, at the page's side where the lens's +y side is after so many quarter turns."""
    names = [view.name for view in page.views if view.quarter_turns == turn]
    if not names:
        return
    left, _, right, top = _turned(page.middle, -turn % 4)
    canvas.saveState()
    canvas.rotate(90 * turn)
    canvas.translate((left + right) / 2, top + _AWAY)
    arrow = canvas.beginPath()
    for k, (x, y) in enumerate([(-1.5, 0.0), (1.5, 0.0), (0.0, 2.2)]):
        (arrow.lineTo if k else arrow.moveTo)(x, y)
    arrow.close()
    canvas.drawPath(arrow, stroke=0, fill=1)
    room = max(right - left, _ROOM)
    canvas.translate(0.0, _MARK + 1.5)
    if turn == 2:  # else the text would be upside down
        canvas.rotate(180)
        canvas.translate(0.0, -_TEXT * 0.7)
    _write(canvas, f"lens's top here: {listed(names)}", _FONT, _TEXT, -room / 2, 0.0, room, centred=True)
    canvas.restoreState()


def _ruler(canvas: Canvas, x: float, y: float, turn: float) -> None:
    """A ruler of 100 mm, its middle at (x, y); ``turn`` degrees counter-clockwise from +x, its marks to the right."""
    canvas.saveState()
    canvas.translate(x, y)
    canvas.rotate(turn)
    canvas.line(-_RULED / 2, 0, _RULED / 2, 0)
    for k in range(_RULED + 1):
        at, length = k - _RULED / 2, 3.0 if k % 10 == 0 else 2.0 if k % 5 == 0 else 1.2
        canvas.line(at, 0, at, -length)
        if k % 10 == 0:
            _write(canvas, str(k), _FONT, _SMALL, at - 5, -length - _SMALL, 10, centred=True)
    _write(canvas, "mm", _FONT, _SMALL, _RULED / 2 + 1, -3 - _SMALL, 6, centred=True)
    canvas.restoreState()


def _head(page: Page) -> Iterable[tuple[str, str, float]]:
    """Lines of text with font and size: what it is, what lies where, from where to look."""
    lens = page.lens
    yield page.title, _BOLD, _TITLE
    sizes = {f"{right - left:g} x {top - bottom:g} mm": None for left, bottom, right, top in page.outlines}
    lies = f"{lens.gap_mm:g} mm above this sheet" if lens.gap_mm else "on this sheet"
    source = f"Source {lens.source_size_mm:g} x {lens.source_size_mm:g} mm"
    yield f"{source}; lens {' or '.join(sizes)}, {lens.thickness_mm:g} mm thick, {lies}", _FONT, _TEXT
    yield _viewpoint(page), _FONT, _TEXT


def _viewpoint(page: Page) -> str:
    """From where to look: where the eyes of a page's views are."""
    # heights are measured from the sheet, which lies a gap below z = 0; + 0.0 turns -0.0 into 0.0
    eyes = {view.name: (view.eye_mm + np.array([0, 0, page.lens.gap_mm])).round() + 0.0 for view in page.views}
    first = next(iter(eyes.values()))
    if any((eye != first).any() for eye in eyes.values()):
        listing = [f"{name} ({x:g}, {y:g}, {z:g})" for name, (x, y, z) in eyes.items()]
        return f"Look from (mm to the right, up the page, above it): {listed(listing)}"
    right, up, above = first
    sides = f"{abs(right):g} mm {'right' if right > 0 else 'left'}, {abs(up):g} mm {'up' if up > 0 else 'down'}"
    return f"Look from {above:g} mm above this sheet, {sides if right or up else 'over the middle of the source'}"


def listed(names: Sequence[str], most: int = 4) -> str:
    """``a, b, c``, or ``a, b, c and 6 more``."""
    if len(names) <= most:
        return ", ".join(names)
    return f"{', '.join(names[: most - 1])} and {len(names) - most + 1} more"


def _write(
    canvas: Canvas, text: str, font: str, size: float, x: float, y: float, room: float, centred: bool = False
) -> None:
    """A line of text from (x, y), or in the middle of its room; letters are smaller if it would be wider than that."""
    wide = canvas.stringWidth(text, font, size)
    scale = min(1.0, room / wide)
    canvas.setFont(font, size * scale)
    canvas.drawString(x + (room - wide * scale) / 2 if centred else x, y, text)
