"""What the page shows of a job and its runs, read from their folders."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from magiclens.report.tables import metric_rows
from magiclens.studio.store import StudioFolder, folder_bytes

WANTS = ("draft", "full")
"""The two runs of a job, which are also the names of their folders: a quick draft, and the design as the spec says."""
_DOWNLOADS = {
    "lens.3mf": "Lens, 3MF", "lens.stl": "Lens, STL", "lens.pdf": "Sheet to print, PDF", "lens.sl1": "Layers, SL1",
    "lens.zip": "Layers, pictures", "lens.gcode": "Milling program, G-code", "lens.rml": "Milling program, RML",
    "lens.jig": "Holder", "lens.monitor": "Sheet for a screen", "lens.": "Lens",
}  # fmt: skip
"""What the files are that somebody takes to a maker, by the beginning of their names, in the order of the page."""


_SHOWN = ("title", "state", "want", "said", "began", "took", "facets", "full_by_draft")
"""What the page is told of a job's state."""


def job_summary(store: StudioFolder, job: str) -> dict[str, Any]:
    """A job as the page shows it: its state, its runs, the room that it takes."""
    folder = store.root / "jobs" / job
    known = store.state(job)
    runs = {want: found for want in WANTS if (found := run_summary(folder / want))}
    shown = {key: known.get(key) for key in _SHOWN}
    return {"id": job, **shown, "runs": runs, "bytes": folder_bytes(folder)}


def run_summary(run: Path) -> dict[str, Any] | None:
    """Pictures, scores, sentences of preflight and files of a run; None if there is no finished run.

    Paths are relative to the run folder.
    """
    manifest = _read(run / "manifest.json")
    if not manifest:
        return None
    preflight = _read(run / "preflight.json") or {"verdict": None, "checks": []}
    files = [artifact["path"] for artifact in manifest["artifacts"]]
    tolerances = {key: value for key, value in manifest["metrics"].items() if key.startswith("tolerance_")}
    return {
        "views": [_view(view, files) for view in manifest["views"]],
        "facets": manifest["scene"]["facets"],
        "verdict": preflight["verdict"],
        "checks": [{key: check[key] for key in ("check", "status", "text")} for check in preflight["checks"]],
        "tolerances": [f"{label}: {value}" for label, value in metric_rows(tolerances)],
        "downloads": _downloads(files),
        "pages": [
            name for name in ("view.html", "show.html", "report.html", "preflight.html") if (run / name).is_file()
        ],
    }


def _downloads(files: list[str]) -> list[dict[str, str]]:
    """Files to take away; those of one kind keep their endings, so that they can be told apart."""
    found = {path: next((start for start in _DOWNLOADS if path.startswith(start)), None) for path in files}
    kinds = list(_DOWNLOADS)
    ours = sorted((kinds.index(start), path, start) for path, start in found.items() if start)
    return [{"path": path, "title": _title(path, start)} for _, path, start in ours]


def _title(path: str, start: str) -> str:
    rest = path.removeprefix(start).strip("-.")
    return f"{_DOWNLOADS[start]}, {rest}" if rest else _DOWNLOADS[start]


def _view(view: dict[str, Any], files: list[str]) -> dict[str, Any]:
    """Pictures of a view: the target, what the design shows, and what the made lens shows, where that is known."""
    renders = list(view["renders"].values())
    made = [f"figures/as-made-rough-{view['name']}.png", f"figures/as-made-{view['name']}.png"]
    return {
        "name": view["name"],
        "source": view["source"],
        "target": view["target"],
        "designed": renders[0] if renders else None,
        "made": next((path for path in made if path in files), None),
        "psnr_db": view["psnr_db"],
    }


def _read(path: Path) -> dict[str, Any] | None:
    """A JSON file; None if it is missing or half-written, as while a run takes its place."""
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found
