"""What the page of one lens shows, gathered from its run folder."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from markupsafe import Markup

from magiclens.config.suggest import unknown
from magiclens.contract.errors import InputError
from magiclens.report.tables import Row, measure
from magiclens.running.folder import MANIFEST
from magiclens.web.gallery.highlight import highlighted
from magiclens.web.gallery.listed import Entry
from magiclens.web.gallery.pictures import Album, Picture

SOURCE_PX, VIEW_PX, CARD_PX, FIGURE_PX = 640, 420, 380, 1100
"""Widths of pictures; about twice as many pixels as they usually have on a page."""
SMALL_PX = 320
"""Of sources and views where there are several sheets."""
MOST_VIEWS = 9
"""A long animation shows so many of its frames, evenly spaced."""
FIGURES = (
    "height-map", "stable-zone", "stable-zone-curve", "warp", "secrecy", "error", "steps", "annealing", "overlap"
)  # fmt: skip
"""Figures of a run in the order of the page; others follow. The contact sheet is what the page itself is."""
DOWNLOADS = {
    "lens.": "the lens, in millimetres",
    "sources/": "what to print",
    "animations/": "the animation",
    "spec.yaml": "the spec with every option",
    "report.html": "the whole report",
    "preflight.html": "whether it is fit to be made",
    "heights.npz": "the surface, for programs",
}
"""What of a run folder is offered, by the beginning of its path."""
HEADLINES = {"slope_mean_deg": "mean slope", "step_max_mm": "highest step"}


class Photo(NamedTuple):
    """A simulated photograph, and how close it is to the target."""

    renderer: str
    picture: Picture
    score: str


@dataclass(frozen=True)
class Seen:
    """One view. turn: lens rotation in degrees; place: how lens and eye are placed, in words."""

    name: str
    place: str
    turn: int
    target: Picture
    photos: Sequence[Photo]


@dataclass(frozen=True)
class Sheet:
    """A source, and every view of it."""

    source: Picture
    views: Sequence[Seen]


class Download(NamedTuple):
    """A file of the run folder."""

    path: str
    content: str
    size: str


@dataclass(frozen=True)
class LensPage:
    """Everything about one lens. card: small pictures of a source and of what is seen."""

    entry: Entry
    facts: dict[str, Any]
    command: str
    spec: Markup
    sheets: Sequence[Sheet]
    card: tuple[Picture, Picture]
    figures: Sequence[Picture]
    films: Sequence[str]
    downloads: Sequence[Download]
    headlines: Sequence[Row]
    viewer: Markup

    @property
    def name(self) -> str:
        """Of the entry, the run folder and the page."""
        return self.entry.name

    @property
    def views(self) -> list[Seen]:
        """All views that are shown."""
        return [view for sheet in self.sheets for view in sheet.views]

    @property
    def unseen(self) -> int:
        """Views that are not shown."""
        return len(self.facts["views"]) - len(self.views)


def lens_page(entry: Entry, folder: Path, viewer: str, album: Album, quick: bool) -> LensPage:
    """Gather a run folder's pictures, numbers and files; pictures are shrunk into the album. viewer: HTML."""
    facts = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    shown = _chosen(entry, facts["views"])
    seen = next(iter(shown["renders"].values()), shown["target"])
    source, seen_through = (album.shrunk(folder / path, entry.name, CARD_PX, "") for path in (shown["source"], seen))
    paths = [artifact["path"] for artifact in facts["artifacts"]]
    return LensPage(
        entry,
        facts,
        entry.command(quick),
        highlighted(entry.spec.read_text(encoding="utf-8"), "yaml"),
        _sheets(facts, folder, entry.name, album),
        (source, seen_through),
        [album.shrunk(folder / path, entry.name, FIGURE_PX, "") for path in _figures(paths)],
        [path for path in paths if path.endswith(".mp4")],
        _downloads(facts),
        _headlines(facts),
        Markup(viewer),
    )


def _chosen(entry: Entry, views: list[dict[str, Any]]) -> dict[str, Any]:
    """The view for the card."""
    names = [view["name"] for view in views]
    if entry.view is not None and entry.view not in names:
        raise InputError(f"{entry.name}: {unknown('view', entry.view, names)}")
    return views[names.index(entry.view) if entry.view else 0]


