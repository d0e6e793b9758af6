"""The height of a solid's top, seen straight down."""

from __future__ import annotations

import numpy as np
import pytest

from fabricated import EYE, LENS, Eye, box, bumpy, flat, together
from magiclens.contract.artifacts import FloatArray, Solid
from magiclens.geometry.columns import top_heights

ASIDE = (60.0, 0.0, 60.0)
INSIDE = np.linspace(-4.9, 4.9, 71)


def highest_by_barycentres(solid: Solid, x: FloatArray, y: FloatArray) -> FloatArray:
    """(rows, columns) the same by weights of the corners of every triangle at every point."""
    z = np.full((len(y), len(x)), -np.inf)
    px, py = np.meshgrid(x, y)
    for a, b, c in solid.vertices[solid.faces]:
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if abs(area) < 1e-12:
            continue
        wb = ((px - a[0]) * (c[1] - a[1]) - (py - a[1]) * (c[0] - a[0])) / area
        wc = ((b[0] - a[0]) * (py - a[1]) - (b[1] - a[1]) * (px - a[0])) / area
        inside = (wb >= 0) & (wc >= 0) & (wb + wc <= 1)
        z = np.where(inside, np.maximum(z, a[2] + wb * (b[2] - a[2]) + wc * (c[2] - a[2])), z)
    return np.where(np.isfinite(z), z, np.nan)


@pytest.mark.parametrize("eye", [None, EYE, ASIDE], ids=["vertical", "eye", "eye aside"])
def test_relief_is_the_highest_point_of_all_triangles(eye: Eye) -> None:
    solid = bumpy(eye)
    x = np.sort(np.random.default_rng(0).uniform(-4.9, 4.9, 60))
    y = np.sort(np.random.default_rng(1).uniform(-4.9, 4.9, 50))[::-1]
    expected = highest_by_barycentres(solid, x, y)
    assert np.isfinite(expected).mean() > 0.9
    assert np.allclose(top_heights(solid, x, y), expected, rtol=0, atol=2e-6, equal_nan=True)


def test_a_top_cut_along_slanting_rays_overhangs() -> None:
    """Else the case above would prove nothing about undercuts."""
    solid = bumpy(ASIDE)
    rows, columns = solid.grid or (0, 0)
    assert (np.diff(solid.vertices[: rows * columns, 0].reshape(rows, columns), axis=1) < 0).any()


def test_rows_run_down_from_plus_y_and_columns_from_minus_x() -> None:
    solid = together(box((-5, -5, 0), (5, 5, 1)), box((1, 2, 2), (5, 5, 3)))
    z = top_heights(solid, np.array([-3.0, 3.0]), np.array([4.0, -4.0]))
    assert z.tolist() == [[1.0, 3.0], [1.0, 1.0]]


def test_borders_belong_to_the_solid_and_what_is_beside_it_has_no_height() -> None:
    lines = np.linspace(-6, 6, 13)
    z = top_heights(flat(), lines, -lines)
    assert np.array_equal(np.isfinite(z), (abs(lines) <= 5)[:, None] & (abs(lines) <= 5)[None, :])
    assert (z[np.isfinite(z)] == LENS.thickness_mm).all()


def test_no_hole_where_lines_run_along_edges_and_through_vertices() -> None:
    solid = bumpy(None)
    x = np.unique(solid.vertices[:, 0])
    middles = (x[:-1] + x[1:]) / 2
    for lines in (x, np.sort(np.concatenate([x, middles]))):
        assert np.isfinite(top_heights(solid, lines, -lines)).all()


def test_vertices_of_an_upright_top_have_their_own_height() -> None:
    solid = bumpy(None)
    rows, columns = solid.grid or (0, 0)
    grid = solid.vertices[: rows * columns].reshape(rows, columns, 3)
    z = top_heights(solid, grid[0, :, 0], grid[:, 0, 1])
    assert np.array_equal(z, grid[..., 2].astype(np.float32))


def test_lines_out_of_order_are_refused() -> None:
    with pytest.raises(ValueError, match="ascend"):
        top_heights(flat(), INSIDE, INSIDE)
    with pytest.raises(ValueError, match="ascend"):
        top_heights(flat(), INSIDE[::-1], -INSIDE)
