"""Checks of the pictures: the exported file shows its targets the right way round, and the sources are fine enough."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import FloatArray, Lens, View
from magiclens.images import resize
from magiclens.images.score import best_exposure_psnr_db
from magiclens.preflight.finding import Finding, Status

if TYPE_CHECKING:
    from magiclens.preflight.triangles_kernels import TracedTriangles

_CLEARLY_BETTER_DB = 0.5
"""Difference of PSNR from which a mirrored or turned picture counts as the better one."""
_EXPECTED_LOSS_DB = 3.0
"""Loss against the run's picture that is not suspicious. The check's picture tends to be better, as it is smaller."""
_FINE_PX_PER_MM = 12.0
"""Resolution of a source that is enough for any lens."""
_COARSE_PX_PER_MM = 5.0
"""Resolution of a source below which its pixels alone cap the picture at 26 dB."""
CHECKED_VIEWS = 8
"""Number of views that are checked; an animation has many more."""
_TURNS = ("as it is", "turned by 90 deg", "turned by 180 deg", "turned by 270 deg")
"""How targets are turned for comparison, in words, by the number of quarter turns."""


def coarse_side(lens: Lens) -> int:
    """Pixels along the side of the picture that a mesh file's triangles make."""
    # 3 x 3 micro-facets to a pixel, or more: every triangle is one ray, and no pixel should stay empty
    return int(np.clip(lens.facets * lens.microfacets // 3, 12, 96))


def check_orientation(
    name: str,
    views: Sequence[View],
    pictures: Sequence[FloatArray],
    flipped_pictures: Sequence[FloatArray],
    run_psnr_db: float | None,
) -> Finding:
    """Compare the picture of a mesh file with its targets, their mirror images and their quarter turns.

    The file itself is mirrored, too: if that shows the targets better, its faces are inside out.

    Args:
        name: The name of the mesh file.
        views: Those that are checked, in the lens frame.
        pictures: (S, S, C) linear light, what their eyes see of the file.
        flipped_pictures: What they see of the mirrored file.
        run_psnr_db: Mean PSNR of the run's pictures; None if it has taken none.
    """
    side = len(pictures[0])
    targets = [resize(view.target, (side, side)) for view in views]
    psnr_db = {turn: _mean_psnr_db(pictures, [np.rot90(t, k) for t in targets]) for k, turn in enumerate(_TURNS)}
    for k, turn in enumerate(_TURNS):
        mirrored = [np.rot90(t[:, ::-1], k) for t in targets]
        psnr_db[f"mirrored and {turn}" if k else "mirrored"] = _mean_psnr_db(pictures, mirrored)
    flipped = _mean_psnr_db(flipped_pictures, targets)
    right = psnr_db.pop(_TURNS[0])
    best = max(psnr_db, key=lambda turn: psnr_db[turn])
    # differences alone: this coarse picture's own PSNR would be another number for what the report shows
    text, farther = f"seen through {name}, the picture", "dB farther from its target"
    # only a picture about as good as the run's proves that the file is turned or mirrored
    good = -np.inf if run_psnr_db is None else run_psnr_db - _EXPECTED_LOSS_DB
    if flipped > max(right + _CLEARLY_BETTER_DB, good):
        nearer = f"{flipped - right:.1f} dB nearer to its target if the file is mirrored"
        return Finding("mirror image", "red", f"{text} is {nearer}: it is inside out")
    if psnr_db[best] > max(right + _CLEARLY_BETTER_DB, good):
        return Finding("mirror image", "red", f"{text} is {psnr_db[best] - right:.1f} dB nearer to its target {best}")
    if run_psnr_db is not None and right < good:
        lost = f"{run_psnr_db - right:.1f} {farther} than that of the run"
        return Finding("mirror image", "red", f"{text} is {lost}: another lens, or turned?")
    if psnr_db[best] > right - _CLEARLY_BETTER_DB:
        mirrored_file = f"{right - flipped:.1f} {farther} if the file is mirrored"
        return Finding("mirror image", "green", f"{text} looks the same {best}; it is {mirrored_file}")
    other = right - max(flipped, psnr_db[best])
    return Finding("mirror image", "green", f"{text} is the right way round; mirrored or turned, {other:.1f} {farther}")


def light_in_pixels(traced: TracedTriangles, lens: Lens, view: View) -> FloatArray:
    """The light that triangles throw into the pixels of the picture of a view, by one ray for each triangle.

    Every triangle's light, from the source pixel that its ray meets, is added to the pixel in which its middle is seen,
    weighted by the area that it fills.

    Args:
        traced: What the eye sees of triangles of the top.
        lens: The lens.
        view: The view, in the lens frame.

    Returns:
        (C + 1, S * S) sums of linear light times area, and of areas, mm^2.
    """
    from magiclens.preflight.triangles_kernels import throw_light

    side = coarse_side(lens)
    light = np.zeros((side * side, view.source.shape[2] + 1))
    throw_light(traced, view.source, (lens.source_size_mm, lens.size_mm), side, light)
    return light.T


def picture_of_light(light: FloatArray) -> FloatArray:
    """The picture (S, S, C) float32, linear light, by what ``light_in_pixels`` finds of all triangles of the top."""
    side = math.isqrt(light.shape[-1])
    # a pixel in which no triangle is seen is black
    shown = light[:-1] / np.maximum(light[-1], 1e-9)
    return np.asarray(shown.T.reshape(side, side, -1), np.float32)


def check_source_resolution(lens: Lens, views: Sequence[View]) -> Finding:
    """Grade the resolution, in pixels per mm, of the coarsest source."""
    coarsest = min(views, key=lambda view: len(view.source))
    per_mm = len(coarsest.source) / lens.source_size_mm
    status: Status = "green" if per_mm >= _FINE_PX_PER_MM else "amber" if per_mm >= _COARSE_PX_PER_MM else "red"
    dpi = f"print it at {25.4 * per_mm:.0f} dpi or finer"
    return Finding("source", status, f"{coarsest.source_name}.png has {per_mm:.3g} pixels per mm; {dpi}, true to scale")


def check_colours(views: Sequence[View]) -> list[Finding]:
    """Warn of the first target that has colours its source has not; no finding if there is none."""
    for view in views:
        if view.source.shape[-1] < view.target.shape[-1]:
            advice = "take a source with its colours (for discs: colours), or accept grey"
            return [
                Finding("colours", "amber", f"{view.target_name} has colours, {view.source_name} has none; {advice}")
            ]
    return []


def _mean_psnr_db(pictures: Sequence[FloatArray], targets: Sequence[FloatArray]) -> float:
    pairs = zip(pictures, targets, strict=True)
    return float(np.mean([best_exposure_psnr_db(picture, target) for picture, target in pairs]))
