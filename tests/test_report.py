"""The report: figures that show what they claim, a page that needs nothing else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from magiclens import builtin
from magiclens.analysis.annealing_effect import ANNEALING_EFFECT, before_after, fine_slopes
from magiclens.analysis.base import Findings
from magiclens.analysis.contact_sheet import CONTACT_SHEET, MARK, marked, view_placement
from magiclens.analysis.ideal_picture import predict
from magiclens.analysis.overlap import FAINT, OVERLAP, coarse, faded, overlaps, seeing_facets, seen
from magiclens.analysis.picture_error import PICTURE_ERROR, difference, gridded
from magiclens.analysis.surface import SURFACE, wall_picture
from magiclens.analysis.warp import TINT, facet_colours, tinted
from magiclens.contract.artifacts import Assignment, FloatArray, HeightField, IntArray, Lens, Scene, Solid, View
from magiclens.contract.result import RunResult
from magiclens.drawing.photographs import photograph
from magiclens.drawing.scales import BLUE_TO_RED, DIVERGING, ColourScale
from magiclens.drawing.shading import hidden_share, sample_heights, shade_heights
from magiclens.drawing.tiles import PAPER_COLOUR, TEXT_LINE, TICK_WIDTH, TILE_GAP, Tile, render_rows, to_pixels
from magiclens.geometry.facets import central_slopes, patches_seen
from magiclens.images.score import score
from magiclens.plan.compile import load_plan
from magiclens.plan.registry import Plugin, Registry
from magiclens.report.tables import errands, format_metric, metric_rows
from magiclens.report.write import write_figure, write_report
from magiclens.running.pipeline import run_plan
from scenes import (
    ABOVE,
    assigned,
    blank_scene,
    blotches,
    choices,
    grey_view,
    letter_f,
    plane_points_mm,
    small_lens,
    surface,
)
from toys import SpecWriter

FIGURES = ("annealing", "contact-sheet", "error", "height-map", "overlap", "steps")
IDENTITY = np.array([1.0, 0.0, 1.0])
HOSTILE = '"><script>alert(1)</script><img src=x onerror=alert(1)>\n&'


def manifest(**changes: Any) -> dict[str, Any]:
    stage = {"kind": "matcher", "type": "toy", "version": "7", "plugin": "toys", "options": {"window": "10%", "n": [1]}}
    facts = {
        "name": "a lens",
        "scenario": "rotating",
        "stages": [stage],
        "metrics": {"energy_before": 2.0, "step_mean_mm": 0.125, "volume_mm3": 4.5e5, "watertight": 1.0, "x_px": None},
        "seed": 3,
        "versions": {"python": "3.11.9"},
    }
    return facts | changes


def run_data(
    lens: Lens, views: tuple[View, ...], renderers: tuple[str, ...] = ("tracer",), **changes: Any
) -> RunResult:
    """A run whose facets see at random and whose renderers see half the target's light."""
    rng = np.random.default_rng(0)
    n = lens.facets
    offsets, maps = rng.normal(size=(n, n, 2, 2)), np.broadcast_to([0.5, 0.0, 0.5], (n, n, 2, 3))
    candidates = choices(offsets, maps, np.zeros((n, n, 2)))
    chosen = Assignment.pick(candidates, np.full((n, n), 1))
    field = surface(lens, rng.normal(size=(n, n, 1, 1)))
    solid = Solid(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32))
    renders = {name: [0.5 * view.target for view in views] for name in renderers}
    scene = Scene(lens, views)
    return RunResult(
        given=scene, painted=scene, scene=scene, candidates=candidates, assignment=chosen, height_field=field,
        unfinished=solid, solid=solid, renders=renders, manifest=manifest(**changes),
    )  # fmt: skip


def report_on(result: RunResult, folder: Path) -> None:
    """Writes the report with the figures of the analyses that need no plan."""
    analyses = (CONTACT_SHEET, PICTURE_ERROR, SURFACE, ANNEALING_EFFECT, OVERLAP)
    figures = [write_figure(figure, folder) for each in analyses for figure in each.figures(result, Findings())]
    views, renders = result.scene.views, result.renders.items()
    scores = {name: [score(p, v.target) for p, v in zip(pictures, views, strict=True)] for name, pictures in renders}
    write_report(result.scene, result.manifest, figures, scores, folder)


