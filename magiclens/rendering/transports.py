"""The sparse matrices from the sources of views to the pictures that the lens as built shows."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import FloatArray, Lens, Scene, Solid, Transport, View
from magiclens.rendering.poses import Pose, PosedLens
from magiclens.rendering.tracer import trace

if TYPE_CHECKING:
    from scipy.sparse import csr_array

LEAST_RESOLUTION = 512
"""Least number of pixels along the side of the pictures that transport matrices give.

No pixel straddles two facets."""

_SAMPLES = 5
"""Number of samples along the side of a pixel of these pictures.

With fewer an encoder paints for the samples instead of the pixels: 3 instead of 5 cost path-traced pictures of
universal lenses 3 to 8 dB."""


def transports(scene: Scene, solid: Solid) -> list[Transport]:
    """One matrix per view; views that share eye, rotation and source raster share the matrix.

    Only the ``traced_view`` of every view is traced.
    """
    resolution = scene.lens.facets * math.ceil(LEAST_RESOLUTION / scene.lens.facets)
    made: dict[tuple[str, int], Transport] = {}
    found = []
    for view in scene.views:
        first = traced_view(scene, view)
        key = first.name, (view.quarter_turns - first.quarter_turns) % 4
        if first is view:
            made[key] = transport(solid, scene.lens, view, resolution, _SAMPLES)
        elif key not in made:
            made[key] = made[first.name, 0].turned(key[1])
        found.append(made[key])
    return found


def transport(solid: Solid, lens: Lens, view: View, resolution: int, samples: int) -> Transport:
    """The sparse matrix from a view's source (world frame, its own raster) to the picture (world frame).

    Args:
        solid: with the top's regular grid.
        lens: the lens that the solid was made for.
        view: its eye, its rotation and the raster of its source are used.
        resolution: pixels along the picture's side.
        samples: samples along a pixel's side.
    """
    hits = trace(solid, lens, view, resolution, samples)
    matrix, shape = _shares(hits, lens, view), (resolution, resolution)
    return Transport(matrix, shape, view.source.shape[:2]).turned(view.quarter_turns)


def posed_transport(posed: PosedLens, lens: Lens, view: View, pose: Pose) -> Transport:
    """The same when sheet, lens and eye are not where the design has them; traced as finely as ``posed`` is."""
    hits = posed.landing(view, pose)  # on the sheet, which has not been turned: only the picture is
    side = len(hits)
    upright = np.rot90(np.arange(side * side).reshape(side, side), view.quarter_turns).ravel()
    return Transport(_shares(hits, lens, view)[upright], (side, side), view.source.shape[:2])


def _shares(hits: FloatArray, lens: Lens, view: View) -> csr_array:
    """(R * R, source pixels) what pixels of a picture take from those of a source; ``hits`` as of ``trace``."""
    from scipy.sparse import csr_array

    from magiclens.rendering.source_kernels import gather_shares

    (rows, columns), pixels = view.source.shape[:2], len(hits) ** 2
    raster = (hits, (rows, columns), columns / lens.source_size_mm)
    pointers = np.zeros(pixels + 1, np.int32)
    nothing = np.zeros(0, np.int32), np.zeros(0, np.float32)
    gather_shares(*raster, pointers, *nothing)
    np.cumsum(pointers, out=pointers)
    index, share = np.zeros(pointers[-1], np.int32), np.zeros(pointers[-1], np.float32)
    gather_shares(*raster, pointers, index, share)
    return csr_array((share, index, pointers), shape=(pixels, rows * columns))


def traced_view(scene: Scene, view: View) -> View:
    """The view that is traced for a view: the first with its eye, in the lens frame, and its source raster."""
    return next(other for other in scene.views if _ray_key(other) == _ray_key(view))


def _ray_key(view: View) -> tuple[float, ...]:
    return (*view.eye_in_lens_frame_mm, *view.source.shape[:2])
