"""Describes a plan as text, for ``mlens plan``."""

from __future__ import annotations

import json
from typing import Any

from magiclens.plan.compile import Plan


def describe_plan(plan: Plan) -> str:
    """A plan as people read it: the lens, every view, every stage with every option."""
    return "\n".join([*_lens_lines(plan), "", *_view_lines(plan), "", *_stage_lines(plan)])


def _lens_lines(plan: Plan) -> list[str]:
    lens = plan.lens
    rows = {
        "name": plan.spec.name,
        "seed": plan.spec.seed,
        "lens": f"{lens.size_mm:g} mm, {lens.facets} x {lens.facets} facets of {lens.pitch_mm:g} mm, "
        f"{lens.microfacets} x {lens.microfacets} micro-facets each, cells {lens.cells}",
        "slab": f"{lens.thickness_mm:g} mm thick, relief {lens.relief_mm:g} mm, wall {lens.wall_mm:g} mm, "
        f"slope at most {lens.max_slope_deg:g} deg, ior {lens.ior:g}",
        "source": f"{lens.source_size_mm:g} mm, {lens.gap_mm:g} mm below the slab",
    }
    if plan.spec.medium:
        black, white = (f"{100 * level:g} %" for level in (plan.spec.medium.black, plan.spec.medium.white))
        glass = plan.spec.medium.glass or 0.0
        below = f", below {glass:g} mm of glass, which is as much as {plan.spec.medium.gap_mm:.3g} mm of air"
        rows["medium"] = f"black reflects {black} of the light, white {white}{below if glass else ''}"
    if plan.fabrication:
        rows["machine"] = f"{plan.fabrication.name}: {plan.fabrication.profile.title}"
    return [f"{key:9}{value}" for key, value in rows.items()]


def _view_lines(plan: Plan) -> list[str]:
    options = plan.resolved()["scenario"]
    return [
        f"scenario {options.pop('type')}",
        *(f"    {key}: {_inline(value)}" for key, value in options.items()),
        *(f"  view {shot}" for shot in plan.shots()),
    ]


def _stage_lines(plan: Plan) -> list[str]:
    lines = [f"pipeline, rematch {plan.spec.pipeline.rematch}, codesign {plan.spec.pipeline.codesign}"]
    for step in plan.steps:
        lines.append(f"  {step}, version {step.stage.version}")
        lines += [f"    {key}: {_inline(value)}" for key, value in step.choice().items() if key != "type"]
    lines.append(f"analyses: {', '.join(planned.name for planned in plan.analyses) or 'none'}")
    return lines


def _inline(value: Any) -> str:
    """A value as YAML writes it on one line."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {_inline(v)}' for key, v in value.items())}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_inline, value))}]"
    return value if isinstance(value, str) else json.dumps(value)
