"""Checks of what the machine can make: its bed, its reach, its finest detail; and what the material costs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from magiclens.contract.artifacts import Lens
from magiclens.preflight.finding import Finding, Status, Verdict, facets_where, graded, worst_facet_text
from magiclens.preflight.light import SMALL_SHARE
from magiclens.preflight.mesh_file import BOTTOM_MM, MeshFile
from magiclens.preflight.triangles import TopTriangles
from magiclens.profiles.machines import Machine, Mill, Printer
from magiclens.profiles.materials import Material

_THINNEST_MM = 1.0
"""Least thickness where no machine is named."""
_ROUNDED_SHARE = 0.4
"""Share of the lens in rounded strips above which fewer facets show more."""


def check_thickness(file: MeshFile, top: TopTriangles, lens: Lens, machine: Machine | None) -> Finding:
    """Compare the lowest and the highest point of the top with what the machine can make.

    Args:
        file: The mesh file.
        top: The triangles of its top.
        lens: The lens.
        machine: None if the spec names none.
    """
    least, most = machine.thickness if machine else (_THINNEST_MM, np.inf)
    thin, high = float(top.lowest_mm.min()), float(file.extent_mm[1, 2])
    too_thin = top.lowest_mm < least
    facets = facets_where(too_thin & ~top.wall, top.facet, -top.lowest_mm, lens)
    allowed = f"{least:g} to {most:g} mm" if machine else f"at least {least:g} mm"
    bad = bool(too_thin.any()) or high > most * (1 + 1e-6)
    at_fault = worst_facet_text(facets)
    text = f"{thin:.4g} mm at the thinnest place, {high:.4g} mm at the highest; {allowed} is fit{at_fault}"
    return Finding("thickness", "red" if bad else "green", text, facets)


def check_bed(file: MeshFile, machine: Machine | None) -> Finding:
    """Compare the body, as it stands, with the machine's bed, on which it may be turned by a quarter.

    Mills can make it in tiles.
    """
    sides = np.diff(file.extent_mm, axis=0)[0]
    if isinstance(machine, Printer) and machine.tilt:
        sides = machine.tilt.box_mm(sides)
    extent = f"{sides[0]:.4g} x {sides[1]:.4g} x {sides[2]:.4g} mm"
    if machine is None:
        return Finding("bed", "grey", f"{extent}; no machine is named")
    room = machine.bed
    fits = machine.has_room_for(sides)
    text = f"{extent} on a bed of {room[0]:g} x {room[1]:g} x {room[2]:g} mm"
    tiled: Status = "amber" if isinstance(machine, Mill) and sides[2] <= room[2] else "red"
    return Finding("bed", "green" if fits else tiled, text + ("" if fits else "; it would have to be made in tiles"))


def check_material(file: MeshFile, machine: Machine | None, material: Material | None) -> Finding:
    """State how much material the lens takes, and what that costs; a mill needs the block around the lens."""
    block = float(np.prod(np.diff(file.extent_mm, axis=0)))
    milled = isinstance(machine, Mill)
    of_block = f", out of a block of {block / 1000:.4g} cm3" if milled else ""
    volume = f"{file.volume_mm3 / 1000:.4g} cm3{of_block}"
    if material is None:
        return Finding("material", "grey", f"{volume}; no material is named, so its cost is unknown")
    text = material_text(block if milled else file.volume_mm3, machine, material)
    return Finding("material", "green", f"{volume}; {text}")


def material_text(volume_mm3: float, machine: Machine | None, material: Material) -> str:
    """How much so much of a material weighs, and what it costs."""
    price = machine.price if machine and machine.price is not None else material.price
    mass = volume_mm3 / 1e6 * material.density
    return f"{mass:.3g} kg of {material.title}, about {mass * price:.0f} EUR at {price:g} EUR/kg"


def check_detail(lens: Lens, machine: Machine) -> Finding:
    """Compare facets and micro-facets with the machine's finest detail."""
    micro = lens.pitch_mm / lens.microfacets
    # a mill has no pixels: its micro-facets are too fine exactly if its facets are
    finest = max(machine.pixels_mm) if isinstance(machine, Printer) else machine.feature / lens.microfacets
    small = lens.pitch_mm < machine.feature * (1 - 1e-9)
    what = f"facets of {lens.pitch_mm:.3g} mm, {machine.feature:g} mm keep their shape"
    fine = f"; micro-facets of {micro:.3g} mm are finer than the machine's {finest:.3g} mm, which rounds them"
    averaged = micro < finest * (1 - 1e-9)
    rounded, strips = _strips(lens, machine)
    status: Status = "red" if small else "amber" if averaged or rounded > _ROUNDED_SHARE else "green"
    return Finding("detail", status, what + (fine if averaged else "") + strips)


