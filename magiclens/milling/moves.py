"""Straight moves of a cutter's tip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray, IntArray

RAPID_MM_PER_MIN = 3000.0
"""Speed of rapid moves, for estimates of the time."""


@dataclass(frozen=True)
class Moves:
    """Straight moves, one after the other.

    points: (M, 3) float64, where each move ends, mm; z = 0 is the plate's top.
    feed: (M,) float64, mm per minute, 0 for rapid moves. tool: (M,) int64, number of the cutter.
    """

    points: FloatArray
    feed: FloatArray
    tool: IntArray

    @property
    def rapid(self) -> BoolArray:
        """(M,) bool."""
        rapid: BoolArray = self.feed == 0
        return rapid

    def lines(self, tool: int | None = None) -> FloatArray:
        """(K, 6): where each move at feed speed begins and ends, of one cutter or of all."""
        cutting = ~self.rapid[1:] & ((self.tool[1:] == tool) | (tool is None))
        lines: FloatArray = np.hstack([self.points[:-1], self.points[1:]])[cutting]
        return lines

    def length_mm(self) -> float:
        """Way at feed speed."""
        return float(self._lengths()[~self.rapid].sum())

    def minutes(self) -> float:
        """Time it takes if the machine gets up to speed at once."""
        speed = np.where(self.rapid, RAPID_MM_PER_MIN, self.feed)
        return float((self._lengths() / speed).sum())

    def shifted(self, way: tuple[float, float, float]) -> Moves:
        """The same moves elsewhere."""
        return Moves(self.points + np.array(way), self.feed, self.tool)

    def without_pauses(self) -> Moves:
        """The same without moves that lead nowhere."""
        kept = np.r_[True, (np.diff(self.points, axis=0) != 0).any(axis=1)][: len(self.points)]
        return Moves(self.points[kept], self.feed[kept], self.tool[kept])

    def _lengths(self) -> FloatArray:
        lengths: FloatArray = np.r_[0.0, np.linalg.norm(np.diff(self.points, axis=0), axis=1)]
        return lengths


class Path:
    """Collects moves that begin and end at the safe height above the origin (x0, y0); it is left at feed speed only."""

    def __init__(self, origin: tuple[float, float], safe_height: float, feed: float):
        self._origin, self._safe, self._feed = origin, safe_height, feed
        self._parts: list[tuple[FloatArray, float, int]] = []
        self._tool = 0
        self._up = True

    def take(self, tool: int) -> None:
        """Go on with another cutter."""
        self.away()
        self._tool = tool
        if not self._parts:
            self._add([(*self._origin, self._safe)], 0.0)

    @property
    def up(self) -> bool:
        """Whether the cutter is at the safe height."""
        return self._up

    @property
    def here(self) -> FloatArray:
        """(3,) where the cutter is."""
        at: FloatArray = self._parts[-1][0][-1]
        return at

    def over(self, x: float, y: float) -> None:
        """To a place at the safe height."""
        self.away()
        self._add([(x, y, self._safe)], 0.0)

    def away(self) -> None:
        """Straight up to the safe height; rapid moves begin and end there."""
        if not self._up:
            self._add([(*self.here[:2], self._safe)], self._feed)
            self._up = True

    def to(self, points: FloatArray | list[tuple[float, float, float]], feed: float) -> None:
        """Along points (K, 3) at a feed speed."""
        self._add(points, feed)
        self._up = False

    def moves(self) -> Moves:
        """Everything, after going back to where it began."""
        self.over(*self._origin)
        points = np.concatenate([part for part, _, _ in self._parts])
        counts = [len(part) for part, _, _ in self._parts]
        feed = np.repeat([feed for _, feed, _ in self._parts], counts)
        tool = np.repeat([tool for _, _, tool in self._parts], counts)
        return Moves(points, feed.astype(float), tool).without_pauses()

    def _add(self, points: FloatArray | list[tuple[float, float, float]], feed: float) -> None:
        if len(points):
            self._parts.append((np.array(points, float), feed, self._tool))
