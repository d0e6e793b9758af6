"""Small scenes and artifacts that contracts give to stages; no stage is needed to make them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magiclens.contract.artifacts import Assignment, Candidates, FloatArray, HeightField, Lens, Scene, Solid, View
from magiclens.geometry.solid import solid_from_heights
from magiclens.images import COLOURED, circles, resize

_LENS = Lens(
    size_mm=12.0, source_size_mm=36.0, facets=4, microfacets=8, thickness_mm=20.0, relief_mm=2.0, floor_mm=30.0
)
"""The lens of all scenes. Its sides lean out, so that no ray leaves through them."""

_EYE_MM = (10.0, -6.0, 220.0)
"""Not straight above the lens, and different in x and y, so that a stage that mixes up axes or signs fails."""
_CANDIDATES = 6
"""Number of candidates per facet."""


def one_view() -> Scene:
    """A grey scene: the letter F hidden in discs, for an eye that is not straight above the lens."""
    return Scene(_LENS, (View("one", _discs(grey=True), _letter(grey=True), np.array(_EYE_MM)),))


def two_turns() -> Scene:
    """A coloured scene: the letter at rotation 0, a half of it at 90 degrees, for one eye straight above."""
    eye, source, letter = np.array([0.0, 0.0, 220.0]), _discs(grey=False), _letter(grey=False)
    half = letter.copy()
    half[:, 32:] = (0.2, 0.5, 0.9)
    turned = View("quarter", source, half, eye, 90.0, target_name="half")
    return Scene(_LENS, (View("upright", source, letter, eye), turned))


def two_eyes() -> Scene:
    """A grey scene: the letter for an eye on the left, its mirror image for one on the right."""
    source, letter = _discs(grey=True), _letter(grey=True)
    lens = replace(_LENS, bleed_mm=_LENS.pitch_mm / 2)
    left, right = (np.array([x, 0.0, 220.0]) for x in (-25.0, 25.0))
    mirrored = View("right", source, np.ascontiguousarray(letter[:, ::-1]), right, target_name="mirrored")
    return Scene(lens, (View("left", source, letter, left), mirrored))


def ramps(scene: Scene) -> Scene:
    """The scene with sources whose colour is the position: red grows with +x, green with +y, from 0 to 1; blue is 1."""
    centres = (np.arange(360) + 0.5) / 360
    red, green = np.meshgrid(centres, centres[::-1])  # row 0 is at +y
    source = np.stack([red, green, np.ones_like(red)], axis=-1).astype(np.float32)
    black = np.zeros((1, 1, 3), np.float32)
    return replace(scene, views=tuple(replace(view, source=source, target=black) for view in scene.views))


def some_candidates(scene: Scene) -> Candidates:
    """Candidates near the patches that a flat lens shows; the last facet has only one."""
    n = scene.lens.facets
    rng = np.random.default_rng(11)
    offsets = straight_down_mm(scene)[:, :, None] + rng.uniform(-1.5, 1.5, (n, n, _CANDIDATES, 2))
    # (xx, xy, yy) with xy = 0: patches are magnified and mirrored, not sheared
    maps = np.zeros((n, n, _CANDIDATES, 3))
    maps[..., [0, 2]] = rng.uniform(0.3, 0.9, (n, n, _CANDIDATES, 2)) * rng.choice([-1, 1], (n, n, _CANDIDATES, 2))
    errors = np.sort(rng.uniform(0, 0.02, (n, n, _CANDIDATES)), axis=-1)
    errors[-1, -1, 1:] = np.inf  # a list that is not full, as matchers return them near the border
    return Candidates(offsets.astype(np.float32), maps.astype(np.float32), errors.astype(np.float32))


def an_assignment(scene: Scene) -> Assignment:
    """The assignment that takes the first of ``some_candidates`` for every facet."""
    return Assignment.pick(some_candidates(scene), np.zeros((scene.lens.facets,) * 2, np.int64))


def straight_down_mm(scene: Scene) -> FloatArray:
    """Offsets of the patches that a flat lens shows to the mean eye, for small angles: (N, N, 2), mm, lens frame."""
    lens, eye = scene.lens, scene.reference_eye_mm
    outward: FloatArray = (lens.facet_centres_mm() - eye[:2]) / (eye[2] - lens.thickness_mm)
    return outward * (lens.thickness_mm / lens.ior + lens.gap_mm)


def flat_heights(scene: Scene) -> HeightField:
    """The height field of a flat lens."""
    n, m = scene.lens.facets, scene.lens.microfacets
    return HeightField(scene.lens, np.zeros((n, n, m + 1, m + 1)), scene.reference_eye_mm)


def bumpy_solid(scene: Scene) -> Solid:
    """A closed mesh whose facets are different smooth lenslets, with heights within 0.5 mm."""
    n, m = scene.lens.facets, scene.lens.microfacets
    rng = np.random.default_rng(5)
    v, u = np.meshgrid(*[np.linspace(-1, 1, m + 1)] * 2, indexing="ij")
    a, b, c, d = rng.uniform(-0.1, 0.1, (4, n, n, 1, 1))
    heights = 2 * a * u + 2 * b * v + 0.5 * c * u * u + 0.5 * d * v * v
    return solid_from_heights(HeightField(scene.lens, heights, scene.reference_eye_mm))


def _discs(grey: bool) -> FloatArray:
    """A source of random discs: (H, H, C), 15 pixels per mm."""
    rng = np.random.default_rng(3)
    size = _LENS.source_size_mm
    return circles(size, 15, rng) if grey else circles(size, 15, rng, colours=COLOURED)


def _letter(grey: bool) -> FloatArray:
    """A dark F on white, which differs from its mirror images and turns: (64, 64, C)."""
    glyph = np.ones((64, 64, 1 if grey else 3), np.float32)
    ink = 0.0 if grey else (0.7, 0.05, 0.1)
    for rows, columns in ((slice(8, 56), slice(16, 26)), (slice(8, 18), slice(16, 50)), (slice(28, 37), slice(16, 42))):
        glyph[rows, columns] = ink
    return resize(glyph, (64, 64))