def _strips(lens: Lens, machine: Machine) -> tuple[float, str]:
    """The share of the lens that a printer rounds along facets' borders, and that in words."""
    if not isinstance(machine, Printer):
        return 0.0, ""
    strip = machine.linear_process.strip_mm
    share = 1 - max(1 - strip / lens.pitch_mm, 0.0) ** 2
    text = f"; borders are rounded in strips of {strip:.2g} mm, which take {100 * share:.0f} % of the lens"
    better = machine.facets_for(lens.size_mm)
    advice = f"; lens.facets: auto would be {better}" if share > _ROUNDED_SHARE and better < lens.facets else ""
    return share, text + advice


def check_tool_reach(file: MeshFile, top: TopTriangles, lens: Lens, mill: Mill) -> Finding:
    """Look for undercuts, for depths beyond the cutter, and for walls steeper than its flank.

    Args:
        file: The mesh file.
        top: The triangles of its top.
        lens: The lens.
        mill: The machine.
    """
    under = top.slope_deg > 90.0 + 1e-3
    deep = float(file.extent_mm[1, 2] - top.lowest_mm.min())
    steep = top.slope_deg > mill.steepest_deg + 0.5
    if under.any():
        facets = facets_where(under, top.facet, top.slope_deg, lens)
        count, at_fault = int(under.sum()), worst_facet_text(facets)
        text = f"{count} faces are undercut; with lens.cells: vertical none would be{at_fault}"
        return Finding("tool reach", "red", text, facets)
    text = f"the top is {deep:.3g} mm deep, the cutter reaches {mill.reach:g} mm"
    if deep > mill.reach:
        low = (top.lowest_mm < file.extent_mm[1, 2] - mill.reach) & ~top.wall
        facets = facets_where(low, top.facet, -top.lowest_mm, lens)
        return Finding("tool reach", "red", text + worst_facet_text(facets), facets)
    share = float(steep.sum() / len(steep))
    facets = facets_where(steep, top.facet, top.slope_deg, lens)
    flank = f"are steeper than the cutter's {mill.steepest_deg:g} deg and stay rounded"
    left = f"; {100 * share:.2g} % of the faces {flank}{worst_facet_text(facets)}" if facets else ""
    status: Status = "amber" if graded(share, SMALL_SHARE, 1.0) == "amber" else "green"
    return Finding("tool reach", status, text + left, facets)


def check_bottom(file: MeshFile) -> Finding:
    """Check that the bottom is at z = 0, where the lens frame has it."""
    low = float(file.extent_mm[0, 2])
    at_zero = abs(low) <= BOTTOM_MM
    text = "the bottom lies at z = 0" if at_zero else f"the lowest point is at z = {low:.4g} mm instead of 0"
    return Finding("bottom", "green" if at_zero else "amber", text)


def check_as_made(metrics: Mapping[str, float], verdict: Verdict) -> Finding:
    """The verdict as a finding, with what making costs if the run has simulated that."""
    if "as_made_psnr_db" not in metrics:
        return Finding("as made", verdict.status, verdict.text)
    shown_db, loss_db = metrics["as_made_psnr_db"], metrics["fabrication_loss_db"]
    # a lens that was refined through its process is better as made than as its mesh
    cost = f"making it costs {loss_db:.1f} dB" if loss_db > 0 else "it was designed for how it is made"
    return Finding("as made", verdict.status, f"{verdict.text}; {shown_db:.1f} dB from its target, {cost}")
