"""sRGB display values and linear light: light adds up in linear light, the eye compares display values."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray

_LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of linear red, green and blue in luminance (IEC 61966-2-1)."""


def to_linear(srgb: FloatArray) -> FloatArray:
    """Linear light of display values 0..1, by the exact sRGB curve (IEC 61966-2-1), with the same shape and dtype.

    Values outside 0..1 are clipped.
    """
    v = np.clip(srgb, 0.0, 1.0)
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def to_display(linear: FloatArray) -> FloatArray:
    """Display values 0..1 of linear light, by the exact sRGB curve (IEC 61966-2-1), with the same shape and dtype.

    Light outside 0..1 is clipped.
    """
    v = np.clip(linear, 0.0, 1.0)
    curve = v ** (1 / 2.4)
    curve *= 1.055  # in place: pictures are large
    curve -= 0.055
    return np.where(v <= 0.0031308, v * 12.92, curve)


def grey(image: FloatArray) -> FloatArray:
    """(H, W, 1) if the channels of every pixel of an image (H, W, C) are equal, else the image itself."""
    first = image[..., :1]
    return first if bool((image == first).all()) else image


def luminance(linear: FloatArray) -> FloatArray:
    """(H, W) luminance 0..1 of an image (H, W, C) in linear light, C = 1 or 3."""
    return linear[..., 0] if linear.shape[-1] == 1 else linear @ np.asarray(_LUMINANCE, linear.dtype)
