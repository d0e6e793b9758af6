"""The sheet that a coupon lies on: squares whose picture the coupon displaces, markers, marks for its corners."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray
from magiclens.coupon.shape import DEPTH_MM, WIDTH_MM

if TYPE_CHECKING:
    import cv2

SHEET_PX_PER_MM = 600 / 25.4
"""Resolution of the sheet: 600 dots per inch."""
_SQUARE_PX, _MODULE_PX = 9, 39
"""Sides of a square and of a marker's module. A marker has 6 x 6 modules, about 10 mm."""
_SIZE_MM = (90.0, 80.0)
"""Width and height of the sheet."""
TEXTURE_MM = (56.0, 46.0)
"""Width and height of the squares' field."""
_MARKERS_MM = (
    *((float(x), float(y)) for y in (32, -32) for x in (-37, -18.5, 0, 18.5, 37)),
    *((float(x), float(y)) for x in (-37, 37) for y in (-15.5, 0, 15.5)),
)
"""Centres of the markers, in the order of their numbers."""


def marker_corners() -> FloatArray:
    """(16, 4, 2) mm on the sheet, +y up, from the middle: each marker's corners clockwise from its top left one."""
    half = 3 * _MODULE_PX / SHEET_PX_PER_MM
    around = half * np.array([(-1, 1), (1, 1), (1, -1), (-1, -1)])
    return np.stack([_middle_mm(_corner_px(centre)) + around for centre in _MARKERS_MM])


def sheet_picture() -> FloatArray:
    """(H, W) float32, 1 is paper and 0 is ink, row 0 at +y."""
    height, width = _shape()
    sheet = np.ones((height, width), np.float32)
    rows, columns = (round(side * SHEET_PX_PER_MM / _SQUARE_PX) for side in TEXTURE_MM[::-1])
    squares = np.random.default_rng(1).integers(0, 2, (rows, columns))
    texture = np.kron(squares, np.ones((_SQUARE_PX, _SQUARE_PX)))
    top, left = (height - len(texture)) // 2, (width - texture.shape[1]) // 2
    sheet[top : top + len(texture), left : left + texture.shape[1]] = texture
    for number, centre in enumerate(_MARKERS_MM):
        row, column = _corner_px(centre)
        marker = _marker(number)
        sheet[row : row + len(marker), column : column + len(marker)] = marker
    sheet[_corner_marks(0.5)] = 1.0
    sheet[_corner_marks(0.15)] = 0.0
    return sheet


def dictionary() -> cv2.aruco.Dictionary:
    """The family of markers as OpenCV has it: 4 x 4 bits."""
    import cv2

    return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)


def write_sheet(folder: Path) -> None:
    """Write ``sheet.png`` and ``sheet.pdf``, both at true size; equal bytes every time."""
    from magiclens.images.files import write_png

    picture = sheet_picture()
    write_png(folder / "sheet.png", picture[..., None], SHEET_PX_PER_MM)
    _write_pdf(picture, folder / "sheet.pdf")


def _write_pdf(picture: FloatArray, path: Path) -> None:
    """The sheet in the middle of the upper half of an A4 page, with rulers, which also fits US letter."""
    from PIL import Image
    from reportlab.lib.utils import ImageReader
    from reportlab.pdfgen.canvas import Canvas

    points = 72 / 25.4
    canvas = Canvas(str(path), (210 * points, 297 * points), pageCompression=1, invariant=1)
    canvas.setTitle("Coupon sheet")
    canvas.setCreator("magiclens")
    canvas.scale(points, points)
    height, width = picture.shape
    image = ImageReader(Image.fromarray(np.uint8(255 * picture)))
    w, h = width / SHEET_PX_PER_MM, height / SHEET_PX_PER_MM
    canvas.drawImage(image, 105 - w / 2, 190 - h / 2, w, h)
    canvas.setLineWidth(0.1)
    canvas.line(55, 140, 155, 140)
    for k in range(11):
        canvas.line(55 + 10 * k, 140, 55 + 10 * k, 143)
    canvas.setFont("Helvetica", 3.5)
    canvas.drawString(55, 134, "Print at 100 %, without fitting to the page: this ruler must measure 100 mm.")
    canvas.drawString(
        55, 129, "Lay the coupon between the corner marks, the row of finest waves (left end) at the top."
    )
    canvas.showPage()
    canvas.save()


def _marker(number: int) -> FloatArray:
    import cv2

    drawn = cv2.aruco.generateImageMarker(dictionary(), number, 6 * _MODULE_PX)
    return np.asarray(drawn, np.float32) / 255


def _corner_marks(half_mm: float) -> BoolArray:
    """(H, W) strips of this half width, 3 mm long, that begin 0.3 mm outside the coupon's corners."""
    height, width = _shape()
    x = np.abs((np.arange(width) + 0.5 - width / 2) / SHEET_PX_PER_MM) - WIDTH_MM / 2
    y = np.abs((np.arange(height) + 0.5 - height / 2) / SHEET_PX_PER_MM)[:, None] - DEPTH_MM / 2
    along_x = (x > 0.3) & (x < 3.3) & (np.abs(y) < half_mm)
    along_y = (y > 0.3) & (y < 3.3) & (np.abs(x) < half_mm)
    return np.asarray(along_x | along_y)


def _shape() -> tuple[int, int]:
    return round(_SIZE_MM[1] * SHEET_PX_PER_MM), round(_SIZE_MM[0] * SHEET_PX_PER_MM)


def _corner_px(centre_mm: tuple[float, float]) -> tuple[int, int]:
    """Row and column of a marker's first pixel."""
    height, width = _shape()
    half = 3 * _MODULE_PX
    return round(height / 2 - centre_mm[1] * SHEET_PX_PER_MM) - half, round(
        width / 2 + centre_mm[0] * SHEET_PX_PER_MM
    ) - half


def _middle_mm(corner_px: tuple[int, int]) -> FloatArray:
    height, width = _shape()
    row, column = corner_px[0] + 3 * _MODULE_PX, corner_px[1] + 3 * _MODULE_PX
    return np.array([(column - width / 2) / SHEET_PX_PER_MM, (height / 2 - row) / SHEET_PX_PER_MM])
