"""The stable viewing zone: how well a lens keeps its picture while the eye moves (section 7, figure 14)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from magiclens.analysis.base import Analysis, Findings
from magiclens.analysis.contact_sheet import MARK
from magiclens.contract.artifacts import FloatArray, Scene, Solid, View
from magiclens.contract.result import RunResult
from magiclens.drawing.chart import Chart, ChartAxis, Curve
from magiclens.drawing.figure import Figure
from magiclens.drawing.photographs import photograph
from magiclens.drawing.scales import round_ticks
from magiclens.drawing.tiles import Tile, to_pixels
from magiclens.plan.compile import Plan
from magiclens.scenarios.base import Shot

RESOLUTION, SAMPLES = 512, 4
"""Pixels per side of the measured pictures, and samples per side of a pixel; with fewer, noise lowers the PSNR."""
_DIRECTIONS = 8
"""Number of directions in which the eye moves: toward the eyes of a cross, and between them."""
_DIAGONAL = np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0])
_SIDE = 320
_COLOURS = {"zone": f"#{bytes(MARK).hex()}", "plain": "#2b6cc4"}


@dataclass(frozen=True)
class Zone:
    """How well two lenses keep their picture while the eye moves away from the middle eye (section 7).

    The lens ``zone`` is designed for all eyes, the lens ``plain`` in the same way for the middle eye alone.

    Attributes:
        distance_mm: From the eye to the reference plane.
        eyes_mm: Distances of the other eyes from the middle eye, ascending, each once; the first is the rim of the
            inner cone.
        moves_mm: (M,) how far the eye is moved, from 0 on.
        psnr_db: By lens, (M, D), in D directions evenly around the middle eye.
        shown_mm: How far the eye was moved toward the upper right for each of ``pictures``.
        pictures: By lens, (R, R, C) float32, linear light.
    """

    distance_mm: float
    eyes_mm: Sequence[float]
    moves_mm: FloatArray
    psnr_db: Mapping[str, FloatArray]
    shown_mm: Sequence[float]
    pictures: Mapping[str, Sequence[FloatArray]]

    @property
    def metrics(self) -> dict[str, float]:
        """PSNR in the middle, and the worst within the inner cone."""
        inside = self.moves_mm <= self.eyes_mm[0] * (1 + 1e-9)
        return {
            f"{lens}_{which}_psnr_db": float(value)
            for lens, psnr in self.psnr_db.items()
            for which, value in (("centre", psnr[0, 0]), ("worst", psnr[inside].min()))
        }

    def degrees(self, move_mm: float) -> float:
        """The angle at the lens's centre by which the eye is moved."""
        return math.degrees(math.atan(move_mm / self.distance_mm))

    def move_mm(self, degrees: float) -> float:
        """How far the eye is moved by an angle at the lens's centre."""
        return self.distance_mm * math.tan(math.radians(degrees))


def rings(scene: Scene) -> list[float]:
    """Distances, mm, of the other eyes from the first, ascending, each once; none if there is no zone to measure.

    There is a zone if all views show the same target, and ``ring_distances_mm`` finds their eyes around the first.
    """
    first, *others = scene.views
    return ring_distances_mm(scene.views) if all(np.array_equal(first.target, v.target) for v in others) else []


def ring_distances_mm(views: Sequence[View] | Sequence[Shot]) -> list[float]:
    """The same by the eyes alone: whether all see one source at one rotation, and lie around the first, as high as it.

    Args:
        views: Views, or shots, which have no pictures yet.

    Returns:
        Distances of the other eyes from the first, mm, ascending; none if they do not lie around it.
    """
    first, *others = views
    steps = np.array([view.eye_mm - first.eye_mm for view in others]).reshape(-1, 3)
    away = np.unique(np.hypot(steps[:, 0], steps[:, 1]).round(6))
    away = away[away > 0]
    around = len(away) > 0 and np.abs(steps[:, 2]).max() < 1e-6 and np.abs(steps.sum(axis=0)).max() < 0.01 * away[-1]
    sources = {(view.source_name, view.quarter_turns) for view in views}
    return away.tolist() if around and len(sources) == 1 else []


def moves(rings_mm: list[float]) -> FloatArray:
    """(M,) mm: how far to move the eye, in small steps within the inner ring, and on beyond the outer ring."""
    inner, outer = rings_mm[0], rings_mm[-1]
    between = np.linspace(inner, outer, 3)
    return np.unique(np.concatenate([[0, inner / 2], between, [1.5 * outer]]).round(6))


def measure(scene: Scene, solid: Solid, plain_scene: Scene, plain: Solid) -> Zone:
    """Pictures and PSNR of a lens, and of a plain lens that is designed for the first eye alone.

    Args:
        scene: The views of the lens, which ``rings`` accepts.
        solid: The lens, with its grid.
        plain_scene: The first view, with a source of its own if sources are painted.
        plain: The plain lens, with its grid.
    """
    rings_mm = rings(scene)
    steps = moves(rings_mm)
    shown = [0.0, rings_mm[0], rings_mm[-1], 1.5 * rings_mm[-1]]
    lenses = {"zone": (scene, solid), "plain": (plain_scene, plain)}
    return Zone(
        float(scene.views[0].eye_mm[2] - scene.lens.thickness_mm),
        rings_mm,
        steps,
        {name: np.array([_around(*lens, step) for step in steps]) for name, lens in lenses.items()},
        shown,
        {name: [seen_from(*lens, step * _DIAGONAL) for step in shown] for name, lens in lenses.items()},
    )


