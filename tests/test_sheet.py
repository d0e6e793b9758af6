"""What is printed, and what is shown on a screen, has its true size."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pypdfium2
import pytest
from PIL import Image

from fabricated import box, flat, view_of, written
from magiclens.contract.artifacts import FloatArray, Lens, Scene, View
from magiclens.contract.errors import InputError
from magiclens.contract.stages import Exporter
from magiclens.exporting.monitor import Monitor
from magiclens.exporting.print_page import listed
from magiclens.exporting.print_sheet import PAPERS, PrintSheet
from magiclens.images.colour import to_display
from magiclens.plan.compile import load_plan
from toys import TOYS, SpecWriter, registry_of

Ink = np.ndarray[Any, Any]
DPI = 1200
PER_MM = DPI / 25.4
CLOSE_MM = 0.05
STROKE_MM = 0.1
LENS = Lens(size_mm=60.0, source_size_mm=60.0, facets=2, microfacets=1, thickness_mm=8.0)
EYE = (0.0, 0.0, 88.0)
BOTTOM_MM = 60.0 * 88 / 80
"""Side of the bottom of a slab cut along rays from the eye."""


def patch() -> FloatArray:
    """(600, 600): white, but for a black patch from (-20, 5) to (-8, 20) mm."""
    source = np.ones((600, 600))
    source[100:250, 100:220] = 0
    return source


def scene_of(*views: View, lens: Lens = LENS) -> Scene:
    return Scene(lens, views or (view_of(patch()),))


def ink_of(path: Path) -> Ink:
    """(rows, columns) uint8, 0 white to 255 black: the middle of an A4 page, 190 x 180 mm."""
    with pypdfium2.PdfDocument(path) as pdf:
        beside, above = (25.4 / 72 * np.array(pdf[0].get_size()) - (190, 180)) / 2 * (72 / 25.4)
        page = pdf[0].render(scale=DPI / 72, grayscale=True, crop=(beside, above, beside, above))
        return 255 - page.to_numpy().reshape(page.height, page.width)


def longest_run(ink: Ink) -> FloatArray:
    """(rows,) mm: of each row's unbroken ink."""
    runs = np.zeros(len(ink))
    for k in np.flatnonzero((ink > 127).sum(axis=1) > PER_MM):
        change = np.flatnonzero(np.diff(np.pad(ink[k] > 127, 1).astype(np.int8)))
        runs[k] = (change[1::2] - change[::2]).max(initial=0) / PER_MM
    return runs


def lines_at(ink: Ink, length: float) -> list[float]:
    """mm from the first row: middles of the horizontal lines that long, or a millimetre more or less."""
    rows = np.flatnonzero(abs(longest_run(ink) - length) < 1)
    return [(group.mean() + 0.5) / PER_MM for group in groups(rows)]


def groups(numbers: Ink) -> list[Ink]:
    """Runs of consecutive numbers."""
    return np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1) if len(numbers) else []


