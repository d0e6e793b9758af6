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
from magiclens.exporting.print_page import listed, pages, write_pages
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


Drawn = tuple[str, FloatArray]


def drawn_on(path: Path) -> list[Drawn]:
    """Everything on the first page: what it is, and left, bottom, right, top in mm, the source's middle at (0, 0)."""
    kinds = {1: "text", 2: "path", 3: "image"}
    with pypdfium2.PdfDocument(path) as pdf:
        found = [(kinds[o.type], np.array(o.get_bounds()) / 72 * 25.4) for o in pdf[0].get_objects()]
    (image,) = (box for kind, box in found if kind == "image")
    return [(kind, box - np.tile(image[:2] + image[2:], 2) / 2) for kind, box in found]


def sizes(boxes: FloatArray) -> FloatArray:
    """(n, 2) width and height of boxes (n, 4)."""
    return boxes[:, 2:] - boxes[:, :2]


def paths_of(drawn: list[Drawn], width: float, height: float) -> FloatArray:
    """(n, 4) lines and shapes of a size, a stroke's width more or less, from left to right and upward."""
    paths = np.array([box for kind, box in drawn if kind == "path"])
    near = paths[(abs(sizes(paths) - (width, height)) < 3 * STROKE_MM).all(axis=1)]
    return near[np.lexsort(near[:, :2].round(1).T[::-1])]


@pytest.fixture(scope="module")
def drawn(sheet: Path) -> list[Drawn]:
    return drawn_on(sheet)


def test_rulers_have_a_mark_at_every_millimetre_longer_ones_at_five_and_ten(drawn: list[Drawn]) -> None:
    (level,), (upright,) = paths_of(drawn, 100, 0), paths_of(drawn, 0, 100)
    assert (level[[0, 2]].sum(), upright[[1, 3]].sum()) == pytest.approx((0, 0), abs=CLOSE_MM), "beside the middle"
    for k in range(101):
        length = 3.0 if k % 10 == 0 else 2.0 if k % 5 == 0 else 1.2
        below, beside = paths_of(drawn, 0, length), paths_of(drawn, length, 0)
        marks = below[abs(below[:, [0, 2]].mean(axis=1) - (k - 50)) < 0.2]
        assert (abs(marks[:, 3] - level[3]) < STROKE_MM).any(), "it hangs from the level ruler"
        marks = beside[abs(beside[:, [1, 3]].mean(axis=1) - (50 - k)) < 0.2]
        assert (abs(marks[:, 2] - upright[2]) < STROKE_MM).any(), "it goes on to the left of the upright one"


def places_of(path: Path, word: str) -> list[tuple[float, float]]:
    """mm from the page's lower left corner: the middle of a word's first letter, wherever it stands."""
    with pypdfium2.PdfDocument(path) as pdf:
        text = pdf[0].get_textpage()
        search, found = text.search(word, match_whole_word=True), []
        while hit := search.get_next():
            left, bottom, right, top = text.get_charbox(hit[0])
            found.append(((left + right) / 144 * 25.4, (bottom + top) / 144 * 25.4))
    return found


def test_numbers_stand_at_the_marks_of_ten_millimetres(sheet: Path) -> None:
    numbers = [places_of(sheet, str(number)) for number in (20, 30, 70, 80, 90)]
    level = [min(places, key=lambda place: place[1]) for places in numbers]
    upright = [min(places, key=lambda place: place[0]) for places in numbers]
    assert np.diff([x for x, _ in level]) == pytest.approx([10, 40, 10, 10], abs=0.2)
    assert np.diff([y for _, y in upright]) == pytest.approx([-10, -40, -10, -10], abs=0.2)


def test_marks_begin_2_mm_beside_all_pictures_and_are_6_mm_long(drawn: list[Drawn]) -> None:
    half, line = BOTTOM_MM / 2, STROKE_MM / 2
    for upright in (paths_of(drawn, 0, 6), paths_of(drawn, 6, 0)[:, [1, 0, 3, 2]]):
        middles = (upright[:, :2] + upright[:, 2:]) / 2
        corners = {(x, y) for x in (-half - line, half + line) for y in (-half - 5, half + 5)}
        assert len(upright) == 4
        for corner in corners:
            assert abs(middles - corner).max(axis=1).min() < 0.01


def test_arrows_point_away_from_the_middle_of_each_side(drawn: list[Drawn]) -> None:
    half = BOTTOM_MM / 2 + 2
    up_and_down, left_and_right = paths_of(drawn, 3, 2.2), paths_of(drawn, 2.2, 3)
    assert up_and_down[:, [0, 2]] == pytest.approx(np.array([[-1.5, 1.5]] * 2), abs=CLOSE_MM)
    assert sorted(up_and_down[:, 1]) == pytest.approx([-half - 2.2, half], abs=CLOSE_MM)
    assert left_and_right[:, [1, 3]] == pytest.approx(np.array([[-1.5, 1.5]] * 2), abs=CLOSE_MM)
    assert sorted(left_and_right[:, 0]) == pytest.approx([-half - 2.2, half], abs=CLOSE_MM)


