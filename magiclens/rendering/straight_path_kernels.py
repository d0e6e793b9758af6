"""Paths that go straight through, compiled: from the eye, in through one gentle cell and out through the flat bottom.

Nearly all paths are such. They are computed many at a time, without choices, so that processors do several at once;
whatever is not certain to go this way is left to ``rendering.tracer_kernels``. Certain is what cones say: a line that
is steeper than the gentle parts of a surface meets none of them once it is on their far side, and to meet a steep part
it has to come within the cone of that slope that has its tip there.
"""

from __future__ import annotations

import math

import numpy as np

from magiclens.kernels.compiler import njit

BATCH = 128
"""Paths that are computed at a time: as many as the nearest cache has room for."""

_ROOM = BATCH + 8
"""Room for one kind of number of a batch; at distances of a power of 2, memory would be slow."""

# Where in a batch's numbers each kind of them begins: given are ...
_QX, _QY = 0 * _ROOM, 1 * _ROOM  # a point of the reference plane, which the path goes through,
_U, _V = 2 * _ROOM, 3 * _ROOM  # a guess where it enters the lens, and afterwards where it does,
_LEFT, _RIGHT, _TOP, _BOTTOM = 4 * _ROOM, 5 * _ROOM, 6 * _ROOM, 7 * _ROOM  # u and v of the sides of the cell there,
_W00, _W01, _W10, _W11 = 8 * _ROOM, 9 * _ROOM, 10 * _ROOM, 11 * _ROOM  # w of its vertices,
_ABOVE, _BELOW = 12 * _ROOM, 13 * _ROOM  # and its cones; found are ...
_W, _X, _Y, _Z = 14 * _ROOM, 15 * _ROOM, 16 * _ROOM, 17 * _ROOM  # w and place of where the path enters the lens,
_DX, _DY, _DZ, _SHARE = 18 * _ROOM, 19 * _ROOM, 20 * _ROOM, 21 * _ROOM  # how it goes on, and how much of its light,
_UPPER = 22 * _ROOM  # 1 if that is in the upper right half of the cell, otherwise 0,
_FOOT_X, _FOOT_Y, _ALONG_X, _ALONG_Y = 23 * _ROOM, 24 * _ROOM, 25 * _ROOM, 26 * _ROOM  # how it leaves the bottom,
_WEIGHT = 27 * _ROOM  # its transmission until there,
_CERTAIN = 28 * _ROOM  # and 2 if it goes straight through, 1 if it only enters the lens as said, or 0
_KINDS = 29
_GUESSES = 4
"""How often the cell is looked for in which a path enters the lens; the first guess is right for the cutting eye."""
_ROUNDING = 1e-9
"""Share of a cell by which a point may lie beside it for rounding."""


@njit(cache=True)
def room_for_batch():
    """The room in which ``straight_through`` works, and leaves what it finds."""
    return np.zeros(_KINDS * _ROOM)


