"""Coupons: what is written for a printer, and what is read from photographs of coupons that the reader has not made."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from coupons import Truth, made_coupon, path_traced, traced, write_photograph
from magiclens.cli import app
from magiclens.contract.errors import InputError
from magiclens.coupon import fit
from magiclens.coupon.fit import Fitted, Reading
from magiclens.coupon.photograph import _stated_focal, read_photograph
from magiclens.coupon.shape import coupon_solid, printing_minutes
from magiclens.coupon.sheet import SHEET_PX_PER_MM, marker_corners, sheet_picture
from magiclens.coupon.write import coupon_of, printed_raster, printer_called
from magiclens.meshing.validation import validate
from magiclens.plan.compile import compile_plan
from magiclens.profiles.machines import Printer, machines

TRUTHS = {
    "bare": Truth(0.088, 0.0, 1.51),
    "thin coat": Truth(0.05, 0.5, 1.535, (-0.3, 0.2, -0.6), (-70.0, 40.0, 280.0)),
    "thick coat": Truth(0.035, 0.9, 1.485, (0.1, 0.35, 0.3), (20.0, -110.0, 300.0), exposure=0.8, noise=0.006),
}


def mlens(*arguments: object) -> Any:
    return CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.mark.sweep
@pytest.mark.parametrize("name", TRUTHS)
def test_process_and_index_are_read_from_path_traced_photographs(name: str, tmp_path: Path) -> None:
    """The reader knows layers and pixels of the printer; process, index, camera and exposure it has to find."""
    truth, photo = TRUTHS[name], tmp_path / "photo.jpg"
    write_photograph(path_traced(truth), truth, photo)
    assert mlens("coupon", "--machine", "sla", "--out", tmp_path / "coupon").exit_code == 0
    done = mlens("coupon", "read", photo, "--coupon", tmp_path / "coupon", "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.output)
    assert found["spread"]["value"] == pytest.approx(truth.spread, rel=0.1)
    assert found["ior"]["value"] == pytest.approx(truth.ior, abs=0.005)
    if truth.levelling:
        assert found["levelling"]["value"] == pytest.approx(truth.levelling, rel=0.1)
    else:
        assert found["levelling"] is None
    assert found["distance"] == pytest.approx(truth.eye[2], rel=0.02)
    assert found["misfit"] < 0.12


@pytest.mark.parametrize("name", [name for name, profile in machines().items() if profile.model is Printer])
def test_coupons_are_closed_and_quickly_printed(name: str) -> None:
    printer = printer_called(name)
    solid = coupon_solid(printer.layer)
    assert validate(solid).flaws == ()
    assert np.ptp(solid.vertices, axis=0)[:2] == pytest.approx((40, 30))
    assert solid.vertices[:, 2].max() < 4.3
    z = solid.vertices[: solid.grid[0] * solid.grid[1], 2]  # type: ignore[index]
    assert z.min() > printer.thickness[0]
    if printer.layer >= 0.02:  # printers of optics build far thinner layers
        assert 5 < printing_minutes(solid, printer) < 20


@pytest.mark.tools
def test_a_coupons_folder_has_all_that_is_needed(tmp_path: Path) -> None:
    done = mlens("coupon", "--machine", "printing", "--out", tmp_path / "c", "--json")
    assert done.exit_code == 0, done.output
    told = json.loads(done.output)
    names = {path.name for path in (tmp_path / "c").iterdir()}
    assert names == {"coupon.json", *told["files"]}
    assert names == {"coupon.json", "coupon.stl", "coupon.3mf", "coupon.slices.zip", "sheet.png", "sheet.pdf"}
    assert coupon_of(tmp_path / "c") == ("printing", printer_called("printing"))
    with Image.open(tmp_path / "c" / "sheet.png") as sheet:
        assert sheet.info["dpi"] == pytest.approx((600, 600), abs=0.1)
        assert np.asarray(sheet, float) / 255 == pytest.approx(sheet_picture(), abs=0.01)


def test_markers_are_where_they_are_said_to_be() -> None:
    sheet = sheet_picture()
    height, width = sheet.shape
    for (left, top), _, (right, bottom), _ in marker_corners():
        columns = [round(width / 2 + x * SHEET_PX_PER_MM) for x in (left, right)]
        rows = [round(height / 2 - y * SHEET_PX_PER_MM) for y in (top, bottom)]
        marker = sheet[rows[0] : rows[1], columns[0] : columns[1]]
        assert (marker[[0, -1]].max(), marker[:, [0, -1]].max()) == (0, 0), "the outermost row is black"
        assert sheet[rows[0] - 1, columns[0] : columns[1]].min() == 1


@pytest.mark.tools
def test_a_photograph_by_the_built_in_tracer_is_understood(tmp_path: Path) -> None:
    """At small size, and begun near the truth, so that it is quick; the whole way is gone in the tools tier."""
    truth = Truth(0.08, 0.45, 1.52, eye=(40.0, -60.0, 230.0))
    write_photograph(traced(truth), truth, tmp_path / "photo.jpg")
    photograph = read_photograph(tmp_path / "photo.jpg")
    assert len(photograph.points_px) == 64
    start = fit._beginning(photograph)
    assert (start.camera_x, start.camera_y, start.camera_z) == pytest.approx(truth.eye, abs=3)
    x, y, turn = truth.lying
    start = start._replace(shift_x=x, shift_y=y, turn=math.radians(turn), gap=0.05)
    fitting = fit._Fit(printed_raster(printer_called("printing")), photograph, 2, start)
    at = fitting.solved(start, ("variance", "fourth", "ior", "blur_px"))
    assert math.sqrt(at.variance) == pytest.approx(truth.spread, rel=0.1)
    assert at.fourth**0.25 == pytest.approx(truth.levelling, rel=0.1)
    assert at.ior == pytest.approx(truth.ior, abs=0.01)


def test_what_is_read_is_what_a_spec_takes() -> None:
    number = Fitted(0.0, 0.0)
    found = Reading(Fitted(0.0497, 3e-4), Fitted(0.501, 1e-3), Fitted(1.5347, 5e-4), number, 280.0, 0.04)
    text = found.as_text("sla")
    lines = [line for line in text.splitlines() if line.startswith(("fabrication:", "lens:"))]
    spec = "scenario: {type: single, source: {type: circles}, target: {art: heart}}\n" + "\n".join(lines)
    plan = planned(spec)
    process = plan.fabrication.machine.linear_process
    assert (process.spread, process.levelling) == (0.0497, 0.501)
    assert plan.lens.ior == 1.5347
    bare = replace(found, levelling=None)
    assert "none" in bare.as_text("sla")
    assert "lacquer" not in bare.spec("sla")["fabrication"]


def planned(spec: str) -> Any:
    from ruamel.yaml import YAML

    from magiclens.config.document import document_of
    from magiclens.plan.registry import Registry

    return compile_plan(document_of(YAML(typ="safe").load(spec)), Registry.load())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--machine", "slaa"], "--machine: unknown printer 'slaa'; did you mean 'sla'?"),
        (["--machine", "egx-600"],
         "--machine: 'egx-600' is a mill; coupons are printed by: droplet-optics, grey-projection, lcd-12k, "
         "lcd-16k, lcd-8k, polyjet-600x300, polyjet-matte, printing, sla"),
        ([], "--machine: name the printer that makes the coupon, such as --machine sla"),
        (["read"], "PHOTO: name the photograph: mlens coupon read PHOTO.jpg"),
        (["read", "photo.png", "--coupon", "."],
         "--coupon: '.' has no coupon.json; write a coupon with 'mlens coupon --machine NAME'"),
    ],
)  # fmt: skip
def test_wrong_words_are_answered(
    arguments: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = mlens("coupon", *arguments)
    assert done.exit_code == 2
    assert done.output == f"error: {message}\n"
    assert list(tmp_path.iterdir()) == []


def test_strange_files_are_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "letter.txt").write_text("dear", encoding="utf-8")
    done = mlens("coupon", "--machine", "sla", "--out", tmp_path)
    assert done.exit_code == 2
    assert [path.name for path in tmp_path.iterdir()] == ["letter.txt"]


def test_photographs_of_something_else_are_refused(tmp_path: Path) -> None:
    Image.fromarray(np.full((300, 400), 90, np.uint8)).save(tmp_path / "grey.png")
    with pytest.raises(InputError, match="0 of the sheet's 16 markers are seen, 8 are needed"):
        read_photograph(tmp_path / "grey.png")
    sheet = Image.fromarray(np.rint(255 * sheet_picture()).astype(np.uint8))
    sheet.resize((520, 462)).save(tmp_path / "far.png")
    with pytest.raises(InputError, match=r"only 5\.8 pixels per mm"):
        read_photograph(tmp_path / "far.png")


def test_the_focal_length_is_taken_from_the_file(tmp_path: Path) -> None:
    """Files state it for film of 36 x 24 mm, by the diagonal."""
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 28
    Image.new("L", (360, 240)).save(tmp_path / "photo.jpg", exif=exif)
    assert _stated_focal(tmp_path / "photo.jpg", (240, 360)) == pytest.approx(280)
    Image.new("L", (360, 240)).save(tmp_path / "silent.jpg")
    assert _stated_focal(tmp_path / "silent.jpg", (240, 360)) is None


def test_the_made_coupon_is_a_closed_body() -> None:
    assert made_coupon(TRUTHS["bare"]).vertices[:, 2].min() == pytest.approx(0.05)
