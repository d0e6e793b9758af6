"""Dart throwing: facets draw regions of the source at random, no two the same, whatever is to be shown (5.1)."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydantic import Field, field_validator

from magiclens.contract.artifacts import (
    Assignment,
    BoolArray,
    Candidates,
    FloatArray,
    HeightField,
    IntArray,
    Lens,
    Scene,
)
from magiclens.contract.errors import InputError
from magiclens.contract.stages import Matcher, Progress, silent
from magiclens.contract.units import LengthOrPercent, relative
from magiclens.geometry.facets import edge_models
from magiclens.matching.grain import flat_scale
from magiclens.matching.key_size import key_size_bits

_SIGNS = np.array([(1, 1), (-1, 1), (1, -1), (-1, -1)], np.float64)
"""The four ways in which a facet can show its sub-region: as it is, or mirrored."""
_LEAST_REACH_MM, _LEAST_REACH_SHARE, _MOST_REACH_MM, _HALF = 0.01, 0.001, 10_000.0, 0.5
"""Bounds of what a spec may ask for; no source is larger."""
_HAND = 16
"""Neighbouring sub-regions that a facet considers when it draws again."""
_TEMPERATURE = 1e-4
"""Temperature of drawing again, as a share of a facet's light: losses beyond that count, all else is left to chance."""
_STEP_WEIGHT = 3e-6
"""Cost of a squared step per facet edge, per mm^2, as a share of a facet's light."""
_REST = 1e-9
"""Pull of a facet toward the reference plane, per mm^2, where its height makes no difference."""


class DartThrowing(Matcher):
    """One sub-region per facet, seen in the four ways it can be mirrored; no pictures are needed."""

    type: ClassVar[str] = "dart-throwing"
    uses_pictures: ClassVar[bool] = False

    subdivisions: int = Field(2, ge=1, le=8, description="sub-regions along one side of a facet's patch of the source")
    reach: LengthOrPercent = Field(
        relative("5%"), description="farthest a facet may look along each axis, of the source's width"
    )
    guard: LengthOrPercent = Field(
        relative("4%"), description="rim of a sub-region that is not looked at, of the sub-region's side"
    )

    sweeps: int = Field(
        20,
        ge=0,
        le=10_000,
        description="sweeps of drawing again where walls between facets would take light; 0: the plain draw",
    )

    @field_validator("reach")
    @classmethod
    def _far_enough(cls, value: LengthOrPercent) -> LengthOrPercent:
        low, high = (_LEAST_REACH_SHARE, 1.0) if value.relative else (_LEAST_REACH_MM, _MOST_REACH_MM)
        if not low <= value.value <= high:
            bounds = f"{_LEAST_REACH_MM:g}mm to {_MOST_REACH_MM:g}mm, or {_LEAST_REACH_SHARE:.1%} to 100%"
            raise ValueError(f"a reach is from {bounds}")
        return value

    @field_validator("guard")
    @classmethod
    def _leaves_something(cls, value: LengthOrPercent) -> LengthOrPercent:
        if not 0 <= value.value < (_HALF if value.relative else _MOST_REACH_MM):
            raise ValueError(
                f"the guard is less than half a sub-region: 0% to less than 50%, or up to {_MOST_REACH_MM:g}mm"
            )
        return value

    def match(self, scene: Scene, rng: np.random.Generator, progress: Progress = silent) -> Candidates:
        """Draw a sub-region for every facet; all errors are 0.

        Raises:
            InputError: the facets cannot all get one, or the views do not share an eye.
        """
        eyes = np.array([view.eye_in_lens_frame_mm for view in scene.views])
        if not np.allclose(eyes, eyes[0]):
            raise InputError("a universal lens needs views that share one eye in the lens frame")
        n, lattice = scene.lens.facets, SubRegions.of(scene.lens, self.subdivisions)
        reach = Reach.of(self, scene, lattice)
        drawn = throw_darts(reach.regions, np.any(reach.usable, axis=-1), lattice.count**2, rng)
        if self.sweeps:
            drawn = _redrawn(reach, drawn, scene, lattice.count**2, self.sweeps, rng)
        offsets, maps, usable = reach.labels(drawn[:, None])
        order = np.argsort(~usable, axis=1, kind="stable")[..., None]
        return Candidates(
            offsets.reshape(n, n, 4, 2).astype(np.float32),
            np.take_along_axis(maps, order, 1).reshape(n, n, 4, 3).astype(np.float32),
            np.where(np.take_along_axis(usable, order[..., 0], 1), 0, np.inf).reshape(n, n, 4).astype(np.float32),
            {"permutation_bits": key_size_bits(reach.regions, reach.usable, np.random.default_rng(0))},
        )

    def rematch(
        self, scene: Scene, candidates: Candidates, assignment: Assignment, built: HeightField, traced: FloatArray,
        progress: Progress = silent,
    ) -> Candidates:  # fmt: skip
        """The same candidates: pictures that are painted for the finished lens say nothing about it before."""
        return candidates


