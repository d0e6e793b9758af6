"""The verdict: will this lens show its picture, made on its machine?"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from magiclens.analysis.as_made import made_picture
from magiclens.contract.artifacts import Lens
from magiclens.images import read_image
from magiclens.images.likeness import likeness, resolved_px
from magiclens.plan.compile import Plan
from magiclens.preflight.finding import Verdict
from magiclens.preflight.picture import CHECKED_VIEWS


def verdict_of(folder: Path, manifest: Mapping[str, Any], plan: Plan) -> Verdict:
    """Compare the pictures in a run folder, as made and as designed, with their targets.

    Args:
        folder: The run folder.
        manifest: Its manifest.
        plan: The plan of its spec.
    """
    views = manifest["views"][:CHECKED_VIEWS]
    rendered = all(view["renders"] for view in views)
    # of several renderers the first, as everywhere
    designed = _worst(folder, plan.lens, views, lambda v: next(iter(v["renders"].values()))) if rendered else None
    if "as_made_psnr_db" not in manifest["metrics"]:
        return Verdict(None, designed, _why_unchecked(plan))
    made = _worst(folder, plan.lens, views, lambda view: f"figures/{made_picture(view['name'])}.png")
    return Verdict(made, designed)


def _worst(
    folder: Path, lens: Lens, views: Sequence[Mapping[str, Any]], picture_path: Callable[[Mapping[str, Any]], str]
) -> float:
    """The least likeness of the views' pictures and their targets."""
    return min(
        likeness(
            read_image(folder / picture_path(view)),
            read_image(folder / view["target"]),
            resolved_px(lens.size_mm, float(np.linalg.norm(np.subtract(view["eye_mm"], (0, 0, lens.thickness_mm))))),
        )
        for view in views
    )


def _why_unchecked(plan: Plan) -> str:
    if plan.fabrication is None:
        return "no machine is named; name one: fabrication: {machine: sla}"
    return "it was not simulated: report.analyses leaves out as-made, or the lens is too large"
