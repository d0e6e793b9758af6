"""What is known of an order before anything is designed: material, time, detail; and what an equal job has shown."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from magiclens.studio.orders import SPEC, Order, write_order
from magiclens.studio.results import WANTS, run_summary
from magiclens.studio.store import StudioFolder

if TYPE_CHECKING:
    from magiclens.plan.compile import Plan

_LAYER_S = 10.0
"""A usual time for a layer of a resin printer; what slicers say is better."""
_MOST_TOLERANCES = 3
Row = tuple[str, str, str]
"""What it is, the text, and a colour as verdicts have it; the colour may be empty."""


def foreseen(order: Order, store: StudioFolder) -> dict[str, Any]:
    """What an order will take, by the estimates that a run makes too; nothing is designed.

    Args:
        order: The order.
        store: The studio's folder; a job of it that has the same spec and the same pictures lends its verdict.

    Returns:
        ``facets`` along a side, ``thickness_mm``, and ``rows`` of label, text and colour.

    Raises:
        InputError: As ``write_order``.
    """
    with store.filling() as folder:
        plan = write_order(order, store, folder)
        rows = [*_making(plan), _designing(plan), *_shown(_equal_job(folder, store))]
    return {"facets": plan.lens.facets, "thickness_mm": plan.lens.thickness_mm, "rows": rows}


def _making(plan: Plan) -> Iterator[Row]:
    from magiclens.preflight.machine import check_detail, material_text
    from magiclens.profiles.machines import Mill, Printer
    from magiclens.profiles.materials import materials

    lens, machine = plan.lens, plan.fabrication.machine if plan.fabrication else None
    material = materials().get(plan.spec.lens.material or "")
    # the reference plane is the mean height; a mill begins with a block as high as the highest point may be
    high = lens.thickness_mm + lens.relief_mm
    base = (lens.size_mm + 2 * lens.bleed_mm) ** 2
    if material:
        volume = base * (high if isinstance(machine, Mill) else lens.thickness_mm)
        yield "Material", material_text(volume, machine, material), ""
    if isinstance(machine, Printer):
        layers = round(high / machine.layer)
        yield "Printing", f"at most {layers} layers; at {_LAYER_S:g} s each {layers * _LAYER_S / 3600:.1f} hours", ""
    elif isinstance(machine, Mill):
        yield "Milling", "hours are in its program, after the full design", ""
    if machine:
        found = check_detail(lens, machine)
        yield "Detail", found.text, found.status
    yield "Facets", f"{lens.facets} x {lens.facets}, each {lens.pitch_mm:.3g} mm; {lens.thickness_mm:g} mm thick", ""


def _designing(plan: Plan) -> Row:
    from magiclens.running.estimate import estimate
    from magiclens.running.feasible import duration_text

    return "Full design", f"about {duration_text(estimate(plan).seconds)}, give or take a factor of three", ""


def _equal_job(folder: Path, store: StudioFolder) -> dict[str, Any] | None:
    """The best run of a job that was made from the same files."""
    files = {path.name: path.read_bytes() for path in folder.iterdir()}
    for job in reversed(store.jobs()):
        there = store.root / "jobs" / job
        same = (there / SPEC).is_file() and all(_holds(there / name, content) for name, content in files.items())
        runs = (run_summary(there / want) for want in reversed(WANTS)) if same else iter(())
        if found := next(filter(None, runs), None):
            return found
    return None


def _holds(path: Path, content: bytes) -> bool:
    return path.is_file() and path.stat().st_size == len(content) and path.read_bytes() == content


def _shown(run: dict[str, Any] | None) -> Iterator[Row]:
    verdict = run and run["verdict"]
    yield ("Verdict", verdict["text"], verdict["status"]) if verdict else ("Verdict", "after the draft", "")
    tolerances = run["tolerances"][:_MOST_TOLERANCES] if run else []
    yield "Tolerance", "; ".join(tolerances) or "after the full design", ""
