"""Small lenses, sources and assignments for tests of the optics, from matching to tracing."""

from __future__ import annotations

from typing import Any

import numpy as np

from magiclens.contract.artifacts import Assignment, Candidates, FloatArray, HeightField, Lens, Scene, View
from magiclens.images import to_linear

THICK, DISTANCE, IOR = 40.0, 400.0, 1.49
Eye = tuple[float, float, float]
ABOVE = (0.0, 0.0, THICK + DISTANCE)
ASIDE = (70.0, -45.0, THICK + DISTANCE)


def small_lens(facets: int = 4, pitch: float = 3.0, source: float = 60.0, **options: Any) -> Lens:
    """A few facets over a source that is large enough for whatever they bend light to."""
    settings: dict[str, Any] = {"microfacets": 8, "thickness_mm": THICK, "ior": IOR} | options
    return Lens(size_mm=facets * pitch, source_size_mm=source, facets=facets, **settings)


def grey_view(source: FloatArray, target: FloatArray, eye: Eye = ABOVE, turn: float = 0.0) -> View:
    """A view of (H, W) linear-light pictures."""
    pictures = [np.ascontiguousarray(p[..., None], np.float32) for p in (source, target)]
    return View("view", pictures[0], pictures[1], np.array(eye, float), turn)


def blank_scene(lens: Lens, eye: Eye = ABOVE) -> Scene:
    """White over black: pictures for tests that need none; light that is lost costs 1."""
    return Scene(lens, (grey_view(np.ones((16, 16)), np.zeros((16, 16)), eye),))


def blotches(pixels: int, blur: float, seed: int = 0) -> FloatArray:
    """(pixels, pixels) linear light: smooth noise that is nowhere symmetric and uses the whole range."""
    from scipy.ndimage import gaussian_filter

    noise = gaussian_filter(np.random.default_rng(seed).normal(size=(pixels, pixels)), blur, mode="nearest")
    return to_linear((noise - noise.min()) / np.ptp(noise)).astype(np.float32)


def letter_f(pixels: int = 64) -> FloatArray:
    """(pixels, pixels) linear light: a black F on white, unlike each of its mirror images and quarter turns."""
    glyph = np.ones((pixels, pixels), np.float32)
    a, b, c = pixels // 4, pixels // 8, pixels * 3 // 4
    glyph[b : pixels - b, a : a + b] = 0
    glyph[b : 2 * b, a:c] = 0
    glyph[pixels // 2 - b // 2 : pixels // 2 + b // 2, a : c - b] = 0
    return glyph


def ramps(pixels: int = 64) -> FloatArray:
    """(pixels, pixels, 3) linear light: red grows with +x, green with +y, both from 0 to 1; blue is 1."""
    centres = (np.arange(pixels) + 0.5) / pixels
    red, green = np.meshgrid(centres, centres[::-1])
    return np.stack([red, green, np.ones_like(red)], axis=-1).astype(np.float32)


def assigned(offsets: FloatArray, maps: FloatArray) -> Assignment:
    """An assignment of offsets (N, N, 2) mm, +y up, and maps (N, N, 3), or of one of either for all facets."""
    n = np.shape(offsets)[0]
    return Assignment(
        np.zeros((n, n), np.int64),
        np.array(offsets, np.float32, order="C"),
        np.array(np.broadcast_to(maps, (n, n, 3)), np.float32, order="C"),
        np.zeros((n, n), np.float32),
    )


def choices(offsets: FloatArray, maps: FloatArray, errors: FloatArray) -> Candidates:
    """Candidates from offsets (N, N, K, 2) mm, maps (N, N, K, 3) and errors (N, N, K)."""
    return Candidates(*(np.array(a, np.float32, order="C") for a in (offsets, maps, errors)))


def surface(lens: Lens, heights: FloatArray, eye: Eye | FloatArray | None = ABOVE) -> HeightField:
    """A height field, from heights that broadcast to (N, N, m + 1, m + 1) mm."""
    k = lens.microfacets + 1
    shape = (lens.facets, lens.facets, k, k)
    return HeightField(lens, np.array(np.broadcast_to(heights, shape), float), None if eye is None else np.array(eye))


def plane_points_mm(lens: Lens) -> tuple[FloatArray, FloatArray]:
    """x and y, each (N, N, m + 1, m + 1), where the facets' vertices rest on the reference plane."""
    within = np.linspace(-0.5, 0.5, lens.microfacets + 1) * (lens.pitch_mm - lens.wall_mm)
    centres = lens.facet_centres_mm()
    x = centres[:, :, 0, None, None] + within[None, :]
    y = centres[:, :, 1, None, None] - within[:, None]
    return np.broadcast_arrays(x, y)  # type: ignore[return-value]
