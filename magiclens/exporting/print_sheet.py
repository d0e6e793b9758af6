"""The sheet that is printed and laid under the lens."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

from pydantic import Field

from magiclens.contract.artifacts import Lens, Scene, Solid
from magiclens.contract.errors import InputError
from magiclens.contract.stages import Exporter

PAPERS = {
    "a4": (210.0, 297.0),
    "letter": (215.9, 279.4),
    "a3": (297.0, 420.0),
    "tabloid": (279.4, 431.8),
    "a2": (420.0, 594.0),
    "a1": (594.0, 841.0),
    "a0": (841.0, 1189.0),
}
"""Width and height of each paper, mm (ISO 216 and ANSI)."""
Paper = Literal["auto", "a4", "letter", "a3", "tabloid", "a2", "a1", "a0"]


class PrintSheet(Exporter):
    """The sources as a PDF to print at their exact size, a page for each.

    A page has the outline of the lens's bottom and marks at its corners, the views at the side that the lens's top
    (+y) is to point to, and rulers of 100 mm that tell whether a printer has kept the size.
    """

    type: ClassVar[str] = "sheet"
    suffix: ClassVar[str] = ".pdf"

    paper: Paper = Field("auto", description="size of the pages; auto takes the first that is large enough")

    def require_possible(self, lens: Lens) -> None:
        """Paper must be larger than the source; margins, marks and words need more."""
        self._paper_mm(lens.source_size_mm, lens.source_size_mm)

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        """Write all pages. Raises InputError if the paper is too small."""
        from magiclens.exporting.print_page import pages, write_pages

        drawn = pages(scene, solid)
        width, height = (max(sizes) for sizes in zip(*(page.needs_mm for page in drawn), strict=True))
        write_pages(drawn, self._paper_mm(width, height), path)

    def _paper_mm(self, width: float, height: float) -> tuple[float, float]:
        fitting = [name for name, (w, h) in PAPERS.items() if w >= width and h >= height]
        chosen = next(iter(fitting), None) if self.paper == "auto" else self.paper
        if chosen in fitting:
            return PAPERS[chosen]
        needs = f"the sheet needs {width:g} x {height:g} mm"
        advice = f"use {' or '.join(fitting[:2])}" if fitting else "no paper is that large; make the source smaller"
        small = "" if self.paper == "auto" else ", {} has {:g} x {:g} mm".format(self.paper, *PAPERS[self.paper])
        raise InputError(f"{needs}{small}; {advice}", keys=("paper", "scenario.source.size"))
