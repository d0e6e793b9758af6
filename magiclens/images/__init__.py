"""Pictures in linear light: files, colour, resampling, scores, and generated sources and targets.

An image is an (H, W, C) float32 array of linear light, 0 to 1; C is 1 (grey) or 3 (RGB). Row 0 is at +y, column 0 at
-x.
"""

from magiclens.images.art import ART, art
from magiclens.images.colour import grey, luminance, to_display, to_linear
from magiclens.images.files import read_image, write_png
from magiclens.images.resample import padded_to_square, resize
from magiclens.images.score import Score, psnr_db, score
from magiclens.images.sources import BLACK_AND_WHITE, COLOURED, circles

__all__ = [
    "ART",
    "BLACK_AND_WHITE",
    "COLOURED",
    "Score",
    "art",
    "circles",
    "grey",
    "luminance",
    "padded_to_square",
    "psnr_db",
    "read_image",
    "resize",
    "score",
    "to_display",
    "to_linear",
    "write_png",
]
