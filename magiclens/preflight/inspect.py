"""All checks of a run folder, in the order of the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from magiclens.contract.artifacts import FloatArray, Lens, Solid, View
from magiclens.contract.errors import InputError
from magiclens.images.files import read_image
from magiclens.plan.compile import Plan
from magiclens.preflight import making, optics, picture, soundness
from magiclens.preflight.exported import Exported, mesh_files, read_exported
from magiclens.preflight.finding import Finding, Status, worst
from magiclens.preflight.sight import facets_of, looks, slopes_deg
from magiclens.profiles.machines import Machine, Mill
from magiclens.profiles.materials import materials

COSTLY_DB, CLEAR_DB, POOR_DB = 3.0, 20.0, 10.0
"""What making may cost the picture without a word; from where on a made picture is clear anyway, and no longer one."""


@dataclass(frozen=True)
class Preflight:
    """Everything that was found. slopes_deg: (N, N), the mean of each facet, for the map; None without a mesh."""

    name: str
    made_by: str
    findings: Sequence[Finding]
    slopes_deg: FloatArray | None

    @property
    def status(self) -> Status:
        """The worst of all findings."""
        return worst(self.findings)


def inspect(folder: Path, facts: Mapping[str, Any], plan: Plan, solid: Solid | None = None) -> Preflight:
    """Check the files of a run folder against its manifest ``facts`` and the plan in its spec.

    A run that has just ended gives its ``solid``. If the file holds just that, what the finisher has found of it holds
    for the file and is not searched for again; other files are left to ``mlens preflight``. Raises InputError if there
    is no mesh file.
    """
    machine = plan.fabrication.machine if plan.fabrication else None
    made_by = plan.fabrication.profile.title if plan.fabrication else ""
    paths = mesh_files(folder)
    if not paths:
        raise InputError("there is no mesh file to be made; add an exporter such as stl", str(folder))
    try:
        file = read_exported(paths[0])
    except Exception as error:  # readers of broken files raise anything
        broken = Finding("mesh", "red", f"{paths[0].name} cannot be read: {error}")
        return Preflight(str(facts["name"]), made_by, [broken], None)
    lens, views = plan.lens, opened(folder, facts)
    eye = lens.cut_along(np.mean([view.eye_mm for view in views], axis=0))
    known = soundness.as_found(facts["metrics"], file.name) if solid and file.same_as(solid) else None
    sound = known or soundness.soundness(file, lens, eye)
    sound.append(soundness.size(file, lens))
    if len(paths) > 1 and solid is None:
        sound.append(soundness.alike(file, paths[1:]))
    if any(finding.check == "size" and finding.status == "red" for finding in sound) or not len(file.on_top):
        return Preflight(str(facts["name"]), made_by, sound, None)
    top = _top(file, lens, eye)
    sights = looks(top.triangles, lens, views)
    findings = [
        *sound,
        making.lies_flat(file),
        making.thickness(file, top, lens, machine),
        optics.slopes(top, lens, *_slope_limit(plan, machine)),
        optics.loss(top, lens, sights),
        optics.reflection(top, lens, sights),
        *([making.detail(lens, machine)] if machine else []),
        *([making.reach(file, top, lens, machine)] if isinstance(machine, Mill) else []),
        making.bed(file, machine),
        making.bill(file, machine, materials().get(plan.spec.lens.material or "")),
        *_as_made(facts["metrics"]),
        picture.mirror(file, lens, views, sights, _claimed_db(facts)),
        picture.resolution(lens, views),
    ]
    return Preflight(str(facts["name"]), made_by, findings, _mean_slopes(top, lens))


def opened(folder: Path, facts: Mapping[str, Any]) -> list[View]:
    """The views of a run, in the lens frame, their pictures as the files of the folder hold them."""
    pictures = {path: read_image(folder / path) for view in facts["views"] for path in (view["source"], view["target"])}
    return [
        View(
            view["name"],
            pictures[view["source"]],
            pictures[view["target"]],
            np.array(view["eye_mm"], float),
            view["rotation_deg"],
            Path(view["source"]).stem,
            Path(view["target"]).stem,
        ).in_lens_frame()
        for view in facts["views"]
    ]


def _top(file: Exported, lens: Lens, eye_mm: FloatArray | None) -> optics.Top:
    triangles = file.triangles[file.on_top]
    facet, wall = facets_of(triangles, lens, eye_mm)
    return optics.Top(triangles, facet, wall, slopes_deg(triangles))


def _slope_limit(plan: Plan, machine: Machine | None) -> tuple[float, str]:
    if machine is None or plan.fabrication is None:
        return plan.lens.max_slope_deg, "the spec"
    return machine.max_slope, plan.fabrication.name


def _claimed_db(facts: Mapping[str, Any]) -> float | None:
    """The mean PSNR of the run's pictures as far as preflight looks at them; None if it has taken none."""
    found = [view["psnr_db"] for view in facts["views"][: picture.MOST_VIEWS]]
    return None if None in found else float(np.mean(found))


def _as_made(metrics: Mapping[str, float]) -> list[Finding]:
    """What the lens shows as the machine makes it, if that was simulated."""
    if "as_made_psnr_db" not in metrics:
        return []
    shown_db, loss_db = metrics["as_made_psnr_db"], metrics["fabrication_loss_db"]
    fine = shown_db >= CLEAR_DB or loss_db <= COSTLY_DB
    status: Status = "green" if fine else "red" if shown_db < POOR_DB else "amber"
    told = f"as made the picture is {shown_db:.1f} dB from its target; making it costs {loss_db:.1f} dB"
    return [Finding("as made", status, told)]


def _mean_slopes(top: optics.Top, lens: Lens) -> FloatArray:
    """(N, N) degrees."""
    inside = ~top.wall
    total = np.bincount(top.facet[inside], top.slope_deg[inside], lens.facets**2)
    count = np.bincount(top.facet[inside], minlength=lens.facets**2)
    return (total / np.maximum(count, 1)).reshape(lens.facets, lens.facets)
