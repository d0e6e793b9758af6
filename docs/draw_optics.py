"""Draws the pictures of docs/explanation/optics.md as files, for those who read the pages without the site.

``python docs/draw_optics.py`` writes ``docs/images/drawings/*.svg``. On the site the same drawings have its colours. A
test fails while the files are not what the code draws. With the folder of a gallery's runs as argument, figures of
these are copied to ``docs/images/runs`` too, smaller and in few colours.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

from PIL import Image

from magiclens.pages.templating import template_text
from magiclens.web.gallery.drawings import DRAWINGS

IMAGES = Path(__file__).parent / "images"
WIDTH, COLOURS = 900, 64
"""Greatest width of figures, pixels, and number of their colours."""


def drawings() -> Iterator[tuple[Path, str]]:
    """The path and the text of every drawing, with the styles of light pages."""
    colours = re.search(r":root \{.*?\n\}", template_text("magiclens.pages/tokens.css"), re.DOTALL)
    rules = [line for line in template_text("magiclens.web.gallery/site.css").splitlines() if ".drawing" in line]
    assert colours
    style = f"<style>{colours[0]} svg {{ font-family: sans-serif; }} {' '.join(rules)}</style>"
    for name, draw in DRAWINGS.items():
        element = draw(name.replace("-", " "))
        opened, rest = element.split(">", 1)
        yield (
            IMAGES / "drawings" / f"{name}.svg",
            f'{opened} xmlns="http://www.w3.org/2000/svg">{style}{rest}\n',
        )


def copy_figures(runs: Path) -> None:
    """Copy the figures that pages show from finished runs."""
    for path in (IMAGES / "runs").rglob("*.png"):
        with Image.open(runs / path.relative_to(IMAGES / "runs")) as image:
            small = image.convert("RGB")
            small.thumbnail((WIDTH, 10 * WIDTH))
            small.quantize(COLOURS).save(path, optimize=True)


if __name__ == "__main__":
    (IMAGES / "drawings").mkdir(exist_ok=True)
    for target, text in drawings():
        target.write_text(text, encoding="utf-8")
    if sys.argv[1:]:
        copy_figures(Path(sys.argv[1]))
