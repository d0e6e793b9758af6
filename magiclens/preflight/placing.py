"""Checks of how exactly sheet, lens and eye must be placed, from the tolerances that the run has measured."""

from __future__ import annotations

import math
from collections.abc import Mapping

from magiclens.contract.artifacts import Lens, View
from magiclens.preflight.finding import Finding

_BY_HAND_MM = 0.1
"""Least shift of a sheet that can be avoided by hand and eye."""
_OF_PRINTS_PERCENT = 0.1
"""Least error of a printed sheet's size that cannot be relied on to be absent."""
_STEADY_MM = 1.0
"""Least move of an eye that a peephole prevents."""


def check_placing(metrics: Mapping[str, float], lens: Lens, view: View) -> list[Finding]:
    """Say how exactly sheet, lens and eye must lie so that the picture loses less than 3 dB.

    Args:
        metrics: Of the manifest.
        lens: The lens.
        view: One of its views; its eye's distance stands for that of all.

    Returns:
        Three findings; none if the run has not measured tolerances. They are amber where hands or printers may fail.
    """
    if "tolerance_shift_x_mm" not in metrics:
        return []
    may = {name.removeprefix("tolerance_"): value for name, value in metrics.items() if name.startswith("tolerance_")}
    shift, tilt = min(may["shift_x_mm"], may["shift_y_mm"]), min(may["tilt_x_deg"], may["tilt_y_deg"])
    aside, away = min(may["eye_x_mm"], may["eye_y_mm"]), view.eye_mm[2] - lens.thickness_mm
    edge = lens.size_mm * math.tan(math.radians(tilt))
    near, far = (f"{distance:.0f}" for distance in (away - may["eye_nearer_mm"], away + may["eye_farther_mm"]))
    hard = shift < _BY_HAND_MM or may["scale_percent"] < _OF_PRINTS_PERCENT
    sheet = f"lay it within {_down(shift)} mm and {_down(may['rotation_deg'])} degrees"
    size = f"its size may be off by {_down(may['scale_percent'])} %"
    bottom = f"it may stand {_down(may['gap_mm'])} mm too high, or {_down(edge)} mm at one edge"
    return [
        Finding("sheet", "amber" if hard else "green", f"{sheet}; {size}"),
        Finding(
            "eye",
            "amber" if aside < _STEADY_MM else "green",
            f"keep the eye within {_down(aside)} mm aside, {near} to {far} mm away",
        ),
        Finding("seat", "green", f"{bottom}; its index of refraction may be off by {_down(may['ior'])}"),
    ]


def _down(value: float) -> str:
    """A limit in two digits, rounded down so that it is kept."""
    step = 10.0 ** (math.floor(math.log10(max(value, 1e-6))) - 1)
    return f"{math.floor(value / step + 1e-9) * step:.2g}"
