"""All checks of a run folder, in the order in which the page shows them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from magiclens.contract.artifacts import FloatArray, Lens, Solid, View
from magiclens.contract.errors import InputError
from magiclens.images.files import read_image
from magiclens.plan.compile import Plan
from magiclens.preflight.body import body_checked_by_finisher, check_body, check_same_body, check_size
from magiclens.preflight.finding import ANY_MESH, Finding, Preflight
from magiclens.preflight.light import check_fresnel_loss, check_slopes, check_total_reflection
from magiclens.preflight.machine import (
    check_as_made,
    check_bed,
    check_bottom,
    check_detail,
    check_material,
    check_thickness,
    check_tool_reach,
)
from magiclens.preflight.mesh_file import MeshFile, SharedCorners, mesh_files, read_mesh_file
from magiclens.preflight.picture import CHECKED_VIEWS, check_colours, check_orientation, check_source_resolution
from magiclens.preflight.placing import check_placing
from magiclens.preflight.stairs import check_stairs
from magiclens.preflight.survey import survey
from magiclens.preflight.triangles import TopTriangles
from magiclens.preflight.verdict import verdict_of
from magiclens.profiles.machines import Machine, Mill, Printer
from magiclens.profiles.materials import materials


def run_preflight(
    folder: Path,
    manifest: Mapping[str, Any],
    plan: Plan,
    solid: Solid | None = None,
    keep: Callable[[Callable[[], Preflight]], Preflight] = lambda check: check(),
) -> Preflight:
    """Check the files of a run folder against its manifest and its plan.

    Args:
        folder: The run folder.
        manifest: Its manifest; one without the list of files will do.
        plan: The plan of its spec.
        solid: The finished lens, given by a run that has just made it. If the first mesh file holds exactly this solid,
            the solid is checked in place of the file: what the finisher has found is not searched for again, and other
            mesh files are left to ``mlens preflight``.
        keep: Is given the checks of the solid, which depend on no file, and may know their result.

    Raises:
        InputError: There is no mesh file.
    """
    paths = mesh_files(folder)
    if not paths:
        raise InputError("there is no mesh file to be made; add an exporter such as stl", str(folder))
    try:
        file = read_mesh_file(paths[0])
        same = solid is not None and file.same_as(solid)
        if not same and not np.isfinite(file.extent_mm).all():
            raise ValueError("some of its corners are nowhere")
    except Exception as error:  # readers of broken files raise anything
        broken = Finding("mesh", "red", f"{paths[0].name} cannot be read: {error}")
        verdict = verdict_of(folder, manifest, plan)
        findings = [check_as_made(manifest["metrics"], verdict), broken]
        return Preflight(str(manifest["name"]), _made_by(plan), findings, None, verdict)
    if solid and same:
        return keep(partial(_check_solid, folder, manifest, plan, solid)).of_mesh(file.name)
    return _check(folder, manifest, plan, file, others=() if solid else paths[1:])


def _check_solid(folder: Path, manifest: Mapping[str, Any], plan: Plan, solid: Solid) -> Preflight:
    """Check a solid as the mesh files hold it, whose place in the texts ``ANY_MESH`` takes."""
    file = MeshFile(Path(ANY_MESH), SharedCorners(solid.vertices.astype(np.float32), solid.faces))
    return _check(folder, manifest, plan, file, body_checked_by_finisher(manifest["metrics"], file.name))


def _check(
    folder: Path,
    manifest: Mapping[str, Any],
    plan: Plan,
    file: MeshFile,
    known: Sequence[Finding] | None = None,
    others: Sequence[Path] = (),
) -> Preflight:
    """Check a mesh.

    Args:
        folder: The run folder, whose pictures are looked at.
        manifest: Its manifest.
        plan: The plan of its spec.
        file: The mesh.
        known: Findings about it as a body, if they are known.
        others: Mesh files that should hold the same.
    """
    machine = plan.fabrication.machine if plan.fabrication else None
    verdict = verdict_of(folder, manifest, plan)
    shown = check_as_made(manifest["metrics"], verdict)
    lens, views = plan.lens, _stored_views(folder, manifest)
    eye = lens.cut_along(np.mean([view.eye_mm for view in views], axis=0))
    body = [*(known or check_body(file, lens, eye)), check_size(file, lens)]
    if others:
        body.append(check_same_body(file, others))
    # the other checks take coordinates for millimetres and need a top
    if any(finding.check == "size" and finding.status == "red" for finding in body) or not file.top_count:
        return Preflight(str(manifest["name"]), _made_by(plan), [shown, *body], None, verdict)
    found = survey(file, lens, eye, views)
    top, light = found.top, (found.top, found.seen, found.areas_mm2, lens)
    findings = [
        shown,
        *body,
        check_bottom(file),
        check_thickness(file, top, lens, machine),
        check_slopes(top, lens, *_slope_limit(plan, machine)),
        check_fresnel_loss(*light),
        check_total_reflection(*light),
        *([check_detail(lens, machine)] if machine else []),
        *([check_stairs(file, top, lens, machine)] if isinstance(machine, Printer) else []),
        *([check_tool_reach(file, top, lens, machine)] if isinstance(machine, Mill) else []),
        check_bed(file, machine),
        check_material(file, machine, materials().get(plan.spec.lens.material or "")),
        check_orientation(
            file.name, views[:CHECKED_VIEWS], found.pictures, found.flipped_pictures, _run_psnr_db(manifest)
        ),
        check_source_resolution(lens, views),
        *check_colours(views),
        *check_placing(manifest["metrics"], lens, views[0]),
    ]
    return Preflight(str(manifest["name"]), _made_by(plan), findings, _mean_slopes_deg(top, lens), verdict)


def _stored_views(folder: Path, manifest: Mapping[str, Any]) -> list[View]:
    """The views of a run, in the lens frame, with the pictures that its folder holds."""
    listed = manifest["views"]
    pictures = {path: read_image(folder / path) for view in listed for path in (view["source"], view["target"])}
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
        for view in listed
    ]


def _made_by(plan: Plan) -> str:
    return plan.fabrication.profile.title if plan.fabrication else ""


def _slope_limit(plan: Plan, machine: Machine | None) -> tuple[float, str]:
    """The steepest slope allowed, degrees, and the name of what allows it."""
    if machine is None or plan.fabrication is None:
        return plan.lens.max_slope_deg, "the spec"
    return machine.max_slope, plan.fabrication.name


def _run_psnr_db(manifest: Mapping[str, Any]) -> float | None:
    """The mean PSNR of the run's pictures of the checked views; None if the run has taken none."""
    found = [view["psnr_db"] for view in manifest["views"][:CHECKED_VIEWS]]
    return None if None in found else float(np.mean(found))


def _mean_slopes_deg(top: TopTriangles, lens: Lens) -> FloatArray:
    """(N, N) mean slope of each facet, without walls."""
    inside = ~top.wall
    total = np.bincount(top.facet, top.slope_deg * inside, lens.facets**2)
    count = np.bincount(top.facet, inside, lens.facets**2)
    return (total / np.maximum(count, 1)).reshape(lens.facets, lens.facets)
