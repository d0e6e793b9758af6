"""The gallery: what is built, what is built again, and how its pages do in a real browser."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from html.parser import HTMLParser
from itertools import chain, groupby, islice, product
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest
from axe_playwright_python.sync_playwright import Axe
from PIL import Image
from playwright.sync_api import Browser, Page
from typer.testing import CliRunner

from browsers import listen, served
from magiclens.cli import app
from magiclens.contract.errors import InputError
from magiclens.contract.stages import KINDS
from magiclens.pages.templating import colours
from magiclens.plan.registry import NAMED_ART, SCENARIO, STAGE, Plugin, Registry
from magiclens.profiles.machines import machines
from magiclens.web.gallery.docstrings import prose, sections
from magiclens.web.gallery.gallery_list import load_gallery
from magiclens.web.gallery.parts import Table, Text
from toys import SPEC, ToyMatcher, plugin_of

ROOT = Path(__file__).parent.parent
PAPER = {"1", "4", "7", "9", "10", "11", "12", "14", "15", "16"}
"""Figures that show what a lens does."""
PAGE_BYTES, INDEX_BYTES = 3_000_000, 1_000_000
LIST = """\
title: Toys & lenses
lead: One <b>lead</b>.
hero: first
entries:
  - name: first
    spec: toy.yaml
    label: Figure <1>
    title: A <script>alert(1)</script> title
    caption: Caption & more.
    quick: [lens.facets=3]
  - name: second
    spec: toy.yaml
    title: Another
    caption: With another view on its card.
    view: rotation-090
docs:
  - title: Start here
    pages: [page.md]
"""
PAGE = """\
# Read me

