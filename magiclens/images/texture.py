"""Texture synthesis: the unknown pixels of a picture are filled with the texture of an example (section 5.2).

Every unknown pixel is a copy of one pixel of the example, its *origin*. At the coarsest size tiles of the example
are laid one after the other, each the one of many random ones that fits best what is there already: known pixels
and earlier tiles. Then, from coarse to fine, each pixel takes the origin whose surroundings match its own best,
among the continuations of its neighbours' origins and a few random ones (as in PatchMatch). So tiles grow into one
another, and toward known pixels, along seams that do not show.
"""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray, IntArray
from magiclens.contract.errors import InputError
from magiclens.images.colour import to_display
from magiclens.images.resample import halved

_FINE_PX = 1024
"""Side from which pictures are matched at half their resolution, which is four times as fast."""
_LEAST_EXAMPLE_PX = 16
_COARSE_TILE_PX = 12
"""Least side of a tile at the coarsest size; pictures are halved until tiles would be smaller."""
_OVERLAP = 4
"""Neighbouring tiles share one part in this many."""
_REUSE_COST = 0.5
"""Cost of laying a part of the example once more than others are laid on average, in variances of the example."""
_KNOWN_WEIGHT = 10.0
"""Weight of known pixels when surroundings are compared; others weigh 1."""


