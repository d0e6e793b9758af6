"""How much of a hidden picture can be guessed from a painted source alone (section 7)."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import Assignment, FloatArray, Lens, Scene, View
from magiclens.contract.result import Secrecy

PIXELS = 16
"""Per side of the tiles that are compared."""
LOOKS = 3
"""Look-ups in the source per side of such a pixel."""


def secrecy(scene: Scene, assignment: Assignment) -> Secrecy:
    """The sources of a scene as somebody without the lens sees them."""
    from magiclens.images import score

    whole = [score(view.source, view.target) for view in scene.views]
    own = np.mean([tile_likeness(scene.lens, assignment, view) for view in scene.views], axis=0)
    chance = np.mean([tile_likeness(scene.lens, assignment, view, shift=1) for view in scene.views])
    return Secrecy(
        float(np.mean([s.psnr_db for s in whole])), float(np.mean([s.ssim for s in whole])), own, float(chance)
    )


def tile_likeness(lens: Lens, assignment: Assignment, view: View, shift: int = 0) -> FloatArray:
    """(N, N): how alike each target tile and the patch that a facet looks at are, 1 less the mean absolute difference.

    What remains of secrecy when an attacker has found the patches, but not yet where each belongs. With a ``shift``,
    tiles are compared with other facets' patches, so many facets further on: what chance would give.
    """
    from scipy.ndimage import map_coordinates

    from magiclens.images import luminance, resize, to_display

    local, n = view.in_lens_frame(), lens.facets
    tiles = to_display(luminance(resize(local.target, (n * PIXELS, n * PIXELS))))
    tiles = tiles.reshape(n, PIXELS, n, PIXELS).transpose(0, 2, 1, 3)
    at = ((np.arange(PIXELS * LOOKS) + 0.5) / (PIXELS * LOOKS) - 0.5) * lens.pitch_mm
    x, y = at[None, None, None, :], -at[None, None, :, None]
    xx, xy, yy = (m[:, :, None, None] for m in np.moveaxis(assignment.maps.astype(np.float64), -1, 0))
    cx, cy = (c[:, :, None, None] for c in np.moveaxis(lens.facet_centres_mm() + assignment.offsets_mm, -1, 0))
    source = luminance(local.source)
    per_mm, half = len(source) / lens.source_size_mm, len(source) / 2 - 0.5
    rows, columns = half - (cy + xy * x + yy * y) * per_mm, half + (cx + xx * x + xy * y) * per_mm
    looks = map_coordinates(source, [rows, columns], order=1, mode="nearest")
    patches = to_display(looks.reshape(n * n, PIXELS, LOOKS, PIXELS, LOOKS).mean(axis=(2, 4)))
    patches = np.roll(patches, shift, axis=0).reshape(tiles.shape)
    likeness: FloatArray = 1 - np.abs(patches - tiles).mean(axis=(2, 3))
    return likeness