Raw <em>HTML</em> is text. See [the other part](#part-two), [a file](toy.yaml), `code`.

```yaml
name: x   # <comment>
```

## Part two

![Where the picture differs](images/runs/first/renders/tracer/rotation-000.png "A caption")
![A ray](images/drawings/refraction.svg)
"""
SMALL = [
    "lens={size: 24mm, facets: 6, microfacets: 6, thickness: 30mm}",
    "scenario.targets=[{art: heart}, {art: star}]",
    "scenario.angles=[0deg, 90deg]",
    "pipeline.renderers=[{type: tracer, resolution: 96}]",
]
WORM = [
    "lens={size: 24mm, facets: 6, microfacets: 6, thickness: 30mm}",
    "scenario.frames={art: worm, length: 3}",
    "pipeline.renderers=[{type: tracer, resolution: 96}]",
]
Build = Callable[..., Any]


@pytest.fixture
def build(tmp_path: Path, registry: Registry, monkeypatch: pytest.MonkeyPatch) -> Build:
    """Builds the gallery of two toy lenses."""
    monkeypatch.setattr(Registry, "load", lambda: registry)
    few = {name: registry.art[name] for name in ("bat", "cat", "heart", "star", "panda")}
    monkeypatch.setattr(Registry, "art", few)  # the reference draws all that there is
    for name, text in (("gallery.yaml", LIST), ("toy.yaml", SPEC), ("page.md", PAGE)):
        (tmp_path / name).write_text(text, encoding="utf-8")

    def run(*options: str) -> Any:
        words = ["gallery", str(tmp_path / "gallery.yaml"), "--out", str(tmp_path / "site"), "--executor", "serial"]
        return CliRunner().invoke(app, [*words, *options])

    return run


def test_a_gallery_has_a_page_for_every_lens_and_every_document(build: Build, tmp_path: Path) -> None:
    result = build()
    assert result.exit_code == 0, result.output
    site = tmp_path / "site"
    pages = {path.relative_to(site).as_posix() for path in site.rglob("*.html") if "runs" not in path.parts}
    assert {"index.html", "lenses/first.html", "lenses/second.html", "docs/page.html", "docs/index.html"} <= pages
    facts = json.loads((site / "gallery.json").read_text())
    assert [lens["name"] for lens in facts["lenses"]] == ["first", "second"]


def test_everything_that_users_wrote_is_escaped(build: Build, tmp_path: Path) -> None:
    build()
    for page in ("index.html", "lenses/first.html"):
        text = (tmp_path / "site" / page).read_text()
        assert "A &lt;script&gt;alert(1)&lt;/script&gt; title" in text
        assert "<script>alert" not in text
    assert "Raw &lt;em&gt;HTML&lt;/em&gt; is text" in (tmp_path / "site" / "docs" / "page.html").read_text()


def test_pages_show_what_the_manifest_says(build: Build, tmp_path: Path) -> None:
    build("--quick")
    manifest = json.loads((tmp_path / "site" / "runs" / "first" / "manifest.json").read_text())
    text = (tmp_path / "site" / "lenses" / "first.html").read_text()
    assert manifest["scene"]["facets"] == 3
    assert "3 x 3" in text
    for view in manifest["views"]:
        assert f"{view['psnr_db']:.1f} dB, SSIM {view['ssim']:.2f}" in text
    assert "lens.facets" in text


def test_the_card_shows_the_view_that_was_asked_for(build: Build, tmp_path: Path) -> None:
    build()
    card = (tmp_path / "site" / "index.html").read_text().split('class="card"')[2]
    assert "tracer-rotation-090" in card


@pytest.mark.tools
def test_links_to_pages_have_previews_with_whole_addresses_where_the_list_has_one(
    build: Build, tmp_path: Path
) -> None:
    build()
    page = (tmp_path / "site" / "lenses" / "first.html").read_text()
    (image,) = re.findall(r'og:image" content="([^"]+)"', page)
    with Image.open(tmp_path / "site" / "lenses" / image) as preview:
        assert preview.size == (1200, 630)
    text = (tmp_path / "gallery.yaml").read_text()
    (tmp_path / "gallery.yaml").write_text(text + "\naddress: https://lenses.example.org/a\n")
    build()
    page = (tmp_path / "site" / "lenses" / "first.html").read_text()
    assert re.search(r'og:image" content="https://lenses.example.org/a/pictures/first/[\w-]+-preview.jpg"', page)
    assert 'rel="canonical" href="https://lenses.example.org/a/lenses/first.html"' in page


@pytest.mark.tools
def test_a_published_copy_is_the_site_and_replaces_nothing_else(build: Build, tmp_path: Path) -> None:
    place = tmp_path / "published"
    for _ in range(2):
        assert build("--publish", str(place)).exit_code == 0
    site = tmp_path / "site"
    files = {path.relative_to(site) for path in site.rglob("*") if path.is_file()}
    files = {path for path in files if path.parts[0] != ".cache"}
    assert {path.relative_to(place) for path in place.rglob("*") if path.is_file()} == {*files, Path(".nojekyll")}
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").touch()
    done = build("--publish", str(tmp_path / "mine"))
    assert done.exit_code == 2
    assert "is no published gallery" in done.output
    (place / ".git").mkdir()
    assert "would be lost" in build("--publish", str(place)).output
    assert (place / ".git").is_dir()


@pytest.mark.tools
def test_what_hosts_do_not_take_is_not_published(
    build: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("magiclens.web.gallery.publish.MOST_FILE_BYTES", 1000)
    done = build("--publish", str(tmp_path / "published"))
    assert done.exit_code == 2
    assert "hosts take 1 kB a file" in done.output
    assert not (tmp_path / "published").exists()


def test_an_unknown_view_is_named(build: Build, tmp_path: Path) -> None:
    _replace(tmp_path / "gallery.yaml", "rotation-090", "rotation-09")
    result = build()
    assert result.exit_code == 2
    assert "second: unknown view 'rotation-09'; did you mean 'rotation-090'?" in result.stderr


@pytest.mark.tools
def test_what_is_up_to_date_is_not_made_again(build: Build, tmp_path: Path) -> None:
    assert "2 lenses, 2 to make" in build().stderr
    before = _bytes(tmp_path / "site")
    assert "2 lenses, 0 to make" in build().stderr
    assert _bytes(tmp_path / "site") == before


@pytest.mark.tools
def test_only_what_changed_is_made_again(build: Build, tmp_path: Path) -> None:
    build()
    _replace(tmp_path / "gallery.yaml", "[lens.facets=3]", "[lens.facets=5]")
    assert "2 lenses, 1 to make" in build("--quick").stderr


@pytest.mark.tools
def test_an_interrupted_build_goes_on_where_it_was(
    build: Build, tmp_path: Path, registry: Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Fails(ToyMatcher):
        type = "fails"

        def match(self, *_: Any) -> Any:
            raise KeyboardInterrupt

    registry.register(plugin_of(Fails), Plugin("fails", "fails", "1"))
    (tmp_path / "bad.yaml").write_text(SPEC.replace("type: toy\n    sweeps: 5", "type: fails"), encoding="utf-8")
    _replace(tmp_path / "gallery.yaml", "spec: toy.yaml\n    title: Another", "spec: bad.yaml\n    title: Another")
    assert build().exit_code == 130
    assert [path.name for path in (tmp_path / "site" / "runs").iterdir()] == ["first"]
    assert not (tmp_path / "site" / "index.html").exists()
    _replace(tmp_path / "gallery.yaml", "spec: bad.yaml", "spec: toy.yaml")
    result = build()
    assert result.exit_code == 0
    assert "2 lenses, 1 to make" in result.stderr


def test_a_lens_that_fails_stops_no_other(build: Build, tmp_path: Path, registry: Registry) -> None:
    class Crash(ToyMatcher):
        type = "crash"

        def match(self, *_: Any) -> Any:
            raise RuntimeError("boom")

    registry.register(plugin_of(Crash), Plugin("crash", "crash", "1"))
    (tmp_path / "bad.yaml").write_text(SPEC.replace("type: toy\n    sweeps: 5", "type: crash"), encoding="utf-8")
    _replace(tmp_path / "gallery.yaml", "name: first\n    spec: toy.yaml", "name: first\n    spec: bad.yaml")
    result = build()
    assert result.exit_code == 1
    assert "matcher crash" in result.stderr
    assert [path.name for path in (tmp_path / "site" / "runs").iterdir()] == ["second"]


@pytest.mark.tools
def test_what_the_list_no_longer_has_is_removed(build: Build, tmp_path: Path) -> None:
    build()
    text = (tmp_path / "gallery.yaml").read_text()
    (tmp_path / "gallery.yaml").write_text(re.sub(r"  - name: second.*?(?=docs:)", "", text, flags=re.DOTALL))
    build()
    assert not [path for path in (tmp_path / "site").rglob("*") if "second" in path.parts or path.stem == "second"]


def test_a_folder_with_something_else_is_left_alone(build: Build, tmp_path: Path) -> None:
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "thesis.tex").touch()
    result = build()
    assert result.exit_code == 2
    assert "is there already and is no gallery; choose another --out" in result.stderr
    assert [path.name for path in (tmp_path / "site").iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("spec: toy.yaml", "spec: toi.yaml", "gallery.yaml:6: entries.0.spec: there is no file"),
        ("hero: first", "hero: frist", "gallery.yaml:3: hero: unknown entry 'frist'; did you mean 'first'?"),
        ("name: second", "name: first", "gallery.yaml:4: entries: two entries are called 'first'"),
        ("label:", "lable:", "gallery.yaml:7: entries.0.lable: unknown key; did you mean 'label'?"),
        ("[lens.facets=3]", "[lens.facets=0]", "lens.facets: must be at least 1"),
    ],
)
def test_mistakes_in_the_list_are_named(build: Build, tmp_path: Path, old: str, new: str, message: str) -> None:
    _replace(tmp_path / "gallery.yaml", old, new)
    result = build("--quick")
    assert result.exit_code == 2
    assert message in result.stderr
    assert not (tmp_path / "site" / "runs").exists()


@pytest.mark.every_third
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("(toy.yaml)", "(tou.yaml)", "page.md:3: broken link: there is no file"),
        ("refraction.svg", "refractoin.svg", "unknown drawing 'refractoin'; did you mean 'refraction'?"),
        ("runs/first/", "runs/frist/", "broken picture: there is no file"),
        ("rotation-000.png", "rotation-00.png", "broken picture: there is no file"),
    ],
)
def test_mistakes_in_documents_are_named(build: Build, tmp_path: Path, old: str, new: str, message: str) -> None:
    _replace(tmp_path / "page.md", old, new)
    result = build()
    assert result.exit_code == 2
    assert message in result.stderr


def test_without_a_list_there_is_a_hint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["gallery"])
    assert result.exit_code == 2
    assert "there is no file 'gallery/gallery.yaml'" in result.stderr
    assert "name the list of a gallery" in result.stderr


def test_the_shipped_list_has_every_figure_of_the_paper_and_every_spec() -> None:
    gallery = load_gallery(ROOT / "gallery" / "gallery.yaml")
    labels = " ".join(entry.label for entry in gallery.entries)
    assert set(re.findall(r"\d+", re.sub(r"Section \S+", "", labels))) >= PAPER
    assert {entry.spec.name for entry in gallery.entries} == {path.name for path in (ROOT / "specs").glob("*.yaml")}


def test_every_figure_that_shows_what_a_lens_does_is_compared() -> None:
    compared = [entry for entry in load_gallery(ROOT / "gallery" / "gallery.yaml").entries if entry.paper]
    assert set(re.findall(r"\d+", " ".join(entry.label for entry in compared))) == PAPER


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A gallery of two real lenses, with the project's own documentation where it needs no other runs."""
    folder = tmp_path_factory.mktemp("gallery")
    shutil.copytree(ROOT / "specs", folder / "specs")
    entries = [
        {"name": "rotating", "spec": "specs/rotating.yaml", "title": "Two", "caption": "Two pictures.", "quick": SMALL,
         "label": "Figure 1 of the paper", "paper": "It shows `four` pictures."},
        {"name": "worm", "spec": "specs/universal-animation.yaml", "title": "Worm", "caption": "Film.", "quick": WORM},
    ]
    (folder / "page.md").write_text(
        PAGE.replace("first/renders/tracer/rotation-000.png", "worm/figures/error.png").replace("toy.yaml", "list.yaml")
    )
    docs = [{"title": "Start here", "pages": ["page.md"]}]
    whole = {"hero": "rotating", "lead": "Two lenses.", "entries": entries, "docs": docs}
    (folder / "list.yaml").write_text(json.dumps(whole))
    words = ["gallery", str(folder / "list.yaml"), "--quick", "--out", str(folder / "site"), "--executor", "serial"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    return folder / "site"


@pytest.mark.tools
def test_every_link_and_picture_leads_somewhere(site: Path) -> None:
    assert broken_links(site) == []


@pytest.mark.tools
def test_the_documentation_alone_is_a_site_without_dead_links(tmp_path: Path) -> None:
    words = ["docs", str(ROOT / "gallery" / "gallery.yaml"), "--out", str(tmp_path / "docs")]
    for _ in range(2):  # the second time over the first
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, done.output
    # Markdown files of the repository are copied as they are, so they have headings, and no anchors
    assert [link for link in broken_links(tmp_path / "docs") if ".md#" not in link] == []
    assert (tmp_path / "docs" / "docs" / "how-to" / "print.html").is_file()
    assert not (tmp_path / "docs" / "runs").exists()


def test_the_documentation_alone_never_takes_the_place_of_lenses(tmp_path: Path) -> None:
    (tmp_path / "gallery" / "runs" / "lens").mkdir(parents=True)
    done = CliRunner().invoke(app, ["docs", "--out", str(tmp_path / "gallery")])
    assert done.exit_code == 2
    assert "is a gallery with lenses" in done.stderr
    assert (tmp_path / "gallery" / "runs" / "lens").is_dir()


@pytest.mark.tools
def test_the_reference_has_everything_that_is_installed(site: Path) -> None:
    def text(page: str) -> str:
        return (site / "docs" / "reference" / f"{page}.html").read_text(encoding="utf-8")

    registry = Registry.load()
    for kind in KINDS:
        for name, cls in registry.classes(STAGE, kind).items():
            assert f">{kind}: {name}</h2>" in text("stages")
            assert all(f"<code>{key}</code>" in text("stages") for key in cls.model_fields)
    assert all(f">scenario: {name}</h2>" in text("spec") for name in registry.types(SCENARIO))
    assert all(f"<code>{name}</code>" in text("art") for name in registry.types(NAMED_ART))
    assert all(f">{name}</h2>" in text("machines") for name in machines())
    for command in ("run", "gallery", "preflight"):
        assert f">mlens {command}</h2>" in text("commands")
    assert "progress: Progress = silent" in re.sub("<[^>]*>", "", text("plugins"))
    assert "object at 0x" not in text("plugins")


def test_sections_of_docstrings_are_tables() -> None:
    def seen(eye: float, source: float) -> float:
        """What is seen.

        From afar.

        Args:
            eye: The eye,
                in mm.
            source: The source.

        Returns:
            The picture.

        Raises:
            ValueError: There is none.
        """
        return eye + source

    assert prose(seen) == "What is seen.\n\nFrom afar."
    arguments, returned, raised = sections(seen)
    assert isinstance(arguments, Table)
    assert arguments.rows == [("`eye`", "The eye, in mm."), ("`source`", "The source.")]
    assert returned == Text("**Returns** The picture.")
    assert isinstance(raised, Table)
    assert raised.rows == [("`ValueError`", "There is none.")]


@pytest.mark.tools
def test_lenses_stand_beside_the_figures_of_the_paper(site: Path) -> None:
    text = (site / "paper.html").read_text(encoding="utf-8")
    assert text.count("<section") == 1
    for words in ("Figure 1 of the paper", "It shows <code>four</code> pictures.", "rotation-090: ", "PSNR as"):
        assert words in text
    assert 'href="paper.html"' in (site / "index.html").read_text(encoding="utf-8")


def test_the_page_of_the_look_shows_every_colour_in_both_schemes(site: Path, browser: Browser) -> None:
    tab = browser.new_page()
    tab.goto((site / "docs" / "reference" / "look.html").as_uri())
    for name, found in colours().items():
        script = f"getComputedStyle(document.querySelector('.as-{name}')).getPropertyValue('--accent')"
        assert tab.evaluate(script) == found["accent"]
        assert tab.locator(f".as-{name} .swatches li").count() == len(found)
    tab.close()


def test_broken_links_are_found(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text('<p id="x"><a href="b.html">1</a><a href="#y">2</a><img src="c.png">')
    assert broken_links(tmp_path) == ["a.html: #y", "a.html: b.html", "a.html: c.png"]


@pytest.mark.tools
def test_figures_have_a_look_for_dark_pages(site: Path) -> None:
    text = (site / "lenses" / "worm.html").read_text(encoding="utf-8")
    dark = re.findall(r'srcset="\.\./(\S+-dark\.webp)" media="screen and \(prefers-color-scheme: dark\)"', text)
    assert dark
    for path in dark:
        with Image.open(site / path) as one, Image.open(site / path.replace("-dark", "")) as other:
            assert one.size == other.size
            assert max(one.convert("L").getpixel((3, 3)), 80) < other.convert("L").getpixel((3, 3))


@pytest.mark.tools
def test_pages_are_light(site: Path) -> None:
    assert heavy_pages(site) == {}
    assert page_bytes(site, "lenses/worm.html") > 100_000


@pytest.mark.parametrize("scheme", ["file", pytest.param("http", marks=pytest.mark.sweep)])
def test_no_page_complains_or_asks_for_anything_elsewhere(site: Path, browser: Browser, scheme: str) -> None:
    assert complaints(site, browser, scheme) == {}


@pytest.mark.parametrize(
    ("colours", "most"), [("light", 2), *(pytest.param(c, 1000, marks=pytest.mark.sweep) for c in ("light", "dark"))]
)
def test_pages_are_accessible(site: Path, browser: Browser, colours: str, most: int) -> None:
    """So many of each folder, whose pages are much alike."""
    assert findings(site, browser, colours, most=most) == {}


def test_axe_finds_what_is_wrong(tmp_path: Path, browser: Browser) -> None:
    (tmp_path / "a.html").write_text('<html lang="en"><title>a</title><main><h1>a</h1><img src="data:,"></main>')
    assert [rule for rule, _ in findings(tmp_path, browser, "light")["a.html"]] == ["image-alt"]


def test_nothing_is_wider_than_a_phone(site: Path, browser: Browser) -> None:
    context = browser.new_context(viewport={"width": 375, "height": 740})
    tab = context.new_page()
    widths = {}
    for page in pages_of(site):
        tab.goto((site / page).as_uri())
        widths[page] = tab.evaluate("document.documentElement.scrollWidth")
    context.close()
    assert {page: width for page, width in widths.items() if width > 375} == {}


def test_the_keyboard_alone_lays_and_turns_the_lens_and_leads_to_its_page(site: Path, browser: Browser) -> None:
    tab = browser.new_page(reduced_motion="reduce")
    tab.goto((site / "index.html").as_uri())
    said = [_pressed_until(tab, "[data-turn]", "Enter"), _pressed(tab, "Enter")]
    assert said == ["lens at 0°.", "lens at 90°."]
    shown = tab.locator("[data-lens] img:visible")
    assert "rotation-090" in str(shown.get_attribute("alt"))
    _pressed_until(tab, ".card", "Enter")
    tab.wait_for_url("**/lenses/rotating.html")
    tab.close()


def test_the_lens_lays_itself_on_the_dots_once(site: Path, browser: Browser) -> None:
    tab = browser.new_page()
    tab.goto((site / "index.html").as_uri())
    tab.wait_for_function("document.querySelector('[data-state]').textContent === 'lens at 0°.'", timeout=10_000)
    tab.close()


def _pressed_until(tab: Page, selector: str, key: str) -> str:
    """Tab to the first match, then press a key there."""
    for _ in range(40):
        tab.keyboard.press("Tab")
        if tab.evaluate("s => document.activeElement.matches(s)", selector):
            return _pressed(tab, key)
    raise AssertionError(f"the keyboard does not reach {selector}")


def _pressed(tab: Page, key: str) -> str:
    tab.keyboard.press(key)
    state = tab.locator("[data-state]")
    return str(state.text_content()) if state.count() else ""


def complaints(site: Path, browser: Browser, scheme: str) -> dict[str, list[str]]:
    """By page: errors in the console, and requests to elsewhere."""
    if scheme == "file":
        return _complaints(site, browser, site.as_uri())
    with served(site) as home:
        return _complaints(site, browser, home)


def _complaints(site: Path, browser: Browser, home: str) -> dict[str, list[str]]:
    found = {}
    for page in pages_of(site):
        tab = browser.new_page()
        heard = listen(tab, home)
        tab.goto(f"{home}/{page}", wait_until="load")
        tab.wait_for_function("!window.magiclens || magiclens.ready.then(() => true)")
        tab.evaluate("Promise.all([...document.images].map(i => (i.loading = 'eager', i.decode())))")
        tab.close()
        if heard:
            found[page] = heard
    return found


def findings(
    site: Path, browser: Browser, colours: Any, width: int = 1280, most: int = 1000
) -> dict[str, list[tuple[str, str]]]:
    """By page: rules of axe-core with serious or critical findings, and where. Dark pages differ in colours only."""
    options = {} if colours == "light" else {"runOnly": ["color-contrast"]}
    found = {}
    folders = groupby(pages_of(site), key=lambda page: page.rpartition("/")[0])
    for page in chain.from_iterable(islice(pages, most) for _, pages in folders):
        size: Any = {"width": width, "height": 900}
        tab = browser.new_page(color_scheme=colours, reduced_motion="reduce", viewport=size)
        tab.goto((site / page).as_uri())
        rules = Axe().run(tab, options=options).response["violations"]
        tab.close()
        bad = [(r["id"], r["nodes"][0]["html"][:200]) for r in rules if r["impact"] in ("serious", "critical")]
        if bad:
            found[page] = bad
    return found


def pages_of(site: Path) -> list[str]:
    """Every page, run reports included."""
    return sorted(path.relative_to(site).as_posix() for path in site.rglob("*.html") if ".cache" not in path.parts)


class _References(HTMLParser):
    """Collects what a page refers to, what it loads, and its anchors."""

    def __init__(self, text: str):
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        found = {key: value or "" for key, value in attributes}
        self.anchors |= {found["id"]} if "id" in found else set()
        self.links += [found[key] for key in ("href", "src", "srcset", "poster") if key in found]
        loads = {"img": "src", "script": "src", "link": "href", "video": "poster"}
        self.loaded += [found[key] for name, key in loads.items() if tag == name and key in found]


def references(site: Path, page: str) -> _References:
    return _References((site / page).read_text(encoding="utf-8"))


def broken_links(site: Path) -> list[str]:
    """``page: link`` of everything that leads nowhere; links to the outside are not followed."""
    found = []
    for page in pages_of(site):
        for link in sorted(set(references(site, page).links)):
            if re.match(r"(data|https?|mailto):", link):
                continue
            path, _, anchor = link.partition("#")
            target = (site / page).parent / unquote(path) if path else site / page
            there = target.is_file() and target.resolve().is_relative_to(site.resolve())
            if not there or (anchor and anchor not in _References(target.read_text(encoding="utf-8")).anchors):
                found.append(f"{page}: {link}")
    return found


def page_bytes(site: Path, page: str) -> int:
    """A page with everything that it loads."""
    loaded = {link for link in references(site, page).loaded if not link.startswith("data:")}
    files = [site / page, *((site / page).parent / unquote(link) for link in loaded)]
    return sum(path.stat().st_size for path in files)


def heavy_pages(site: Path) -> dict[str, int]:
    """Pages above their limit."""
    sizes = {page: page_bytes(site, page) for page in pages_of(site)}
    return {p: size for p, size in sizes.items() if size > (INDEX_BYTES if p == "index.html" else PAGE_BYTES)}


def _bytes(site: Path) -> dict[str, bytes]:
    return {path.as_posix(): path.read_bytes() for path in site.rglob("*") if path.is_file()}


def _replace(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


@pytest.mark.sweep
def test_the_whole_gallery_is_quick_to_build_light_and_accessible(tmp_path: Path, browser: Browser) -> None:
    site = tmp_path / "site"
    done = CliRunner().invoke(app, ["gallery", str(ROOT / "gallery" / "gallery.yaml"), "--quick", "--out", str(site)])
    assert done.exit_code == 0, done.output
    assert (broken_links(site), heavy_pages(site)) == ([], {})
    assert complaints(site, browser, "file") == {}
    for scheme, width in product(("light", "dark"), (1440, 390)):
        assert findings(site, browser, scheme, width) == {}, (scheme, width)


def test_a_list_that_is_no_mapping_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "list.yaml").write_text("- a\n")
    with pytest.raises(InputError, match="list instead of a mapping"):
        load_gallery(tmp_path / "list.yaml")
