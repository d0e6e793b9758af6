"""The kernel that turns lines of a surface back from the build plate."""

from __future__ import annotations

import numpy as np

from magiclens.kernels.compiler import njit


@njit(cache=True, nogil=True)
def turn_back_part(part, lines, at, turn, to, found):
    """Part of the lines: their points turned back, and the highest of what lies between neighbours at each place.

    Args:
        part: the lines, a ``LoopPart``.
        lines: (lines, points) heights.
        at: (points,) ascending, where they are.
        turn: cosine and sine of the angle by which the part stands tilted.
        to: (places,) ascending, where heights are wanted.
        found: (lines, places) float32, raised in place.
    """
    cosine, sine = turn
    for i in range(part.first, part.end):
        for k in range(len(at) - 1):
            a, b = cosine * at[k] + sine * lines[i, k], cosine * at[k + 1] + sine * lines[i, k + 1]
            za, zb = cosine * lines[i, k] - sine * at[k], cosine * lines[i, k + 1] - sine * at[k + 1]
            rise = (zb - za) / (b - a) if a != b else 0.0
            j = np.searchsorted(to, min(a, b))
            while j < len(to) and to[j] <= max(a, b):
                found[i, j] = max(found[i, j], za + (to[j] - a) * rise)
                j += 1
