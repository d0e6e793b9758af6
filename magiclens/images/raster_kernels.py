"""Exact area coverage of outlines, and painting what is covered, compiled."""

from __future__ import annotations

from math import ceil, floor

from magiclens.kernels.compiler import njit


@njit(cache=True, nogil=True)
def cover_pixels(points, firsts, holes, cover):
    """The share of each pixel's area that is inside closed outlines, see ``raster.coverage``.

    The signed area to the right of every edge is added up per pixel, then along the rows.

    Args:
        points: (n, 2) float64 x and y in pixels of all outlines.
        firsts: (m + 1,) index of the first point of each outline, and n.
        holes: Whether outlines count as they run; if not, all count as if they ran clockwise as seen.
        cover: (rows, columns + 2) float64, zeros; filled but for its last two columns, which hold nothing of use.
    """
    rows, columns = cover.shape[0], cover.shape[1] - 2
    for k in range(len(firsts) - 1):
        first, end = firsts[k], firsts[k + 1]
        way = 1.0 if holes or _turn(points, first, end) >= 0.0 else -1.0
        for n in range(first, end):
            after = n + 1 if n + 1 < end else first
            _add_edge(points[n, 0], points[n, 1], points[after, 0], points[after, 1], way, cover)
    for i in range(rows):
        winding = 0.0
        for j in range(columns):
            winding += cover[i, j]
            cover[i, j] = min(abs(winding), 1.0)


@njit(cache=True, forceinline=True)
def _turn(points, first, end):
    """Positive if an outline runs clockwise as seen, y being down: twice its area."""
    double = 0.0
    for n in range(first, end):
        after = n + 1 if n + 1 < end else first
        double += points[n, 0] * points[after, 1] - points[after, 0] * points[n, 1]
    return double


@njit(cache=True, forceinline=True)
def _add_edge(x0, y0, x1, y1, way, cover):
    """Cut an edge into pieces that lie within one pixel each, and add the area to the right of each piece."""
    rows, columns = cover.shape[0], cover.shape[1] - 2
    if y0 > y1:
        x0, y0, x1, y1, way = x1, y1, x0, y0, -way
    if y0 == y1:
        return
    slope = (x1 - x0) / (y1 - y0)
    for row in range(max(floor(y0), 0), min(ceil(y1), rows)):
        top, bottom = max(float(row), y0), min(row + 1.0, y1)
        left, right = x0 + (top - y0) * slope, x0 + (bottom - y0) * slope
        if left > right:
            left, right = right, left
        if left == right:
            _add_piece(row, min(max(left, 0.0), columns), bottom - top, way, cover)
            continue
        per_column = (bottom - top) / (right - left)
        if left < 0.0:  # one piece, at the raster's edge
            _add_piece(row, 0.0, (min(right, 0.0) - left) * per_column, way, cover)
        at, end = max(left, 0.0), min(right, columns)
        while at < end:
            cut = min(floor(at) + 1.0, end)
            _add_piece(row, 0.5 * (at + cut), (cut - at) * per_column, way, cover)
            at = cut


@njit(cache=True, forceinline=True)
def _add_piece(row, x, height, way, cover):
    """Add the area to the right of a piece of an edge, which is at x on average, to the pixels of a row."""
    column = int(x)
    inside = x - column
    cover[row, column] += way * height * (1.0 - inside)
    cover[row, column + 1] += way * height * inside


@njit(cache=True, nogil=True)
def find_covered(cover, x, y):
    """The middles of the pixels that are covered at all, row by row.

    Args:
        cover: (rows, columns) shares.
        x, y: To fill, in pixels from the upper left corner; one for each pixel whose share is not 0.
    """
    n = 0
    for i in range(cover.shape[0]):
        for j in range(cover.shape[1]):
            if cover[i, j] != 0.0:
                x[n], y[n] = j + 0.5, i + 0.5
                n += 1


@njit(cache=True, nogil=True)
def mix_colours(canvas, cover, opacity, colours):
    """Paint over the pixels that are covered, as far as they are.

    Args:
        canvas: (rows, columns, C) float32 linear light, which is changed.
        cover: (rows, columns) shares.
        opacity: Of the paint.
        colours: (n, C) linear light of the paint in each pixel whose share is not 0, row by row.
    """
    n = 0
    for i in range(cover.shape[0]):
        for j in range(cover.shape[1]):
            if cover[i, j] != 0.0:
                share = opacity * cover[i, j]
                for k in range(canvas.shape[2]):
                    canvas[i, j, k] += share * (colours[n, k] - canvas[i, j, k])
                n += 1