@dataclass(frozen=True)
class SubRegions:
    """A lattice of square sub-regions of the source, aligned with the facets; image frame (y down).

    Along either axis, number k lies k sides after the lens's edge.

    Args:
        side: of a sub-region, mm.
        first: number of the first sub-region along an axis that lies inside the source.
        count: how many along an axis do.
    """

    side: float
    first: int
    count: int

    @classmethod
    def of(cls, lens: Lens, subdivisions: int) -> SubRegions:
        """The sub-regions that cut the patch below each facet into subdivisions^2."""
        side = lens.pitch_mm / subdivisions
        first = -math.floor((lens.source_size_mm - lens.size_mm) / 2 / side + 1e-9)
        return cls(side, first, lens.facets * subdivisions - 2 * first)


@dataclass(frozen=True)
class Reach:
    """What facets can show: F facets, D^2 neighbouring sub-regions each, row by row; image frame (y down).

    Args:
        offsets: (D^2, 2) of sub-regions from the facet, mm.
        maps: (4, 2) xx and yy.
        usable: (F, D^2, 4) whether a facet can show a neighbour with a map.
        regions: (F, D^2) which sub-region of the lattice a neighbour is.
    """

    offsets: FloatArray
    maps: FloatArray
    usable: BoolArray
    regions: IntArray

    @classmethod
    def of(cls, options: DartThrowing, scene: Scene, lattice: SubRegions) -> Reach:
        """What is within reach, below slope limit and relief, inside the source and not reserved.

        Args:
            options: the reach, and how sub-regions are shown.
            scene: the lens and what is reserved.
            lattice: of the sub-regions.
        """
        from magiclens.matching.dart_throwing_kernels import regions_reachable
        from magiclens.optics.medium import image_optics_of

        lens, q = scene.lens, options.subdivisions
        maps = _SIGNS * _shrunk_scale(lattice.side, options.guard.mm(lattice.side), scene)
        numbers = _neighbours(lattice.side, q, options.reach.mm(lens.source_size_mm))
        along = (numbers + 0.5 - q / 2) * lattice.side
        offsets = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
        regions = _neighbour_regions(lattice, lens.facets, q, numbers)
        centres = lens.facet_centres_mm().reshape(-1, 2) * (1, -1)
        usable = regions_reachable(centres, offsets, maps, lens.pitch_mm, image_optics_of(scene))
        free = np.append(_unreserved(scene, lattice).ravel(), False)
        return cls(offsets, maps, usable & free[regions][..., None], regions)

    def labels(self, options: IntArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """What facets would show if they drew some of their neighbours, each with each of the four maps; +y up.

        Args:
            options: (F, H) numbers among a facet's D^2 neighbours.

        Returns:
            Offsets (F, 4 H, 2), mm, maps (F, 4 H, 3) and usability (F, 4 H).
        """
        facets, count = options.shape
        maps = np.stack([self.maps[:, 0], np.zeros(4), self.maps[:, 1]], axis=-1)
        usable = np.take_along_axis(self.usable, options[..., None], axis=1).reshape(facets, -1)
        return (
            np.repeat(self.offsets[options] * (1, -1), 4, axis=1),
            np.broadcast_to(maps, (facets, count, 4, 3)).reshape(facets, -1, 3),
            usable,
        )


def _shrunk_scale(side: float, guard: float, scene: Scene) -> float:
    """The scale at which a facet of flat micro-facets sees a sub-region but for its guarded rim, mm.

    A flat micro-facet shows its patch unmagnified, whatever the scale between the micro-facets' centres.
    """
    cell = scene.lens.pitch_mm / scene.lens.microfacets
    left = side - 2 * guard - flat_scale(scene) * cell
    if left <= 0:
        raise InputError(
            f"a micro-facet sees {flat_scale(scene) * cell:.3g} mm of the source, more than the guard leaves of "
            f"sub-regions of {side:.3g} mm: use fewer subdivisions, a smaller guard or more micro-facets",
            keys=("subdivisions", "guard", "lens.microfacets"),
        )
    return left / max(scene.lens.pitch_mm - cell, left)


def _neighbours(side: float, subdivisions: int, reach: float) -> IntArray:
    """(D,) numbers, counted from a facet's own first, of sub-regions along an axis with centres within reach, mm."""
    centre = (subdivisions - 1) / 2
    far = reach / side + 1e-9
    return np.arange(math.ceil(centre - far), math.floor(centre + far) + 1)


def _neighbour_regions(lattice: SubRegions, facets: int, subdivisions: int, numbers: IntArray) -> IntArray:
    """(F, D^2) index in the lattice of each facet's neighbours, row by row; count^2 for those outside the source."""
    line = np.arange(facets)[:, None] * subdivisions + numbers - lattice.first
    inside = (line >= 0) & (line < lattice.count)
    index = line[:, None, :, None] * lattice.count + line[None, :, None, :]
    both = inside[:, None, :, None] & inside[None, :, None, :]
    return np.where(both, index, lattice.count**2).reshape(facets**2, -1)


def _unreserved(scene: Scene, lattice: SubRegions) -> BoolArray:
    """(count, count): sub-regions of which no pixel is reserved in any view; lens frame."""
    free = np.ones((lattice.count, lattice.count), bool)
    if scene.reserved is None:
        return free
    lens, pixels = scene.lens, len(scene.reserved)
    edges = (np.arange(lattice.count + 1) + lattice.first) * lattice.side + (lens.source_size_mm - lens.size_mm) / 2
    at = edges * pixels / lens.source_size_mm
    low, high = np.floor(at[:-1] + 1e-6).astype(int), np.ceil(at[1:] - 1e-6).astype(int)
    for turns in {view.quarter_turns for view in scene.views}:
        sums = np.pad(np.rot90(scene.reserved, -turns), ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
        below, above = sums[high], sums[low]
        free &= below[:, high] - below[:, low] - above[:, high] + above[:, low] == 0
    return free


def throw_darts(regions: IntArray, allowed: BoolArray, count: int, rng: np.random.Generator) -> IntArray:
    """Draw one of its sub-regions for each facet at random, no sub-region twice (5.1).

    Facets come in random order and throw darts at what is allowed and left. One that finds nothing left takes a region
    from another facet, which draws again, and so on until a free one is met (augmenting paths of bipartite matching).

    Args:
        regions: (F, D) numbers of the sub-regions around each facet.
        allowed: (F, D) which of them it may draw.
        count: how many sub-regions there are.
        rng: decides on the order of facets and what they draw.

    Returns:
        (F,) which of its D sub-regions each facet has drawn.

    Raises:
        InputError: the facets cannot all get one.
    """
    owner, drawn = np.full(count + 1, -1), np.full(len(regions), -1)
    for facet in rng.permutation(len(regions)):
        left = np.flatnonzero(allowed[facet] & (owner[regions[facet]] < 0))
        if len(left):
            drawn[facet] = rng.choice(left)
            owner[regions[facet, drawn[facet]]] = facet
        else:
            _displace(facet, regions, allowed, owner, drawn, rng)
    return drawn


def _displace(
    facet: int, regions: IntArray, allowed: BoolArray, owner: IntArray, drawn: IntArray, rng: np.random.Generator
) -> None:
    """Give a facet a region by moving others along a shortest path of facets to a free region; in place."""
    came_from: dict[int, tuple[int, int]] = {}
    waiting = deque([facet])
    while waiting:
        other = waiting.popleft()
        for option in rng.permutation(np.flatnonzero(allowed[other])).tolist():
            region = int(regions[other, option])
            if region in came_from:
                continue
            came_from[region] = (other, option)
            if owner[region] >= 0:
                waiting.append(int(owner[region]))
                continue
            while True:
                taker, option = came_from[region]
                given_up = int(regions[taker, drawn[taker]])
                owner[region], drawn[taker] = taker, option
                if taker == facet:
                    return
                region = given_up
    n = math.isqrt(len(regions))
    raise InputError(
        f"facet (row {facet // n}, column {facet % n}) gets no sub-region of its own, as it and its neighbours can "
        "look at too few: use a larger reach, more subdivisions, a smaller mask, a larger max_slope or relief",
        keys=("reach", "subdivisions", "scenario.mask", "lens.max_slope", "lens.relief"),
    )


def _redrawn(
    reach: Reach, drawn: IntArray, scene: Scene, count: int, sweeps: int, rng: np.random.Generator
) -> IntArray:
    """A draw (F,) as injective as the one given, of which walls take hardly any light.

    Every facet considers a few random neighbours and turns to those that are free, by heat bath.
    """
    from magiclens.matching.dart_throwing_kernels import Labels, draw_again
    from magiclens.optics.walls import EnergyTerms

    n = scene.lens.facets
    luck = np.where(reach.usable.any(axis=-1), rng.random(reach.regions.shape), 2.0)
    luck[np.arange(n * n), drawn] = -1.0
    hand = np.argsort(luck, axis=1, kind="stable")[:, :_HAND]
    offsets, maps, usable = reach.labels(hand)
    usable = usable.reshape(n, n, -1)
    edges = edge_models(scene, offsets.reshape(n, n, -1, 2), maps.reshape(n, n, -1, 3))
    regions = np.repeat(np.take_along_axis(reach.regions, hand, 1), 4, axis=1).reshape(n, n, -1)
    chosen = usable.argmax(axis=-1)
    owner = np.full(count + 1, -1)
    owner[reach.regions[np.arange(n * n), drawn]] = np.arange(n * n)
    turns = rng.permuted(np.broadcast_to(np.arange(n * n), (sweeps, n * n)), axis=1)
    draw_again(
        chosen, owner, Labels(regions, usable, edges), turns, rng.random((sweeps, n * n)), _TEMPERATURE,
        EnergyTerms(1.0, scene.lens.pitch_mm, _STEP_WEIGHT, _REST), scene.lens.relief_mm,
    )  # fmt: skip
    return np.take_along_axis(hand, chosen.reshape(-1, 1) // 4, 1)[:, 0]
