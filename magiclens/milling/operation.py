"""An operation, roughing or finishing: its lines, and the heights at which its cutter may run along them.

All coordinates are multiples of the machine's step. x and y are in the lens frame, mm; z = 0 is the plate's top. Lines
run along x, at constant y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from magiclens.contract.artifacts import FloatArray, Solid
from magiclens.milling.border import Rectangle, inner_rectangle, outer_rectangle, top_vertices
from magiclens.milling.cutter import Cutter
from magiclens.milling.offset import Contacts
from magiclens.milling.options import MillingOptions
from magiclens.milling.outline import Outline
from magiclens.milling.outline_kernels import touch
from magiclens.milling.toolpath_kernels import covering, segments, thinned

SAG_MM = 5e-5
"""How far a cutter's true path may bulge above the straight line between two samples, mm."""
_COARSEST_MM, _FINEST_MM = 0.02, 0.002
"""Largest and smallest distance of samples along a line, mm."""
_LIFT_MM = 0.5
"""Distance, mm, of the points at which it is computed how high a cutter must be to step to the next line."""


@dataclass(frozen=True)
class Operation:
    """One operation with its cutter, on the whole of a solid with a grid.

    Attributes:
        options: The options of the exporter.
        name: ``roughing`` or ``finishing``.
        solid: The lens, of which the highest surface counts.
        thickness_mm: z of the plate's top, lens frame.
        slope: The steepest tangent expected at the solid's border; lines go on beyond it as far as the cutter must to
            touch such a slope.
    """

    options: MillingOptions
    name: str
    solid: Solid
    thickness_mm: float
    slope: float

    @property
    def number(self) -> int:
        """The cutter's number in the tool table."""
        return self.options.cutters[self.name][0]

    @property
    def cutter(self) -> Cutter:
        """The cutter of this operation."""
        return self.options.cutters[self.name][1]

    @property
    def stepover_mm(self) -> float:
        """The most that two neighbouring lines are apart."""
        return self.options.rough_stepover_mm if self.name == "roughing" else self.options.stepover

    @cached_property
    def floor_mm(self) -> float:
        """The lowest z of the top, lens frame."""
        return float(top_vertices(self.solid)[..., 2].min())

    @cached_property
    def whole(self) -> Rectangle:
        """What the tip must go over: beyond the border wherever the cutter touches a slope beside its axis."""
        beyond = float(touch(self.cutter.outline(), self.slope, 0.0)) if self.slope else 0.0
        x0, x1, y0, y1 = outer_rectangle(self.solid)
        return Rectangle(x0 - beyond, x1 + beyond, y0 - beyond, y1 + beyond)

    @cached_property
    def contacts(self) -> Contacts:
        """Where the cutter's tip may go.

        What is sharp in a cutter makes paths that jump: it is taken to be wider by the distance of two samples, so that
        whatever lies between them is known to both.
        """
        outline = self.cutter.outline()
        wider = 0.0 if outline.arc else self.spacing[0]
        outline = outline._replace(flat=outline.flat + wider, knee=outline.knee + wider, radius=outline.radius + wider)
        return Contacts(self.solid, outline, inner_rectangle(self.solid))

    @cached_property
    def stepping(self) -> Contacts:
        """Where the cutter may step to a neighbouring line: where a flat cutter may be that is wider by that way."""
        radius = self.cutter.diameter / 2 + self.stepover_mm + _LIFT_MM
        return Contacts(self.solid, Outline(radius, 0.0, 0.0, radius, 0.0, radius), inner_rectangle(self.solid))

    @cached_property
    def spacing(self) -> tuple[float, int]:
        """Distance of samples along a line, mm, and every how many of them there is a node, where a path may turn.

        Nodes are on the machine's grid. An arc of radius r bulges by spacing^2 / (8 r) between samples.
        """
        arc, step = self.cutter.outline().arc, self.options.step_mm
        wish = min(max(math.sqrt(8 * SAG_MM * arc), _FINEST_MM), _COARSEST_MM)
        every = max(math.ceil(step / wish), 1)
        return (step / every, every) if every > 1 else (math.floor(wish / step) * step, 1)

    def lines(self, part: Rectangle) -> FloatArray:
        """(rows,) ascending y of the lines of the whole that are in a part, mm."""
        low, high = self.whole.y0, self.whole.y1
        count = math.ceil((high - low) / self.stepover_mm) + 1
        step = self.options.step_mm
        # the lines of the whole, so that tiles go on with each other's; on the machine's grid, two may become one
        y = np.unique(np.round(np.linspace(low, high, count) / step)) * step
        # a step more: rounding must not leave out a line between two tiles
        return y[(y >= part.y0 - step) & (y <= part.y1 + step)]

    def nodes(self, part: Rectangle) -> FloatArray:
        """(columns,) ascending x of the nodes that span a part, mm."""
        spacing, every = self.spacing
        first, last = math.floor(part.x0 / (spacing * every)), math.ceil(part.x1 / (spacing * every))
        return np.arange(first, last + 1) * (spacing * every)

    def tips(self, nodes: FloatArray, y_mm: FloatArray) -> FloatArray:
        """(rows, nodes): lowest z of the tip at the nodes such that straight lines between them cut nothing away."""
        spacing, every = self.spacing
        samples = np.linspace(nodes[0], nodes[-1], (len(nodes) - 1) * every + 1)
        arc = self.cutter.outline().arc
        z = self.contacts.tips(samples, y_mm, self.floor_mm)
        # cutters without an arc have no roundness to tell jumps from; ``contacts`` takes them to be wider instead
        tips: FloatArray = thinned(covering(z, spacing**2 / arc) if arc else z, every) - self.thickness_mm
        return tips

    def lifts(self, nodes: FloatArray, y_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x (columns,) and z (rows, columns) from which the tip may step to a neighbouring line anywhere near x."""
        x = np.linspace(nodes[0], nodes[-1], max(math.ceil((nodes[-1] - nodes[0]) / _LIFT_MM), 1) + 1)
        return x, self.stepping.tips(x, y_mm, self.floor_mm) - self.thickness_mm

    def corners(self, nodes: FloatArray, y: float, z: FloatArray, tolerance: float) -> FloatArray:
        """The points at which a path turns that follows heights from above.

        Args:
            nodes: (columns,) x of the nodes.
            y: of the line.
            z: (columns,) heights to follow.
            tolerance: the most that the path may be above them, mm.

        Returns:
            (K, 3), in ascending x.
        """
        (spacing, every), step = self.spacing, self.options.step_mm
        at, count = segments(np.ascontiguousarray(z), spacing * every, tolerance, step)
        return np.column_stack([nodes[at], np.full(len(at), y), count * step])

    def on_grid_above(self, z: float) -> float:
        """The least height on the machine's grid that is not below z, with ``SAG_MM`` to spare."""
        step = self.options.step_mm
        return math.ceil((z + SAG_MM) / step) * step
