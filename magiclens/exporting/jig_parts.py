"""The parts of a jig, as bodies where they belong: world frame of the scene, mm, the lens's flat bottom at z = 0."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import Lens, Scene, Solid
from magiclens.contract.errors import InputError
from magiclens.exporting.print_page import pages
from magiclens.geometry.mark import lowest_points, mark_of

if TYPE_CHECKING:
    from manifold3d import Manifold

_WALL, _FLOOR, _HIGH = 6.0, 2.0, 8.0
"""Width of the walls around the lens, thickness of the floor below the sheet, height of the walls above the sheet."""
_DEEPEST = 10.0
"""Greatest gap between sheet and lens."""
_LEDGE, _THINNEST = 1.0, 1.5
"""Least width of a ledge that carries the lens, and of any other wall."""
_BLOCK, _BLOCK_HIGH = 30.0, 20.0
"""Side and height of the block beside the tray in which the column stands."""
_COLUMN, _PEG, _PEG_LONG = 20.0, 12.0, 14.0
"""Sides of a column and of the pegs that join its parts, and length of a peg."""
_ARM, _RING = 5.0, 14.0
"""Thickness of an arm, and radius of its end around the peephole."""
_FAR = 1e4
"""Higher than anything."""


@dataclass(frozen=True)
class JigShape:
    """What the parts depend on besides the lens; mm.

    Attributes:
        clearance: Air on each side of what is put into something.
        sheet: Thickness of the sheet.
        peephole: Diameter.
        bed: Longest side of a part.
        stand: Whether there are columns and arms.
    """

    clearance: float
    sheet: float
    peephole: float
    bed: float
    stand: bool


@dataclass(frozen=True)
class JigPart:
    """A part of the jig: its name, its body in place, and whether it is printed upside down."""

    name: str
    body: Manifold
    flipped: bool = False

    def on_bed(self) -> Manifold:
        """The body as it is printed, its lowest point at z = 0 and its middle above the origin."""
        body = self.body.rotate([180, 0, 0]) if self.flipped else self.body
        x0, y0, z0, x1, y1, _ = body.bounding_box()
        return body.translate([-(x0 + x1) / 2, -(y0 + y1) / 2, -z0])


@dataclass(frozen=True)
class _Box:
    """A rectangle."""

    left: float
    bottom: float
    right: float
    top: float

    def grown(self, by: float) -> _Box:
        return _Box(self.left - by, self.bottom - by, self.right + by, self.top + by)

    def moved(self, x: float, y: float) -> _Box:
        return _Box(self.left + x, self.bottom + y, self.right + x, self.top + y)

    def around(self, other: _Box) -> _Box:
        low, high = min(self.left, other.left), max(self.right, other.right)
        return _Box(low, min(self.bottom, other.bottom), high, max(self.top, other.top))

    def body(self, low: float, high: float) -> Manifold:
        """The upright block over it, from one z to another."""
        from manifold3d import Manifold

        cube = Manifold.cube([self.right - self.left, self.top - self.bottom, high - low])
        return cube.translate([self.left, self.bottom, low])


def jig_parts(scene: Scene, solid: Solid, shape: JigShape) -> list[JigPart]:
    """The tray that holds sheet and lens, columns, and an arm with a peephole for each eye; the tray comes first.

    There is one place for a column, so columns of several heights, and arms, are put there in turn.

    Raises:
        InputError: No such jig can hold this lens, or a part is too large.
    """
    lens, seat = scene.lens, _seat(scene, solid)
    sheet = _square(lens.source_size_mm)
    outer = seat.around(sheet).grown(shape.clearance + _WALL)
    eyes = sorted({tuple(view.eye_mm.tolist()) for view in scene.views}, key=lambda eye: (eye[2], eye[1], eye[0]))
    foot = _foot(outer, lens, eyes)
    turns = {view.quarter_turns for view in scene.views} if lens.mark else set()
    slots = [_slot(_Box(*mark_of(lowest_points(solid))), shape.clearance, turn) for turn in sorted(turns)]
    tray = _tray(lens, seat, outer, shape)
    tray = _without(tray + _block(foot, lens, shape) if shape.stand else tray, slots)
    parts = [*_tiles(tray, shape.bed), *_inset(seat, sheet, shape, slots)]
    if shape.stand:
        parts += [part for height in sorted({eye[2] for eye in eyes}) for part in _column(foot, height, eyes, shape)]
        parts += [_arm(foot, eye, f"arm-{k + 1}" if len(eyes) > 1 else "arm", shape) for k, eye in enumerate(eyes)]
    for part in parts:
        _check_size(part, shape.bed)
    return parts


def sight(lens: Lens, eye: Sequence[float]) -> Manifold:
    """The pyramid of all rays between an eye (3,) and the lens's square, without its tip in the peephole."""
    from manifold3d import Manifold

    half, tip = lens.size_mm / 2, 1e-3
    corners = [(x, y, lens.thickness_mm) for x in (-half, half) for y in (-half, half)]
    ends = [[c + (1 - tip) * (e - c) for c, e in zip(corner, eye, strict=True)] for corner in corners]
    return Manifold.hull_points(np.array([*corners, *ends], np.float32))


