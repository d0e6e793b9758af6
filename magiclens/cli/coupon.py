"""The command that writes a coupon and reads photographs of it: ``mlens coupon``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from magiclens.cli.common import AsJson, Quiet, Traceback, print_result, reporting
from magiclens.contract.errors import InputError

if TYPE_CHECKING:
    from magiclens.coupon.fit import Reading

_PLACE = Path("out", "coupon")


class CouponAction(StrEnum):
    """What ``mlens coupon`` can do beside writing a coupon."""

    read = "read"


def coupon_command(
    action: Annotated[
        CouponAction | None,
        typer.Argument(help="Read a photograph; without it, a coupon is written.", show_default=False),
    ] = None,
    photo: Annotated[
        Path | None, typer.Argument(metavar="PHOTO", help="For read: the photograph.", show_default=False)
    ] = None,
    machine: Annotated[
        str | None, typer.Option("--machine", metavar="NAME", help="The printer that makes the coupon.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="The folder to write.")] = _PLACE,
    coupon: Annotated[
        Path, typer.Option("--coupon", metavar="DIR", help="For read: the folder of the coupon.")
    ] = _PLACE,
    quiet: Quiet = False,
    as_json: AsJson = False,
    traceback: Traceback = False,
) -> None:
    """Write a small part to print, or read what its photograph says of blur, finish and index of refraction."""
    with reporting(traceback):
        if action is CouponAction.read:
            _read(photo, coupon, quiet, as_json)
        elif machine is None:
            raise InputError("name the printer that makes the coupon, such as --machine sla", "--machine")
        else:
            from magiclens.coupon.write import write_coupon

            made = write_coupon(machine, out)
            print_result(lambda: _written_text(out, made), lambda: {"folder": str(out), **made}, quiet, as_json)


def _read(photo: Path | None, folder: Path, quiet: bool, as_json: bool) -> None:
    from magiclens.coupon.fit import read_coupon
    from magiclens.coupon.photograph import read_photograph
    from magiclens.coupon.write import coupon_of, printed_raster

    if photo is None:
        raise InputError("name the photograph: mlens coupon read PHOTO.jpg", "PHOTO")
    name, printer = coupon_of(folder)
    found = read_coupon(printed_raster(printer), read_photograph(photo))
    print_result(lambda: found.as_text(name), lambda: _reading_data(name, found), quiet, as_json)


def _written_text(folder: Path, made: dict[str, Any]) -> str:
    width, depth, height = made["size_mm"]
    return (
        f"{folder}: {', '.join(made['files'])}\n"
        f"{width:g} x {depth:g} x {height:g} mm; about {made['minutes']:.0f} minutes on a desktop resin printer\n"
        "Print sheet.pdf at 100 %, lay the coupon on it, photograph both, then:\n"
        f"mlens coupon read PHOTO.jpg --coupon {folder}"
    )


def _reading_data(name: str, found: Reading) -> dict[str, Any]:
    from dataclasses import asdict

    return {"machine": name, **asdict(found), "spec": found.spec(name)}