@njit(cache=True, forceinline=True)
def straight_through(grid, slab, eye, across, down, cells, numbers):
    """Where paths of a batch leave the lens, or at least how they enter it.

    Args:
        grid: the top.
        slab: the glass.
        eye: (3,) mm.
        across, down: (count,) x and y of the points of the reference plane that the paths go through, mm.
        cells: (BATCH, 2) row and column of the grid's cells there, and afterwards of those in which the paths enter.
        numbers: (_KINDS * _ROOM,), to fill: what is certain of every path is then in it.
    """
    count = len(across)
    us, vs, ws, above, below = grid.us, grid.vs, grid.ws, grid.above, grid.below
    for n in range(count):
        numbers[_QX + n] = numbers[_U + n] = across[n]
        numbers[_QY + n] = numbers[_V + n] = down[n]
    for guess in range(_GUESSES):
        for n in range(count):
            r, c = cells[n, 0], cells[n, 1]
            if guess > 0:
                u, v = numbers[_U + n], numbers[_V + n]
                while c < len(us) - 2 and us[c + 1] <= u:
                    c += 1
                while c > 0 and us[c] > u:
                    c -= 1
                while r < len(vs) - 2 and vs[r + 1] > v:
                    r += 1
                while r > 0 and vs[r] <= v:
                    r -= 1
                cells[n, 0], cells[n, 1] = r, c
            r, c = np.uintp(r), np.uintp(c)
            one = np.uintp(1)
            numbers[_LEFT + n], numbers[_RIGHT + n] = us[c], us[c + one]
            numbers[_TOP + n], numbers[_BOTTOM + n] = vs[r], vs[r + one]
            numbers[_W00 + n], numbers[_W01 + n] = ws[r, c], ws[r, c + one]
            numbers[_W10 + n], numbers[_W11 + n] = ws[r + one, c], ws[r + one, c + one]
            numbers[_ABOVE + n], numbers[_BELOW + n] = above[r, c], below[r, c]
        if _all_at_once(grid, slab, eye, numbers, count) == 0:
            break


@njit(cache=True, forceinline=True)
def goes_through(numbers, n):
    """Whether the n-th path of a batch is sure to go straight through, see ``straight_through``."""
    return numbers[_CERTAIN + n] > 1.0


@njit(cache=True, forceinline=True)
def way_out(numbers, n):
    """How it then leaves the flat bottom: what ``_follow`` of ``rendering.tracer_kernels`` returns."""
    foot = numbers[_FOOT_X + n], numbers[_FOOT_Y + n]
    return *foot, numbers[_WEIGHT + n], numbers[_ALONG_X + n], numbers[_ALONG_Y + n]


@njit(cache=True, forceinline=True)
def goes_in(numbers, n):
    """Whether the n-th path of a batch is sure to enter the lens as ``way_in`` says."""
    return numbers[_CERTAIN + n] > 0.0


@njit(cache=True, forceinline=True)
def way_in(numbers, n):
    """How it then goes on from the top.

    Returns:
        x, y, z of the place, mm; the direction; u, v, w of the place; whether that is in the upper right half of its
        cell; and the transmission.
    """
    point, way = (
        (numbers[_X + n], numbers[_Y + n], numbers[_Z + n]),
        (numbers[_DX + n], numbers[_DY + n], numbers[_DZ + n]),
    )
    place = numbers[_U + n], numbers[_V + n], numbers[_W + n]
    return point, way, place, numbers[_UPPER + n] > 0.0, numbers[_SHARE + n]


