"""Layers of voxels fill the solid, wherever its surface runs."""

from __future__ import annotations

import io
import json
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest
from PIL import Image

from fabricated import EYE, LENS, Eye, box, bumpy, flat, together, winding, written
from magiclens.contract.artifacts import BoolArray, FloatArray, Lens, Scene, Solid
from magiclens.contract.errors import InputError
from magiclens.exporting.mesh_files import Stl
from magiclens.exporting.png import png
from magiclens.exporting.slices import LayerStack, Sl1, Slices
from magiclens.geometry.solid import volume
from magiclens.kernels.spreading import spreading_by
from magiclens.plan.compile import load_plan
from magiclens.profiles.machines import Printer, machines
from magiclens.simulation.as_printed import as_printed, in_layers
from toys import TOYS, Others, SpecWriter, registry_of

MILLIMETRE = {"dpi_x": 25.4, "dpi_y": 25.4, "layer": "1mm"}
FINE = {"dpi_x": 400.0, "dpi_y": 250.0, "layer": "60um"}


def stack(solid: Solid, folder: Path, **options: Any) -> tuple[BoolArray, dict[str, Any], FloatArray]:
    """The voxels (layers, rows, columns), the manifest, and the voxels' centres (layers, rows, columns, 3)."""
    with ZipFile(written(Slices(**options), folder, solid)) as archive:
        facts = json.loads(archive.read("manifest.json"))
        files = [io.BytesIO(archive.read(f"layer-{k:05d}.png")) for k in range(facts["layers"])]
        layers = [np.asarray(Image.open(file)) for file in files]
        assert len(archive.namelist()) == len(layers) + 1
    (dx, dy), dz, (x, y, z) = facts["pixel_mm"], facts["layer_mm"], facts["first_voxel_mm"]
    voxels = np.array(layers)
    k, i, j = np.indices(voxels.shape)
    return voxels, facts, np.stack([x + j * dx, y - i * dy, z + k * dz], axis=-1)


@pytest.mark.parametrize("eye", [None, EYE, (60.0, 0.0, 60.0)], ids=["vertical", "eye", "leaning far"])
def test_a_voxel_is_filled_if_its_centre_is_in_the_solid(eye: Eye, tmp_path: Path) -> None:
    solid = bumpy(eye)
    voxels, _, centres = stack(solid, tmp_path, **FINE)
    rng = np.random.default_rng(0)
    rough = abs(centres[:, 0, 0, 2] - LENS.thickness_mm) < 0.6
    for band in (rough, ~rough):
        some = rng.integers(band.sum() * voxels[0].size, size=400)
        turns = winding(solid, centres[band].reshape(-1, 3)[some])
        clear = abs(turns - turns.round()) < 1e-6
        assert clear.mean() > 0.95
        assert np.array_equal(voxels[band].reshape(-1)[some][clear], turns[clear] > 0.5)
    assert 0.1 < voxels[rough].mean() < 0.9


@pytest.mark.parametrize("eye", [None, EYE], ids=["vertical", "eye"])
def test_voxels_have_the_volume_of_the_mesh(eye: Eye, tmp_path: Path) -> None:
    solid = bumpy(eye)
    voxels, facts, _ = stack(solid, tmp_path)
    assert facts["filled_mm3"] == pytest.approx(solid.metrics["volume_mm3"], rel=0.005)
    assert facts["filled_mm3"] == pytest.approx(voxels.sum() * np.prod([*facts["pixel_mm"], facts["layer_mm"]]))


def test_default_resolution_of_a_leaning_slab_has_its_volume(tmp_path: Path) -> None:
    lens = Lens(size_mm=12.0, facets=2, microfacets=4, thickness_mm=6.0, floor_mm=15.0)
    solid = bumpy((3.0, 1.0, 80.0), lens=lens)
    _, facts, _ = stack(solid, tmp_path)
    assert facts["filled_mm3"] == pytest.approx(solid.metrics["volume_mm3"], rel=0.005)


def test_lines_along_edges_and_through_vertices_cross_the_surface_once(tmp_path: Path) -> None:
    """The middle row and the middle column run through vertices of the middle facet."""
    voxels, facts, centres = stack(flat(), tmp_path, dpi_x=252.0, dpi_y=252.0, layer="0.5mm")
    assert facts["pixels"] == [99, 99]
    assert abs(centres[0, 49, 49, :2]).max() < 1e-12
    assert voxels.all()


