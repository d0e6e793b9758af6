"""Verdicts of 24 lenses, each from a picture and a machine alone, against what makers would see. `pytest -m sweep`.

The measure that judges them is written anew here, with scikit-image, and uses nothing of the package's own.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import skimage.data
from PIL import Image, ImageDraw, ImageFont
from skimage.filters import gaussian
from skimage.metrics import structural_similarity
from skimage.transform import resize

from magiclens import run_spec
from magiclens.images import to_display
from magiclens.new.write import Making, new_spec, treatment_of

DOCS = Path(__file__).parent.parent / "docs"
MACHINES = ("sla", "milling", "diamond-turning")
SIZE_MM, DISTANCE_MM = 40, 400
SMALL = [
    "lens.microfacets=12",
    "pipeline.renderers=[{type: tracer, resolution: 256}]",
    "pipeline.exporters=[{type: stl}]",
    "report.analyses=[as-made]",
]
WORDS = ("lost", "hard to see", "recognisable", "clear")
WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
"""Of five scales, the finest first (Wang, Simoncelli and Bovik 2003)."""


def letters(text: str, size: int) -> Image.Image:
    """Black letters in the middle of white paper."""
    picture = Image.new("L", (256, 256), 255)
    ImageDraw.Draw(picture).text((128, 128), text, 0, ImageFont.load_default(size), anchor="mm", align="center")
    return picture


def house() -> Image.Image:
    """Line art."""
    picture = Image.new("L", (256, 256), 255)
    pen = ImageDraw.Draw(picture)
    for line in (
        [(50, 220), (50, 120), (128, 50), (206, 120), (206, 220), (50, 220)],
        [(110, 220), (110, 160), (146, 160), (146, 220)],
        [(165, 82), (165, 45), (190, 45), (190, 105)],
    ):
        pen.line(line, 0, 7)
    pen.rectangle((66, 140, 94, 170), outline=0, width=6)
    pen.ellipse((158, 138, 190, 170), outline=0, width=6)
    return picture


def logo() -> Image.Image:
    """Two signs in bold colours."""
    picture = Image.new("RGB", (256, 256), "white")
    pen = ImageDraw.Draw(picture)
    pen.ellipse((30, 50, 170, 190), fill="navy")
    pen.polygon([(110, 210), (178, 70), (236, 210)], fill="orange")
    pen.ellipse((70, 90, 130, 150), fill="white")
    return picture


def paragraph() -> Image.Image:
    """Seven lines of small letters."""
    lines = ["A lens of glass lay on", "the sheet of dots, and", "whoever looked at it", "from straight above",
             "saw a letter that no", "eye had found before", "among so many dots."]  # fmt: skip
    return letters("\n".join(lines), 21)


def photograph(name: str) -> Image.Image:
    """The middle square of a picture that scikit-image brings."""
    return Image.fromarray(getattr(skimage.data, name)())


PICTURES: dict[str, Any] = {
    "cat": lambda: photograph("chelsea").crop((60, 0, 360, 300)),
    "photographer": lambda: photograph("camera").crop((60, 30, 380, 350)),
    "horse": lambda: photograph("horse"),
    "page": lambda: photograph("page").crop((0, 0, 190, 190)),
    "paragraph": paragraph,
    "letter": lambda: letters("R", 230),
    "house": house,
    "logo": logo,
}


@dataclass(frozen=True)
class Made:
    """A lens as its maker would see it: what it is, the word that it got, and how alike picture and target are."""

    name: str
    word: str
    similarity: float


def similarity(seen: Any, wanted: Any, side: int) -> float:
    """Multi-scale SSIM of two pictures (H, W, 3) of display values, averaged to ``side`` pixels.

    At each scale it is the mean over places and colours, which count by the contrast that is wanted there.
    """
    shown, target = (resize(picture, (max(side, 176),) * 2, anti_aliasing=True) for picture in (seen, wanted))
    found = 1.0
    for scale, weight in enumerate(WEIGHTS):
        how = {"gaussian_weights": True, "use_sample_covariance": False, "channel_axis": -1, "full": True}
        _, alike = structural_similarity(shown, target, data_range=1.0, **how)
        means = [blurred(picture) for picture in (shown, target)]
        if scale < len(WEIGHTS) - 1:  # brightness counts at the coarsest scale only
            alike = alike * (means[0] ** 2 + means[1] ** 2 + 1e-4) / (2 * means[0] * means[1] + 1e-4)
        contrast = np.sqrt(np.maximum(blurred(target**2) - means[1] ** 2, 1e-12))
        found *= max(float(np.average(alike, weights=contrast)), 0.0) ** weight
        half = (len(shown) // 2,) * 2
        shown, target = (resize(picture, half, anti_aliasing=True) for picture in (shown, target))
    return found


def blurred(picture: Any) -> Any:
    """The means that SSIM compares, (H, W, 3)."""
    return gaussian(picture, 1.5, truncate=3.5, channel_axis=-1)


def display_values(file: Path) -> Any:
    """(H, W, 3) display values of a picture file."""
    return np.asarray(Image.open(file).convert("RGB"), float) / 255


def made(picture: str, machine: str, folder: Path) -> Made:
    """The lens that ``mlens new`` and ``mlens run`` make of a picture and a machine."""
    folder.mkdir(parents=True)
    PICTURES[picture]().save(folder / f"{picture}.png")
    making = Making(machine, f"{SIZE_MM}mm")
    new_spec(
        "single", [folder / f"{picture}.png"], folder / "spec.yaml", making=making, treatment=treatment_of("centre")
    )
    run = run_spec(folder / "spec.yaml", folder / "run", SMALL)
    [view] = run.manifest["views"]
    shown, target = run.folder / "figures" / f"as-made-{view['name']}.png", run.folder / view["target"]
    verdict = json.loads((run.folder / "preflight.json").read_text(encoding="utf-8"))["verdict"]
    arc_minutes = round(np.degrees(np.arctan(SIZE_MM / DISTANCE_MM)) * 60)  # along the lens
    alike = similarity(display_values(shown), display_values(target), arc_minutes)
    return Made(f"{picture}, {machine}", verdict["as_made"]["word"], alike)


@pytest.fixture(scope="module")
def lenses(tmp_path_factory: pytest.TempPathFactory) -> list[Made]:
    folder = tmp_path_factory.mktemp("verdicts")
    return [made(picture, machine, folder / picture / machine) for picture in PICTURES for machine in MACHINES]


@pytest.fixture(scope="module")
def examples() -> dict[str, list[float]]:
    """The similarity of the documentation's examples and their targets, by their word."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(DOCS)
        script = import_module("draw_verdicts")
    found: dict[str, list[float]] = {word: [] for word in WORDS}
    for name, shown, wanted in script.pictures():
        pair = (np.broadcast_to(to_display(picture), (*picture.shape[:2], 3)) for picture in (shown, wanted))
        found[script.EXAMPLES[name][2]].append(similarity(*pair, script.SIDE))
    return found


@pytest.mark.sweep
def test_words_are_in_the_order_of_what_is_seen(lenses: list[Made]) -> None:
    assert len(lenses) == 24
    assert {lens.word for lens in lenses} == set(WORDS), "every word is tried"
    for worse in lenses:
        for better in lenses:
            if WORDS.index(worse.word) < WORDS.index(better.word):
                assert worse.similarity < better.similarity, f"{worse} and {better}"


@pytest.mark.sweep
def test_words_mean_what_the_examples_show(lenses: list[Made], examples: dict[str, list[float]]) -> None:
    for lens in lenses:
        assert lens.word != "clear" or lens.similarity >= max(examples["recognisable"]), lens
        assert lens.word != "lost" or lens.similarity <= min(examples["clear"]), lens
        assert lens.word not in ("clear", "recognisable") or lens.similarity > max(examples["lost"]), lens