@njit(cache=True)
def _all_at_once(grid, slab, eye, numbers, count):
    """The arithmetic of ``straight_through``; returns how many paths enter the lens beside the guessed cell."""
    us, vs, cut, lowest = grid.us, grid.vs, grid.cut_eye, grid.lowest
    flat = 1.0 if grid.vertical else 0.0
    rest, scale = 1.0 - flat, grid.eye_distance
    height = cut[2] + flat  # w = (rest scale + flat z) / (height - rest z): see ``rendering.grid``
    frame = cut[0], cut[1], cut[2], flat, rest, scale, rest / scale
    dz, top = slab.depth - eye[2], grid.highest
    # an eye that does not look down at the whole top sees nothing for certain
    limits = us[0], us[-1], vs[-1], vs[0], (grid.gentlest if eye[2] > top and dz < 0.0 else np.inf)
    rise, zoom, zoom_floor = (top - eye[2]) / dz, scale / (height - rest * top), scale / height
    w_top, w_floor = (rest * scale + flat * top) / (height - rest * top), rest * scale / height
    missed = 0
    for n in range(count):
        cell = numbers[_LEFT + n], numbers[_RIGHT + n], numbers[_BOTTOM + n], numbers[_TOP + n]
        corners = numbers[_W00 + n], numbers[_W01 + n], numbers[_W10 + n], numbers[_W11 + n]
        dx, dy = numbers[_QX + n] - eye[0], numbers[_QY + n] - eye[1]
        ray = (eye[0], eye[1], eye[2]), (dx, dy, dz)
        (x, y, z), (u, v, w), normal, upper, within = _entry(
            frame, cell, corners, (numbers[_U + n], numbers[_V + n]), ray
        )
        missed += 0 if within else 1
        start = frame[0] + (eye[0] + dx * rise - frame[0]) * zoom, frame[1] + (eye[1] + dy * rise - frame[1]) * zoom
        first = _meets_nothing(limits, cell, (u, v), start, w_top - w, numbers[_ABOVE + n] - (w - lowest))
        (tx, ty, tz), share, share_out, per_tz, spread = _bent((dx, dy, dz), normal, slab.ior)
        enters = within & first & (share >= 0.5) & (tz < 0.0)
        foot_x, foot_y = x - tx * z * per_tz, y - ty * z * per_tz
        end = frame[0] + (foot_x - frame[0]) * zoom_floor, frame[1] + (foot_y - frame[1]) * zoom_floor
        last = _meets_nothing(limits, cell, (u, v), end, w - w_floor, (w - lowest) - numbers[_BELOW + n])
        last = last & (spread > 0.0)
        numbers[_U + n], numbers[_V + n], numbers[_W + n] = u, v, w
        numbers[_X + n], numbers[_Y + n], numbers[_Z + n] = x, y, z
        numbers[_DX + n], numbers[_DY + n], numbers[_DZ + n] = tx, ty, tz
        numbers[_SHARE + n], numbers[_UPPER + n] = share, 1.0 if upper else 0.0
        numbers[_FOOT_X + n], numbers[_FOOT_Y + n], numbers[_WEIGHT + n] = foot_x, foot_y, share * share_out
        numbers[_ALONG_X + n], numbers[_ALONG_Y + n] = tx * spread, ty * spread
        numbers[_CERTAIN + n] = (2.0 if last else 1.0) if enters else 0.0
    return missed


@njit(cache=True, forceinline=True)
def _entry(frame, cell, corners, guess, ray):
    """Where a ray meets the plane of one half of a cell: in space, in the grid, and whether that is in this half.

    Args:
        frame: of the grid, see ``_all_at_once``.
        cell: u of its left and right, v of its lower and upper side.
        corners: w of its vertices, row by row.
        guess: u and v of a point in the half that counts.
        ray: a point of it, and its direction, of any length.

    Returns:
        x, y, z; u, v, w; the upward normal, of any length; whether it is the upper half; and whether the ray meets it.
    """
    (cx, cy, cz, flat, rest, scale, per_scale), (left, right, bottom, top), (a, b, d, e) = frame, cell, corners
    (ex, ey, ez), (dx, dy, dz) = ray
    wide, tall = right - left, top - bottom
    area, upper = wide * tall, (guess[0] - left) * tall > (top - guess[1]) * wide
    # what would have to be divided by the area is left as it is
    nx, ny = ((a - b) if upper else (d - e)) * tall, ((e - b) if upper else (d - a)) * wide
    under_eye = a * area + nx * (left - cx) + ny * (top - cy)
    nz = flat * area + rest * per_scale * under_eye
    toward = nx * dx + ny * dy + nz * dz
    to_plane = flat * under_eye - rest * area - (nx * (ex - cx) + ny * (ey - cy) + nz * (ez - cz))
    below = (cz + flat - rest * ez) * toward - rest * dz * to_plane
    once = 1.0 / (toward * below)  # instead of two divisions
    far, zoom = to_plane * below * once, toward * toward * once
    x, y, z = ex + far * dx, ey + far * dy, ez + far * dz
    u, v, w = cx + (x - cx) * scale * zoom, cy + (y - cy) * scale * zoom, (rest * scale + flat * z) * zoom
    s, t, slack = (u - left) * tall, (top - v) * wide, _ROUNDING * area
    most, least = (s if upper else t), (t if upper else s)
    within = (least >= -slack) & (most <= area + slack) & (most >= least - slack)
    return (x, y, z), (u, v, w), (nx, ny, nz), upper, within


