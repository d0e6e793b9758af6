"""What the lens shows as the machine makes it, and what that costs (see ``simulation.as_made``)."""

from __future__ import annotations

from magiclens.analysis.base import Analysis, Findings
from magiclens.contract.result import RunResult
from magiclens.plan.compile import Plan


def _applies(plan: Plan) -> bool:
    return plan.fabrication is not None


def _compute(plan: Plan, result: RunResult) -> Findings | None:
    from magiclens.simulation.as_made import as_made, exposed

    assert plan.fabrication is not None
    made = as_made(plan.fabrication.machine, result.scene, result.solid)
    if made is None:
        return None
    views = result.scene.views
    names = [f"as-made-{view.name}" for view in views]
    return Findings(
        {"as_made_psnr_db": made.psnr_db, "fabrication_loss_db": made.loss_db},
        pictures=dict(zip(names, exposed(made.pictures, views), strict=True)),
    )


AS_MADE = Analysis("as-made", _applies, _compute)
"""The picture as the machine makes the lens."""
