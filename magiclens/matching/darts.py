"""The numerics of the ``dart-throwing`` matcher: what facets can reach, and an injective draw of it."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import BoolArray, Candidates, FloatArray, IntArray, Lens, Scene
from magiclens.contract.errors import InputError
from magiclens.geometry.facets import edge_models
from magiclens.matching.driver import flat_scale
from magiclens.matching.realisable import realisable
from magiclens.matching.shuffling import REST, shuffle
from magiclens.matching.strength import injective_maps_bits
from magiclens.optics.medium import image_optics_of
from magiclens.optics.walls import EnergyTerms

if TYPE_CHECKING:
    from magiclens.matching.dart_throwing import DartThrowing

SIGNS = np.array([(1, 1), (-1, 1), (1, -1), (-1, -1)], np.float64)
"""The four ways in which a facet can show its sub-region: as it is, or mirrored."""

HAND = 16
"""Neighbouring sub-regions that a facet considers when it draws again."""
TEMPERATURE = 1e-4
"""Of redrawing, as a share of a facet's light: what is lost beyond that counts, all else is left to chance."""
STEP_WEIGHT = 3e-6
"""Cost of a squared step per facet edge, per mm^2, as a share of a facet's light."""


@dataclass(frozen=True)
class Lattice:
    """Square sub-regions of ``side`` mm, aligned with the facets; image frame (y down).

    Along either axis, number k lies k sides after the lens's edge; ``count`` of them, from ``first`` on, lie inside the
    source.
    """

    side: float
    first: int
    count: int

    @classmethod
    def of(cls, lens: Lens, subdivisions: int) -> Lattice:
        """The lattice that cuts the patch below each facet into subdivisions^2."""
        side = lens.pitch_mm / subdivisions
        first = -math.floor((lens.source_size_mm - lens.size_mm) / 2 / side + 1e-9)
        return cls(side, first, lens.facets * subdivisions - 2 * first)


