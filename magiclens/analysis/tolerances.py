"""How exactly sheet, lens and eye must lie, and material and gap be as designed, so that the picture stays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from magiclens.analysis.base import Analysis, Findings
from magiclens.contract.artifacts import FloatArray, Scene, Solid, View
from magiclens.contract.result import RunResult
from magiclens.drawing.chart import Chart, ChartAxis, Curve
from magiclens.drawing.figure import Figure
from magiclens.drawing.scales import GLOW, ColourScale
from magiclens.drawing.tiles import Tile
from magiclens.plan.compile import Plan
from magiclens.rendering.poses import Pose, PosedLens

FALL_DB = 3.0
"""By how much a picture's PSNR may fall within the tolerance."""
RESOLUTION, SAMPLES = 128, 3
"""Pixels per side of the measured pictures, and samples per side of a pixel: a tenth of the rays of a render."""
MAP_RESOLUTION, _MAP_STEPS, _MAP_SIDE = 64, 13, 468
"""Pixels per side of the pictures of the map, places along its side, and its own side in pixels."""
_MOST_VIEWS = 4
"""Number of views that are measured; an animation has many more, which look from one place."""
_STEPS = (0.5, 1.0, 1.5)
"""Where curves are measured, as multiples of the amount that costs the first view about ``FALL_DB``."""
_TRIES = 4
"""Number of tries to find this amount."""
_COLOURS = ("#2b6cc4", "#e8590c", "#16803c", "#8a3ffc")


@dataclass(frozen=True)
class _Axis:
    """Something that may be other than designed.

    Attributes:
        fields: Fields of ``Pose`` that are measured up to the same amount.
        unit: As axes of charts say it.
        guess: Amount with which the search begins.
        most: Greatest amount that is looked at.
    """

    fields: Sequence[str]
    unit: str
    guess: float
    most: float


_AXES = (
    _Axis(("shift_x_mm", "shift_y_mm"), "mm", 0.2, 10.0),
    _Axis(("rotation_deg",), "degrees", 0.2, 20.0),
    _Axis(("scale_percent",), "%", 0.3, 20.0),
    _Axis(("tilt_x_deg", "tilt_y_deg"), "degrees", 0.3, 10.0),
    _Axis(("gap_mm",), "mm", 0.3, 10.0),
    _Axis(("eye_x_mm", "eye_y_mm"), "mm", 3.0, 200.0),
    _Axis(("eye_z_mm",), "mm", 20.0, 0.6),  # times the eye's distance
    _Axis(("ior",), "", 0.01, 0.3),
)
_TITLES = {
    "shift_x_mm": "Sheet to the right",
    "shift_y_mm": "Sheet upward",
    "rotation_deg": "Sheet turned counter-clockwise",
    "scale_percent": "Sheet printed too large",
    "tilt_x_deg": "Lens tilted, upper edge lifted",
    "tilt_y_deg": "Lens tilted, left edge lifted",
    "gap_mm": "Air between sheet and lens, beyond the design",
    "eye_x_mm": "Eye to the right",
    "eye_y_mm": "Eye upward",
    "eye_z_mm": "Eye farther away",
    "ior": "Index of refraction too high",
}
"""What positive amounts mean, by field of ``Pose``."""


@dataclass(frozen=True)
class Response:
    """What one deviation does to the pictures.

    Attributes:
        field: The field of ``Pose``.
        unit: As axes of charts say it.
        amounts: (M,) ascending, 0 among them.
        psnr_db: (V, M) of each view.
        ssim: (V, M) of each view.
    """

    field: str
    unit: str
    amounts: FloatArray
    psnr_db: FloatArray
    ssim: FloatArray

    def limit(self, sign: int) -> float:
        """How far this may go, up or down, until the first picture has lost ``FALL_DB``; the last amount if none has.

        Between amounts, the squared error is taken to grow with the square of the deviation.
        """
        way = np.flatnonzero(sign * self.amounts >= 0)[::sign]
        squares = self.amounts[way] ** 2
        return float(math.sqrt(min(_crossing(squares, psnr[way]) for psnr in self.psnr_db)))

    @property
    def tolerance(self) -> float:
        """The smaller of the limits in both directions, or the only one."""
        return min(self.limit(sign) for sign in (1, -1) if (sign * self.amounts > 0).any())