def test_air_between_bodies_stays_empty(tmp_path: Path) -> None:
    solid = together(box((0, 0, 0), (4, 3, 2)), box((1, 0, 5), (4, 3, 6)))
    voxels, _, _ = stack(solid, tmp_path, **MILLIMETRE)
    expected = np.zeros((6, 3, 4), bool)
    expected[:2] = True
    expected[5, :, 1:] = True
    assert np.array_equal(voxels, expected)


@pytest.mark.parametrize("slicing", ["plain", "diffused"])
def test_columns_without_a_body_stay_empty(slicing: str, tmp_path: Path) -> None:
    solid = together(box((0, 0, 0), (4, 3, 2)), box((6, 0, 0), (8, 3, 5)))
    voxels, facts, _ = stack(solid, tmp_path, **MILLIMETRE, slicing=slicing)
    expected = np.zeros((5, 3, 8), bool)
    expected[:2, :, :4] = expected[:, :, 6:] = True
    assert np.array_equal(voxels[:5], expected)
    assert not voxels[5:].any(), "error diffusion may use more layers"
    assert facts["filled_mm3"] == pytest.approx(4 * 3 * 2 + 2 * 3 * 5)


@pytest.mark.parametrize("options", [{}, {"slicing": "diffused"}, {"grey": {}}])
def test_a_tower_of_one_voxel_ends_where_it_ends(options: dict[str, Any], tmp_path: Path) -> None:
    solid = together(box((0, 0, 0), (4, 3, 2)), box((6, 0, 0), (7, 1, 5)))
    voxels, _, _ = stack(solid, tmp_path, **MILLIMETRE, **options)
    assert [int((layer > 0).sum()) for layer in voxels[:5]] == [13, 13, 1, 1, 1]
    assert not voxels[5:].any()


def test_a_body_that_leans_over_is_filled_where_it_is(tmp_path: Path) -> None:
    """A prism sheared by 45 degrees: its layers move along +x, one pixel per layer."""
    upright = box((0, 0, 0), (2, 3, 6))
    leaning = Solid(upright.vertices + upright.vertices[:, 2:] * np.array([1.0, 0.0, 0.0]), upright.faces)
    voxels, _, centres = stack(leaning, tmp_path, **MILLIMETRE | {"dpi_x": 254.0})
    x, z = centres[..., 0], centres[..., 2]
    assert np.array_equal(voxels, (x >= z) & (x < z + 2))
    assert volume(leaning) == pytest.approx(36)


def test_layers_start_at_the_bottom_rows_at_plus_y_and_columns_at_minus_x(tmp_path: Path) -> None:
    solid = together(box((-2, -3, 0), (2, 3, 1)), box((1, 2, 2), (2, 3, 3)))
    voxels, facts, _ = stack(solid, tmp_path, **MILLIMETRE)
    assert voxels[0].all()
    assert not voxels[1].any()
    assert np.argwhere(voxels[2]).tolist() == [[0, 3]]
    assert facts["first_voxel_mm"] == pytest.approx([-1.5, 2.5, 0.5])


def test_pixels_may_be_oblong_and_files_know_it(tmp_path: Path) -> None:
    path = written(Slices(dpi_x=600, dpi_y=300, layer="1mm"), tmp_path, flat())
    with ZipFile(path) as archive:
        facts = json.loads(archive.read("manifest.json"))
        image = Image.open(io.BytesIO(archive.read("layer-00003.png")))
    assert (image.mode, image.size) == ("1", (236, 118))
    assert image.info["dpi"] == pytest.approx((600, 300), rel=1e-4)
    assert (facts["pixels"], facts["layers"]) == ([236, 118], 8)
    assert facts["pixel_mm"] == pytest.approx([25.4 / 600, 25.4 / 300])


@pytest.mark.parametrize("width", [1, 8, 13])
def test_layers_are_png_files_of_bits_or_of_grey(width: int) -> None:
    pixels = np.random.default_rng(width).integers(0, 2, (5, width), np.uint8)
    bits, grey = png(np.packbits(pixels, axis=1), (600, 300), width), png(255 * pixels, (600, 300))
    for content, mode in ((bits, "1"), (grey, "L")):
        image = Image.open(io.BytesIO(content))
        image.verify()  # that every part has the right checksum
        image = Image.open(io.BytesIO(content))
        assert image.mode == mode
        assert image.info["dpi"] == pytest.approx((600, 300), rel=1e-4)
        assert np.array_equal(np.asarray(image) > 0, pixels > 0)


