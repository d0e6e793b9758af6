"""Line drawings as SVG; colours come from the style sheet of the page, so that they suit a dark and a light page."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from markupsafe import escape

Point = tuple[float, float]


class Svg:
    """A drawing in millimetres, y upward."""

    def __init__(self, left: float, bottom: float, right: float, top: float, scale: float):
        """Start an empty drawing of a rectangle in millimetres, at ``scale`` pixels per millimetre."""
        self._left, self._top, self._scale = left, top, scale
        self._width, self._height = scale * (right - left), scale * (top - bottom)
        self._parts: list[str] = []

    def line(self, points: Iterable[Point], style: str) -> None:
        """Draw a line through points; ``style`` is a class of the style sheet, as in all methods."""
        self._parts.append(f'<polyline class="{style}" points="{self._points(points)}"/>')

    def area(self, points: Iterable[Point], style: str) -> None:
        """Draw a closed, filled outline."""
        self._parts.append(f'<polygon class="{style}" points="{self._points(points)}"/>')

    def dot(self, at: Point, radius_px: float, style: str) -> None:
        """Draw a filled circle."""
        x, y = self._at(at)
        self._parts.append(f'<circle class="{style}" cx="{x:.1f}" cy="{y:.1f}" r="{radius_px:g}"/>')

    def arrow(self, start: Point, end: Point, style: str, head: float) -> None:
        """Draw a line with an arrow head at its end; ``head`` is the length of the head, mm."""
        dx, dy = end[0] - start[0], end[1] - start[1]
        length = (dx * dx + dy * dy) ** 0.5 or 1.0
        ux, uy = head * dx / length, head * dy / length
        self.line([start, end], style)
        wings = [(end[0] - ux + s * uy / 2, end[1] - uy - s * ux / 2) for s in (1, -1)]
        self.line([wings[0], end, wings[1]], style)

    def text(self, at: Point, words: str, anchor: str = "start", style: str = "label") -> None:
        """Write one line of text; ``anchor`` says whether its start, middle or end is at the point."""
        x, y = self._at(at)
        attributes = f'x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"'
        self._parts.append(f'<text class="{style}" {attributes}>{escape(words)}</text>')

    def render(self, alt: str) -> str:
        """The drawing as an SVG element; ``alt`` is its alternative text."""
        box = f'viewBox="0 0 {self._width:.0f} {self._height:.0f}" width="{self._width:.0f}"'
        inner = "".join(self._parts)
        return f'<svg class="drawing" {box} role="img" aria-label="{escape(alt)}">{inner}</svg>'

    def _at(self, point: Sequence[float]) -> Point:
        return self._scale * (point[0] - self._left), self._scale * (self._top - point[1])

    def _points(self, points: Iterable[Point]) -> str:
        return " ".join(f"{x:.1f},{y:.1f}" for x, y in map(self._at, points))
