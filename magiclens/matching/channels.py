"""Views that share an eye in the lens frame stack up as channels of one matching problem.

Inside the matching code, coordinates are those of images: millimetres from the lens's centre, x right and *y down*
(row order), and samples are display values. ``artifacts.Candidates`` is +y up; the conversion is one sign.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magiclens.contract.artifacts import FloatArray, Scene
from magiclens.contract.errors import InputError
from magiclens.images import resize, to_display


@dataclass(frozen=True)
class Channels:
    """All views of a scene, turned into the lens frame and stacked.

    Args:
        source: (C, H, W) float32, linear light; C = views x colours.
        target: (C, R, R) float32, linear light.
        source_size_mm: side of the source.
    """

    source: FloatArray
    target: FloatArray
    source_size_mm: float

    @property
    def source_px_mm(self) -> float:
        """Side of a source pixel, mm."""
        return self.source_size_mm / int(self.source.shape[2])

    def tiles(self, facets: int, pixels: int, rows: slice = slice(None)) -> FloatArray:
        """Cut the targets into the facets' tiles.

        Args:
            facets: N, along the lens's side.
            pixels: P, along a tile's side.
            rows: of facets that are wanted; all by default.

        Returns:
            (R, N, C, P, P) float32 display values.
        """
        n, (first, last, _) = facets * pixels, rows.indices(facets)
        wanted = slice(first * pixels, last * pixels)
        small = np.stack([resize(c[..., None], (n, n))[wanted, :, 0] for c in self.target])
        shown = to_display(small).reshape(len(small), -1, pixels, facets, pixels)
        return shown.transpose(1, 3, 0, 2, 4).astype(np.float32)


def stack_channels(scene: Scene) -> Channels:
    """Stack the views of a scene whose eyes coincide in the lens frame.

    Raises:
        InputError: they do not; offsets then differ between views and need a multi-view matcher.
    """
    views, eyes = scene.views, [view.eye_in_lens_frame_mm for view in scene.views]
    if any(not np.allclose(eye, eyes[0]) for eye in eyes):
        raise InputError("this matcher needs views that share one eye in the lens frame")
    rows, side = max(len(view.source) for view in views), max(len(view.target) for view in views)
    colours = views[0].source.shape[2]
    source = np.empty((len(views), colours, rows, rows), np.float32)
    target = np.empty((len(views), colours, side, side), np.float32)
    for k, view in enumerate(views):  # one after the other: getting memory for all at once takes longer than the work
        turned = view.in_lens_frame()
        source[k] = np.moveaxis(resize(turned.source, (rows, rows)), -1, 0)
        target[k] = np.moveaxis(resize(turned.target, (side, side)), -1, 0)
    return Channels(source.reshape(-1, rows, rows), target.reshape(-1, side, side), scene.lens.source_size_mm)
