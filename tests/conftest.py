"""Fixtures that several test modules use."""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from magiclens.plan.registry import Registry
from toys import SPEC, TOYS, SpecWriter, prism, registry_of


@pytest.fixture
def registry() -> Registry:
    """Built-in scenarios and art, and the toy stages."""
    return registry_of(*TOYS)


@pytest.fixture
def toy_geometry(monkeypatch: pytest.MonkeyPatch) -> None:
    """The steps between stages, without optics: a prism for a solid, traced errors that fall from round to round."""
    solid, traced = ModuleType("magiclens.geometry.solid"), ModuleType("magiclens.rendering.facet_errors")
    falling = itertools.count(100, -1)
    vars(solid)["solid_from_heights"] = prism
    vars(solid)["heights_of"] = lambda solid, lens: None
    vars(traced)["facet_errors"] = lambda scene, heights: np.full((scene.lens.facets,) * 2, next(falling) / 100)
    monkeypatch.setitem(sys.modules, solid.__name__, solid)
    monkeypatch.setitem(sys.modules, traced.__name__, traced)


@pytest.fixture
def without_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs that are not about the report write none, which saves most of their time."""
    monkeypatch.setattr("magiclens.report.write.write_report", lambda data, folder: None)


@pytest.fixture
def write_spec(tmp_path: Path) -> SpecWriter:
    """Writes the spec above, with replacements made in its text, and returns its path."""

    def write(*replacements: tuple[str, str], text: str = SPEC) -> Path:
        for old, new in replacements:
            assert old in text
            text = text.replace(old, new, 1)
        path = tmp_path / "toy.yaml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def grey_png(tmp_path: Path) -> Path:
    """A small picture file beside the spec, wider than high."""
    from magiclens.images.files import write_png

    path = tmp_path / "grey.png"
    write_png(path, np.full((40, 60, 1), 0.2, np.float32))
    return path