@pytest.fixture(scope="module")
def sheet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four rotations over one source."""
    views = [view_of(patch(), f"rotation-{a:03d}", a) for a in (0, 90, 180, 270)]
    return written(PrintSheet(), tmp_path_factory.mktemp("sheet"), flat(LENS, EYE), scene_of(*views))


@pytest.fixture(scope="module")
def ink(sheet: Path) -> Ink:
    return ink_of(sheet)


def test_rulers_measure_100_mm(ink: Ink) -> None:
    for lying in (ink, ink.T):
        runs = longest_run(lying)
        assert runs[abs(runs - 100) < 5].max() - STROKE_MM == pytest.approx(100, abs=CLOSE_MM)
        assert len(lines_at(lying, 100)) == 1


def test_outline_is_the_lens_s_bottom(ink: Ink) -> None:
    for lying in (ink, ink.T):
        first, last = lines_at(lying, BOTTOM_MM)
        assert last - first - STROKE_MM == pytest.approx(BOTTOM_MM, abs=CLOSE_MM)


def test_source_is_where_it_belongs_below_the_lens(ink: Ink) -> None:
    top, bottom = lines_at(ink, BOTTOM_MM)
    left, right = lines_at(ink.T, BOTTOM_MM)
    middle = np.array([bottom + top, left + right]) / 2
    first = np.rint((middle - 29) * PER_MM).astype(int)
    last = np.rint((middle + 29) * PER_MM).astype(int)
    below = ink[first[0] : last[0], first[1] : last[1]]
    places = (np.argwhere(below > 127) + first) / PER_MM - middle
    assert places.min(axis=0) == pytest.approx([-20, -20], abs=CLOSE_MM)
    assert places.max(axis=0) + 1 / PER_MM == pytest.approx([-5, -8], abs=CLOSE_MM)
    assert (below / 255).sum() / PER_MM**2 == pytest.approx(12 * 15, rel=0.01)


def test_marks_go_on_where_the_outline_s_sides_would(ink: Ink) -> None:
    top, _ = lines_at(ink, BOTTOM_MM)
    left, right = lines_at(ink.T, BOTTOM_MM)
    above = ink[round((top - 7) * PER_MM) : round((top - 3) * PER_MM)].mean(axis=0)
    marks = (np.array([group.mean() for group in groups(np.flatnonzero(above > 200))]) + 0.5) / PER_MM
    beside_the_ruler = marks[marks > left - 3]
    assert beside_the_ruler == pytest.approx([left, right], abs=CLOSE_MM)


def test_views_stand_at_the_side_that_the_lens_s_top_points_to(sheet: Path) -> None:
    """Turned counter-clockwise by 90 degrees, what was up is left."""
    with pypdfium2.PdfDocument(sheet) as pdf:
        text = pdf[0].get_textpage()
        places = {}
        for angle in (0, 90, 180, 270):
            index, _ = text.search(f"lens's top here: rotation-{angle:03d}").get_next()
            left, bottom, right, top = text.get_charbox(index)
            places[angle] = np.array([left + right, bottom + top]) / 2 / 72 * 25.4
    up, left, down, right = (places[a] for a in (0, 90, 180, 270))
    assert up[1] - down[1] == pytest.approx(BOTTOM_MM + 2 * 11, abs=3)
    assert right[0] - left[0] == pytest.approx(BOTTOM_MM + 2 * 11, abs=3)
    assert left[0] < up[0] < right[0]
    assert down[1] < left[1] < up[1]


@pytest.mark.parametrize("channels", [1, 3])
def test_source_keeps_every_pixel(channels: int, tmp_path: Path) -> None:
    source = np.random.default_rng(0).random((70, 70, channels)).astype(np.float32)
    path = written(PrintSheet(), tmp_path, flat(LENS, EYE), scene_of(view_of(source)))
    with pypdfium2.PdfDocument(path) as pdf:
        images = [o for o in pdf[0].get_objects() if isinstance(o, pypdfium2.PdfImage)]
        assert len(images) == 1
        kept = np.asarray(images[0].get_bitmap().to_pil().convert("RGB"))
    assert np.array_equal(kept, np.broadcast_to(np.rint(to_display(source) * 255), kept.shape))


def test_every_source_has_its_page(tmp_path: Path) -> None:
    frames = [view_of(np.full((8, 8), k / 4), f"frame-{k}", source_name=f"frame-{k}") for k in range(3)]
    again = view_of(np.full((8, 8), 0.0), "frame-0-again", 180.0, "frame-0")
    with pypdfium2.PdfDocument(written(PrintSheet(), tmp_path, flat(LENS), scene_of(*frames, again))) as pdf:
        texts = [page.get_textpage().get_text_range() for page in pdf]
    assert len(texts) == 3
    for k, text in enumerate(texts):
        assert f"Magic lens: frame-{k} ({k + 1} of 3)" in text
        assert ("frame-0-again" in text) == (k == 0)


def test_a_lens_that_leans_has_an_outline_for_every_way_it_lies(tmp_path: Path) -> None:
    """Its bottom is off the axis; turned by 180 degrees it is off to the other side."""
    views = [view_of(patch(), "first"), view_of(patch(), "second", 180.0)]
    path = written(PrintSheet(), tmp_path, box((-30, -30, 0), (50, 30, 8)), scene_of(*views))
    assert np.diff(lines_at(ink_of(path).T, 60)) == pytest.approx([20, 60, 20], abs=CLOSE_MM + STROKE_MM)


@pytest.mark.parametrize(("gap", "lines"), [(0.0, 2), (50.0, 0)])
def test_a_lens_that_shows_what_is_beside_it_shows_no_outline(gap: float, lines: int, tmp_path: Path) -> None:
    """Across a gap it sees the source beside its bottom too: only marks outside the source say where it goes."""
    lens = replace(LENS, source_size_mm=90.0, gap_mm=gap)
    path = written(PrintSheet(), tmp_path, flat(lens), scene_of(view_of(np.ones((8, 8))), lens=lens))
    ink = ink_of(path)
    assert len(lines_at(ink, 60)) == lines
    assert lines or len(lines_at(ink, 6)) == 2  # the marks


@pytest.mark.parametrize(
    ("size", "paper"), [(60.0, "a4"), (150.0, "a4"), (160.0, "letter"), (240.0, "a3"), (500.0, "a1")]
)
def test_paper_is_the_first_that_is_large_enough(size: float, paper: str, tmp_path: Path) -> None:
    lens = Lens(size_mm=size, source_size_mm=size, facets=2, microfacets=1, thickness_mm=8.0)
    with pypdfium2.PdfDocument(written(PrintSheet(), tmp_path, flat(lens), scene_of(lens=lens))) as pdf:
        assert np.array(pdf[0].get_size()) / 72 * 25.4 == pytest.approx(PAPERS[paper], abs=0.01)


def test_paper_must_be_high_enough_too(tmp_path: Path) -> None:
    narrow = box((-30, -130, 0), (30, 130, 8))
    with pypdfium2.PdfDocument(written(PrintSheet(), tmp_path, narrow, scene_of())) as pdf:
        assert np.array(pdf[0].get_size()) / 72 * 25.4 == pytest.approx(PAPERS["a3"], abs=0.01)


def test_paper_may_be_chosen_if_it_is_large_enough(tmp_path: Path) -> None:
    with pypdfium2.PdfDocument(written(PrintSheet(paper="a3"), tmp_path, flat(LENS), scene_of())) as pdf:
        assert np.array(pdf[0].get_size()) / 72 * 25.4 == pytest.approx(PAPERS["a3"], abs=0.01)
    lens = Lens(size_mm=250.0, source_size_mm=250.0, facets=2, microfacets=1)
    with pytest.raises(InputError, match=r"the sheet needs .* mm, a4 has 210 x 297 mm; use a2 or a1"):
        written(PrintSheet(paper="a4"), tmp_path, flat(lens), scene_of(lens=lens))
    lens = Lens(size_mm=900.0, source_size_mm=900.0, facets=2, microfacets=1)
    with pytest.raises(InputError, match="no paper is that large; make the source smaller"):
        written(PrintSheet(), tmp_path, flat(lens), scene_of(lens=lens))


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ("type: sheet, paper: a5", "paper: 'a5' is not allowed; choose one of: a0, a1, a2, a3, a4, auto, letter"),
        ("type: sheet, papr: a4", "papr: unknown option; did you mean 'paper'?"),
        ("type: monitor", "ppi: this key is required"),
        ("type: monitor, ppi: 96dpi", "ppi: expected a number, got '96dpi'"),
        ("type: monitor, ppi: 5", "ppi: must be at least 20"),
    ],
)
def test_wrong_options_are_explained(choice: str, message: str, write_spec: SpecWriter) -> None:
    spec = write_spec(("exporters: [{type: toy}]", f"exporters: [{{{choice}}}]"))
    with pytest.raises(InputError) as caught:
        load_plan(spec, registry=registry_of(*TOYS, PrintSheet, Monitor))
    assert f"pipeline.exporters.0.{message}" in str(caught.value)


@pytest.mark.parametrize("exporter", [PrintSheet(), Monitor(ppi=109)], ids=["sheet", "monitor"])
def test_equal_sources_give_equal_bytes_and_others_do_not(exporter: Exporter, tmp_path: Path) -> None:
    scenes = {"one": scene_of(), "same": scene_of(), "other": scene_of(view_of(np.eye(600)))}
    files = {name: written(exporter, tmp_path / name, flat(LENS), scene).read_bytes() for name, scene in scenes.items()}
    assert files["one"] == files["same"]
    assert files["one"] != files["other"]


def test_long_lists_are_cut() -> None:
    assert listed(["a", "b", "c", "d"]) == "a, b, c, d"
    assert listed(["a", "b", "c", "d", "e"]) == "a, b, c and 2 more"


@pytest.mark.parametrize("ppi", [96.0, 109.0, 700.0])
def test_on_a_screen_the_source_has_its_size(ppi: float, tmp_path: Path) -> None:
    """Measured by the light that is missing, so finer than a pixel."""
    path = written(Monitor(ppi=ppi), tmp_path, flat(LENS), scene_of())
    image = Image.open(path)
    assert image.info["dpi"] == pytest.approx((ppi, ppi), rel=2e-4)  # whole pixels per metre
    values = np.asarray(image) / 255
    light = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    pixel = 25.4 / ppi
    assert 60 <= len(values) * pixel < 60 + pixel
    assert (1 - light).sum() * pixel**2 == pytest.approx(12 * 15, rel=2e-3)
    x = (np.arange(len(values)) - (len(values) - 1) / 2) * pixel
    assert (1 - light).sum(axis=0) @ x / (1 - light).sum() == pytest.approx(-14, abs=0.01)
    assert (1 - light).sum(axis=1) @ -x / (1 - light).sum() == pytest.approx(12.5, abs=0.01)


def test_on_a_screen_light_is_averaged_not_display_values(tmp_path: Path) -> None:
    checks = np.indices((600, 600)).sum(axis=0) % 2
    values = np.asarray(Image.open(written(Monitor(ppi=25.4), tmp_path, flat(LENS), scene_of(view_of(checks * 1.0)))))
    assert values.shape == (60, 60)
    assert (values == 188).all()


def test_every_source_has_its_screen_picture(tmp_path: Path) -> None:
    grey = [view_of(np.full((8, 8), k / 2), f"v{k}", source_name=f"frame-{k}") for k in range(3)]
    written(Monitor(ppi=96), tmp_path, flat(LENS), scene_of(*grey))
    names = ["lens.monitor.png", "lens.monitor.frame-1.png", "lens.monitor.frame-2.png"]
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names)
    assert [int(np.asarray(Image.open(tmp_path / name))[100, 100]) for name in names] == [0, 188, 255]


def test_a_screen_that_large_is_refused(tmp_path: Path) -> None:
    lens = Lens(size_mm=900.0, source_size_mm=900.0, facets=2, microfacets=1)
    with pytest.raises(InputError, match=r"900 mm at 1000 ppi are 35434 pixels .* use 462 or less"):
        written(Monitor(ppi=1000), tmp_path, flat(lens), scene_of(lens=lens))
