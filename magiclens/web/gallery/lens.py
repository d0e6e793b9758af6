"""The content of the page of one lens, gathered from its run folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from markupsafe import Markup

from magiclens.analysis.as_made import made_picture
from magiclens.config.suggest import unknown
from magiclens.contract.errors import InputError
from magiclens.report.tables import TableRow, format_bytes, metric_headlines, verdict_of_run
from magiclens.running.folder import MANIFEST
from magiclens.running.manifest import REFERENCE_RENDERER
from magiclens.running.run_files import verified
from magiclens.web.gallery.gallery_list import GalleryEntry
from magiclens.web.gallery.highlight import highlighted
from magiclens.web.gallery.pictures import Album, Picture

_SOURCE_WIDTH, _VIEW_WIDTH, _CARD_WIDTH, _FIGURE_WIDTH = 640, 420, 380, 1100
"""Widths of pictures, pixels: about twice as many as they usually have on a page, for dense screens."""
_SMALL_WIDTH = 320
"""Width of sources and views if there are several sources, pixels."""
_MOST_VIEWS = 9
"""Most views on the page; of a longer animation some frames are shown, evenly spaced."""
_FIGURES = (
    "height-map", "stable-zone", "stable-zone-curve", "warp", "secrecy", "error", "steps", "annealing", "overlap"
)  # fmt: skip
"""Figures of a run in the order of the page; others follow. The contact sheet is left out: the page shows the same."""
_DOWNLOADS = {
    "lens.": "the lens, in millimetres",
    "sources/": "what to print",
    "animations/": "the animation",
    "spec.yaml": "the spec with every option",
    "report.html": "the whole report",
    "preflight.html": "whether it is fit to be made",
    "heights.npz": "the surface, for programs",
}
"""Descriptions of the files that can be downloaded, by the beginning of their path."""
_HEADLINE_METRICS = {"as_made_psnr_db": "PSNR as made", "slope_mean_deg": "mean slope", "step_max_mm": "highest step"}
"""Labels of the metrics at the top of the page."""


class Photo(NamedTuple):
    """A simulated photograph with its scores."""

    renderer: str
    picture: Picture
    score: str


@dataclass(frozen=True)
class ViewPictures:
    """The pictures of one view; ``placement`` says where lens and eye are, ``turn`` is the lens rotation in degrees."""

    name: str
    placement: str
    turn: int
    target: Picture
    photos: Sequence[Photo]


@dataclass(frozen=True)
class SourceGroup:
    """A source and all views of it."""

    source: Picture
    views: Sequence[ViewPictures]


class Download(NamedTuple):
    """A file of the run folder that can be downloaded."""

    path: str
    content: str
    size: str


@dataclass(frozen=True)
class LensPage:
    """Everything about one lens; ``card`` is a small source and a small photograph of it through the lens, and
    ``preview`` has both side by side, for links to the page."""

    entry: GalleryEntry
    manifest: dict[str, Any]
    command: str
    spec: Markup
    groups: Sequence[SourceGroup]
    card: tuple[Picture, Picture]
    preview: Picture
    figures: Sequence[Picture]
    films: Sequence[str]
    downloads: Sequence[Download]
    headlines: Sequence[TableRow]
    verdict: Mapping[str, Any] | None
    viewer: Markup

    @property
    def name(self) -> str:
        """The name of the entry, of the run folder and of the page."""
        return self.entry.name

    @property
    def views(self) -> list[ViewPictures]:
        """All views on the page."""
        return [view for group in self.groups for view in group.views]

    @property
    def views_left_out(self) -> int:
        """The number of views that are not on the page."""
        return len(self.manifest["views"]) - len(self.views)


def lens_page(entry: GalleryEntry, folder: Path, viewer: str, album: Album, quick: bool) -> LensPage:
    """Gather the pictures, numbers and files of a run.

    Args:
        entry: The lens in the list.
        folder: Its run folder.
        viewer: HTML of its viewer; may be empty.
        album: Takes the pictures, shrunk.
        quick: Whether the run was made with the overrides of a quick build.

    Raises:
        InputError: The entry names a view that the run does not have.
    """
    manifest = verified(folder).manifest
    shown = _chosen(entry, manifest["views"])
    paths = [artifact["path"] for artifact in manifest["artifacts"]]
    # what a print shows, if a machine was simulated: the mesh of a lens that makes up for its printer shows less
    made = f"figures/{made_picture(shown['name'])}.png"
    photo = made if made in paths else next(iter(shown["renders"].values()), shown["target"])
    card = [album.shrunk(folder / path, entry.name, _CARD_WIDTH, "") for path in (shown["source"], photo)]
    return LensPage(
        entry,
        manifest,
        entry.command(quick),
        highlighted(entry.spec.read_text(encoding="utf-8"), "yaml"),
        _groups(manifest, folder, entry.name, album),
        (card[0], card[1]),
        album.preview(folder / shown["source"], folder / photo, entry.name, entry.title),
        [album.shrunk(folder / path, entry.name, _FIGURE_WIDTH, "") for path in _figures(paths)],
        [path for path in paths if path.endswith(".mp4")],
        _downloads(manifest),
        _headlines(manifest),
        verdict_of_run(folder),
        Markup(viewer),
    )


def _chosen(entry: GalleryEntry, views: list[dict[str, Any]]) -> dict[str, Any]:
    """The view for the card."""
    names = [view["name"] for view in views]
    if entry.view is not None and entry.view not in names:
        raise InputError(f"{entry.name}: {unknown('view', entry.view, names)}")
    return views[names.index(entry.view) if entry.view else 0]


def _groups(manifest: dict[str, Any], folder: Path, group: str, album: Album) -> list[SourceGroup]:
    """Views by source, in the order of the first view of each."""
    views: dict[str, list[dict[str, Any]]] = {}
    for view in _some_views(manifest["views"]):
        views.setdefault(view["source"], []).append(view)
    wide, narrow = (_SOURCE_WIDTH, _VIEW_WIDTH) if len(views) == 1 else (_SMALL_WIDTH, _SMALL_WIDTH)
    return [
        SourceGroup(
            album.shrunk(folder / source, group, wide, "The source, without the lens"),
            [
                _view_pictures(view, manifest, folder, partial(album.shrunk, group=group, width=narrow))
                for view in of_source
            ],
        )
        for source, of_source in views.items()
    ]


def _some_views(views: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """At most ``_MOST_VIEWS`` views, the first and the last among them."""
    if len(views) <= _MOST_VIEWS:
        return views
    return [views[round(k * (len(views) - 1) / (_MOST_VIEWS - 1))] for k in range(_MOST_VIEWS)]


def _view_pictures(
    view: dict[str, Any], manifest: dict[str, Any], folder: Path, shrunk: Callable[..., Picture]
) -> ViewPictures:
    placement = _placement(view, manifest)
    return ViewPictures(
        view["name"],
        placement,
        round(view["rotation_deg"]) % 360,
        shrunk(folder / view["target"], alt=f"{view['name']}: the target"),
        [
            Photo(
                renderer,
                shrunk(folder / path, alt=f"{view['name']}: what is seen through the lens, {placement}"),
                _score(view, renderer),
            )
            for renderer, path in view["renders"].items()
        ],
    )


def _score(view: dict[str, Any], renderer: str) -> str:
    """PSNR and SSIM from the manifest; empty if it has none."""
    psnr, ssim = view.get(_key("psnr_db", renderer)), view.get(_key("ssim", renderer))
    return "" if psnr is None or ssim is None else f"{psnr:.1f} dB, SSIM {ssim:.2f}"


def _key(score: str, renderer: str) -> str:
    """The key of a score in the manifest, which names the renderer unless it is the reference."""
    return score if renderer == REFERENCE_RENDERER else f"{score}_{renderer}"


def _placement(view: dict[str, Any], manifest: dict[str, Any]) -> str:
    """Where lens and eye are, in words."""
    x, y, z = view["eye_mm"]
    above = f"eye {z - manifest['scene']['thickness_mm']:.0f} mm above the lens"
    aside = f"eye at ({round(x)}, {round(y)}) mm" if abs(x) + abs(y) > 0.5 else ""
    turned = any(v["rotation_deg"] for v in manifest["views"])
    parts = [f"lens at {view['rotation_deg']:g}°" if turned else "", aside]
    return ", ".join(part for part in parts if part) or above


def _figures(paths: Sequence[str]) -> list[str]:
    found = {Path(path).stem: path for path in paths if path.startswith("figures/") and path.endswith(".png")}
    found.pop("contact-sheet", None)
    names = [name for name in _FIGURES if name in found]
    return [found[name] for name in [*names, *(name for name in found if name not in names)]]


def _downloads(manifest: dict[str, Any]) -> list[Download]:
    """In the order of ``_DOWNLOADS``."""
    files = manifest["artifacts"]
    found = [
        Download(file["path"], content, format_bytes(file["bytes"]))
        for start, content in _DOWNLOADS.items()
        for file in files
        if file["path"].startswith(start)
    ]
    return [*found, Download(MANIFEST, "everything about the run, for programs", "")]


def _headlines(manifest: dict[str, Any]) -> list[TableRow]:
    """The few numbers at the top of the page."""
    scene, metrics = manifest["scene"], manifest["metrics"]
    rows = [TableRow("facets", f"{scene['facets']} x {scene['facets']}"), TableRow("size", f"{scene['size_mm']:g} mm")]
    for renderer in manifest["views"][0]["renders"]:
        key = _key("psnr_db", renderer)
        values = [view[key] for view in manifest["views"] if view.get(key) is not None]
        if values:
            rows.append(TableRow(f"PSNR as designed ({renderer})", f"{sum(values) / len(values):.1f} dB"))
    return rows + metric_headlines(metrics, _HEADLINE_METRICS)