def two_turns(target: FloatArray | None = None) -> tuple[View, ...]:
    """The same source seen through the lens as it is and after a quarter turn."""
    picture = letter_f(48) if target is None else target
    views = [grey_view(blotches(96, 2.0), picture, turn=turn) for turn in (0.0, 90.0)]
    return tuple(replace(view, name=f"turn-{view.rotation_deg:.0f}") for view in views)


@pytest.fixture(scope="module")
def data() -> RunResult:
    return run_data(small_lens(source=20.0), two_turns(), ("tracer", "other"))


@pytest.fixture(scope="module")
def report(data: RunResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    (folder / "lens.stl").write_bytes(b"x" * 1234)
    report_on(data, folder)
    return folder


@pytest.fixture
def written(tmp_path: Path) -> Callable[[RunResult], str]:
    """Writes the report of a run and returns its page."""

    def write(data: RunResult) -> str:
        report_on(data, tmp_path)
        return (tmp_path / "report.html").read_text(encoding="utf-8")

    return write


class Tags(HTMLParser):
    """Collects the tags of a page with their attributes."""

    def __init__(self, page: str):
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))


def test_a_report_is_six_figures_and_a_page(report: Path) -> None:
    names = sorted(p.relative_to(report).as_posix() for p in report.rglob("*") if p.is_file())
    assert names == [*(f"figures/{name}.png" for name in FIGURES), "lens.stl", "report.html"]


def test_the_contact_sheet_has_a_row_per_view_and_a_column_per_renderer(report: Path) -> None:
    with Image.open(report / "figures" / "contact-sheet.png") as image:
        assert image.size == (4 * 400 + 5 * TILE_GAP, 2 * (400 + TEXT_LINE + TILE_GAP) + TEXT_LINE + TILE_GAP)


def test_equal_runs_give_equal_reports(data: RunResult, report: Path, tmp_path: Path) -> None:
    (tmp_path / "lens.stl").write_bytes(b"x" * 1234)
    report_on(data, tmp_path)
    for path in (p for p in report.rglob("*") if p.is_file()):
        assert (tmp_path / path.relative_to(report)).read_bytes() == path.read_bytes(), path.name


def test_figures_carry_their_words_and_no_dates(report: Path) -> None:
    for name in FIGURES:
        with Image.open(report / "figures" / f"{name}.png") as image:
            assert set(image.info) == {"Title", "Description", "Pictures"}
            assert all(image.info.values())


def test_the_page_needs_no_other_file(report: Path) -> None:
    page = (report / "report.html").read_text(encoding="utf-8")
    for forbidden in ("http:", "https:", "file:", "url(", "@import", str(report)):
        assert forbidden not in page
    tags = Tags(page).found
    assert not {"script", "iframe", "object", "base"} & {tag for tag, _ in tags}
    named = {attributes["href"] for _, attributes in tags if "href" in attributes}
    links = {link for link in named if not link.startswith("data:")} - {"manifest.json"}
    beside = {path.relative_to(report).as_posix() for path in report.rglob("*") if path.is_file()}
    assert links == beside, "it leads to every file beside it"
    sources = [attributes["src"] or "" for _, attributes in tags if "src" in attributes]
    assert len(sources) == 8 + 2 + 2 + 1 + 4 + 2
    assert all(source.startswith("data:image/webp;base64,") for source in sources)


