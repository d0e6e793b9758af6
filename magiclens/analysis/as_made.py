"""What the lens shows as the machine makes it, and what that costs (see ``simulation.as_made``)."""

from __future__ import annotations

from magiclens.analysis.base import Analysis, Findings
from magiclens.contract.result import RunResult
from magiclens.drawing.figure import Figure
from magiclens.drawing.photographs import photograph, photographs
from magiclens.drawing.tiles import side_of_tiles, titled_rows, to_pixels
from magiclens.plan.compile import Plan

_MOST_VIEWS = 8
"""Most views in the figure; an animation has many more."""


def _applies(plan: Plan) -> bool:
    return plan.fabrication is not None


def _compute(plan: Plan, result: RunResult) -> Findings | None:
    from magiclens.simulation.as_made import as_made, exposed

    assert plan.fabrication is not None
    made = as_made(plan.fabrication.machine, result.scene, result.solid)
    if made is None:
        return None
    views = result.scene.views
    names = [made_picture(view.name) for view in views]
    return Findings(
        {"as_made_psnr_db": made.psnr_db, "fabrication_loss_db": made.loss_db},
        pictures=dict(zip(names, exposed(made.pictures, views), strict=True)),
    )


def _figures(result: RunResult, findings: Findings) -> list[Figure]:
    views = result.scene.views[:_MOST_VIEWS]
    side, meshes = side_of_tiles(len(views)), next(iter(photographs(result).values()), None)
    titles = ["Target", *(["Through the mesh itself"] if meshes else []), "As the machine makes it"]
    rows = []
    for k, view in enumerate(views):
        photos = [*([meshes[k]] if meshes else []), photograph(findings.pictures[made_picture(view.name)], view, 1.0)]
        seen = [(to_pixels(photo.picture, side), photo.caption) for photo in photos]
        rows.append([(to_pixels(view.target, side), view.name), *seen])
    caption = "Hold this against your print: what cameras see of the lens as its machine makes it, simulated."
    return [Figure("as-made", "What the made lens shows", titled_rows(titles, rows), caption)]


def made_picture(view: str) -> str:
    """Name of the picture of a view, without its ending, that is found in ``figures/``."""
    return f"as-made-{view}"


AS_MADE = Analysis("as-made", _applies, _compute, _figures)
"""The picture as the machine makes the lens."""
