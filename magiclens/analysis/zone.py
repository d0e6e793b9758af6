"""The stable viewing zone: how well a lens keeps its picture while the eye moves (section 7, figure 14)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magiclens.contract.artifacts import FloatArray, Scene, Solid, View
from magiclens.contract.result import Zone

RESOLUTION, SAMPLES = 512, 4
"""Pixels per side of the measured pictures, samples per side of a pixel: fewer take noise for what an eye sees."""
DIRECTIONS = 8
"""In which the eye is moved: toward the eyes of a cross, and between them."""
DIAGONAL = np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0])


def rings(scene: Scene) -> list[float]:
    """Distances, mm, of the other eyes from the first, ascending, each once; none if there is no zone to measure.

    There is one where all views show the same target through the same source at the same rotation, and their eyes
    stand around the first one, as far from the lens as it.
    """
    first, *others = scene.views
    steps = np.array([view.eye_mm - first.eye_mm for view in others]).reshape(-1, 3)
    away = np.unique(np.hypot(steps[:, 0], steps[:, 1]).round(6))
    away = away[away > 0]
    around = len(away) > 0 and np.abs(steps[:, 2]).max() < 1e-6 and np.abs(steps.sum(axis=0)).max() < 0.01 * away[-1]
    return away.tolist() if around and all(_alike(first, view) for view in others) else []


def _alike(one: View, other: View) -> bool:
    same = (one.source_name, one.quarter_turns) == (other.source_name, other.quarter_turns)
    return same and np.array_equal(one.target, other.target)


def moves(rings_mm: list[float]) -> FloatArray:
    """(M,) mm: how far to move the eye; finest within the inner ring, and on beyond the outer one."""
    inner, outer = rings_mm[0], rings_mm[-1]
    between = np.linspace(inner, outer, 3)
    return np.unique(np.concatenate([[0, inner / 2], between, [1.5 * outer]]).round(6))


def measure(scene: Scene, solid: Solid, plain_scene: Scene, plain: Solid) -> Zone:
    """Pictures and PSNR of a lens and of one made for its first eye alone; see ``rings`` for what scenes it takes."""
    rings_mm = rings(scene)
    steps = moves(rings_mm)
    shown = [0.0, rings_mm[0], rings_mm[-1], 1.5 * rings_mm[-1]]
    lenses = {"zone": (scene, solid), "plain": (plain_scene, plain)}
    return Zone(
        float(scene.views[0].eye_mm[2] - scene.lens.thickness_mm),
        rings_mm,
        steps,
        {name: np.array([_around(*lens, step) for step in steps]) for name, lens in lenses.items()},
        shown,
        {name: [seen_from(*lens, step * DIAGONAL) for step in shown] for name, lens in lenses.items()},
    )


def seen_from(scene: Scene, solid: Solid, move_mm: FloatArray) -> FloatArray:
    """(R, R, C) float32, linear light, world frame: what the first view's eye sees once it has moved by (3,) mm."""
    from magiclens.rendering.tracer import picture, trace

    view = replace(scene.views[0], eye_mm=scene.views[0].eye_mm + move_mm)
    hits = trace(solid, scene.lens, view, RESOLUTION, SAMPLES)
    seen = picture(hits, view.in_lens_frame().source, scene.lens.source_size_mm)
    return np.ascontiguousarray(np.rot90(seen, view.quarter_turns))


def _around(scene: Scene, solid: Solid, step_mm: float) -> list[float]:
    """PSNR, dB, in every direction."""
    from magiclens.images import resize, score

    angles = 2 * np.pi * np.arange(DIRECTIONS if step_mm else 1) / DIRECTIONS
    ways = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=-1)
    target = resize(scene.views[0].target, (RESOLUTION, RESOLUTION))
    found = [score(seen_from(scene, solid, step_mm * way), target).psnr_db for way in ways]
    return found if step_mm else found * DIRECTIONS