def seen_from(scene: Scene, solid: Solid, move_mm: FloatArray) -> FloatArray:
    """(R, R, C) float32, linear light, world frame: what the first view's eye sees once it has moved by (3,) mm."""
    from magiclens.rendering.tracer import picture, trace

    view = replace(scene.views[0], eye_mm=scene.views[0].eye_mm + move_mm)
    hits = trace(solid, scene.lens, view, RESOLUTION, SAMPLES)
    seen = picture(hits, view.in_lens_frame().source, scene.lens.source_size_mm)
    return np.ascontiguousarray(np.rot90(seen, view.quarter_turns))


def _around(scene: Scene, solid: Solid, step_mm: float) -> list[float]:
    """PSNR, dB, in every direction; a move of 0 is measured once."""
    from magiclens.images import resize, score

    angles = 2 * np.pi * np.arange(_DIRECTIONS if step_mm else 1) / _DIRECTIONS
    ways = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=-1)
    target = resize(scene.views[0].target, (RESOLUTION, RESOLUTION))
    found = [score(seen_from(scene, solid, step_mm * way), target).psnr_db for way in ways]
    return found if step_mm else found * _DIRECTIONS


def zone_figures(result: RunResult, zone: Zone) -> list[Figure]:
    """Photographs from displaced eyes, and how the worst picture gets worse with the displacement (figure 14)."""
    return [_pictures(result, zone), _curve(result, zone)]


def _pictures(result: RunResult, zone: Zone) -> Figure:
    view, names = result.scene.views[0], _names(result)
    places = [f"eye moved {move:.1f} mm, {zone.degrees(move):.2g}°" for move in zone.shown_mm]
    rows = []
    for lens, pictures in zone.pictures.items():
        photos = [photograph(picture, view) for picture in pictures]
        titles = [names[lens], *places[1:]] if lens == "zone" else [names[lens], *([""] * len(photos[1:]))]
        pairs = zip(photos, titles, strict=True)
        rows.append([Tile(to_pixels(photo.picture, _SIDE), title, photo.caption) for photo, title in pairs])
    return Figure(
        "stable-zone",
        "While the eye moves",
        rows,
        f"Above the lens for {len(result.scene.views)} eyes, below one designed in the same way for the middle eye. "
        "Left, what the middle eye sees; then, what it sees farther and farther toward the upper right.",
    )


def _names(result: RunResult) -> dict[str, str]:
    return {"zone": f"Lens for {len(result.scene.views)} eyes", "plain": "Lens for the middle eye"}


def _curve(result: RunResult, zone: Zone) -> Figure:
    worst = {lens: psnr.min(axis=1) for lens, psnr in zone.psnr_db.items()}
    low, high = min(w.min() for w in worst.values()), max(w.max() for w in worst.values())
    reach, names = float(zone.moves_mm[-1]), _names(result)
    widest = zone.degrees(reach)
    degrees = {zone.move_mm(place * widest) / reach: text for place, text in round_ticks(0.0, widest).items()}
    chart = Chart(
        zone.moves_mm,
        [Curve(names[lens], curve, _COLOURS[lens]) for lens, curve in worst.items()],
        ChartAxis("how far the eye moves, mm", 0.0, reach),
        ChartAxis("PSNR, dB", float(np.floor(low - 0.5)), float(np.ceil(high + 0.5))),
        (0.0, zone.eyes_mm[0], "inner cone"),
        zone.eyes_mm,
        ("degrees", degrees),
    )
    found = zone.metrics
    caption = (
        f"worst within the inner cone: {found['zone_worst_psnr_db']:.1f} dB for {len(result.scene.views)} eyes, "
        f"{found['plain_worst_psnr_db']:.1f} dB for the middle eye"
    )
    return Figure(
        "stable-zone-curve",
        "How large the viewing zone is",
        [[Tile(chart.draw(), "", caption, drawn=True)]],
        "How good the picture is from the worst of eight directions into which the eye may move. "
        "Dotted lines are as far from the middle as the eyes for which the lens was made.",
    )


def _applies(plan: Plan) -> bool:
    return bool(ring_distances_mm(plan.shots()))


def _compute(plan: Plan, result: RunResult) -> Findings | None:
    if not rings(result.given) or result.redesign is None:
        return None
    first = replace(result.given, views=result.given.views[:1])
    zone = measure(result.scene, result.unfinished, *result.redesign(first))
    return Findings(zone.metrics, zone)


def _figures(result: RunResult, findings: Findings) -> list[Figure]:
    return zone_figures(result, findings.details)


STABLE_ZONE = Analysis("stable-zone", _applies, _compute, _figures)
"""The picture while the eye moves, beside that of a lens designed for the middle eye alone."""
