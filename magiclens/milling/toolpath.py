"""Straight moves of a cutter's tip, and how they are collected to a toolpath."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray, IntArray

_RAPID_MM_PER_MIN = 3000.0
"""Speed of rapid moves, an assumption for estimates of the time."""


@dataclass(frozen=True)
class Moves:
    """Straight moves of the tip, one after the other.

    Attributes:
        points: (M, 3) float64, where each move ends, mm; +x right, +y up as the viewer sees the lens, z = 0 is the
            plate's top.
        feed: (M,) float64, mm per minute, 0 for rapid moves.
        tool: (M,) int64, number of the cutter.
    """

    points: FloatArray
    feed: FloatArray
    tool: IntArray

    @property
    def rapid(self) -> BoolArray:
        """(M,) bool, which moves are rapid: as fast as the machine can, so they must not touch material."""
        rapid: BoolArray = self.feed == 0
        return rapid

    def cutting(self, tool: int | None = None) -> FloatArray:
        """(K, 2, 3) mm, from and to where the tip moves at feed speed, with one cutter or with all."""
        kept = ~self.rapid[1:] & ((self.tool[1:] == tool) | (tool is None))
        moves: FloatArray = np.stack([self.points[:-1], self.points[1:]], axis=1)[kept]
        return moves

    def cutting_length_mm(self) -> float:
        """Length of all moves at feed speed."""
        return float(self._lengths()[~self.rapid].sum())

    def minutes(self) -> float:
        """Time that the moves take if the machine gets up to speed at once."""
        speed = np.where(self.rapid, _RAPID_MM_PER_MIN, self.feed)
        return float((self._lengths() / speed).sum())

    def shifted(self, way_mm: tuple[float, float, float]) -> Moves:
        """The same moves, shifted by (x, y, z), mm."""
        return Moves(self.points + np.array(way_mm), self.feed, self.tool)

    def without_pauses(self) -> Moves:
        """The same moves without those that end where they begin."""
        # the first is always kept, if there is one
        kept = np.r_[True, (np.diff(self.points, axis=0) != 0).any(axis=1)][: len(self.points)]
        return Moves(self.points[kept], self.feed[kept], self.tool[kept])

    def _lengths(self) -> FloatArray:
        lengths: FloatArray = np.r_[0.0, np.linalg.norm(np.diff(self.points, axis=0), axis=1)]
        return lengths


class Toolpath:
    """Collects moves that begin and end at the safe height above an origin.

    The safe height is left at feed speed only: a rapid move into the plate would break the cutter.
    """

    def __init__(self, origin_mm: tuple[float, float], safe_height_mm: float, feed: float):
        """Start above (x, y) ``origin_mm``; ``feed`` is the speed at which the cutter is lifted, mm per minute."""
        self._origin, self._safe, self._feed = origin_mm, safe_height_mm, feed
        self._parts: list[tuple[FloatArray, float, int]] = []
        self._tool = 0
        self._up = True

    def take(self, tool: int) -> None:
        """Go on with the cutter of this number."""
        self.lift()
        self._tool = tool
        if not self._parts:
            self._add([(*self._origin, self._safe)], 0.0)

    @property
    def up(self) -> bool:
        """Whether the cutter is at the safe height."""
        return self._up

    @property
    def here(self) -> FloatArray:
        """(3,) where the cutter's tip is, mm."""
        at: FloatArray = self._parts[-1][0][-1]
        return at

    def travel(self, x: float, y: float) -> None:
        """Go to the safe height above (x, y), mm."""
        self.lift()
        self._add([(x, y, self._safe)], 0.0)

    def lift(self) -> None:
        """Go straight up to the safe height; rapid moves begin and end there."""
        if not self._up:
            self._add([(*self.here[:2], self._safe)], self._feed)
            self._up = True

    def cut(self, points: FloatArray | list[tuple[float, float, float]], feed: float) -> None:
        """Go along points (K, 3), mm, at a feed speed, mm per minute."""
        self._add(points, feed)
        self._up = False

    def moves(self) -> Moves:
        """All moves, after going back to the origin."""
        self.travel(*self._origin)
        points = np.concatenate([part for part, _, _ in self._parts])
        counts = [len(part) for part, _, _ in self._parts]
        feed = np.repeat([feed for _, feed, _ in self._parts], counts)
        tool = np.repeat([tool for _, _, tool in self._parts], counts)
        return Moves(points, feed.astype(float), tool).without_pauses()

    def _add(self, points: FloatArray | list[tuple[float, float, float]], feed: float) -> None:
        if len(points):
            self._parts.append((np.array(points, float), feed, self._tool))
