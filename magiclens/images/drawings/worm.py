"""An animated caterpillar: a hump runs from its tail to its head and carries it one stride along."""

from __future__ import annotations

import numpy as np

from magiclens.images.drawings.clipart import cut, ink
from magiclens.images.vector import Layer, ellipse, polygon, rectangle, stroke

_GROUND = 74.0
_STRIDE = 18.0
_HUMP = 33.0
_RADIUS = 8.6
_BALLS = 9


def worm(k: int, n: int) -> list[Layer]:
    """Frame k of a loop of n frames; the camera travels with the caterpillar, so the ground slides back."""
    phase = k / n
    body = [layer for s in np.linspace(0, 0.86, _BALLS) for layer in _ball(*_middle(s, phase), _RADIUS)]
    return [*_ground(phase), *body, *_head(*_middle(1.0, phase))]


def _middle(s: float, phase: float) -> tuple[float, float]:
    """Middle (x, y) of the body at s, 0 at the tail to 1 at the head; what the hump has passed is a stride ahead."""
    hump = -0.45 + 1.9 * phase
    ahead = 1 / (1 + np.exp((s - hump) / 0.09))
    lift = _HUMP * np.exp(-(((s - hump) / 0.23) ** 2)) * (1 - 0.7 * (2 * s - 1) ** 4)
    return 17 + 62 * s + _STRIDE * (ahead - phase), _GROUND - _RADIUS - lift


def _ball(x: float, y: float, radius: float) -> tuple[Layer, Layer]:
    """A black ball with a white rim that sets it off from what lies behind."""
    return cut(ellipse(x, y, radius + 1.4)), ink(ellipse(x, y, radius))


def _head(x: float, y: float) -> list[Layer]:
    """The head on its neck, looking to the right."""
    x, y = x + 2, y - 6
    feelers = (
        f"{x - 3},{y - 8} {x - 5},{y - 18} {x - 11},{y - 22}",
        f"{x + 4},{y - 8} {x + 6},{y - 18} {x + 2},{y - 25}",
    )
    knobs = ((x - 11, y - 22), (x + 2, y - 25))
    return [
        cut(*(stroke(feeler, 5.4, 4.8) for feeler in feelers), *(ellipse(*knob, 4.4) for knob in knobs)),
        ink(*(stroke(feeler, 2.6, 2) for feeler in feelers), *(ellipse(*knob, 3) for knob in knobs)),
        *_ball(x, y, 12),
        cut(ellipse(x + 3.5, y - 3, 4), stroke(f"{x + 10.5},{y + 3} {x + 6},{y + 6.5} {x},{y + 5}", 0.6, 2, 0.8)),
        ink(ellipse(x + 4.7, y - 2.6, 2.1)),
    ]


def _ground(phase: float) -> list[Layer]:
    """A bar with one notch per stride."""
    starts = [_STRIDE * (j - phase) for j in range(8)]
    notches = [
        polygon(f"{x},{_GROUND + 1} {x + 3},{_GROUND + 1} {x},{_GROUND + 13} {x - 3},{_GROUND + 13}") for x in starts
    ]
    beyond = (rectangle(-10, _GROUND, 7, _GROUND + 13), rectangle(93, _GROUND, 130, _GROUND + 13))
    return [ink(rectangle(7, _GROUND + 2, 93, _GROUND + 11)), cut(*notches, *beyond)]
