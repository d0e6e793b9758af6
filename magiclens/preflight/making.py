"""Can the machine make it? Its bed, its reach, its finest detail; and what the material costs."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import Lens
from magiclens.preflight.exported import FLOOR_MM, Exported
from magiclens.preflight.finding import Finding, Status, facets_with, first_of, graded
from magiclens.preflight.optics import FEW, Top
from magiclens.profiles.machines import Machine, Mill, Printer
from magiclens.profiles.materials import Material

THINNEST_MM = 1.0
"""Where no machine is named."""


def thickness(file: Exported, top: Top, lens: Lens, machine: Machine | None) -> Finding:
    """The thinnest place and the highest point of the lens."""
    least, most = machine.thickness if machine else (THINNEST_MM, np.inf)
    lowest = top.triangles[..., 2].min(axis=1)
    thin, high = float(lowest.min()), float(file.extent_mm[1, 2])
    thin_there = lowest < least
    facets = facets_with(thin_there & ~top.wall, top.facet, -lowest, lens)
    allowed = f"{least:g} to {most:g} mm" if machine else f"at least {least:g} mm"
    bad = bool(thin_there.any()) or high > most * (1 + 1e-6)
    text = f"{thin:.4g} mm at the thinnest place, {high:.4g} mm at the highest; {allowed} is fit{first_of(facets)}"
    return Finding("thickness", "red" if bad else "green", text, facets)


def bed(file: Exported, machine: Machine | None) -> Finding:
    """The body against the machine's bed, turned by a quarter if need be."""
    sides = np.diff(file.extent_mm, axis=0)[0]
    extent = f"{sides[0]:.4g} x {sides[1]:.4g} x {sides[2]:.4g} mm"
    if machine is None:
        return Finding("bed", "green", f"{extent}; no machine is named")
    room = machine.bed
    flat = sorted(sides[:2]) <= sorted(room[:2]) and max(sides[:2]) <= max(room[:2])
    fits = flat and sides[2] <= room[2]
    text = f"{extent} on a bed of {room[0]:g} x {room[1]:g} x {room[2]:g} mm"
    tiled: Status = "amber" if isinstance(machine, Mill) and sides[2] <= room[2] else "red"
    return Finding("bed", "green" if fits else tiled, text + ("" if fits else "; it would have to be made in tiles"))


def bill(file: Exported, machine: Machine | None, material: Material | None) -> Finding:
    """How much material it takes, and what that costs."""
    volume = file.volume_mm3 / 1000
    block = float(np.prod(np.diff(file.extent_mm, axis=0))) / 1000
    milled = isinstance(machine, Mill)
    of_block = f", out of a block of {block:.4g} cm3" if milled else ""
    price = machine.price if machine and machine.price is not None else material.price if material else None
    if material is None:
        return Finding("material", "amber", f"{volume:.4g} cm3{of_block}; no material is named, so its cost is unknown")
    mass = (block if milled else volume) * material.density / 1000
    cost = f"{mass:.3g} kg of {material.title}, about {mass * (price or 0.0):.0f} EUR at {price:g} EUR/kg"
    return Finding("material", "green", f"{volume:.4g} cm3{of_block}; {cost}")


def detail(lens: Lens, machine: Machine) -> Finding:
    """Facets and micro-facets against the machine's finest detail."""
    micro = lens.pitch_mm / lens.microfacets
    finest = max(machine.pixels_mm) if isinstance(machine, Printer) else machine.feature / lens.microfacets
    small = lens.pitch_mm < machine.feature * (1 - 1e-9)
    what = f"facets of {lens.pitch_mm:.3g} mm, {machine.feature:g} mm keep their shape"
    fine = f"; micro-facets of {micro:.3g} mm are finer than the machine's {finest:.3g} mm, which rounds them"
    averaged = micro < finest * (1 - 1e-9)
    return Finding("detail", "red" if small else "amber" if averaged else "green", what + (fine if averaged else ""))


def reach(file: Exported, top: Top, lens: Lens, mill: Mill) -> Finding:
    """Undercuts, depths beyond the cutter, and walls steeper than its flank."""
    under = top.slope_deg > 90.0 + 1e-3
    deep = float(file.extent_mm[1, 2] - top.triangles[..., 2].min())
    steep = top.slope_deg > mill.steepest_deg + 0.5
    if under.any():
        facets = facets_with(under, top.facet, top.slope_deg, lens)
        text = f"{int(under.sum())} faces are undercut; with lens.cells: vertical none would be{first_of(facets)}"
        return Finding("tool reach", "red", text, facets)
    text = f"the top is {deep:.3g} mm deep, the cutter reaches {mill.reach:g} mm"
    if deep > mill.reach:
        low = top.triangles[..., 2].min(axis=1)
        facets = facets_with((low < file.extent_mm[1, 2] - mill.reach) & ~top.wall, top.facet, -low, lens)
        return Finding("tool reach", "red", text + first_of(facets), facets)
    share = float(steep.sum() / len(steep))
    facets = facets_with(steep, top.facet, top.slope_deg, lens)
    flank = f"are steeper than the cutter's {mill.steepest_deg:g} deg and stay rounded"
    left = f"; {100 * share:.2g} % of the faces {flank}{first_of(facets)}" if facets else ""
    return Finding("tool reach", "amber" if graded(share, FEW, 1.0) == "amber" else "green", text + left, facets)


def lies_flat(file: Exported) -> Finding:
    """The bottom is flat and at z = 0, where the source is."""
    low = float(file.extent_mm[0, 2])
    at_zero = abs(low) <= FLOOR_MM
    text = "the bottom lies at z = 0" if at_zero else f"the lowest point is at z = {low:.4g} mm instead of 0"
    return Finding("bottom", "green" if at_zero else "amber", text)
