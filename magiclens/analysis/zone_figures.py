"""What the eye sees while it moves about, through a lens for several eyes and through one for a single eye."""

from __future__ import annotations

import numpy as np

from magiclens.analysis.contact import MARK
from magiclens.contract.result import RunResult, Zone
from magiclens.drawing.chart import Chart, ChartAxis, Curve
from magiclens.drawing.figure import Figure
from magiclens.drawing.photographs import photograph
from magiclens.drawing.scales import round_ticks
from magiclens.drawing.tiles import Tile, to_pixels

SIDE = 320
COLOURS = {"zone": f"#{bytes(MARK).hex()}", "plain": "#2b6cc4"}


def zone_figures(data: RunResult, zone: Zone) -> list[Figure]:
    """Photographs from displaced eyes, and how the worst picture gets worse with the displacement (figure 14)."""
    return [_pictures(data, zone), _curve(data, zone)]


def _pictures(data: RunResult, zone: Zone) -> Figure:
    view, names = data.scene.views[0], _names(data)
    places = [f"eye moved {move:.1f} mm, {zone.degrees(move):.2g}°" for move in zone.shown_mm]
    rows = []
    for lens, pictures in zone.pictures.items():
        photos = [photograph(picture, view) for picture in pictures]
        titles = [names[lens], *places[1:]] if lens == "zone" else [names[lens], *([""] * len(photos[1:]))]
        both = zip(photos, titles, strict=True)
        rows.append([Tile(to_pixels(photo.picture, SIDE), title, photo.caption) for photo, title in both])
    return Figure(
        "stable-zone",
        "While the eye moves",
        rows,
        f"Above the lens for {len(data.scene.views)} eyes, below one designed in the same way for the middle eye only. "
        "Left, what the middle eye sees; then, what it sees farther and farther toward the upper right.",
    )


def _names(data: RunResult) -> dict[str, str]:
    return {"zone": f"Lens for {len(data.scene.views)} eyes", "plain": "Lens for the middle eye"}


def _curve(data: RunResult, zone: Zone) -> Figure:
    worst = {lens: psnr.min(axis=1) for lens, psnr in zone.psnr_db.items()}
    low, high = min(w.min() for w in worst.values()), max(w.max() for w in worst.values())
    reach, names = float(zone.moves_mm[-1]), _names(data)
    widest = zone.degrees(reach)
    degrees = {zone.move_mm(place * widest) / reach: text for place, text in round_ticks(0.0, widest).items()}
    chart = Chart(
        zone.moves_mm,
        [Curve(names[lens], curve, COLOURS[lens]) for lens, curve in worst.items()],
        ChartAxis("how far the eye moves, mm", 0.0, reach),
        ChartAxis("PSNR, dB", float(np.floor(low - 0.5)), float(np.ceil(high + 0.5))),
        ("degrees", degrees),
        (zone.eyes_mm[0], "inner cone"),
        zone.eyes_mm,
    )
    found = zone.metrics
    caption = (
        f"worst within the inner cone: {found['zone_worst_psnr_db']:.1f} dB for {len(data.scene.views)} eyes, "
        f"{found['plain_worst_psnr_db']:.1f} dB for the middle eye"
    )
    return Figure(
        "stable-zone-curve",
        "How large the viewing zone is",
        [[Tile(chart.draw(), "", caption)]],
        "How good the picture is from the worst of eight directions into which the eye may move. "
        "Dotted lines are as far from the middle as the eyes for which the lens was made.",
    )