def synthesize(
    example: FloatArray, fixed: FloatArray, known: BoolArray, rng: np.random.Generator, patch_px: int = 48
) -> FloatArray:
    """Fill the unknown pixels of a picture with the texture of an example.

    Args:
        example: (h, w, C) linear light.
        fixed: (H, W, C) linear light; what unknown pixels hold is ignored.
        known: (H, W) pixels that come back unchanged.
        rng: Randomness.
        patch_px: Side of the tiles, at least as large as the texture's features. Small examples and pictures take
            smaller tiles.

    Returns:
        (H, W, C) float32, linear light.

    Raises:
        InputError: The example is smaller than 16 x 16 pixels.
        ValueError: The shapes do not fit.
    """
    rows, columns, channels = example.shape
    if min(rows, columns) < _LEAST_EXAMPLE_PX:
        least = f"{_LEAST_EXAMPLE_PX} x {_LEAST_EXAMPLE_PX}"
        raise InputError(f"the example of a texture is {columns} x {rows} pixels; it needs at least {least}")
    if fixed.shape != (*known.shape, channels):
        raise ValueError(f"the picture has shape {fixed.shape}, not {(*known.shape, channels)}")
    even = known.shape[0] % 2 == known.shape[1] % 2 == 0
    if even and min(known.shape) >= _FINE_PX and min(rows, columns) >= 8 * _LEAST_EXAMPLE_PX:
        origins = _origins_at_half(example[: rows // 2 * 2, : columns // 2 * 2], fixed, known, rng, patch_px // 2)
    else:
        tile = min(patch_px, rows // 2, columns // 2, *known.shape)
        origins = _origins(example, np.where(known[..., None], fixed, 0), known, rng, tile)
    copied = example[origins[..., 0], origins[..., 1]]
    return np.where(known[..., None], fixed, copied).astype(np.float32)


def _origins_at_half(
    example: FloatArray, fixed: FloatArray, known: BoolArray, rng: np.random.Generator, tile: int
) -> IntArray:
    """Like ``_origins``, but found at half the resolution: blocks of 2 x 2 pixels are copied whole."""
    small, whole = halved(example), halved(known[..., None].astype(np.float32))[..., 0] == 1
    around = halved(np.where(known[..., None], fixed, 0).astype(np.float32))
    coarse = _origins(small, np.where(whole[..., None], around, 0), whole, rng, max(tile, 4))
    origins = 2 * coarse.repeat(2, axis=0).repeat(2, axis=1)
    origins[1::2, :, 0] += 1
    origins[:, 1::2, 1] += 1
    return origins


def _origins(example: FloatArray, fixed: FloatArray, known: BoolArray, rng: np.random.Generator, tile: int) -> IntArray:
    """(H, W, 2) row and column in the example of every pixel; those of known pixels are not used."""
    halvings = max(int(np.log2(tile / _COARSE_TILE_PX)), 0)
    examples = _pyramid(to_display(example).astype(np.float32), halvings)
    colours = _pyramid(to_display(fixed).astype(np.float32), halvings)
    shares = _pyramid(known.astype(np.float32), halvings)
    origins: IntArray = np.zeros((0, 0, 2), np.int32)
    for level in reversed(range(halvings + 1)):
        pattern, share = examples[level], shares[level]
        picture = colours[level] / np.where(share > 0, share, 1)[..., None]
        weight = np.where(share >= 0.5, np.float32(_KNOWN_WEIGHT), np.float32(0))
        if level == halvings:
            origins = _tiled(pattern, picture, weight, tile >> level, rng)
        else:
            origins = _doubled(origins, share.shape)
        origins = _improved(pattern, picture, weight, origins, 2 + min(level, 2), rng)
    return origins


def _pyramid(image: FloatArray, halvings: int) -> list[FloatArray]:
    """The image and its halves, finest first."""
    images = [image]
    for _ in range(halvings):
        images.append(halved(images[-1]))
    return images


def _tiled(
    example: FloatArray, picture: FloatArray, weight: FloatArray, tile: int, rng: np.random.Generator
) -> IntArray:
    """(H, W, 2) origins after tiles are laid in reading order; ``weight`` (H, W) is 0 where nothing is known."""
    from magiclens.images.texture_kernels import Canvas, lay_tiles

    channels = example.shape[-1]
    weights = np.repeat(weight[..., None], channels, axis=-1)
    canvas = Canvas(_rows(example), _rows(picture), _rows(weights), channels)
    starts_y, starts_x = (_starts(length, tile) for length in weight.shape)
    origins = np.full((*weight.shape, 2), -1, np.int32)
    lay_tiles(canvas, tile, starts_y, starts_x, _REUSE_COST * float(example.var()), origins, rng)
    return origins


def _starts(length: int, tile: int) -> IntArray:
    """First pixels of overlapping tiles that cover a side."""
    step = tile - tile // _OVERLAP
    return np.append(np.arange(0, length - tile, step), length - tile)


def _doubled(origins: IntArray, shape: tuple[int, ...]) -> IntArray:
    """The origins (H, W, 2) at twice the size, cut to ``shape``."""
    rows, columns = np.arange(shape[0])[:, None], np.arange(shape[1])[None, :]
    odd = np.stack(np.broadcast_arrays(rows % 2, columns % 2), axis=-1)
    return np.asarray(2 * origins[rows // 2, columns // 2] + odd)


def _improved(
    example: FloatArray,
    picture: FloatArray,
    weight: FloatArray,
    origins: IntArray,
    passes: int,
    rng: np.random.Generator,
) -> IntArray:
    """Better origins (H, W, 2) after a few passes over the pixels, forward and backward in turn."""
    from scipy.ndimage import maximum_filter

    from magiclens.images.texture_kernels import REACH, Canvas, improve_origins

    height, width, channels = example.shape
    origins = np.clip(origins, REACH, (height - 1 - REACH, width - 1 - REACH)).astype(np.int32)
    known = weight > 0
    near = maximum_filter(~known, 2 * REACH + 1)
    start = np.where(known[..., None], picture, example[origins[..., 0], origins[..., 1]])
    around = ((REACH, REACH), (REACH, REACH), (0, 0))
    weights = np.pad(np.repeat(np.maximum(weight, 1)[..., None], channels, axis=-1), around)
    canvas = Canvas(_rows(example), _rows(np.pad(start, around)), _rows(weights), channels)
    for k in range(passes):
        improve_origins(canvas, near, known, k % 2 == 1, origins, rng)
    return origins


def _rows(image: FloatArray) -> FloatArray:
    """(H, W * C) of an (H, W, C) image."""
    return np.ascontiguousarray(image, np.float32).reshape(len(image), -1)