def test_the_page_says_how_to_make_the_lens_right_after_the_picture(
    data: RunResult, report: Path, tmp_path: Path
) -> None:
    page = (report / "report.html").read_text(encoding="utf-8")
    order = ["What the lens shows", "Make it", "<details", "How well it shows them", "Measured", "How it was made"]
    assert sorted(order, key=page.index) == order
    assert page.count("<details") == page.count("</details>") == 2
    names = ["lens.stl", "lens.gcode", "lens.pdf", "lens.jig.stl", "lens.jig-arm.stl", "lens.monitor.png"]
    (tmp_path / "sources").mkdir()
    for name in (*names, "preflight.html", "sources/dots.png"):
        (tmp_path / name).touch()
    parts = data.solid.metrics
    found = {errand.title: list(errand.files) for errand in errands(data.scene, parts, tmp_path)}
    assert found == {
        "Check it": ["preflight.html"],
        "Have the lens made": ["lens.gcode", "lens.stl"],
        "Print the sheet": ["lens.pdf"],
        "Print the jig": ["lens.jig-arm.stl", "lens.jig.stl"],
        "Or show it on a screen": ["lens.monitor.png"],
        "Look through it: turn-0": [],
    }
    (tmp_path / "lens.pdf").unlink()
    sheet = next(errand for errand in errands(data.scene, parts, tmp_path) if errand.title == "Print the sheet")
    assert sheet.files == ["sources/dots.png"]
    assert "exactly 20 mm wide" in sheet.how


def test_what_users_write_is_escaped(written: Callable[[RunResult], str]) -> None:
    stage = {"kind": "matcher", "type": HOSTILE, "version": HOSTILE, "plugin": HOSTILE, "options": {HOSTILE: HOSTILE}}
    facts = {"name": HOSTILE, "scenario": HOSTILE, "stages": [stage], "metrics": {HOSTILE: 1.0}}
    views = tuple(replace(view, name=HOSTILE, source_name=HOSTILE) for view in two_turns())
    page = written(run_data(small_lens(), views, (HOSTILE,), **facts))
    assert "<script" not in page
    assert page.count("&lt;script&gt;") > 10
    assert not [tag for tag, attributes in Tags(page).found if "onerror" in attributes]


def test_the_page_tells_scores_metrics_stages_files_and_how_to_run_again(report: Path) -> None:
    page = (report / "report.html").read_text(encoding="utf-8")
    for text in (
        "PSNR, tracer", "SSIM, other", "turn-90", "lens at 90°", "mean", "Step between neighbouring facets, mean",
        "0.125 mm", "450 cm³", "Mesh is watertight", "not a number", "matcher: toy", "version 7", "[1]", "lens.stl",
        "1.23 kB", "mlens run spec.yaml", "Seed 3", "python 3.11.9", "energy 2",
    ):  # fmt: skip
        assert text in page, text


def test_a_lens_of_one_facet_that_nobody_rendered_has_a_report(written: Callable[[RunResult], str]) -> None:
    page = written(run_data(small_lens(1), two_turns()[:1], ()))
    assert "Steps between facets" in page
    assert "PSNR" not in page


def test_colour_views_stay_coloured(written: Callable[[RunResult], str], tmp_path: Path) -> None:
    green = np.zeros((32, 32, 3), np.float32)
    green[..., 1] = 1.0
    view = View("green", green, green, np.array([0.0, 0.0, 440.0]))
    written(run_data(small_lens(), (view,)))
    with Image.open(tmp_path / "figures" / "contact-sheet.png") as image:
        left, row = TILE_GAP + 200, TILE_GAP + TEXT_LINE + 200
        middles = [image.getpixel((left + k * (400 + TILE_GAP), row)) for k in range(3)]
    assert middles == [(0, 255, 0)] * 3