def _seat(scene: Scene, solid: Solid) -> _Box:
    """The outline of the lens's bottom, the same in all views."""
    outlines = {outline for page in pages(scene, solid) for outline in page.outlines}
    if len(outlines) > 1:
        raise InputError("the lens's bottom lies elsewhere in each view, and no tray fits all of them", "exporter jig")
    return _Box(*outlines.pop())


def _square(side: float) -> _Box:
    return _Box(-side / 2, -side / 2, side / 2, side / 2)


def _tray(lens: Lens, seat: _Box, outer: _Box, shape: JigShape) -> Manifold:
    """The tray: the sheet's pocket, the lens's seat above it, walls around both, an arrow up."""
    pocket, low = _square(lens.source_size_mm).grown(shape.clearance), -lens.gap_mm - shape.sheet
    if lens.gap_mm > _DEEPEST:
        reason = f"the sheet would lie {lens.gap_mm:g} mm deep in a tray, where no light falls on it"
        raise InputError(f"{reason}; the jig is for gaps up to {_DEEPEST:g} mm", "exporter jig")
    if lens.gap_mm > 0 and _ledge(seat, pocket) < _LEDGE:
        reason = f"nothing would hold the lens {lens.gap_mm:g} mm above its sheet, which is as wide as its bottom"
        raise InputError(f"{reason}; lay spacers between them, and leave the jig out", "exporter jig")
    holes = seat.grown(shape.clearance).body(0.0, _FAR) + pocket.body(low, _FAR)
    return outer.body(low - _FLOOR, _HIGH) - holes - _arrow(outer)


def _block(foot: _Box, lens: Lens, shape: JigShape) -> Manifold:
    """The block in which the column stands."""
    body = foot.body(-lens.gap_mm - shape.sheet - _FLOOR, _BLOCK_HIGH)
    return body - _middle(foot, _PEG / 2 + shape.clearance).body(_BLOCK_HIGH - _PEG_LONG - 1, _FAR)


def _inset(seat: _Box, sheet: _Box, shape: JigShape, slots: Sequence[Manifold]) -> Iterator[JigPart]:
    """The frame that centres a lens on a sheet which is wider than its bottom."""
    window = seat.grown(shape.clearance)
    beyond = [
        window.left - sheet.left,
        window.bottom - sheet.bottom,
        sheet.right - window.right,
        sheet.top - window.top,
    ]
    if max(beyond) <= 0:
        return
    if min(beyond) < _THINNEST:
        reach = f"the source reaches {min(beyond):.3g} to {max(beyond):.3g} mm beyond the sides of the lens's bottom"
        remedy = f"too little for a frame between them; make it {_THINNEST:g} mm or more on all sides, or none"
        raise InputError(f"{reach}, {remedy}", "exporter jig")
    yield JigPart("inset", _without(sheet.body(0.0, _HIGH) - window.body(-1.0, _FAR), slots))


def _ledge(seat: _Box, pocket: _Box) -> float:
    """Width of the ledge that carries the lens, on the better one of two pairs of sides."""
    across = min(pocket.left - seat.left, seat.right - pocket.right)
    return max(across, min(pocket.bottom - seat.bottom, seat.top - pocket.top))


def _foot(outer: _Box, lens: Lens, eyes: Sequence[Sequence[float]]) -> _Box:
    """Where the column stands: beside a side of the tray, off its middle, where no eye is in its way."""
    middles = [outer.left + share * (outer.right - outer.left) for share in (0.75, 0.25)]
    beyond = (outer.top + _BLOCK / 2, outer.bottom - _BLOCK / 2, outer.right + _BLOCK / 2, outer.left - _BLOCK / 2)
    places = [*product(middles, beyond[:2]), *product(beyond[2:], middles)]
    for x, y in places:
        foot = _square(_BLOCK).moved(x, y)
        column = _middle(foot, _COLUMN / 2).body(0.0, max(eye[2] for eye in eyes))
        if all((column ^ sight(lens, eye)).is_empty() for eye in eyes):
            return foot
    raise InputError("wherever its column stands, it would be in the way of an eye", "exporter jig")