def test_layers_that_are_alike_have_equal_bytes(tmp_path: Path) -> None:
    with ZipFile(written(Slices(layer="1mm"), tmp_path, flat())) as archive:
        assert len({archive.read(name) for name in archive.namelist() if name.endswith(".png")}) == 1


def test_equal_solids_give_equal_bytes_and_others_do_not(tmp_path: Path) -> None:
    solids = {"one": bumpy(), "same": bumpy(), "other": bumpy(seed=6)}
    one, same, other = (written(Slices(**FINE), tmp_path / n, s).read_bytes() for n, s in solids.items())
    assert one == same
    assert one != other
    with ZipFile(tmp_path / "one" / "lens.slices.zip") as archive:
        assert {info.date_time for info in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("layer: 27", "layer: 27 is a bare number; a length needs a unit, such as '27mm'"),
        ("layer: 0mm", "layer: must be at least 1e-06mm"),
        ("dpi_x: 5", "dpi_x: must be at least 10"),
        ("dpi: 600", "dpi: unknown option; did you mean 'dpi_"),
    ],
)
def test_wrong_options_are_explained(option: str, message: str, write_spec: SpecWriter) -> None:
    spec = write_spec(("exporters: [{type: toy}]", f"exporters: [{{type: slices, {option}}}]"))
    with pytest.raises(InputError) as caught:
        load_plan(spec, registry=registry_of(*TOYS, Slices))
    assert f"pipeline.exporters.0.{message}" in str(caught.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dpi_x": 9999, "dpi_y": 9999}, "39366 x 39366 pixels, more than 100,000,000; lower dpi_x and"),
        ({"dpi_x": 10, "dpi_y": 10, "layer": "0.01um"}, "800000 layers, more than 100,000; raise layer, now 1e-05mm"),
    ],
)
def test_stacks_too_large_to_make_are_refused(options: dict[str, Any], message: str, tmp_path: Path) -> None:
    lens = Lens(facets=2, microfacets=1, thickness_mm=8.0)
    with pytest.raises(InputError) as caught:
        Slices(**options).export(Scene(lens, ()), flat(lens), tmp_path / "lens.slices.zip")
    assert message in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_diffused_columns_have_the_right_mean_height(tmp_path: Path) -> None:
    lens = replace(LENS, thickness_mm=8.013)  # 0.52 layers above whole ones
    options = {**FINE, "layer": "25um"}
    plain, diffused = (stack(flat(lens), tmp_path, **options, slicing=s)[0] for s in ("plain", "diffused"))
    heights = diffused.sum(axis=0)
    assert np.ptp(plain.sum(axis=0)) == 0
    assert np.ptp(heights) == 1
    assert heights.mean() * 0.025 == pytest.approx(8.013, abs=0.002)
    assert (np.diff(diffused.astype(int), axis=0) <= 0).all(), "no voxel hangs in the air"


@pytest.mark.parametrize("process", [{}, {"spread": "0.1mm"}])
def test_diffused_slices_are_what_is_simulated(tmp_path: Path, process: dict[str, str]) -> None:
    solid = bumpy(None)
    options = {"dpi_x": 508.0, "dpi_y": 508.0, "layer": "50um", "slicing": "diffused", "process": process}
    voxels, facts, _ = stack(solid, tmp_path, **options)
    assert facts["slicing"] == "diffused"
    profile = machines()["sla"]
    own = {"blur": process.get("spread", "0mm"), "polish": "0mm"}
    raw = {"dpi": [508, 508], "layer": "50um", **own, "slicing": "diffused"}
    printer = profile.model.model_validate({**profile.options, **raw})
    assert isinstance(printer, Printer)
    z, _, _ = in_layers(solid, printer)
    assert z.shape == voxels.shape[1:]
    assert np.array_equal(np.rint(z / 0.05), np.maximum(voxels.sum(axis=0), 1))


GREY = {"grey": {"bits": 3}, "slicing": "diffused"}


