"""Preflight as a page, as JSON, and as a table in a terminal."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.drawing.scales import Pixels
from magiclens.pages.base import embedded, look
from magiclens.preflight.finding import Finding
from magiclens.preflight.inspect import Preflight

SIDE = 640
"""Pixels of the map."""
MOST_PICTURES = 4
"""What a lens as made shows, in so many views."""
INK = {"green": (22, 128, 60), "amber": (217, 119, 6), "red": (200, 30, 40)}
VERDICTS = {
    "green": "Fit to be made.",
    "amber": "Can be made; look at what is amber first.",
    "red": "Not fit to be made as it is.",
}


def write_preflight(found: Preflight, folder: Path) -> None:
    """Write ``preflight.html`` and ``preflight.json``; equal findings give equal bytes."""
    (folder / "preflight.html").write_text(_page(found, _as_made(folder)), encoding="utf-8")
    (folder / "preflight.json").write_text(json.dumps(_facts(found), indent=2) + "\n", encoding="utf-8")


def table(found: Preflight) -> str:
    """One line per check, and the verdict."""
    lines = [f"{f.status:6} {f.check:18} {f.text}" for f in found.findings]
    return "\n".join([*lines, "", f"{found.status}: {VERDICTS[found.status]}"])


def lens_map(found: Preflight) -> Pixels | None:
    """(S, S, 3): the lens from above, the steeper the darker; facets at fault are framed, the worst crossed.

    None where there are no slopes to draw.
    """
    from PIL import Image, ImageDraw

    if found.slopes_deg is None:
        return None
    image = Image.fromarray(_shades(found.slopes_deg)).resize((SIDE, SIDE), Image.Resampling.NEAREST)
    draw, pitch = ImageDraw.Draw(image), SIDE / len(found.slopes_deg)
    width = max(round(pitch / 8), 2)
    for finding in sorted(_at_fault(found), key=lambda f: f.status == "red"):
        for row, column in finding.facets:
            box = (column * pitch, row * pitch, (column + 1) * pitch - 1, (row + 1) * pitch - 1)
            draw.rectangle(box, outline=INK[finding.status], width=width)
    for finding in _at_fault(found):
        row, column = finding.facets[0]
        left, top = column * pitch + width, row * pitch + width
        right, bottom = (column + 1) * pitch - 1 - width, (row + 1) * pitch - 1 - width
        draw.line((left, top, right, bottom), fill=INK[finding.status], width=width)
        draw.line((left, bottom, right, top), fill=INK[finding.status], width=width)
    return np.asarray(image)


def _shades(slopes_deg: FloatArray) -> Pixels:
    """(N, N, 3): white where a facet is flat, dark grey at 60 degrees."""
    grey = np.rint(245 - 150 * np.clip(slopes_deg / 60, 0, 1)).astype(np.uint8)
    return np.ascontiguousarray(np.broadcast_to(grey[..., None], (*grey.shape, 3)))


def _at_fault(found: Preflight) -> list[Finding]:
    return [finding for finding in found.findings if finding.facets and finding.status != "green"]


def _facts(found: Preflight) -> dict[str, object]:
    checks = [
        {"check": f.check, "status": f.status, "text": f.text, "facets": [list(facet) for facet in f.facets]}
        for f in found.findings
    ]
    return {"name": found.name, "machine": found.made_by or None, "status": found.status, "checks": checks}


def _as_made(folder: Path) -> dict[str, str]:
    """Data URIs of what the lens shows as made, by view: the rough pictures where there are some."""
    from PIL import Image

    figures = folder / "figures"
    paths = sorted(figures.glob("as-made-rough-*.png")) or sorted(figures.glob("as-made-*.png"))
    shown = {}
    for path in paths[:MOST_PICTURES]:
        with Image.open(path) as image:
            name = path.stem.removeprefix("as-made-").removeprefix("rough-")
            shown[name] = embedded(np.asarray(image.convert("RGB").resize((SIDE // 2, SIDE // 2))))
    return shown


def _page(found: Preflight, as_made: dict[str, str]) -> str:
    """The page; everything that users wrote is escaped."""
    from jinja2 import Environment, StrictUndefined

    source = (files("magiclens.preflight") / "templates" / "preflight.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    picture = lens_map(found)
    return environment.from_string(source).render(
        look=look(),
        found=found,
        verdict=VERDICTS[found.status],
        map=None if picture is None else embedded(picture),
        side=SIDE,
        framed=[finding.check for finding in _at_fault(found)],
        as_made=as_made,
    )
