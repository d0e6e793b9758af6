"""Writes the folder of a coupon: the part for the printer, the sheet for below it, and what reads photographs of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from magiclens.config.suggest import unknown
from magiclens.contract.artifacts import Solid
from magiclens.contract.errors import InputError
from magiclens.coupon.model import LayeredTop
from magiclens.coupon.shape import DEPTH_MM, WIDTH_MM, coupon_solid, features_data, printing_minutes
from magiclens.profiles.machines import Printer, machines

COUPON = "coupon.json"
"""File of a coupon's folder that says what was made, for which machine."""
_KIND = "magiclens coupon"


def printer_called(name: str) -> Printer:
    """The listed printer of that name.

    Raises:
        InputError: There is none; the nearest name is proposed. Or it is a mill, which has no layers and no blur.
    """
    known = {each: profile for each, profile in machines().items() if profile.model is Printer}
    if name not in known:
        if name in machines():
            raise InputError(f"{name!r} is a mill; coupons are printed by: {', '.join(sorted(known))}", "--machine")
        raise InputError(unknown("printer", name, known), "--machine")
    machine = known[name].machine()
    assert isinstance(machine, Printer)
    return machine


def write_coupon(name: str, place: Path) -> dict[str, Any]:
    """Write the coupon for a listed printer.

    Args:
        name: The machine.
        place: The folder. Nothing is there, or an older coupon.

    Returns:
        The manifest, as in ``coupon.json``.

    Raises:
        InputError: There is no such printer, or something else is at the place.
    """
    from magiclens.coupon.sheet import write_sheet
    from magiclens.running.replacing import atomic_folder

    printer = printer_called(name)
    if place.exists() and any(place.iterdir() if place.is_dir() else [place]) and not (place / COUPON).is_file():
        raise InputError(f"'{place}' is there already and is not a coupon's folder; choose another --out", "--out")
    solid = coupon_solid(printer.layer)
    manifest = _manifest(name, printer, solid)
    with atomic_folder(place.resolve()) as folder:
        _write_part(solid, printer, folder)
        write_sheet(folder)
        manifest["files"] = sorted(path.name for path in folder.iterdir())
        (folder / COUPON).write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
    return manifest


def coupon_of(folder: Path) -> tuple[str, Printer]:
    """The name of the machine that a coupon's folder was written for, and the machine.

    Raises:
        InputError: It is no such folder.
    """
    try:
        manifest = json.loads((folder / COUPON).read_text(encoding="utf-8"))
        kind, name, options = manifest["kind"], manifest["machine"], manifest["options"]
        machine = Printer.model_validate(options)
    except (OSError, ValueError, KeyError, TypeError):
        wish = f"'{folder}' has no {COUPON}"
        raise InputError(f"{wish}; write a coupon with 'mlens coupon --machine NAME'", "--coupon") from None
    if kind != _KIND:
        raise InputError(f"{COUPON} in '{folder}' is that of another program", "--coupon")
    return str(name), machine


def printed_raster(printer: Printer) -> LayeredTop:
    """The coupon in the printer's layers and pixels, before anything evens it out."""
    from magiclens.simulation.as_printed import in_layers

    return LayeredTop(*in_layers(coupon_solid(printer.layer), printer))


def _write_part(solid: Solid, printer: Printer, folder: Path) -> None:
    from magiclens.contract.artifacts import Lens, Scene
    from magiclens.exporting.mesh_files import Stl
    from magiclens.exporting.slices import Slices
    from magiclens.exporting.three_mf import ThreeMf

    scene = Scene(Lens(size_mm=WIDTH_MM, source_size_mm=WIDTH_MM), ())  # exporters of meshes ask for the size
    for exporter in (Stl(), ThreeMf(), Slices.model_validate(printer.exporters()["slices"])):
        exporter.export(scene, solid, folder / f"coupon{exporter.suffix}")


def _manifest(name: str, printer: Printer, solid: Solid) -> dict[str, Any]:
    height = float(np.round(solid.vertices[:, 2].max(), 6))
    return {
        "kind": _KIND,
        "machine": name,
        "size_mm": [WIDTH_MM, DEPTH_MM, height],
        "minutes": round(printing_minutes(solid, printer), 1),
        "options": printer.model_dump(mode="json", exclude_none=True),
        "features": features_data(),
    }