def test_grey_tops_of_columns_have_the_height_that_the_table_says(tmp_path: Path) -> None:
    solid = bumpy(None)
    pixels, facts, _ = stack(solid, tmp_path, **FINE, **GREY)
    assert facts["bits"] == 3
    share = np.zeros(256)
    values, shares = np.array(facts["table"]).T
    share[values.astype(int)] = shares
    assert set(np.unique(pixels)) == set(values.astype(int))
    heights = share[pixels].sum(axis=0) * facts["layer_mm"]
    assert facts["filled_mm3"] == pytest.approx(heights.sum() * np.prod(facts["pixel_mm"]))
    # the box of voxels is not quite the solid's
    assert facts["filled_mm3"] == pytest.approx(volume(solid), rel=1e-2)
    assert facts["filled_mm3"] == pytest.approx(stack(solid, tmp_path, **FINE)[1]["filled_mm3"], rel=1e-5)
    # below a column's top all is white
    top = (pixels > 0).sum(axis=0)
    assert np.all(np.where(np.arange(len(pixels))[:, None, None] < top - 1, pixels == 255, True))
    plain, _, _ = stack(solid, tmp_path, **FINE, slicing="diffused")
    assert np.abs(heights - plain.sum(axis=0) * facts["layer_mm"]).max() < 2 * facts["layer_mm"]


def test_what_ends_in_the_first_layer_is_not_in_the_second(tmp_path: Path) -> None:
    low, high = box((0, 0, 0), (3, 2, 1)), box((5, 0, 0), (8, 2, 3))
    pixels, _, _ = stack(together(low, high), tmp_path, **MILLIMETRE, grey={"bits": 3})
    assert (pixels[:, :, :3] > 0).any(axis=(1, 2)).tolist() == [True, False, False]
    assert (pixels[:, :, 5:] == 255).all()


def test_a_layer_that_differs_from_the_one_below_in_one_grey_voxel_is_written(tmp_path: Path) -> None:
    wide, pin = box((0, 0, 0), (3, 2, 5)), box((5, 0, 0), (6, 1, 2.5))
    pixels, _, _ = stack(together(wide, pin), tmp_path, **MILLIMETRE, grey={"bits": 3})
    assert pixels[:2, -1, 5].tolist() == [255, 255]
    assert 0 < pixels[2, -1, 5] < 255
    assert (pixels[3:, -1, 5] == 0).all()


def test_grey_slices_are_what_is_simulated(tmp_path: Path) -> None:
    solid = bumpy(None)
    options = {**machines()["lcd-12k"].options, "dpi": (400.0, 250.0), "layer": "60um", "blur": "0mm", "polish": "0mm"}
    made = as_printed(solid, Printer.model_validate({**options, "slicing": "diffused"}))
    pixels, facts, _ = stack(solid, tmp_path, **FINE, **GREY)
    share = np.interp(pixels, *np.array(facts["table"]).T)
    heights = share.sum(axis=0) * 0.06
    assert made.grid == heights.shape
    simulated = made.vertices[: heights.size, 2].reshape(heights.shape)
    assert np.abs(simulated - heights).mean() < 0.06 / 20


def test_an_sl1_archive_shows_the_lens_mirrored_in_the_middle_of_the_screen(tmp_path: Path) -> None:
    options = {**FINE, **GREY, "bed": ("30mm", "24mm", "50mm")}
    solid = bumpy(None)
    pixels, _, _ = stack(solid, tmp_path, **FINE, **GREY)
    with ZipFile(written(Sl1(**options), tmp_path, solid)) as archive:
        job, settings = (
            dict(line.split(" = ") for line in archive.read(name).decode().splitlines())
            for name in ("config.ini", "prusaslicer.ini")
        )
        names = [name for name in archive.namelist() if name.endswith(".png")]
        screens = np.array([np.asarray(Image.open(io.BytesIO(archive.read(name)))) for name in names])
    assert names == [f"{job['jobDir']}{k:05d}.png" for k in range(len(pixels))]
    assert float(job["layerHeight"]) == float(settings["layer_height"]) == 0.06
    columns, rows = int(settings["display_pixels_x"]), int(settings["display_pixels_y"])
    assert (columns, rows) == (round(30 * 400 / 25.4), round(24 * 250 / 25.4))
    assert screens.shape == (len(pixels), rows, columns)
    assert settings["display_mirror_x"] == "1"
    top, left = ((big - small) // 2 for big, small in zip(screens.shape[1:], pixels.shape[1:], strict=True))
    middle = screens[:, top : top + pixels.shape[1], left : left + pixels.shape[2]]
    assert np.array_equal(middle[:, :, ::-1], pixels)
    assert screens.sum(dtype=np.int64) == pixels.sum(dtype=np.int64)  # all else is dark
    assert not np.array_equal(pixels, pixels[:, :, ::-1])


def test_a_lens_larger_than_the_screen_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"the lens has \d+ x \d+ pixels, the screen"):
        written(Sl1(**FINE, bed=("8mm", "24mm", "50mm")), tmp_path, bumpy(None))


