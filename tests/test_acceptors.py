"""Do slicers and mesh checkers take the lenses of all specs without a repair? Some here, all in the sweep tier."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from acceptors import admesh, assert_accepted, assert_sliceable, volume_of_self_union
from lenses import SHIPPED, Lenses

UNLIKE = {"single", "milled", "printed-lcd"}
"""Specs whose meshes have little in common: the others are in the sweep tier."""
EVERY = [pytest.param(name, marks=pytest.mark.tools if name in UNLIKE else pytest.mark.sweep) for name in SHIPPED]


@pytest.mark.parametrize("name", EVERY)
def test_slicers_and_mesh_checkers_take_the_lens_as_it_is(name: str, lenses: Lenses) -> None:
    folder = lenses.shipped(name).folder
    assert_accepted(folder / "lens.stl")
    opened = assert_sliceable(folder / "lens.3mf")
    sides = np.ptp(trimesh.load_mesh(folder / "lens.stl").vertices, axis=0)
    np.testing.assert_allclose([float(opened[f"size_{axis}"]) for axis in "xyz"], sides, atol=1e-3)


@pytest.mark.tools
def test_the_acceptors_do_see_what_is_wrong(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(2)
    turned, open_one = ball.copy(), ball.copy()
    turned.faces = np.vstack([ball.faces[:1, ::-1], ball.faces[1:]])
    open_one.faces = ball.faces[1:]
    for name, mesh in (("turned", turned), ("open", open_one)):
        mesh.export(tmp_path / f"{name}.stl")
        with pytest.raises(AssertionError):
            assert_sliceable(tmp_path / f"{name}.stl")
    assert admesh(tmp_path / "turned.stl")["Facets reversed"] > 0
    assert admesh(tmp_path / "open.stl")["Facets added"] == 1


def test_an_overlap_shows_in_the_union_of_a_mesh_with_itself(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(2)
    trimesh.util.concatenate([ball, ball.copy().apply_translation((0.5, 0, 0))]).export(tmp_path / "two.stl")
    volume, union = volume_of_self_union(tmp_path / "two.stl")
    assert union < 0.8 * volume