@dataclass(frozen=True)
class Tolerances:
    """All deviations of a lens, and the map of shifts.

    Attributes:
        responses: By field of ``Pose``.
        shifts_mm: (K,) ascending, moves of the sheet along either axis of the map.
        map_db: (K, K) mean PSNR of the views, rows from +y down.
    """

    responses: dict[str, Response]
    shifts_mm: FloatArray
    map_db: FloatArray

    @property
    def metrics(self) -> dict[str, float]:
        """The tolerances; the eye's distance has one in each direction."""
        single = {f"tolerance_{name}": r.tolerance for name, r in self.responses.items() if name != "eye_z_mm"}
        away = self.responses["eye_z_mm"]
        return {**single, "tolerance_eye_nearer_mm": away.limit(-1), "tolerance_eye_farther_mm": away.limit(1)}


def tolerances(scene: Scene, solid: Solid) -> Tolerances:
    """Measure what the first views of a scene lose through a solid with a grid when something is not as designed."""
    from magiclens.kernels.threads import side_by_side

    views = scene.views[:_MOST_VIEWS]
    bench = _Bench(scene, solid, views, RESOLUTION)
    responses = [response for responses in side_by_side(bench.responses, _AXES) for response in responses]
    found = {response.field: response for response in responses}
    reach = 2 * max(found["shift_x_mm"].tolerance, found["shift_y_mm"].tolerance)
    shifts, coarse = np.linspace(-reach, reach, _MAP_STEPS), _Bench(scene, solid, views, MAP_RESOLUTION)
    rows = side_by_side(lambda y: [coarse.mean_psnr_db(Pose(shift_x_mm=x, shift_y_mm=y)) for x in shifts], -shifts)
    return Tolerances(found, shifts, np.array(rows))


class _Bench:
    """Scores a lens in any pose."""

    def __init__(self, scene: Scene, solid: Solid, views: Sequence[View], resolution: int):
        from magiclens.images.resample import resize

        self._lens, self._posed = scene.lens, PosedLens(solid, scene.lens, resolution, SAMPLES)
        self._views = [replace(view, target=resize(view.target, (resolution, resolution))) for view in views]
        self._distance_mm = float(views[0].eye_mm[2] - scene.lens.thickness_mm)

    @cached_property
    def _designed(self) -> list[tuple[float, float]]:
        """The scores without any deviation."""
        return self.scores(Pose())

    def responses(self, axis: _Axis) -> list[Response]:
        """What the deviations of an axis do."""
        most = axis.most * self._distance_mm if axis.fields == ("eye_z_mm",) else axis.most
        reach = self._reach(axis, most)
        up = [step * reach for step in _STEPS]
        amounts = [*(-x for x in reversed(up)), 0.0, *up]
        if axis.fields == ("gap_mm",):  # the lens cannot sink into the sheet
            amounts = [x for x in amounts if x >= -self._lens.gap_mm]
        # amount by amount, not axis by axis: views that are turned see the same moves in another order
        moves = [(name, x) for x in amounts for name in axis.fields]
        scores = {(name, x): self.scores(Pose(**{name: x})) if x else self._designed for name, x in moves}
        found = {name: np.array([scores[name, x] for x in amounts]) for name in axis.fields}
        return [Response(name, axis.unit, np.array(amounts), *found[name].transpose(2, 1, 0)) for name in axis.fields]

    def scores(self, pose: Pose) -> list[tuple[float, float]]:
        """PSNR, dB, and SSIM of each view."""
        from magiclens.images.score import score

        found = [score(self._posed.picture(view, pose), view.target) for view in self._views]
        return [(each.psnr_db, each.ssim) for each in found]

    def mean_psnr_db(self, pose: Pose) -> float:
        """Mean PSNR of the views, dB."""
        return float(np.mean([self._psnr_db(view, pose) for view in self._views]))

    def _reach(self, axis: _Axis, most: float) -> float:
        """About how much of an axis's first field costs the first view ``FALL_DB``."""
        error = 10 ** (-self._designed[0][0] / 10)
        amount = min(axis.guess, most)
        for _ in range(_TRIES):
            more = self._error(Pose(**{axis.fields[0]: amount})) - error
            wanted = error * (10 ** (FALL_DB / 10) - 1)
            factor = float(np.clip(math.sqrt(wanted / max(more, 1e-12)), 0.1, 10.0))
            amount = min(amount * factor, most / _STEPS[-1])
            if 0.7 < factor < 1.4:
                break
        return amount

    def _error(self, pose: Pose) -> float:
        """Mean squared error of the first view."""
        return float(10 ** (-self._psnr_db(self._views[0], pose) / 10))

    def _psnr_db(self, view: View, pose: Pose) -> float:
        from magiclens.images.score import best_exposure_psnr_db

        return best_exposure_psnr_db(self._posed.picture(view, pose), view.target)


