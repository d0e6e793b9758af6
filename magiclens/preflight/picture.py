"""Does the exported file show the pictures, the right way round? Are the sources fine enough to be printed?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray, Lens, View
from magiclens.images import resize, score
from magiclens.preflight.exported import Exported
from magiclens.preflight.finding import Finding, Status
from magiclens.preflight.sight import Sight, looks

MARGIN_DB = 0.5
"""By how much a mirror image must be the better one to be an alarm."""
OFF_DB = 3.0
"""By how much this rough picture may be worse than the run's; it tends to be better, as it is smaller."""
FINE, COARSE = 12.0, 5.0
"""Source pixels per mm: enough for any lens; too few, they alone cap the picture at 26 dB."""
MOST_VIEWS = 8
"""Frames of an animation that are looked at."""
TURNS = ("as it is", "turned by 90 deg", "turned by 180 deg", "turned by 270 deg")


def mirror(
    file: Exported, lens: Lens, views: Sequence[View], sights: Sequence[Sight], claimed_db: float | None
) -> Finding:
    """The file's own picture against the targets, and against their mirror images and quarter turns; the file mirrored.

    views: in the lens frame. sights: of the file's top, one per view. claimed_db: mean PSNR that the run has found in
    its renders, None if there is none.
    """
    views, sights = views[:MOST_VIEWS], sights[:MOST_VIEWS]
    side = int(np.clip(lens.facets * lens.microfacets // 3, 12, 96))
    seen = [rendered(sight, lens, view, side) for sight, view in zip(sights, views, strict=True)]
    targets = [resize(view.target, (side, side)) for view in views]
    images = {name: _mean(seen, [np.rot90(t, k) for t in targets]) for k, name in enumerate(TURNS)}
    for k, name in enumerate(TURNS):
        images[f"mirrored and {name}" if k else "mirrored"] = _mean(seen, [np.rot90(t[:, ::-1], k) for t in targets])
    swapped = file.mirrored()
    other = looks(swapped.triangles[file.on_top], lens, views)
    flipped = _mean([rendered(s, lens, v, side) for s, v in zip(other, views, strict=True)], targets)
    right = images.pop(TURNS[0])
    best = max(images, key=lambda name: images[name])
    text = f"rendered from {file.name}, the picture is {right:.1f} dB from its target"
    good = -np.inf if claimed_db is None else claimed_db - OFF_DB
    if flipped > max(right + MARGIN_DB, good):
        return Finding("mirror image", "red", f"{text}, but {flipped:.1f} dB if the file is mirrored: it is inside out")
    if images[best] > max(right + MARGIN_DB, good):
        return Finding("mirror image", "red", f"{text}, but {images[best]:.1f} dB from the target {best}")
    if right < good:
        return Finding("mirror image", "red", f"{text}; the run saw {claimed_db:.1f} dB: another lens, or turned?")
    if images[best] > right - MARGIN_DB:
        text = f"{text}, which looks the same {best}; {flipped:.1f} dB if the file is mirrored"
        return Finding("mirror image", "green", text)
    return Finding("mirror image", "green", f"{text}; mirrored or turned at best {max(flipped, images[best]):.1f} dB")


def rendered(sight: Sight, lens: Lens, view: View, side: int) -> FloatArray:
    """(side, side, C) float32: every triangle's light, from the source at its middle, gathered in the pixel it is in.

    view: in the lens frame.
    """
    source, scale = view.source, view.source.shape[1] / lens.source_size_mm
    rows, columns = (_index(x * scale, n) for x, n in ((-sight.y, len(source)), (sight.x, source.shape[1])))
    inside = (sight.through > 0) & (np.maximum(abs(sight.x), abs(sight.y)) <= lens.source_size_mm / 2)
    light = source[rows, columns] * (sight.area * sight.through * inside)[:, None]
    down, right = (_index(x * side / lens.size_mm, side) for x in (-sight.v, sight.u))
    within = np.maximum(abs(sight.u), abs(sight.v)) <= lens.size_mm / 2
    pixel, area = (down * side + right)[within], sight.area[within]
    total = [np.bincount(pixel, light[within, c], side * side) for c in range(source.shape[-1])]
    filled = np.maximum(np.bincount(pixel, area, side * side), 1e-9)
    return np.asarray((np.stack(total, axis=-1) / filled[:, None]).reshape(side, side, -1), np.float32)


def resolution(lens: Lens, views: Sequence[View]) -> Finding:
    """Pixels per mm of the coarsest source."""
    coarsest = min(views, key=lambda view: len(view.source))
    per_mm = len(coarsest.source) / lens.source_size_mm
    status: Status = "green" if per_mm >= FINE else "amber" if per_mm >= COARSE else "red"
    dpi = f"print it at {25.4 * per_mm:.0f} dpi or finer"
    return Finding("source", status, f"{coarsest.source_name}.png has {per_mm:.3g} pixels per mm; {dpi}, true to scale")


def _mean(seen: Sequence[FloatArray], targets: Sequence[FloatArray]) -> float:
    pairs = zip(seen, targets, strict=True)
    return float(np.mean([score(picture, target).psnr_db for picture, target in pairs]))


def _index(places: FloatArray, count: int) -> IntArray:
    """Pixels that places lie in, counted from the picture's middle."""
    return np.asarray(np.clip((places + count / 2).astype(int), 0, count - 1))
