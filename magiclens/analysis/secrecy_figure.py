"""What a source gives away (section 7)."""

from __future__ import annotations

import numpy as np

from magiclens.contract.result import RunResult, Secrecy
from magiclens.drawing.figure import Figure
from magiclens.drawing.scales import GLOW, ColourScale
from magiclens.drawing.tiles import Tile, to_pixels

SIDE = 400


def secrecy_map(data: RunResult, found: Secrecy) -> Figure:
    """The first source, its target, and how much of each tile stands readable in its patch."""
    view = data.scene.views[0]
    scale = ColourScale(GLOW, 0.0, 1.0)
    facet = np.arange(SIDE) * len(found.tiles) // SIDE
    bits = data.manifest["metrics"].get("permutation_bits")
    strength = f"; about 2^{bits:.0f} lenses of this kind exist" if bits else ""
    likeness = f"PSNR {found.psnr_db:.1f} dB, SSIM {found.ssim:.2f} of the target"
    row = [
        Tile(to_pixels(view.source, SIDE), "Source", likeness),
        Tile(to_pixels(view.target, SIDE), "Target", view.name),
        Tile(
            scale.paint(found.tiles[facet[:, None], facet]),
            "Readable in its own patch",
            f"{found.tiles.mean():.2f} on average, {found.chance:.2f} by chance{strength}",
            scale,
        ),
    ]
    return Figure(
        "secrecy",
        "What the source gives away",
        [row],
        "To somebody without the lens the source looks unlike the target. Its patches hold the tiles of the target, "
        "shuffled and mirrored: 1 where a patch shows its tile exactly.",
    )
