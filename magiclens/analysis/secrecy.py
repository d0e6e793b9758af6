"""How much of a hidden picture can be guessed from a painted source alone (section 7)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magiclens.analysis.base import Analysis, Findings
from magiclens.contract.artifacts import Assignment, FloatArray, Lens, Scene, View
from magiclens.contract.result import RunResult
from magiclens.drawing.figure import Figure
from magiclens.drawing.scales import GLOW, ColourScale
from magiclens.drawing.tiles import Tile, to_pixels
from magiclens.plan.compile import Plan

_PIXELS = 16
"""Pixels per side of the tiles that are compared."""
_SAMPLES = 3
"""Samples of the source per side of such a pixel."""
_SIDE = 400
_HIDDEN, _GUESSABLE = 0.1, 0.3
"""Similarity of a sheet and its picture up to which the picture is hidden, and up to which it is only guessed."""
_BLACK, _UNEVEN = 0.01**2, 0.03**2
"""What keeps SSIM finite where tiles are black, and where they are even."""
_SPREAD, _LEAST_SPREAD = 0.25, 1e-3
"""Standard deviation of display values in usual pictures, and that below which one is even, however an eye adapts."""


@dataclass(frozen=True)
class Secrecy:
    """What painted sources give away to somebody without the lens (section 7), on average over the views.

    Attributes:
        psnr_db: Of the sources against their targets.
        ssim: Of the sources against their targets.
        tiles: (N, N) likeness, 0 to 1, of each tile of the target and the patch that its facet shows.
        chance: The mean likeness of tiles and other facets' patches.
        shown: How much of the target shows in the source without the lens, see ``shown_in_sheet``; of the worst view.
    """

    psnr_db: float
    ssim: float
    tiles: FloatArray
    chance: float
    shown: float

    @property
    def metrics(self) -> dict[str, float]:
        """For the manifest."""
        return {
            "stealth_psnr_db": self.psnr_db,
            "stealth_ssim": self.ssim,
            "tile_leakage": float(self.tiles.mean()),
            "tile_leakage_by_chance": self.chance,
            "shown_in_sheet": self.shown,
        }


def secrecy(scene: Scene, assignment: Assignment) -> Secrecy:
    """Compare the painted sources of a scene with its targets: whole, tile by tile, and with tiles of other facets."""
    from magiclens.images import score

    whole = [score(view.source, view.target) for view in scene.views]
    own = np.mean([tile_likeness(scene.lens, assignment, view) for view in scene.views], axis=0)
    chance = np.mean([tile_likeness(scene.lens, assignment, view, shift=1) for view in scene.views])
    shown = max(shown_in_sheet(view.source, view.target, scene.lens) for view in scene.views)
    psnr_db, ssim = (float(np.mean(values)) for values in ([s.psnr_db for s in whole], [s.ssim for s in whole]))
    return Secrecy(psnr_db, ssim, own, float(chance), shown)


def shown_in_sheet(sheet: FloatArray, picture: FloatArray, lens: Lens) -> float:
    """How much of a picture somebody sees in the sheet alone: 1 for all of it, about 0 for nothing.

    It is the structural similarity (SSIM, Wang et al. 2004) of the sheet below the lens and the picture, tile by tile
    of the lens in place, each tile being one window; the mean over all tiles. An eye adapts to pale prints and reads
    negatives: the largest of three counts, for both as they are, and for both at the same brightness and contrast, the
    sheet as it is and as a negative.

    Args:
        sheet: (H, W, C) linear light, over the whole source.
        picture: (h, w, C) linear light, over the lens.
        lens: The lens.
    """
    from magiclens.images import luminance, resize, to_display

    n, edge = lens.facets, round(len(sheet) * (1 - lens.size_mm / lens.source_size_mm) / 2)
    below = sheet[edge : len(sheet) - edge, edge : len(sheet) - edge]
    seen, wanted = (to_display(luminance(resize(p, (n * _PIXELS,) * 2))).astype(float) for p in (below, picture))
    seen, wanted = (p.reshape(n, _PIXELS, n, _PIXELS).swapaxes(1, 2).reshape(n * n, -1) for p in (seen, wanted))
    adapted = _adapted(seen), _adapted(wanted)
    return max(_similarity(seen, wanted), _similarity(*adapted), _similarity(1 - adapted[0], adapted[1]))


def secrecy_word(shown: float) -> str:
    """The word for ``shown_in_sheet``: hidden, guessable or plain."""
    return "hidden" if shown <= _HIDDEN else "guessable" if shown <= _GUESSABLE else "plain"


def _adapted(tiles: FloatArray) -> FloatArray:
    """Display values at a usual brightness and contrast."""
    adapted: FloatArray = 0.5 + (tiles - tiles.mean()) * (_SPREAD / max(float(tiles.std()), _LEAST_SPREAD))
    return adapted


def _similarity(seen: FloatArray, wanted: FloatArray) -> float:
    """The mean SSIM of tiles (T, P) of display values."""
    one, other = seen.mean(axis=1), wanted.mean(axis=1)
    both = ((seen - one[:, None]) * (wanted - other[:, None])).mean(axis=1)
    brightness = (2 * one * other + _BLACK) / (one**2 + other**2 + _BLACK)
    return float((brightness * (2 * both + _UNEVEN) / (seen.var(axis=1) + wanted.var(axis=1) + _UNEVEN)).mean())


def tile_likeness(lens: Lens, assignment: Assignment, view: View, shift: int = 0) -> FloatArray:
    """How alike each tile of the target and the patch of its facet are: 1 less the mean absolute difference.

    This is what an attacker sees who has found the patches, but not yet where each belongs.

    Args:
        lens: The lens.
        assignment: Which patch every facet shows.
        view: Its source is painted.
        shift: Compare each tile with the patch of the facet so many facets further on, for the likeness by chance.

    Returns:
        (N, N) likeness, 0 to 1, of luminance in display values.
    """
    from scipy.ndimage import map_coordinates

    from magiclens.images import luminance, resize, to_display

    local, n = view.in_lens_frame(), lens.facets
    tiles = to_display(luminance(resize(local.target, (n * _PIXELS, n * _PIXELS))))
    tiles = tiles.reshape(n, _PIXELS, n, _PIXELS).transpose(0, 2, 1, 3)
    at = ((np.arange(_PIXELS * _SAMPLES) + 0.5) / (_PIXELS * _SAMPLES) - 0.5) * lens.pitch_mm
    x, y = at[None, None, None, :], -at[None, None, :, None]
    xx, xy, yy = (m[:, :, None, None] for m in np.moveaxis(assignment.maps.astype(np.float64), -1, 0))
    cx, cy = (c[:, :, None, None] for c in np.moveaxis(lens.facet_centres_mm() + assignment.offsets_mm, -1, 0))
    source = luminance(local.source)
    per_mm, half = len(source) / lens.source_size_mm, len(source) / 2 - 0.5
    rows, columns = half - (cy + xy * x + yy * y) * per_mm, half + (cx + xx * x + xy * y) * per_mm
    samples = map_coordinates(source, [rows, columns], order=1, mode="nearest")
    patches = to_display(samples.reshape(n * n, _PIXELS, _SAMPLES, _PIXELS, _SAMPLES).mean(axis=(2, 4)))
    patches = np.roll(patches, shift, axis=0).reshape(tiles.shape)
    likeness: FloatArray = 1 - np.abs(patches - tiles).mean(axis=(2, 3))
    return likeness


def secrecy_map(result: RunResult, found: Secrecy) -> Figure:
    """The first source, its target, and how much of each tile can be read in its patch."""
    view = result.scene.views[0]
    scale = ColourScale(GLOW, 0.0, 1.0)
    facet = np.arange(_SIDE) * len(found.tiles) // _SIDE
    bits = result.manifest["metrics"].get("permutation_bits")
    key_size = f"; about 2^{bits:.0f} lenses of this kind exist" if bits else ""
    of_target = f"{secrecy_word(found.shown)}: {found.shown:.2f} of the target shows without the lens"
    row = [
        Tile(to_pixels(view.source, _SIDE), "Source", of_target),
        Tile(to_pixels(view.target, _SIDE), "Target", view.name),
        Tile(
            scale.paint(found.tiles[facet[:, None], facet]),
            "Readable in its own patch",
            f"{found.tiles.mean():.2f} on average, {found.chance:.2f} by chance{key_size}",
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


def _applies(plan: Plan) -> bool:
    return plan.encoder is not None


def _compute(plan: Plan, result: RunResult) -> Findings:
    found = secrecy(result.painted, result.assignment)
    return Findings(found.metrics, found)


def _figures(result: RunResult, findings: Findings) -> list[Figure]:
    return [secrecy_map(result, findings.details)]


SECRECY = Analysis("secrecy", _applies, _compute, _figures)
"""What painted sources give away."""
