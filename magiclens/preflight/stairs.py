"""The check of how a printed part stands on its plate: gentle slopes that lie along the layers become stairs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from magiclens.contract.artifacts import FloatArray, Lens
from magiclens.contract.units import ANGLE
from magiclens.preflight.finding import Finding, Status
from magiclens.preflight.mesh_file import MeshFile
from magiclens.preflight.triangles import TopTriangles
from magiclens.processes.layers import stair_slopes
from magiclens.processes.tilting import Tilt
from magiclens.profiles.machines import Printer

_ANGLES_DEG = range(5, 65, 5)
"""Angles that are tried, in either direction."""
_OVERHANG_DEG = 85.0
"""Facets that are steeper than this when tilted would need supports of their own."""
_UPWARD = 0.999
"""Share of the top that must not hang over."""
_SAMPLE = 5_000
"""Triangles that are looked at, evenly over the top."""
_UNSEEN_MM, _BEARABLE_MM = 0.05, 0.2
"""Errors of rays up to which no eye sees anything, and up to which a picture of 512 pixels on 100 mm stays sharp."""
_WORTHWHILE = 0.75
"""Share of the error that a tilt may leave, or it is not worth its supports."""
_GOOD_ENOUGH = 1.1
"""Of the tilts whose error is at most so many times the least, the smallest is proposed."""


def check_stairs(file: MeshFile, top: TopTriangles, lens: Lens, printer: Printer) -> Finding:
    """How far layers throw rays off as the part stands, and the tilt that would help.

    Layers that are rounded by error diffusion leave no stairs; otherwise stairs are wide where a facet is nearly level
    with the layers, and no finish evens them out. A tilt helps lenses of gentle slopes most: of others, some facets are
    level at any tilt.

    Args:
        file: The mesh file.
        top: The triangles of its top.
        lens: The lens.
        printer: The machine.
    """
    normals = _normals(file, top, lens)
    if printer.slicing == "diffused" and printer.tilt is None:
        other_mm = _ray_error_mm(normals, lens, printer, None)
        cut = f"stairs of layers that another slicer cuts from {file.name} throw rays off by {other_mm:.2g} mm rms"
        known = "; the verdict is of its own slices" if other_mm > _UNSEEN_MM else ""
        return Finding("layers", "green", f"lying flat on the plate, its own slices leave no stairs; {cut}{known}")
    stands = "lying flat" if printer.tilt is None else f"tilted by {ANGLE.text(printer.tilt.angle)}"
    now_mm = _ray_error_mm(normals, lens, printer, printer.tilt)
    grown = f", and its flat side grows by {printer.growth_mm:.2g} mm" if printer.growth_mm else ""
    text = f"{stands} on the plate, stairs of plain layers throw rays off by {now_mm:.2g} mm rms{grown}"
    status: Status = "green" if now_mm <= _BEARABLE_MM else "amber"
    if now_mm <= _UNSEEN_MM:
        return Finding("layers", status, text)
    tried = {tilt: _ray_error_mm(normals, lens, printer, tilt) for tilt in _possible(file, normals, printer)}
    least = min(tried.values(), default=now_mm)
    if least > _WORTHWHILE * now_mm:
        return Finding("layers", status, text)
    enough = max(_GOOD_ENOUGH * least, _UNSEEN_MM / 10)
    best = min((tilt for tilt in tried if tried[tilt] <= enough), key=lambda tilt: abs(tilt.angle))
    wish = f"{{about: {best.about}, angle: {ANGLE.text(best.angle)}}}"
    advice = f"with fabrication.tilt: {wish} it would be {tried[best]:.2g} mm; supports belong on the flat side"
    return Finding("layers", status, f"{text}; {advice}")


def _normals(file: MeshFile, top: TopTriangles, lens: Lens) -> FloatArray:
    """(S, 3) normals of some triangles of facets, as long as their areas, lens frame."""
    inside, first, picked = np.flatnonzero(~top.wall), 0, []
    wanted = inside[:: max(len(inside) // _SAMPLE, 1)]
    for triangles in file.top_parts(lens):
        here = wanted - first
        picked.append(triangles[here[(here >= 0) & (here < len(triangles))]])
        first += len(triangles)
    a, b, c = np.moveaxis(np.concatenate(picked).astype(np.float64), 1, 0)
    return np.asarray(np.cross(b - a, c - a))


def _ray_error_mm(normals: FloatArray, lens: Lens, printer: Printer, tilt: Tilt | None) -> float:
    """Errors of rays on the sheet by stairs, rms over the top's area as seen from above."""
    turned = normals @ tilt.turn.T if tilt else normals
    gradients = turned[:, :2] / np.maximum(turned[:, 2:], 1e-9)
    slopes = stair_slopes(printer.linear_process, printer.layer, printer.pixels_mm, gradients)
    # light bends by 1 - 1/n of an error in slope, to first order
    lever = lens.thickness_mm * (1 - 1 / lens.ior) + lens.gap_mm * (lens.ior - 1)
    return float(lever * np.sqrt(np.average(slopes**2, weights=normals[:, 2])))


def _possible(file: MeshFile, normals: FloatArray, printer: Printer) -> Iterator[Tilt]:
    """Tilts at which the part fits the machine, and no facet hangs over."""
    sides = np.diff(file.extent_mm.astype(float), axis=0)[0]
    steepest = np.tan(np.radians(_OVERHANG_DEG))
    for about in ("x", "y"):
        for angle in _ANGLES_DEG:
            for sign in (1, -1):
                tilt = Tilt.model_validate({"about": about, "angle": ANGLE.text(sign * angle)})
                box, turned = tilt.box_mm(sides), normals @ tilt.turn.T
                faces_up = np.hypot(turned[:, 0], turned[:, 1]) < steepest * turned[:, 2]
                if printer.has_room_for(box) and np.mean(faces_up) > _UPWARD:
                    yield tilt
