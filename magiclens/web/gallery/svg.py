"""Line drawings as SVG that takes its colours from the page around it, so that they suit dark and light."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from markupsafe import escape

Point = tuple[float, float]


class Svg:
    """A drawing in millimetres, y upward. left, bottom, right, top: what it covers. scale: pixels per millimetre."""

    def __init__(self, left: float, bottom: float, right: float, top: float, scale: float):
        self._left, self._top, self._scale = left, top, scale
        self._width, self._height = scale * (right - left), scale * (top - bottom)
        self._parts: list[str] = []

    def line(self, points: Iterable[Point], style: str) -> None:
        """A line through points; ``style`` is a class of the page's style sheet."""
        self._parts.append(f'<polyline class="{style}" points="{self._points(points)}"/>')

    def area(self, points: Iterable[Point], style: str) -> None:
        """A closed, filled outline."""
        self._parts.append(f'<polygon class="{style}" points="{self._points(points)}"/>')

    def dot(self, at: Point, radius_px: float, style: str) -> None:
        """A filled circle."""
        x, y = self._at(at)
        self._parts.append(f'<circle class="{style}" cx="{x:.1f}" cy="{y:.1f}" r="{radius_px:g}"/>')

    def arrow(self, start: Point, end: Point, style: str, head: float) -> None:
        """A line with a head of so many millimetres at its end."""
        dx, dy = end[0] - start[0], end[1] - start[1]
        length = (dx * dx + dy * dy) ** 0.5 or 1.0
        ux, uy = head * dx / length, head * dy / length
        self.line([start, end], style)
        wings = [(end[0] - ux + s * uy / 2, end[1] - uy - s * ux / 2) for s in (1, -1)]
        self.line([wings[0], end, wings[1]], style)

    def text(self, at: Point, words: str, anchor: str = "start", style: str = "label") -> None:
        """One line of text at a point: its start, middle or end."""
        x, y = self._at(at)
        place = f'x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"'
        self._parts.append(f'<text class="{style}" {place}>{escape(words)}</text>')

    def render(self, alt: str) -> str:
        """The drawing as an element of a page; ``alt`` says what is in it to those who do not see it."""
        box = f'viewBox="0 0 {self._width:.0f} {self._height:.0f}" width="{self._width:.0f}"'
        inner = "".join(self._parts)
        return f'<svg class="drawing" {box} role="img" aria-label="{escape(alt)}">{inner}</svg>'

    def _at(self, point: Sequence[float]) -> Point:
        return self._scale * (point[0] - self._left), self._scale * (self._top - point[1])

    def _points(self, points: Iterable[Point]) -> str:
        return " ".join(f"{x:.1f},{y:.1f}" for x, y in map(self._at, points))