def test_a_run_writes_its_report(
    write_spec: SpecWriter, registry: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("magiclens.analysis.tolerances.RESOLUTION", 16)
    monkeypatch.setattr("magiclens.analysis.tolerances.MAP_RESOLUTION", 8)
    registry.register(SimpleNamespace(mlens_analyses=builtin.mlens_analyses), Plugin("figures", "magiclens", "1"))
    run = run_plan(load_plan(write_spec(), (), registry), tmp_path / "out")
    paths = [artifact["path"] for artifact in run.manifest["artifacts"]]
    assert {"report.html", *(f"figures/{name}.png" for name in (*FIGURES, "tolerances", "shift-map"))} <= set(paths)


def overlaps_of(lens: Lens, assignment: Assignment, side: int) -> IntArray:
    """As the eye straight above sees them."""
    return overlaps(lens, patches_seen(blank_scene(lens), assignment, np.array(ABOVE)), side)


def test_facets_that_see_their_own_places_cover_the_source_once() -> None:
    lens = small_lens(4, source=12.0)
    assert (overlaps_of(lens, assigned(np.zeros((4, 4, 2)), IDENTITY), 120) == 1).all()


def test_a_source_pixel_knows_the_facet_that_sees_it() -> None:
    lens = small_lens(2, source=12.0)
    to = np.array([[[3.0, -3.0], [-3.0, 0.0]], [[0.0, 30.0], [0.0, 0.0]]])  # the third one looks beyond the source
    facets = seeing_facets(lens, patches_seen(blank_scene(lens), assigned(to, IDENTITY), np.array(ABOVE)), 4)
    assert facets.tolist() == [[-1] * 4, [-1, 1, -1, -1], [-1, -1, 3, -1], [-1] * 4]


def test_pictures_take_the_tints_of_facets_and_what_nothing_sees_turns_grey() -> None:
    colours = facet_colours(4)
    assert len(np.unique(colours.round(3), axis=0)) == 16
    facets = np.array([[5, 5, -1, -1]] * 4)
    picture = tinted(np.ones((4, 4, 1), np.float32), facets, colours)
    np.testing.assert_allclose(picture[0, 0], 255 * (1 - TINT + TINT * colours[5]), atol=1)
    np.testing.assert_array_equal(picture[0, 1], FAINT[1])


@pytest.mark.parametrize("signs", [(1, 1), (-1, 1), (1, -1), (-1, -1)])
def test_all_facets_on_one_patch_overlap_there_and_nowhere_else(signs: tuple[int, int]) -> None:
    lens = small_lens(4, source=12.0)
    to = np.array([1.5, 3.0]) - lens.facet_centres_mm()
    counts = overlaps_of(lens, assigned(to, np.array([signs[0] * 0.5, 0.0, signs[1] * 1.0])), 120)
    expected = np.zeros((120, 120), int)
    # 1.5 mm wide about x = +1.5 mm and 3 mm high about y = +3 mm, at 10 pixels per mm, row 0 at y = +6 mm
    expected[15:45, 68:82] = 16
    inner = counts.copy()
    inner[:, [67, 82]] = 0
    assert np.array_equal(inner, expected)
    assert set(np.unique(counts[15:45, [67, 82]])) <= {0, 16}


def test_sheared_patches_have_the_area_and_the_lean_of_their_maps() -> None:
    lens = small_lens(1, pitch=3.0, source=12.0)
    counts = overlaps_of(lens, assigned(np.zeros((1, 1, 2)), np.array([1.0, 0.6, 1.0])), 600)
    assert counts.sum() * 0.02**2 == pytest.approx(9 * (1 - 0.36), rel=0.01)
    rows, columns = np.nonzero(counts)
    assert np.corrcoef(columns, -rows)[0, 1] > 0.5


def test_another_eye_sees_other_points_through_the_same_facets() -> None:
    """Through flat facets, an eye to the right sees what lies farther to the left, and no less of it."""
    lens = small_lens(4, source=40.0)
    scene = Scene(lens, tuple(grey_view(letter_f(8), letter_f(8), (x, 0.0, 440.0)) for x in (60.0, -60.0)))
    flat = 1 + (lens.thickness_mm / lens.ior) / 400
    chosen = assigned((flat - 1) * lens.facet_centres_mm(), flat * IDENTITY)
    right, left = (overlaps(lens, patches_seen(scene, chosen, view.eye_mm), 400) for view in scene.views)
    middles = [np.nonzero(counts)[1].mean() / 10 - 20 for counts in (right, left)]
    shift = 60 / 400 * lens.thickness_mm / lens.ior
    assert middles == pytest.approx([-shift, shift], rel=0.05)
    assert right.sum() == pytest.approx(left.sum(), rel=0.01)
    assert right.sum() / 100 == pytest.approx((12 * flat) ** 2, rel=0.05)


def test_patches_outside_the_source_and_without_area_count_nowhere() -> None:
    lens = small_lens(1, source=12.0)
    assert not overlaps_of(lens, assigned(np.full((1, 1, 2), 20.0), IDENTITY), 60).any()
    assert not overlaps_of(lens, assigned(np.zeros((1, 1, 2)), np.array([1.0, 1.0, 1.0])), 60).any()
    half_out = overlaps_of(lens, assigned(np.array([[[6.0, 0.0]]]), IDENTITY), 120)
    assert half_out.sum() == 15 * 30
    assert half_out[45:75, 105:].all()


def test_coarse_counts_lose_no_patch() -> None:
    counts = np.zeros((16, 16), np.int32)
    counts[5, 14] = 3
    expected = np.zeros((4, 4))
    expected[1, 3] = 3
    assert np.array_equal(coarse(counts), expected)


def test_what_is_seen_turns_with_the_lens() -> None:
    picture = letter_f(16)
    view = grey_view(picture, picture, turn=90.0)
    in_lens_frame = (view.in_lens_frame().source[..., 0] > 0).astype(int)
    assert np.array_equal(seen([view], [in_lens_frame]), picture > 0)
    assert np.array_equal(seen([view, view], [in_lens_frame] * 2), 2 * (picture > 0))


def test_only_what_is_seen_keeps_its_contrast() -> None:
    source = np.zeros((8, 8, 1), np.float32)
    source[:, 4:] = 1.0
    counts = np.zeros((8, 8), int)
    counts[:4] = 2
    picture = faded(source, counts)
    assert (np.ptp(picture[:4], axis=(0, 1)) == 255).all()
    assert (np.ptp(picture[4:], axis=(0, 1)) < 80).all()


@pytest.mark.parametrize("wall", [0.002, 0.3])
def test_the_height_map_is_the_height_field_with_plus_y_up(wall: float) -> None:
    lens = small_lens(4, wall_mm=wall)
    x, y = plane_points_mm(lens)
    sampled = sample_heights(surface(lens, 0.2 * x + 0.5 * y), 120)
    at = (np.arange(120) + 0.5) / 10 - 6
    inside = abs(at - 3 * np.rint(at / 3)) > wall / 2
    assert inside.sum() > 90
    assert np.allclose(sampled[inside][:, inside], (0.2 * at - 0.5 * at[:, None])[inside][:, inside], atol=1e-5)
    assert sampled[0].mean() > sampled[-1].mean()


@pytest.mark.parametrize(("dx", "dy", "brighter"), [(1, 0, True), (-1, 0, False), (0, 1, False), (0, -1, True)])
def test_slopes_that_face_the_lamp_are_brighter(dx: int, dy: int, brighter: bool) -> None:
    at = np.linspace(0.0, 1.0, 32, dtype=np.float32)
    slope = np.float32(0.4)
    tilted = slope * (dx * at[None, :] - dy * at[:, None]) + np.zeros((32, 32), np.float32)
    flat = shade_heights(np.zeros((32, 32), np.float32), 1 / 31)[16, 16].sum()
    assert (shade_heights(tilted, 1 / 31)[16, 16].sum() > flat) == brighter


def test_shadows_fall_away_from_the_lamp() -> None:
    heights = np.zeros((60, 60), np.float32)
    heights[20:30, 20:30] = 2.0
    hidden = hidden_share(heights, 0.2)
    assert not hidden[20:30, 20:30].any()
    assert not hidden[:20].any()
    assert not hidden[:, :20].any()
    assert (hidden[np.arange(30, 35), np.arange(30, 35)] == 1).all()
    assert not hidden[np.arange(48, 60), np.arange(48, 60)].any()


def test_a_step_is_drawn_along_its_wall_only() -> None:
    right, below = np.zeros((4, 3, 9)), np.zeros((3, 4, 9))
    right[0, 1, -1] = 2.0
    picture = wall_picture(right, below, 360)
    rows, columns = np.nonzero(picture)
    assert picture.max() == 2.0
    assert (rows.min(), rows.max()) == (80, 89)
    assert columns.mean() == pytest.approx(179.5)
    assert np.ptp(columns) < 30
    below[2, 0] = 1.0
    rows, columns = np.nonzero(wall_picture(0 * right, below, 360))
    assert rows.mean() == pytest.approx(269.5)
    assert (columns.min(), columns.max()) == (0, 89)


def test_the_parts_of_an_ideal_lenslet_look_where_its_map_says() -> None:
    lens = small_lens(2)
    chosen = assigned(np.array([[[2.0, 1.0], [-1.0, 0.5]], [[0.0, -3.0], [1.5, 1.5]]]), np.array([0.4, 0.2, -0.6]))
    slopes = fine_slopes(blank_scene(lens), chosen, 3)
    finer = replace(lens, facets=6)
    places, centres = finer.facet_centres_mm(), lens.facet_centres_mm().repeat(3, 0).repeat(3, 1)
    from_centre = places - centres
    matrix = np.array([[0.4, 0.2], [0.2, -0.6]])
    looked_at = centres + chosen.offsets_mm.repeat(3, 0).repeat(3, 1) + from_centre @ matrix
    expected = central_slopes(blank_scene(finer), (looked_at - places)[:, :, None])[:, :, 0]
    assert np.allclose(slopes, expected, atol=1e-6)
    assert not np.allclose(slopes[0, 0], slopes[2, 0], atol=1e-3)


def test_before_and_after_annealing_are_as_the_first_eye_of_all_sees_them() -> None:
    lens, glyph = small_lens(source=40.0), letter_f(32)
    views = tuple(grey_view(blotches(400, 2.0), glyph, (x, 20.0, 440.0)) for x in (60.0, -60.0))
    data = run_data(lens, views)
    data = replace(data, candidates=replace(data.candidates, heights_mm=np.full((4, 4), -1.0)))
    tiles = before_after(data).rows[1]
    levels = [np.full((4, 4), -1.0), data.height_field.levels_mm]
    for tile, chosen, heights in zip(tiles, (data.best_match, data.assignment), levels, strict=True):
        pictures = predict(data.scene, chosen, len(tile.picture), 4, heights)
        photos = [photograph(picture, view) for picture, view in zip(pictures, views, strict=True)]
        assert tile.caption == f"view: {photos[0].caption}"
        assert np.array_equal(tile.picture, to_pixels(photos[0].picture, len(tile.picture)))
        assert not np.array_equal(tile.picture, to_pixels(photos[1].picture, len(tile.picture)))


@pytest.mark.parametrize(
    ("turn", "corner"), [(0, (3, 3)), (90, (-4, 3)), (180, (-4, -4)), (270, (3, -4))], ids=["0", "90", "180", "270"]
)
def test_the_mark_turns_counter_clockwise_with_the_lens(turn: int, corner: tuple[int, int]) -> None:
    source = np.zeros((100, 100, 3), np.uint8)
    picture = marked(source, small_lens(source=12.0), grey_view(letter_f(8), letter_f(8), turn=turn))
    corners = [(3, 3), (-4, 3), (-4, -4), (3, -4)]
    assert [tuple(picture[c]) == MARK for c in corners] == [c == corner for c in corners]


def test_the_outline_of_a_lens_smaller_than_its_source_lies_within() -> None:
    picture = marked(np.zeros((100, 100, 3), np.uint8), small_lens(source=24.0), grey_view(letter_f(8), letter_f(8)))
    rows = np.flatnonzero((picture == MARK).all(axis=-1).any(axis=1))
    assert (rows.min(), rows.max()) == (25, 74)


def test_places_of_views() -> None:
    lens, picture = small_lens(), letter_f(8)
    assert view_placement(grey_view(picture, picture), lens, False) == "eye 400 mm above the lens"
    assert view_placement(grey_view(picture, picture), lens, True) == "lens at 0°"
    assert view_placement(grey_view(picture, picture, (70.0, -45.0, 440.0)), lens, False) == "eye at (70, -45) mm"
    assert view_placement(grey_view(picture, picture, (-1e-14, 103.7, 440.0)), lens, False) == "eye at (0, 104) mm"


def test_photographs_are_exposed_and_differences_signed() -> None:
    view = grey_view(letter_f(16), 0.8 * letter_f(32))
    photo = photograph(0.25 * view.target, view)
    assert np.allclose(photo.picture, view.target, atol=1e-6)
    assert photo.caption == "120.0 dB, SSIM 1.00"
    assert (difference(0 * photo.target + 1, photo.target, 32) > 0).all()
    assert (difference(0 * photo.target, photo.target, 32) <= 0).all()


def test_grid_lines_lie_between_facets() -> None:
    lined = gridded(np.full((64, 64, 3), 200, np.uint8), 4)
    assert np.flatnonzero(lined[5, :, 0] < 200).tolist() == [16, 32, 48]
    assert np.flatnonzero(lined[:, 5, 0] < 200).tolist() == [16, 32, 48]


def test_scales_end_in_their_end_colours_and_clip() -> None:
    scale = ColourScale(BLUE_TO_RED, 0.0, 18.0)
    low, high, beyond = scale.paint(np.array([0.0, 18.0, 99.0]))
    assert low.tobytes().hex() == BLUE_TO_RED.split()[0]
    assert high.tobytes().hex() == beyond.tobytes().hex() == BLUE_TO_RED.split()[-1]


def test_ticks_are_round_and_in_their_places() -> None:
    assert list(ColourScale(DIVERGING, -4.87, 4.87).ticks().values()) == ["-4", "-2", "0", "+2", "+4"]
    assert ColourScale(DIVERGING, -4.0, 4.0).ticks() == {0.0: "-4", 0.25: "-2", 0.5: "0", 0.75: "+2", 1.0: "+4"}
    assert list(ColourScale(BLUE_TO_RED, 0.0, 0.012).ticks().values())[:3] == ["0.000", "0.002", "0.004"]
    assert list(ColourScale(BLUE_TO_RED, 0.0, 2.0, whole=True).ticks().values()) == ["0", "1", "2"]


def test_a_caption_that_is_a_little_too_long_is_made_smaller_not_cut() -> None:
    text = "at most 6 for 2 eyes; 7% of the source is seen"

    def width(tile: Tile) -> int:
        """Pixels from the first to the last letter of the caption."""
        below = np.asarray(render_rows([[tile]]))[TILE_GAP + TEXT_LINE + 44 :, TILE_GAP:-TILE_GAP]
        return int(np.flatnonzero((below < 255).any(axis=(0, 2))).max())

    wide, narrow = (Tile(np.zeros((40, side, 3), np.uint8), "title", text) for side in (900, 420))
    cut = Tile(np.zeros((40, 420, 3), np.uint8), "title", text[:-1])
    assert 330 < width(narrow) < 420 < width(wide)
    assert width(narrow) != width(cut)


def test_long_captions_stay_under_their_pictures() -> None:
    tile = Tile(np.zeros((40, 200, 3), np.uint8), "a title " * 40, "a caption\n" * 40, ColourScale(DIVERGING, 0.0, 1.0))
    image = render_rows([[tile]])
    assert image.width == 200 + 2 * TILE_GAP + TILE_GAP // 2 + 20 + TICK_WIDTH
    pixels = np.asarray(image)
    top = TILE_GAP + TEXT_LINE
    above, below = pixels[: top - 4], pixels[top + 44 :]
    assert PAPER_COLOUR == "#ffffff"
    assert (above[:, TILE_GAP + 204 :] == 255).all()
    assert (below[:, TILE_GAP + 204 :] == 255).all()
    assert (below[:, TILE_GAP : TILE_GAP + 200] < 255).any()


def test_metrics_have_plain_names_and_units() -> None:
    rows = metric_rows({"my_gap_mm": 1.25, "slope_max_deg": 31.256, "bodies": 1.0})
    assert [(row.label, row.value) for row in rows] == [
        ("Slope of the surface, steepest", "31.26°"),
        ("Bodies", "1"),
        ("My gap", "1.25 mm"),
    ]
    assert (format_metric("watertight", 0.0), format_metric("other", None), format_metric("volume_mm3", 1e5)) == (
        "no",
        "not a number",
        "100 cm³",
    )


def test_heights_in_the_figure_are_those_of_the_field(data: RunResult) -> None:
    flat = HeightField(data.scene.lens, np.zeros_like(data.height_field.heights_mm), None)
    assert not sample_heights(flat, 64).any()
    assert np.ptp(sample_heights(data.height_field, 64)) > 1
