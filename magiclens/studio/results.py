"""What the page shows of a job and its runs, read from their folders."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from magiclens.report.tables import metric_rows
from magiclens.studio.store import StudioFolder, folder_bytes

WANTS = ("draft", "full")
"""The two runs of a job, which are also the names of their folders: a quick draft, and the design as the spec says."""
_DOWNLOADS = (".stl", ".3mf", ".obj", ".ply", ".glb", ".pdf", ".zip", ".sl1", ".nc", ".ngc", ".rml", ".svx", ".yaml")


def job_summary(store: StudioFolder, job: str) -> dict[str, Any]:
    """A job as the page shows it: its state, its runs, the room that it takes."""
    folder = store.root / "jobs" / job
    known = store.state(job)
    runs = {want: found for want in WANTS if (found := run_summary(folder / want))}
    shown = {key: known.get(key) for key in ("title", "state", "want", "said", "done")}
    return {"id": job, **shown, "runs": runs, "bytes": folder_bytes(folder)}


def run_summary(run: Path) -> dict[str, Any] | None:
    """Pictures, scores, sentences of preflight and files of a run; None if there is no finished run.

    Paths are relative to the run folder.
    """
    manifest = _read(run / "manifest.json")
    if not manifest:
        return None
    preflight = _read(run / "preflight.json") or {"status": None, "checks": []}
    files = [artifact["path"] for artifact in manifest["artifacts"]]
    tolerances = {key: value for key, value in manifest["metrics"].items() if key.startswith("tolerance_")}
    return {
        "views": [_view(view, files) for view in manifest["views"]],
        "status": preflight["status"],
        "checks": [{key: check[key] for key in ("check", "status", "text")} for check in preflight["checks"]],
        "tolerances": [f"{label}: {value}" for label, value in metric_rows(tolerances)],
        "downloads": [path for path in files if path.endswith(_DOWNLOADS)],
        "pages": [name for name in ("report.html", "preflight.html", "view.html") if (run / name).is_file()],
    }


def _view(view: dict[str, Any], files: list[str]) -> dict[str, Any]:
    """Pictures of a view: the target, what the design shows, and what the made lens shows, where that is known."""
    renders = list(view["renders"].values())
    made = [f"figures/as-made-rough-{view['name']}.png", f"figures/as-made-{view['name']}.png"]
    return {
        "name": view["name"],
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