@njit(cache=True, forceinline=True)
def _meets_nothing(limits, cell, place, end, change, need):
    """Whether a line from the surface to a place within the grid is sure to meet it no more.

    Args:
        limits: of the grid, as of a cell, and its ``gentlest``.
        cell: u of the left and right, v of the lower and upper side of the cell that the line starts in.
        place: u and v of its start.
        end: u and v of its end.
        change: in w, from start to end, as a positive number.
        need: change in w with which it has to leave the cell.
    """
    (least_u, most_u, least_v, most_v, gentlest), (left, right, bottom, top), (u, v) = limits, cell, place
    du, dv = end[0] - u, end[1] - v
    free_u, free_v = (right - u if du > 0.0 else u - left), (top - v if dv > 0.0 else v - bottom)
    aside_u, aside_v = abs(du), abs(dv)
    steep = (change > gentlest * aside_u) & (change > gentlest * aside_v)
    clear = (free_u * change >= need * aside_u) & (free_v * change >= need * aside_v)
    return steep & clear & (end[0] >= least_u) & (end[0] <= most_u) & (end[1] >= least_v) & (end[1] <= most_v)


@njit(cache=True, forceinline=True)
def _bent(way, normal, ior):
    """A ray's way into the glass and out of the flat bottom, by ``refract`` and ``transmittance`` of both surfaces.

    Args:
        way: its direction, of any length.
        normal: of the surface, upward, of any length.
        ior: index of refraction of the glass.

    Returns:
        Direction in the glass; transmission of the surface and of the bottom; the reciprocal of the direction's z; and
        how far the ray goes on below per mm that it falls, as a multiple of the direction. Where light does not go this
        way, a share is below 1/2 or something is not a number.
    """
    (dx, dy, dz), (nx, ny, nz), thin = way, normal, 1.0 / ior
    normal_2 = nx * nx + ny * ny + nz * nz
    both = math.sqrt((dx * dx + dy * dy + dz * dz) * normal_2)
    per_both_and_normal = 1.0 / (both * normal_2)
    per_both = per_both_and_normal * normal_2
    per_way = math.sqrt(per_both * per_both * normal_2)
    cos_i = -(nx * dx + ny * dy + nz * dz) * per_both
    cos_t = math.sqrt(1.0 - (1.0 - cos_i * cos_i) * thin * thin)
    on, bend = thin * per_way, (cos_i * thin - cos_t) * both * both * per_both_and_normal * per_way
    tx, ty, tz = on * dx + bend * nx, on * dy + bend * ny, on * dz + bend * nz
    cos_o = math.sqrt(1.0 - (1.0 - tz * tz) * ior * ior)
    s_in, p_in, s_out, p_out = cos_i + ior * cos_t, ior * cos_i + cos_t, cos_o - ior * tz, ior * cos_o - tz
    surface, bottom, last = s_in * p_in, s_out * p_out, tz * cos_o
    once = 1.0 / (surface * bottom * last)  # instead of six divisions
    per_surface, per_bottom, per_last = once * bottom * last, once * surface * last, once * surface * bottom
    s_in, p_in = (cos_i - ior * cos_t) * p_in * per_surface, (ior * cos_i - cos_t) * s_in * per_surface
    s_out, p_out = (cos_o + ior * tz) * p_out * per_bottom, (ior * cos_o + tz) * s_out * per_bottom
    share, share_out = 1.0 - 0.5 * (s_in * s_in + p_in * p_in), 1.0 - 0.5 * (s_out * s_out + p_out * p_out)
    return (tx, ty, tz), share, share_out, per_last * cos_o, ior * per_last * tz