@dataclass(frozen=True)
class Reach:
    """What facets can look at. F facets, D^2 neighbouring sub-regions each, row by row; image frame (y down).

    offsets: (D^2, 2) mm, of sub-regions from the facet. maps: (4, 2) xx and yy. usable: (F, D^2, 4): whether a facet
    can show a neighbour with a map. places: (F, D^2): which sub-region of the lattice a neighbour is.
    """

    offsets: FloatArray
    maps: FloatArray
    usable: BoolArray
    places: IntArray

    @classmethod
    def of(cls, options: DartThrowing, scene: Scene, lattice: Lattice) -> Reach:
        """Within the option's reach, below slope limit and relief, inside the source and not reserved."""
        lens, q = scene.lens, options.subdivisions
        maps = SIGNS * shrunk_scale(lattice.side, options.guard.mm(lattice.side), scene)
        numbers = neighbours(lattice.side, q, options.reach.mm(lens.source_size_mm))
        along = (numbers + 0.5 - q / 2) * lattice.side
        offsets = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
        places = regions(lattice, lens.facets, q, numbers)
        usable = realisable(
            lens.facet_centres_mm().reshape(-1, 2) * (1, -1), offsets, maps, lens.pitch_mm,
            image_optics_of(scene), lens.relief_mm,
        )  # fmt: skip
        free = np.append(unreserved(scene, lattice).ravel(), False)
        return cls(offsets, maps, usable & free[places][..., None], places)

    def labels(self, options: IntArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Offsets (F, 4 H, 2), maps (F, 4 H, 3), +y up, and usability (F, 4 H) of ``options`` (F, H) with each map."""
        facets, count = options.shape
        maps = np.stack([self.maps[:, 0], np.zeros(4), self.maps[:, 1]], axis=-1)
        usable = np.take_along_axis(self.usable, options[..., None], axis=1).reshape(facets, -1)
        return (
            np.repeat(self.offsets[options] * (1, -1), 4, axis=1),
            np.broadcast_to(maps, (facets, count, 4, 3)).reshape(facets, -1, 3),
            usable,
        )


def match(options: DartThrowing, scene: Scene, rng: np.random.Generator) -> Candidates:
    """See ``DartThrowing.match``."""
    eyes = np.array([view.eye_in_lens_frame_mm for view in scene.views])
    if not np.allclose(eyes, eyes[0]):
        raise InputError("a universal lens needs views that share one eye in the lens frame")
    n, lattice = scene.lens.facets, Lattice.of(scene.lens, options.subdivisions)
    reach = Reach.of(options, scene, lattice)
    drawn = draw(reach.places, np.any(reach.usable, axis=-1), lattice.count**2, rng)
    if options.sweeps:
        drawn = redraw(reach, drawn, scene, lattice.count**2, options.sweeps, rng)
    offsets, maps, usable = reach.labels(drawn[:, None])
    order = np.argsort(~usable, axis=1, kind="stable")[..., None]
    return Candidates(
        offsets.reshape(n, n, 4, 2).astype(np.float32),
        np.take_along_axis(maps, order, 1).reshape(n, n, 4, 3).astype(np.float32),
        np.where(np.take_along_axis(usable, order[..., 0], 1), 0, np.inf).reshape(n, n, 4).astype(np.float32),
        {"permutation_bits": injective_maps_bits(reach.places, reach.usable, np.random.default_rng(0))},
    )


def shrunk_scale(side: float, guard: float, scene: Scene) -> float:
    """The scale at which a facet of flat micro-facets sees a sub-region but for its guarded rim, mm.

    A flat micro-facet shows its patch unmagnified, whatever the scale between the micro-facets' centres.
    """
    cell = scene.lens.pitch_mm / scene.lens.microfacets
    left = side - 2 * guard - flat_scale(scene) * cell
    if left <= 0:
        raise InputError(
            f"a micro-facet sees {flat_scale(scene) * cell:.3g} mm of the source, more than the guard leaves of "
            f"sub-regions of {side:.3g} mm: use fewer subdivisions, a smaller guard or more micro-facets"
        )
    return left / max(scene.lens.pitch_mm - cell, left)


def neighbours(side: float, subdivisions: int, reach: float) -> IntArray:
    """(D,) numbers, counted from a facet's own first, of sub-regions along an axis with centres within reach, mm."""
    centre = (subdivisions - 1) / 2
    far = reach / side + 1e-9
    return np.arange(math.ceil(centre - far), math.floor(centre + far) + 1)


def regions(lattice: Lattice, facets: int, subdivisions: int, numbers: IntArray) -> IntArray:
    """(F, D^2) index in the lattice of each facet's neighbours, row by row; count^2 for those outside the source."""
    line = np.arange(facets)[:, None] * subdivisions + numbers - lattice.first
    inside = (line >= 0) & (line < lattice.count)
    index = line[:, None, :, None] * lattice.count + line[None, :, None, :]
    both = inside[:, None, :, None] & inside[None, :, None, :]
    return np.where(both, index, lattice.count**2).reshape(facets**2, -1)


def unreserved(scene: Scene, lattice: Lattice) -> BoolArray:
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


def draw(places: IntArray, allowed: BoolArray, count: int, rng: np.random.Generator) -> IntArray:
    """(F,) which of its places (F, D) each facet draws at random, no place twice; ``count``: how many places there are.

    Facets come in random order and throw darts at what is allowed and left. One that finds nothing left takes a place
    from another facet, which draws again, and so on until a free place is met (augmenting paths of bipartite matching).
    """
    owner, drawn = np.full(count + 1, -1), np.full(len(places), -1)
    for facet in rng.permutation(len(places)):
        left = np.flatnonzero(allowed[facet] & (owner[places[facet]] < 0))
        if len(left):
            drawn[facet] = rng.choice(left)
            owner[places[facet, drawn[facet]]] = facet
        else:
            _displace(facet, places, allowed, owner, drawn, rng)
    return drawn


def _displace(
    facet: int, places: IntArray, allowed: BoolArray, owner: IntArray, drawn: IntArray, rng: np.random.Generator
) -> None:
    """Give a facet a place by moving others along a shortest path of facets to a free place; in place."""
    came_from: dict[int, tuple[int, int]] = {}
    waiting = deque([facet])
    while waiting:
        other = waiting.popleft()
        for option in rng.permutation(np.flatnonzero(allowed[other])).tolist():
            place = int(places[other, option])
            if place in came_from:
                continue
            came_from[place] = (other, option)
            if owner[place] >= 0:
                waiting.append(int(owner[place]))
                continue
            while True:
                taker, option = came_from[place]
                given_up = int(places[taker, drawn[taker]])
                owner[place], drawn[taker] = taker, option
                if taker == facet:
                    return
                place = given_up
    n = math.isqrt(len(places))
    raise InputError(
        f"facet (row {facet // n}, column {facet % n}) gets no sub-region of its own, as it and its neighbours can "
        "look at too few: use a larger reach, more subdivisions, a smaller mask, a larger max_slope or relief"
    )


def redraw(reach: Reach, drawn: IntArray, scene: Scene, count: int, sweeps: int, rng: np.random.Generator) -> IntArray:
    """A draw (F,) as injective as the one given, of which walls take hardly any light.

    Every facet has a hand of random neighbours and turns to those that are free, by heat bath.
    """
    n = scene.lens.facets
    luck = np.where(reach.usable.any(axis=-1), rng.random(reach.places.shape), 2.0)
    luck[np.arange(n * n), drawn] = -1.0
    hand = np.argsort(luck, axis=1, kind="stable")[:, :HAND]
    offsets, maps, usable = reach.labels(hand)
    usable = usable.reshape(n, n, -1)
    edges = edge_models(scene, offsets.reshape(n, n, -1, 2), maps.reshape(n, n, -1, 3))
    places = np.repeat(np.take_along_axis(reach.places, hand, 1), 4, axis=1).reshape(n, n, -1)
    chosen = usable.argmax(axis=-1)
    owner = np.full(count + 1, -1)
    owner[reach.places[np.arange(n * n), drawn]] = np.arange(n * n)
    shuffle(
        chosen, owner, places, usable, edges,
        rng.permuted(np.broadcast_to(np.arange(n * n), (sweeps, n * n)), axis=1), rng.random((sweeps, n * n)),
        TEMPERATURE, EnergyTerms(1.0, scene.lens.pitch_mm, STEP_WEIGHT, REST), scene.lens.relief_mm,
    )  # fmt: skip
    return np.take_along_axis(hand, chosen.reshape(-1, 1) // 4, 1)[:, 0]
