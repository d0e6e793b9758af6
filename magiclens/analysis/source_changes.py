"""How much painted sources still look like the sources that were given."""

from __future__ import annotations

import numpy as np

from magiclens.analysis.base import Analysis, Findings
from magiclens.contract.artifacts import Scene
from magiclens.contract.result import RunResult
from magiclens.plan.compile import Plan


def source_changes(given: Scene, painted: Scene) -> dict[str, float]:
    """PSNR, dB, and SSIM of the painted sources against the given ones, means over the sources."""
    from magiclens.images.score import score

    both = zip(given.views, painted.views, strict=True)
    pairs = {new.source_name: score(new.source, old.source, 1.0) for old, new in both}
    scores = list(pairs.values())
    return {
        "source_psnr_db": float(np.mean([s.psnr_db for s in scores])),
        "source_ssim": float(np.mean([s.ssim for s in scores])),
    }


def _applies(plan: Plan) -> bool:
    return plan.encoder is not None


def _compute(plan: Plan, result: RunResult) -> Findings:
    return Findings(source_changes(result.given, result.painted))


SOURCE_CHANGES = Analysis("source-changes", _applies, _compute)
"""How much an encoder has changed the sources."""
