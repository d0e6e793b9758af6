"""The sources of a scene, as exporters of sources need them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import FloatArray, Scene
from magiclens.images.colour import grey, to_display

if TYPE_CHECKING:
    from PIL.Image import Image


def distinct_sources(scene: Scene) -> dict[str, FloatArray]:
    """Every source of a scene once, by name, in the order of the views: (H, W, C) linear light."""
    return {view.source_name: view.source for view in scene.views}


def eight_bit(linear: FloatArray) -> Image:
    """An (H, W, C) picture in linear light as 8-bit sRGB, grey if it has no colour."""
    from PIL import Image

    values = np.rint(to_display(grey(linear)) * 255).astype(np.uint8)
    return Image.fromarray(values[..., 0] if values.shape[-1] == 1 else values)