def _middle(box: _Box, half: float) -> _Box:
    """The square of half a side in the middle of a box."""
    return _square(2 * half).moved((box.left + box.right) / 2, (box.bottom + box.top) / 2)


def _column(foot: _Box, height: float, eyes: Sequence[Sequence[float]], shape: JigShape) -> Iterator[JigPart]:
    """The parts of the column that carries the arms of one height, joined by pegs, the lowest first."""
    heights = sorted({eye[2] for eye in eyes})
    name = "column" if len(heights) == 1 else f"column-{heights.index(height) + 1}"
    if height < _BLOCK_HIGH + _PEG_LONG + _THINNEST:
        raise InputError(f"the eye is only {height:g} mm above the sheet; no stand is needed", "exporter jig: stand")
    count = math.ceil((height - _BLOCK_HIGH) / (shape.bed - _PEG_LONG))
    ends = np.linspace(_BLOCK_HIGH, height, count + 1)
    for k, (low, high) in enumerate(pairwise(ends.tolist())):
        body = _middle(foot, _COLUMN / 2).body(low, high) + _middle(foot, _PEG / 2).body(low - _PEG_LONG, low)
        socket = _middle(foot, _PEG / 2 + shape.clearance).body(high - _PEG_LONG - 1, _FAR)
        # upside down it stands on its flat end, the peg on top
        yield JigPart(f"{name}-part-{k + 1}" if count > 1 else name, body - socket, flipped=True)


def _arm(foot: _Box, eye: Sequence[float], name: str, shape: JigShape) -> JigPart:
    """The arm from the column to the peephole, which widens upward so that an eye comes close."""
    from manifold3d import Manifold

    x, y, z = eye
    ring = Manifold.cylinder(_ARM, _RING, circular_segments=64).translate([x, y, z])
    plate = Manifold.batch_hull([_middle(foot, _COLUMN / 2).body(z, z + _ARM), ring])
    hole = Manifold.cylinder(_ARM + 0.02, shape.peephole / 2, shape.peephole / 2 + _ARM, 64).translate([x, y, z - 0.01])
    return JigPart(name, plate + _middle(foot, _PEG / 2).body(z - _PEG_LONG, z + 0.5) - hole, flipped=True)


def _arrow(outer: _Box) -> Manifold:
    """The arrow that is cut into the upper wall: this edge up."""
    from manifold3d import CrossSection

    x, y = (outer.left + outer.right) / 2, outer.top
    corners = [(x - 4, y - _WALL + 1), (x + 4, y - _WALL + 1), (x, y - 1)]
    return CrossSection([corners]).extrude(2.0).translate([0, 0, _HIGH - 1.0])


def _slot(mark: _Box, clearance: float, quarter_turns: int) -> Manifold:
    """The room for a lens's mark after quarter turns of the lens."""
    half = (mark.right - mark.left) / 2 + clearance
    box = _Box(-half, mark.bottom - 1.0, half, mark.top + 2 * clearance)
    return box.moved((mark.left + mark.right) / 2, 0.0).body(0.0, _FAR).rotate([0, 0, 90 * quarter_turns])


def _without(body: Manifold, slots: Sequence[Manifold]) -> Manifold:
    """A body with slots cut into it."""
    from manifold3d import Manifold, OpType

    return Manifold.batch_boolean([body, *slots], OpType.Subtract) if slots else body


def _tiles(tray: Manifold, bed: float) -> Iterator[JigPart]:
    """The tray, cut into equal tiles if it is larger than the bed; they are glued edge to edge."""
    x0, y0, z0, x1, y1, z1 = tray.bounding_box()
    columns, rows = (math.ceil(side / bed) for side in (x1 - x0, y1 - y0))
    for row, column in product(range(rows), range(columns)):
        left, bottom = x0 + column * (x1 - x0) / columns, y0 + row * (y1 - y0) / rows
        cell = _Box(left, bottom, left + (x1 - x0) / columns, bottom + (y1 - y0) / rows)
        name = "tray" if rows * columns == 1 else f"tray-{row * columns + column + 1}"
        yield JigPart(name, tray ^ cell.body(z0 - 1, z1 + 1))


def _check_size(part: JigPart, bed: float) -> None:
    low, high = np.split(np.array(part.on_bed().bounding_box()), 2)
    if (high - low).max() > bed + 1e-6:
        sides = " x ".join(f"{side:.0f}" for side in high - low)
        raise InputError(
            f"its {part.name} would be {sides} mm; use a bed of {(high - low).max():.0f} mm", "exporter jig: bed"
        )