def _sheets(facts: dict[str, Any], folder: Path, group: str, album: Album) -> list[Sheet]:
    """Views by source, in the order of the first view of each."""
    views: dict[str, list[dict[str, Any]]] = {}
    for view in _spread(facts["views"]):
        views.setdefault(view["source"], []).append(view)
    wide, narrow = (SOURCE_PX, VIEW_PX) if len(views) == 1 else (SMALL_PX, SMALL_PX)
    return [
        Sheet(
            album.shrunk(folder / source, group, wide, "The source, without the lens"),
            [_seen(view, facts, folder, partial(album.shrunk, group=group, width=narrow)) for view in of_source],
        )
        for source, of_source in views.items()
    ]


def _spread(views: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """At most ``MOST_VIEWS`` views, the first and the last among them."""
    if len(views) <= MOST_VIEWS:
        return views
    return [views[round(k * (len(views) - 1) / (MOST_VIEWS - 1))] for k in range(MOST_VIEWS)]


def _seen(view: dict[str, Any], facts: dict[str, Any], folder: Path, shrunk: Callable[..., Picture]) -> Seen:
    place = _place(view, facts)
    return Seen(
        view["name"],
        place,
        round(view["rotation_deg"]) % 360,
        shrunk(folder / view["target"], alt=f"{view['name']}: the target"),
        [
            Photo(
                renderer,
                shrunk(folder / path, alt=f"{view['name']}: what is seen through the lens, {place}"),
                _score(view, renderer),
            )
            for renderer, path in view["renders"].items()
        ],
    )


def _score(view: dict[str, Any], renderer: str) -> str:
    """PSNR and SSIM as the manifest has them."""
    suffix = "" if renderer == "tracer" else f"_{renderer}"
    psnr, ssim = view.get(f"psnr_db{suffix}"), view.get(f"ssim{suffix}")
    return "" if psnr is None or ssim is None else f"{psnr:.1f} dB, SSIM {ssim:.2f}"


def _place(view: dict[str, Any], facts: dict[str, Any]) -> str:
    """How the lens and the eye are placed."""
    x, y, z = view["eye_mm"]
    above = f"eye {z - facts['scene']['thickness_mm']:.0f} mm above the lens"
    aside = f"eye at ({round(x)}, {round(y)}) mm" if abs(x) + abs(y) > 0.5 else ""
    turned = any(v["rotation_deg"] for v in facts["views"])
    parts = [f"lens at {view['rotation_deg']:g}°" if turned else "", aside]
    return ", ".join(part for part in parts if part) or above


def _figures(paths: Sequence[str]) -> list[str]:
    found = {Path(path).stem: path for path in paths if path.startswith("figures/") and path.endswith(".png")}
    found.pop("contact-sheet", None)
    names = [name for name in FIGURES if name in found]
    return [found[name] for name in [*names, *(name for name in found if name not in names)]]


def _downloads(facts: dict[str, Any]) -> list[Download]:
    """In the order of ``DOWNLOADS``."""
    files = facts["artifacts"]
    found = [
        Download(file["path"], content, size_text(file["bytes"]))
        for start, content in DOWNLOADS.items()
        for file in files
        if file["path"].startswith(start)
    ]
    return [*found, Download(MANIFEST, "everything about the run, for programs", "")]


def _headlines(facts: dict[str, Any]) -> list[Row]:
    """The few numbers that matter most."""
    scene, metrics = facts["scene"], facts["metrics"]
    rows = [Row("facets", f"{scene['facets']} x {scene['facets']}"), Row("size", f"{scene['size_mm']:g} mm")]
    for renderer in facts["views"][0]["renders"]:
        key = "psnr_db" if renderer == "tracer" else f"psnr_db_{renderer}"
        values = [view[key] for view in facts["views"] if view.get(key) is not None]
        if values:
            rows.append(Row(f"PSNR ({renderer})", f"{sum(values) / len(values):.1f} dB"))
    return rows + [Row(label, measure(key, metrics[key], 3)) for key, label in HEADLINES.items() if key in metrics]


def size_text(size: float) -> str:
    """Bytes for people."""
    for unit in ("bytes", "kB", "MB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} GB"
