"""What covers the pixels that no facet sees."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from magiclens.contract.artifacts import FloatArray
from magiclens.images import to_display
from magiclens.images.files import write_png
from magiclens.scenarios.camouflage import Camouflage

SIDE, SIZE_MM = 90, 6.0
KNOWN = np.zeros((SIDE, SIDE), bool)
KNOWN[20:40, 50:80] = True
KINDS: tuple[dict[str, Any], ...] = (
    {"type": "none"},
    {"type": "flat", "level": "40%"},
    {"type": "noise"},
    {"type": "circles"},
    {"type": "circles", "colours": "coloured"},
    {"type": "inpaint"},
    {"type": "texture", "circles": {"type": "circles", "radius": ["0.2mm", "0.4mm"]}},
)


def covered(spec: dict[str, Any], source: FloatArray, seed: int = 0) -> FloatArray:
    camouflage: Any = TypeAdapter(Camouflage).validate_python(spec)
    out: FloatArray = camouflage.cover(source, KNOWN, SIZE_MM, np.random.default_rng(seed))
    return out


def picture(channels: int) -> FloatArray:
    return np.random.default_rng(1).random((SIDE, SIDE, channels)).astype(np.float32)


@pytest.mark.parametrize("spec", KINDS, ids=str)
@pytest.mark.parametrize("channels", [1, 3])
def test_known_pixels_stay_and_equal_seeds_give_equal_pictures(spec: dict[str, Any], channels: int) -> None:
    source = picture(channels)
    before = source.copy()
    once, again = covered(spec, source), covered(spec, source)
    assert once.shape == source.shape
    assert once.dtype == np.float32
    assert once.min() >= 0
    assert once.max() <= 1
    np.testing.assert_array_equal(once[KNOWN], source[KNOWN])
    np.testing.assert_array_equal(once, again)
    np.testing.assert_array_equal(source, before)


def test_none_leaves_the_source_and_flat_fills_with_its_level() -> None:
    source = picture(1)
    np.testing.assert_array_equal(covered(KINDS[0], source), source)
    np.testing.assert_allclose(to_display(covered(KINDS[1], source)[~KNOWN]), 0.4, atol=1e-6)


def test_noise_has_every_display_value_in_squares_of_its_grain() -> None:
    noise = to_display(covered({"type": "noise", "grain": "0.2mm"}, picture(1)))[..., 0]
    assert np.histogram(noise[~KNOWN], 4, (0, 1))[0].min() > 0.2 * (~KNOWN).sum()
    assert (noise[:3, :3] == noise[0, 0]).all()
    assert noise[0, 0] != noise[0, 3]


@pytest.mark.parametrize("kind", [2, 3, 6])
def test_other_seeds_give_other_pictures(kind: int) -> None:
    source = picture(1)
    assert (covered(KINDS[kind], source, 1)[~KNOWN] != covered(KINDS[kind], source, 2)[~KNOWN]).mean() > 0.05


def test_inpainting_continues_what_is_known() -> None:
    source = np.full((SIDE, SIDE, 1), 0.3, np.float32)
    source[~KNOWN] = 0.9
    np.testing.assert_allclose(covered({"type": "inpaint"}, source), 0.3, atol=1e-4)


def test_a_texture_may_come_from_a_file(tmp_path: Path) -> None:
    write_png(tmp_path / "grey.png", np.full((64, 64, 1), 0.25, np.float32))
    out = covered({"type": "texture", "image": str(tmp_path / "grey.png")}, picture(1))
    assert out[~KNOWN] == pytest.approx(0.25, abs=0.005)


def test_a_texture_has_one_example(tmp_path: Path) -> None:
    write_png(tmp_path / "grey.png", picture(1))
    both = {"type": "texture", "image": str(tmp_path / "grey.png"), "circles": {"type": "circles"}}
    with pytest.raises(ValidationError, match="an image or circles, not both"):
        covered(both, picture(1))
