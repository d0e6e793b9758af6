"""A leaf and a petal, drawn once about (0, 0), one unit long and pointing up, to be used many times."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from magiclens.contract.artifacts import FloatArray
from magiclens.images.vector import blob, placed, stroke


@dataclass(frozen=True)
class Blade:
    """A leaf or petal: its outline, and the outlines of its veins."""

    outline: FloatArray
    veins: tuple[FloatArray, ...]

    def placed(self, x: float, y: float, size: float, degrees: float) -> Blade:
        """The blade with its root at (x, y), ``size`` units long, turned clockwise."""
        return Blade(
            placed(self.outline, x, y, size, degrees), tuple(placed(v, x, y, size, degrees) for v in self.veins)
        )


@cache
def petal() -> Blade:
    """A notched petal with four veins."""
    right = "0.13,-0.22 0.23,-0.6 0.15,-0.9 0.05,-0.99"
    left = "-0.05,-0.99 -0.15,-0.9 -0.23,-0.6 -0.13,-0.22"
    veins = (stroke(f"{d * 0.3},-0.2 {d},-0.55 {d * 0.8},-0.88", 0.02, 0.008) for d in (-0.12, -0.05, 0.05, 0.12))
    return Blade(blob(f"0,0! {right} 0,-0.95! {left}"), tuple(veins))


@cache
def leaf() -> Blade:
    """A pointed leaf with a stalk, a midrib and four pairs of veins."""
    pairs = ((-0.12, 0.2), (-0.27, 0.22), (-0.42, 0.19), (-0.57, 0.13))
    side = [
        stroke(f"0,{y} {d * 0.1},{y - 0.1} {d * reach},{y - 0.2}", 0.014, 0.006) for y, reach in pairs for d in (-1, 1)
    ]
    midrib = stroke("0,0.12 0.01,-0.4 0,-0.95", 0.035, 0.02, 0.008)
    outline = blob("0,0! 0.2,-0.18 0.27,-0.45 0.15,-0.78 0,-1! -0.15,-0.78 -0.27,-0.45 -0.2,-0.18")
    return Blade(outline, (midrib, *side))
