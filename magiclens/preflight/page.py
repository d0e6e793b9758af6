"""Preflight as a page, as JSON, and as a table for a terminal."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.drawing.scales import Pixels
from magiclens.pages.pictures import webp_uri
from magiclens.pages.templating import render_page
from magiclens.preflight.finding import Finding, Preflight

STATUS_COLOURS = {"green": (22, 128, 60), "grey": (110, 110, 110), "amber": (217, 119, 6), "red": (200, 30, 40)}
"""Colours of the frames in the map, 8-bit sRGB."""
_MAP_SIDE = 640
"""Width and height of the map, pixels."""
_MOST_PICTURES = 4
"""Most pictures of the lens as made that the page shows."""
_ADVICE = {
    "green": "Fit to be made.",
    "grey": "Nothing wrong was found, but what is grey was not checked.",
    "amber": "Can be made; look at what is amber first.",
    "red": "Not fit to be made as it is.",
}
"""The sentence of each status about the whole lens."""


def write_preflight(found: Preflight, folder: Path) -> None:
    """Write ``preflight.html`` and ``preflight.json`` into a run folder; equal findings give equal bytes."""
    (folder / "preflight.html").write_text(_page(found, _as_made(folder)), encoding="utf-8")
    (folder / "preflight.json").write_text(json.dumps(_as_object(found), indent=2) + "\n", encoding="utf-8")


def preflight_text(found: Preflight) -> str:
    """A table for a terminal: the verdict, one line for each check, then whether the lens is fit to be made."""
    lines = [f"{f.status:6} {f.check:18} {f.text}" for f in found.findings]
    return "\n".join([found.verdict.text, "", *lines, "", f"{found.status}: {_ADVICE[found.status]}"])


def lens_map(found: Preflight) -> Pixels | None:
    """Draw the lens from above: steep facets are dark, facets at fault are framed, each check's worst has a cross.

    Returns:
        A picture (S, S, 3), row 0 at +y; None if the slopes are not known.
    """
    from PIL import Image, ImageDraw

    if found.slopes_deg is None:
        return None
    image = Image.fromarray(_shades(found.slopes_deg)).resize((_MAP_SIDE, _MAP_SIDE), Image.Resampling.NEAREST)
    draw, pitch = ImageDraw.Draw(image), _MAP_SIDE / len(found.slopes_deg)
    width = max(round(pitch / 8), 2)
    # red frames come last: a facet that is at fault twice shows the worse status
    for finding in sorted(_at_fault(found), key=lambda f: f.status == "red"):
        for row, column in finding.facets:
            box = (column * pitch, row * pitch, (column + 1) * pitch - 1, (row + 1) * pitch - 1)
            draw.rectangle(box, outline=STATUS_COLOURS[finding.status], width=width)
    for finding in _at_fault(found):
        row, column = finding.facets[0]
        left, top = column * pitch + width, row * pitch + width
        right, bottom = (column + 1) * pitch - 1 - width, (row + 1) * pitch - 1 - width
        draw.line((left, top, right, bottom), fill=STATUS_COLOURS[finding.status], width=width)
        draw.line((left, bottom, right, top), fill=STATUS_COLOURS[finding.status], width=width)
    return np.asarray(image)


def _shades(slopes_deg: FloatArray) -> Pixels:
    """Greys (N, N, 3) of facets with slopes (N, N): nearly white where flat, dark at 60 degrees."""
    grey = np.rint(245 - 150 * np.clip(slopes_deg / 60, 0, 1)).astype(np.uint8)
    return np.ascontiguousarray(np.broadcast_to(grey[..., None], (*grey.shape, 3)))


def _at_fault(found: Preflight) -> list[Finding]:
    return [finding for finding in found.findings if finding.facets and finding.status in ("amber", "red")]


def _as_object(found: Preflight) -> dict[str, object]:
    """The content of ``preflight.json``."""
    checks = [
        {"check": f.check, "status": f.status, "text": f.text, "facets": [list(facet) for facet in f.facets]}
        for f in found.findings
    ]
    return {
        "verdict": found.verdict.as_object(),
        "name": found.name,
        "machine": found.made_by or None,
        "status": found.status,
        "checks": checks,
    }


def _as_made(folder: Path) -> dict[str, str]:
    """Data URIs of the pictures of the lens as made, by view; those with rough surfaces if there are any."""
    from PIL import Image

    figures = folder / "figures"
    paths = sorted(figures.glob("as-made-rough-*.png")) or sorted(figures.glob("as-made-*.png"))
    shown = {}
    for path in paths[:_MOST_PICTURES]:
        with Image.open(path) as image:
            name = path.stem.removeprefix("as-made-").removeprefix("rough-")
            shown[name] = webp_uri(np.asarray(image.convert("RGB").resize((_MAP_SIDE // 2, _MAP_SIDE // 2))))
    return shown


def _page(found: Preflight, as_made: dict[str, str]) -> str:
    """The HTML page; everything that users wrote is escaped."""
    picture = lens_map(found)
    return render_page(
        "magiclens.preflight/preflight.html",
        found=found,
        advice=_ADVICE[found.status],
        map=None if picture is None else webp_uri(picture),
        side=_MAP_SIDE,
        framed=[finding.check for finding in _at_fault(found)],
        as_made=as_made,
    )
