"""Polishing and evaluation, for all matchers whose views share an eye: rough candidates become as good as can be."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import Candidates, FloatArray, Scene
from magiclens.images import to_display
from magiclens.kernels.lanes import with_room
from magiclens.kernels.threads import side_by_side
from magiclens.matching.channels import Channels, stack_channels
from magiclens.matching.evaluation_kernels import Staircase, evaluate
from magiclens.matching.grain import flat_scale, seen_grain
from magiclens.matching.options import MatchingOptions
from magiclens.matching.polishing_kernels import drop_unreachable, polish
from magiclens.matching.pool import Pool
from magiclens.matching.rasters import DISPLAY_TABLE
from magiclens.matching.tuples import Levels, PolishingRule, Tiles
from magiclens.optics.medium import image_optics_of

WIDTHS_MM = (0.0, 0.1, 0.2, 0.35)
"""Widths of the boxes over which sources are averaged, mm: patches that are seen small need the widest."""
ITERATIONS = 10
"""Levenberg-Marquardt steps per candidate, at most."""


def polished(scene: Scene, rough: Candidates, options: MatchingOptions, isotropic: bool = False) -> Candidates:
    """Move, scale and shear candidates until their patches' edges fall on the tile's; best first (4.2).

    What refraction cannot reach is left out. Errors are those that flat micro-facets will show, sampled pixel by pixel,
    the distance term included.

    Args:
        scene: its views must share an eye in the lens frame.
        rough: (N, N, K) candidates, whose errors need only be finite.
        options: of the matcher that found them.
        isotropic: whether maps are and stay multiples of the identity.

    Returns:
        (N, N, at most ``options.candidates``) candidates.

    Raises:
        InputError: a facet has no candidate that it can show, or views do not share an eye.
    """
    lens, pool = scene.lens, Pool.of(rough)
    centres = lens.facet_centres_mm().reshape(-1, 2) * (1, -1)
    drop_unreachable(centres, lens.pitch_mm / 2, image_optics_of(scene), pool.found)
    pool.require_all(lens)
    pool.sort()
    finish(pool, scene, stack_channels(scene), slice(0, lens.facets), options, isotropic)
    return pool.candidates(lens, options.candidates)


def finish(
    pool: Pool, scene: Scene, channels: Channels, rows: slice, options: MatchingOptions, isotropic: bool
) -> None:
    """Polish, evaluate and sort what a search has left in the pool.

    Args:
        pool: the candidates of the facets in these rows.
        scene: the lens and its views.
        channels: its views, stacked.
        rows: of facets.
        options: of the matcher.
        isotropic: whether maps stay multiples of the identity.
    """
    lens, pixels, per_mm = scene.lens, 2 * options.pixels, 1 / channels.source_px_mm
    values = channels.tiles(lens.facets, pixels, rows).reshape(len(pool.errors), -1, pixels, pixels)
    centres, window = lens.facet_centres_mm()[rows].reshape(-1, 2) * (1, -1), options.window_on(lens)
    tiles = Tiles(_interleaved(values), centres, lens.pitch_mm)
    rule = PolishingRule(options.polish, ITERATIONS, isotropic)
    images = with_room((len(WIDTHS_MM), *channels.source.shape[1:], len(channels.source)))
    blur_levels(channels.source, channels.source_px_mm, seen_grain(scene), WIDTHS_MM, np.moveaxis(images, -1, 1))
    levels = Levels(images, np.array(WIDTHS_MM))
    polish(tiles, levels, per_mm, window, rule, image_optics_of(scene), pool.found)
    pool.drop(options.acceptance)
    stairs = Staircase(lens.microfacets, flat_scale(scene), DISPLAY_TABLE)
    evaluate(tiles, _interleaved(channels.source), per_mm, stairs, window, pool.found)
    pool.drop(options.acceptance)
    pool.sort()


def blur_levels(
    source: FloatArray, source_px_mm: float, grain_mm: float, widths_mm: tuple[float, ...], levels: FloatArray
) -> None:
    """Average a source over boxes of several widths.

    A flat micro-facet shows a patch of its own size, ``grain_mm``, unmagnified: every level is averaged over that too.

    Args:
        source: (C, H, W) linear light.
        source_px_mm: side of a source pixel.
        grain_mm: side of what a micro-facet shows.
        widths_mm: of the boxes.
        levels: (L, C, H, W) float32 to fill with display values.
    """
    grain = grain_mm / source_px_mm
    grained = box_blur(source, grain, grain)

    # plane by plane, or most of the time would go into getting memory
    def blur(plane: tuple[int, ...]) -> None:
        level, channel = plane
        width = widths_mm[level] / source_px_mm
        levels[plane] = to_display(box_blur(grained[channel : channel + 1], width, width)[0])

    side_by_side(blur, np.ndindex(levels.shape[:2]))


def box_blur(image: FloatArray, rows: float, columns: float) -> FloatArray:
    """Average an image over centred boxes.

    Args:
        image: (C, H, W).
        rows: height of the box, pixels, which need not be a whole number.
        columns: width of the box, likewise.

    Returns:
        (C, H, W).
    """
    import cv2

    down, across = _box(rows), _box(columns)
    return np.stack([cv2.sepFilter2D(plane, -1, across, down, borderType=cv2.BORDER_REPLICATE) for plane in image])


def _box(width: float) -> FloatArray:
    """Weights of the pixels that a box covers, its middle pixel in their middle; a narrow box leaves images alone."""
    if width <= 1.0:
        return np.ones(1)
    whole = int((width - 1) / 2)
    rest = (width - 1) / 2 - whole
    return np.concatenate([[rest], np.ones(2 * whole + 1), [rest]]) / width


def _interleaved(images: FloatArray) -> FloatArray:
    """(..., H, W, C) of images (..., C, H, W), with room for lanes."""
    moved = np.moveaxis(images, -3, -1)
    out = with_room(moved.shape)
    out[...] = moved
    return out
