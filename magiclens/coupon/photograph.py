"""A photograph of a coupon on its sheet: its light, its markers, and a first guess at where the camera was."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.contract.errors import InputError
from magiclens.coupon.sheet import TEXTURE_MM, dictionary, marker_corners

_LEAST_MARKERS = 8
_MOST_PX_PER_MM, _LEAST_PX_PER_MM = 14.0, 7.0
"""A finer photograph is made coarser, as that is quicker; a coarser one shows too little."""


@dataclass(frozen=True)
class CouponPhotograph:
    """The part of a photograph that shows the squares of the sheet.

    Attributes:
        light: (rows, columns) linear light.
        first: Column and row of its first pixel in the whole photograph.
        size: Width and height of the whole photograph, pixels.
        points_px: (P, 2) corners of markers in the whole photograph.
        points_mm: (P, 2) the same corners on the sheet.
        focal: Focal length in pixels, if the file states it.
    """

    light: FloatArray
    first: tuple[int, int]
    size: tuple[int, int]
    points_px: FloatArray
    points_mm: FloatArray
    focal: float | None


def read_photograph(path: Path) -> CouponPhotograph:
    """Read a photograph and find the sheet on it.

    Raises:
        InputError: It is no picture, it shows fewer than eight markers, or the sheet is too small on it.
    """
    import cv2

    from magiclens.images.files import read_image

    light = read_image(path).mean(axis=2)
    points_px, points_mm = _markers(light, path)
    homography = np.asarray(cv2.findHomography(points_mm, points_px)[0], np.float64)
    scale = _px_per_mm(homography)
    if scale < _LEAST_PX_PER_MM:
        wish = f"the sheet has only {scale:.1f} pixels per mm in this photograph"
        raise InputError(f"{wish}; go nearer, so that it fills the picture: {_LEAST_PX_PER_MM:g} are needed", str(path))
    joined = max(math.floor(scale / _MOST_PX_PER_MM), 1)
    focal = _stated_focal(path, light.shape)
    light, points_px = _coarser(light, joined), points_px / joined
    homography = np.diag([1 / joined, 1 / joined, 1]) @ homography
    left, top, right, bottom = _field(homography, light.shape)
    part = np.ascontiguousarray(light[top:bottom, left:right])
    size = (light.shape[1], light.shape[0])
    return CouponPhotograph(part, (left, top), size, points_px, points_mm, focal and focal / joined)


def _markers(light: FloatArray, path: Path) -> tuple[FloatArray, FloatArray]:
    """Corners of all markers: in pixels, and in mm on the sheet."""
    import cv2

    from magiclens.images import to_display

    grey = np.rint(255 * to_display(np.clip(light / np.quantile(light, 0.99), 0, 1))).astype(np.uint8)
    options = cv2.aruco.DetectorParameters()
    options.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    found, numbers, _ = cv2.aruco.ArucoDetector(dictionary(), options).detectMarkers(grey)
    known = marker_corners()
    numbered = [] if numbers is None else zip(found, numbers.ravel().tolist(), strict=True)
    pairs = [(corners, known[int(number)]) for corners, number in numbered if number < len(known)]
    if len(pairs) < _LEAST_MARKERS:
        wish = f"{len(pairs)} of the sheet's {len(known)} markers are seen, {_LEAST_MARKERS} are needed"
        raise InputError(f"{wish}; photograph the whole sheet, sharp and evenly lit", str(path))
    # OpenCV counts from the middle of the first pixel, we from its corner
    px = np.concatenate([np.asarray(c, np.float64).reshape(4, 2) + 0.5 for c, _ in pairs])
    return px, np.concatenate([mm for _, mm in pairs])


def _px_per_mm(homography: FloatArray) -> float:
    """The resolution in the middle of the sheet, in the direction in which it is less."""
    a, b, c, d = _moved(homography, np.array([(-10.0, 0), (10.0, 0), (0, -10.0), (0, 10.0)]))
    return float(min(np.linalg.norm(b - a), np.linalg.norm(d - c)) / 20)


def _moved(homography: FloatArray, points: FloatArray) -> FloatArray:
    """Where points (P, 2) go by a homography (3, 3)."""
    moved = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return np.asarray(moved[:, :2] / moved[:, 2:])


def _coarser(light: FloatArray, joined: int) -> FloatArray:
    rows, columns = (n // joined * joined for n in light.shape)
    blocks = light[:rows, :columns].reshape(rows // joined, joined, columns // joined, joined)
    return np.asarray(blocks.mean(axis=(1, 3)), np.float64)


def _field(homography: FloatArray, shape: tuple[int, ...]) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of the box round the squares, pixels."""
    half = np.array(TEXTURE_MM) / 2
    corners = _moved(homography, half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]))
    low, high = np.floor(corners.min(axis=0)).astype(int), np.ceil(corners.max(axis=0)).astype(int)
    return max(low[0], 0), max(low[1], 0), min(high[0], shape[1]), min(high[1], shape[0])


def _stated_focal(path: Path, shape: tuple[int, ...]) -> float | None:
    """The focal length in pixels, from what cameras write into their files: that of a lens for film of 36 x 24 mm."""
    from PIL import Image

    with Image.open(path) as image:
        equivalent = image.getexif().get_ifd(0x8769).get(0xA405)
    return float(equivalent) / math.hypot(36, 24) * math.hypot(*shape) if equivalent else None