def test_labels_stand_in_the_middle_of_a_side_and_have_room_beside_small_sources(tmp_path: Path) -> None:
    """The lens's bottom lies off the middle of its source, and both are narrower than the label is long."""
    lens, name = replace(LENS, size_mm=20.0, source_size_mm=20.0), "a view with a name of some length, but no more"
    path = written(PrintSheet(), tmp_path, box((-10, -10, 0), (18, 10, 8)), scene_of(view_of(patch(), name), lens=lens))
    drawn = drawn_on(path)
    (arrow,) = paths_of(drawn, 3, 2.2)
    assert arrow[[0, 2]].mean() == pytest.approx((-10 + 18) / 2, abs=CLOSE_MM)
    with pypdfium2.PdfDocument(path) as pdf:
        text = pdf[0].get_textpage()
        index, count = text.search(f"lens's top here: {name}").get_next()
        first, last = text.get_charbox(index), text.get_charbox(index + count - 1)
    assert 50 < (last[2] - first[0]) / 72 * 25.4 <= 60


def test_a_long_label_may_be_as_wide_as_a_large_lens(tmp_path: Path) -> None:
    lens, name = replace(LENS, size_mm=120.0, source_size_mm=120.0), "a view with a name that is as long as a wide lens"
    path = written(PrintSheet(), tmp_path, flat(lens), scene_of(view_of(patch(), f"{name}, but no longer"), lens=lens))
    with pypdfium2.PdfDocument(path) as pdf:
        text = pdf[0].get_textpage()
        index, count = text.search(f"lens's top here: {name}, but no longer").get_next()
        first, last = text.get_charbox(index), text.get_charbox(index + count - 1)
    assert 80 < (last[2] - first[0]) / 72 * 25.4 <= 120


def test_the_outline_is_that_of_the_foot_however_far_the_top_leans_beyond_it() -> None:
    leaning = flat(LENS, (120.0, 0.0, 88.0))
    x = leaning.vertices[leaning.vertices[:, 2] == 0, 0]
    ((left, _, right, _),) = pages(scene_of(), leaning)[0].outlines
    assert (left, right) == pytest.approx((x.min(), x.max()), abs=1e-5)
    assert leaning.vertices[:, 0].max() > right + 5


LONG = "a view whose name is much too long for the room beside the lens, so that it must be small"


@pytest.mark.parametrize(
    ("source", "bottom", "names"),
    [
        (60.0, (-30, -30, 30, 30), "short"),
        (60.0, (-30, -30, 50, 30), "short"),
        (60.0, (-50, -30, 30, 45), LONG),
        (140.0, (-30, -30, 30, 30), LONG),
        (140.0, (-60, -80, 60, 75), "short"),
    ],
)
def test_the_smallest_paper_has_room_for_everything_and_nothing_is_printed_over_text(
    source: float, bottom: tuple[float, float, float, float], names: str, tmp_path: Path
) -> None:
    left, low, right, top = bottom
    lens = replace(LENS, source_size_mm=source, gap_mm=5.0)
    views = [view_of(np.ones((8, 8)), f"{names} {angle}", angle) for angle in (0, 90, 180, 270)]
    (page,) = pages(scene_of(*views, lens=lens), box((left, low, 0), (right, top, 8)))
    write_pages([page], page.needs_mm, tmp_path / "sheet.pdf")
    drawn = drawn_on(tmp_path / "sheet.pdf")
    with pypdfium2.PdfDocument(tmp_path / "sheet.pdf") as pdf:
        paper = np.array(pdf[0].get_size()) / 72 * 25.4
        (image,) = (o for o in pdf[0].get_objects() if o.type == 3)
        middle = np.array(image.get_bounds()).reshape(2, 2).mean(axis=0) / 72 * 25.4
    everything = np.array([each for _, each in drawn]) + np.tile(middle, 2)
    assert (everything[:, :2] > 7.5).all(), "mm of margin, to the left and below"
    assert (paper - everything[:, 2:] > (5, 7.5)).all(), "and above, and to the right but for a ruler's unit"
    texts = np.array([each for kind, each in drawn if kind == "text"])
    for other in [*texts, *(each for kind, each in drawn if kind == "image")]:
        over = (texts[:, :2] < other[2:] - 0.1).all(axis=1) & (other[:2] + 0.1 < texts[:, 2:]).all(axis=1)
        assert over.sum() <= (texts == other).all(axis=1).sum(), "only over itself"


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