def _crossing(squares: FloatArray, psnr_db: FloatArray) -> float:
    """Where among ascending ``squares`` a curve has fallen by ``FALL_DB`` from its start; the last if it has not."""
    errors = 10 ** ((psnr_db[0] - psnr_db) / 10)
    limit = 10 ** (FALL_DB / 10)
    beyond = np.flatnonzero(errors > limit)
    if not len(beyond):
        return float(squares[-1])
    k = int(beyond[0])
    return float(np.interp(limit, errors[[k - 1, k]], squares[[k - 1, k]]))


def _charts(found: Tolerances, views: Sequence[View], ssim: bool) -> list[list[Tile]]:
    charts = [_chart(response, views, ssim) for response in found.responses.values()]
    return [charts[k : k + 2] for k in range(0, len(charts), 2)]


def _chart(response: Response, views: Sequence[View], ssim: bool) -> Tile:
    curves = response.ssim if ssim else response.psnr_db
    margin, step = (0.02, 0.1) if ssim else (0.5, 1.0)
    low = step * math.floor((curves.min() - margin) / step)
    high = step * math.ceil((curves.max() + margin) / step)
    within = (-response.limit(-1), response.limit(1))
    pairs = zip(views, curves, _COLOURS, strict=False)
    chart = Chart(
        response.amounts,
        [Curve(view.name, curve, colour) for view, curve, colour in pairs],
        ChartAxis(f"{_TITLES[response.field]}, {response.unit}".rstrip(", "), *response.amounts[[0, -1]].tolist()),
        ChartAxis("SSIM" if ssim else "PSNR, dB", low, high),
        (*within, f"loses less than {FALL_DB:g} dB"),
        legend="shaded",
    )
    text = f"{0 + within[0]:.2g} to {within[1]:+.2g} {response.unit}".strip()
    return Tile(chart.draw(), _TITLES[response.field], text, drawn=True)


def _shift_map(found: Tolerances) -> Figure:
    reach, best = float(found.shifts_mm[-1]), float(found.map_db.max())
    scale = ColourScale(GLOW, float(found.map_db.min()), max(best, float(found.map_db.min()) + 0.1))
    block = _MAP_SIDE // _MAP_STEPS
    picture = scale.paint(np.kron(found.map_db, np.ones((block, block))))
    caption = f"PSNR in dB of shifts by up to {reach:.2g} mm to each side"
    title = "Where the sheet may lie"
    words = "The middle is the sheet in its place; each square is the mean of the views with the sheet moved there."
    return Figure("shift-map", title, [[Tile(picture, "", caption, scale)]], words)


def _compute(plan: Plan, result: RunResult) -> Findings | None:
    from magiclens.simulation.as_made import body_of

    if result.solid.grid is None:
        return None
    machine = plan.fabrication.machine if plan.fabrication else None
    found = tolerances(result.scene, body_of(result.solid, machine))
    return Findings(found.metrics, found)


def _figures(result: RunResult, findings: Findings) -> list[Figure]:
    found, views = findings.details, result.scene.views
    words = "Each chart changes one thing and leaves all others as designed. Shaded:"
    caption = f"{words} what costs the worst view less than {FALL_DB:g} dB."
    return [
        Figure("tolerances", "How exactly it must lie", _charts(found, views, False), caption),
        _shift_map(found),
        Figure("tolerances-ssim", "The same in SSIM", _charts(found, views, True), caption),
    ]


TOLERANCES = Analysis("tolerances", compute=_compute, figures=_figures)
"""What the picture loses when sheet, lens, eye, gap or material are not as designed."""
