"""Layers as PNG files (ISO/IEC 15948).

Pillow holds a black-and-white picture as a byte per pixel; to pack these into bits takes it five times as long as to
compress them, and a stack has hundreds of layers of millions of pixels.
"""

from __future__ import annotations

import zlib
from struct import pack

import numpy as np
from numpy.typing import NDArray


def png(pixels: NDArray[np.uint8], dpi: tuple[float, float], packed_width: int = 0) -> bytes:
    """A picture as a file that knows its physical size.

    Args:
        pixels: (rows, columns) uint8, grey; or (rows, ceil(columns / 8)), black and white, eight pixels to a byte, the
            left one in the highest bit.
        dpi: Pixels per inch along x and y.
        packed_width: Columns, if they are packed.
    """
    rows, width = len(pixels), packed_width or pixels.shape[1]
    size = pack(">IIBBBBB", width, rows, 1 if packed_width else 8, 0, 0, 0, 0)  # grey, not interlaced
    metre = pack(">IIB", *(round(each / 0.0254) for each in dpi), 1)
    # every row begins with the number of its filter: none
    raw = np.concatenate([np.zeros((rows, 1), np.uint8), pixels], axis=1)
    # layers are runs of equal pixels: to look for nothing else is as quick as level 1 and a quarter smaller
    packer = zlib.compressobj(1, zlib.DEFLATED, zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL, zlib.Z_RLE)
    data = packer.compress(raw.tobytes()) + packer.flush()
    chunks = ((b"IHDR", size), (b"pHYs", metre), (b"IDAT", data), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, content) for kind, content in chunks)


def _chunk(kind: bytes, content: bytes) -> bytes:
    return pack(">I", len(content)) + kind + content + pack(">I", zlib.crc32(kind + content))