TILT = {"tilt": {"about": "y", "angle": "30deg"}}


@pytest.mark.parametrize("options", [{}, {"slicing": "diffused"}, GREY, TILT, {**GREY, **TILT}])
@pytest.mark.parametrize("exporter", [Slices, Sl1])
def test_layers_that_others_pack_have_the_same_bytes(
    exporter: type[LayerStack], options: dict[str, Any], tmp_path: Path
) -> None:
    # a slab with a tower: the blocks of layers begin where layers change, and where they do not
    solid, others = together(bumpy(None), box((0, 0, 0), (3, 2, 20))), Others(3)
    alone = written(exporter(**FINE, **options), tmp_path / "alone", solid).read_bytes()
    with spreading_by(others):
        spread = written(exporter(**FINE, **options), tmp_path / "spread", solid).read_bytes()
    assert len(others.items) == 14
    assert spread == alone


@pytest.mark.parametrize("options", [{}, {"slicing": "diffused"}, GREY])
def test_layers_of_a_tilted_lens_hold_it_as_it_stands(tmp_path: Path, options: dict[str, Any]) -> None:
    solid = bumpy(None)
    voxels, facts, centres = stack(solid, tmp_path, **FINE, **TILT, **options)
    assert facts["tilt"] == {"about": "y", "angle_deg": 30.0}
    stood = Slices(**TILT)._standing(solid)
    assert facts["filled_mm3"] == pytest.approx(volume(solid), rel=5e-3)
    some = np.random.default_rng(0).integers(voxels.size, size=600)
    turns = winding(stood, centres.reshape(-1, 3)[some])
    clear = abs(turns - turns.round()) < 1e-6
    right = (voxels.reshape(-1)[some][clear] > 0) == (turns[clear] > 0.5)
    assert right.mean() > (0.999 if not options else 0.98), "diffusion moves tops by a layer or two"
    # the edge at -x is lifted: nothing lies on the plate there
    assert not voxels[0, :, : voxels.shape[2] // 2].any()


@pytest.mark.tools
def test_prusaslicer_reads_the_settings_of_an_sl1_and_makes_the_same_screens(tmp_path: Path) -> None:
    """Its command line opens no archives, but slices the mesh with their settings, which it must all know."""
    solid = bumpy(None)
    mesh = written(Stl(), tmp_path, solid)
    archive = written(Sl1(dpi_x=400.0, dpi_y=250.0, layer="100um", bed=("30mm", "24mm", "50mm")), tmp_path, solid)
    ours, settings = screens_of(archive)
    (tmp_path / "ours.ini").write_text(settings, encoding="utf-8")
    options = ["--supports-enable=0", "--pad-enable=0", "--center", "15,12", "--output", tmp_path / "theirs.sl1"]
    slicing = ["prusa-slicer", "--export-sla", "--load", tmp_path / "ours.ini", *options, mesh]
    subprocess.run(slicing, check=True, capture_output=True)
    theirs, kept = screens_of(tmp_path / "theirs.sl1")
    pairs = ([line.split(" = ", 1) for line in text.splitlines() if " = " in line] for text in (settings, kept))
    wanted, got = map(dict, pairs)
    numbers = {"initial_exposure_time": "30"}
    assert {key: got[key] for key in wanted} == {**wanted, **numbers}
    assert ours.shape[1:] == theirs.shape[1:]
    common = min(len(ours), len(theirs))
    assert abs(len(ours) - len(theirs)) <= 1
    both = (ours[:common], ours[:common, :, ::-1])
    same, mirrored = (((each > 127) != (theirs[:common] > 127)).mean(axis=(1, 2)) for each in both)
    assert same.max() < 0.005, "they differ by pixels of the outline"
    assert mirrored.max() > 10 * same.max()


def screens_of(archive: Path) -> tuple[FloatArray, str]:
    """The screens (layers, rows, columns) of an SL1 archive, and its settings."""
    with ZipFile(archive) as file:
        names = sorted(name for name in file.namelist() if name.endswith(".png") and "/" not in name)
        screens = [np.asarray(Image.open(io.BytesIO(file.read(name))).convert("L")) for name in names]
        return np.array(screens), file.read("prusaslicer.ini").decode()


def test_files_of_solid_layers_are_small(tmp_path: Path) -> None:
    path = written(Slices(dpi_x=2000, dpi_y=2000, layer="20um"), tmp_path, flat())
    assert path.stat().st_size < 400 * 1000  # 400 layers of 787 x 787 pixels, of which each is 77 kB
