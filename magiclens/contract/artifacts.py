"""What flows from stage to stage: small frozen dataclasses of read-only arrays.

Frames (the whole package): millimetres and degrees; right-handed world with its origin at the centre of
the slab's flat bottom (z = 0), +z toward the viewer, +x right, +y up as the viewer sees it. The source
lies at z = -gap, the *reference plane* at z = thickness. Arrays over the lens are ``[i, j]`` with i along
the image's rows (row 0 is +y) and j along its columns (column 0 is -x). Vectors are (x, y[, z]), +y up.
The *lens frame* is glued to the lens; the world frame is the viewer's. They differ by the lens rotation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.sparse import csr_array

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.integer]
BoolArray = NDArray[np.bool_]


class _ReadOnly:
    """Mixin: arrays of a frozen dataclass are made read-only, mappings immutable, wherever it is sent."""

    def __post_init__(self) -> None:
        for f in fields(self):  # type: ignore[arg-type]
            value = getattr(self, f.name)
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
            elif isinstance(value, dict):
                object.__setattr__(self, f.name, MappingProxyType(dict(value)))

    def __reduce__(self) -> tuple[type[Any], tuple[Any, ...]]:
        """Pickled as its fields, so that it can be sent to other processes and is read-only there too."""
        values = (getattr(self, f.name) for f in fields(self))  # type: ignore[arg-type]
        return type(self), tuple(dict(v) if isinstance(v, MappingProxyType) else v for v in values)


@dataclass(frozen=True)
class Lens:
    """The slab that is to be designed, before any of its facets has a shape.

    ``relief_mm`` bounds how far the top may leave the reference plane, ``wall_mm`` is the width of the
    strip between two facets, ``max_slope_deg`` bounds the angle between a facet's normal and +z.
    ``cells`` says along what facets are cut: ``eye`` rays (steps are edge-on and invisible) or ``vertical``.
    Tilted eyes look past the edge of what stands low and against the sides: so the outer facets go on for ``bleed_mm``
    beyond the lens's square, and the slab's sides lean out to a flat bottom of at least the side ``floor_mm``.
    """

    size_mm: float = 100.0
    source_size_mm: float = 100.0
    facets: int = 32
    microfacets: int = 22
    thickness_mm: float = 40.0
    gap_mm: float = 0.0
    ior: float = 1.49
    wall_mm: float = 0.0005
    relief_mm: float = 5.0
    max_slope_deg: float = 60.0
    cells: Literal["eye", "vertical"] = "eye"
    bleed_mm: float = 0.0
    floor_mm: float = 0.0

    @property
    def pitch_mm(self) -> float:
        """Distance between the centres of two neighbouring facets on the reference plane."""
        return self.size_mm / self.facets

    def facet_centres_mm(self) -> FloatArray:
        """(N, N, 2) float64: x and y of each facet's centre on the reference plane, +y up."""
        c = (np.arange(self.facets) + 0.5) * self.pitch_mm - self.size_mm / 2
        return np.stack(np.broadcast_arrays(c[None, :], -c[:, None]), axis=-1)

    def cut_along(self, eye_mm: FloatArray) -> FloatArray | None:
        """The eye along whose rays facets are cut, if this is the reference eye; None where they are cut vertically."""
        return None if self.cells == "vertical" else eye_mm


class Seen:
    """Mixin: from where the lens is seen, and how it is turned.

    eye_mm: (3,) float64, world frame. rotation_deg: lens rotation, counter-clockwise as the viewer sees it, in quarter
    turns.
    """

    eye_mm: FloatArray
    rotation_deg: float

    @property
    def quarter_turns(self) -> int:
        """How many counter-clockwise quarter turns the lens has made."""
        return round(self.rotation_deg / 90.0) % 4

    @property
    def eye_in_lens_frame_mm(self) -> FloatArray:
        """(3,) float64: the eye as an observer who turns with the lens sees it."""
        c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[self.quarter_turns]
        x, y, z = self.eye_mm
        return np.array([c * x + s * y, -s * x + c * y, z])


@dataclass(frozen=True)
class View(Seen, _ReadOnly):
    """One thing the lens must show: through the lens, this eye sees ``target`` when ``source`` lies below.

    source: (H, W, C) float32, linear light, covers ``Lens.source_size_mm`` centred on the lens.
    target: (H, W, C) float32, linear light, covers the lens's square on the reference plane.
    C is 1 (grey) or 3 (RGB), the same in every view of a scene. Both are in the world frame.
    ``source_name`` and ``target_name`` name the files in the run folder; views may share a source.
    """

    name: str
    source: FloatArray
    target: FloatArray
    eye_mm: FloatArray
    rotation_deg: float = 0.0
    source_name: str = "source"
    target_name: str = "target"

    def in_lens_frame(self) -> View:
        """The same view seen by an observer who turns with the lens: rotation 0, images and eye turned back."""
        k = self.quarter_turns
        return View(
            self.name,
            np.ascontiguousarray(np.rot90(self.source, -k)),
            np.ascontiguousarray(np.rot90(self.target, -k)),
            self.eye_in_lens_frame_mm,
            0.0,
            self.source_name,
            self.target_name,
        )


@dataclass(frozen=True)
class Scene(_ReadOnly):
    """A lens to design and everything it must show.

    reserved: (H, W) bool, world frame, covers the source: where no facet of a universal lens may look and no encoder
    may paint (5.1); None reserves nothing.
    """

    lens: Lens
    views: tuple[View, ...]
    reserved: BoolArray | None = None

    @property
    def reference_eye_mm(self) -> FloatArray:
        """(3,) float64, lens frame: the eye that facets are designed for (mean of all eyes)."""
        eye: FloatArray = np.mean([v.eye_in_lens_frame_mm for v in self.views], axis=0)
        return eye

    @property
    def cut_eye_mm(self) -> FloatArray | None:
        """(3,) float64, lens frame: the eye along whose rays facets are cut; None where they are cut vertically."""
        return self.lens.cut_along(self.reference_eye_mm)


@dataclass(frozen=True)
class Candidates(_ReadOnly):
    """Up to K facet-patch transformations per facet (4.2), best first.

    A point at p from its facet's centre c (both on the reference plane, mm, +y up) sees the source point
    ``c + offset + M p`` with M = [[xx, xy], [xy, yy]], symmetric because a lenslet's displacement field is
    a gradient. M = identity shows the source unmagnified, negative entries show it mirrored.

    offsets_mm: (N, N, K, 2) float32. maps: (N, N, K, 3) float32 as (xx, xy, yy).
    errors: (N, N, K) float32, mean squared difference of display values (0..1), the distance term included;
    inf where a facet has fewer than K candidates. heights_mm: (N, N), where facets stand for whom the errors hold, for
    matchers that care; None is the reference plane.
    """

    offsets_mm: FloatArray
    maps: FloatArray
    errors: FloatArray
    metrics: Mapping[str, float] = field(default_factory=dict)
    heights_mm: FloatArray | None = None


@dataclass(frozen=True)
class Assignment(_ReadOnly):
    """One facet-patch transformation per facet, as chosen by an annealer.

    choice: (N, N) int64, index into the candidates. offsets_mm: (N, N, 2), maps: (N, N, 3), errors: (N, N).
    """

    choice: IntArray
    offsets_mm: FloatArray
    maps: FloatArray
    errors: FloatArray
    metrics: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def pick(cls, candidates: Candidates, choice: IntArray, metrics: Mapping[str, float] | None = None) -> Assignment:
        """The assignment that takes candidate ``choice[i, j]`` at facet (i, j)."""
        i, j = np.indices(choice.shape)
        return cls(
            np.array(choice, np.int64),
            candidates.offsets_mm[i, j, choice],
            candidates.maps[i, j, choice],
            candidates.errors[i, j, choice],
            dict(metrics or {}),
        )


@dataclass(frozen=True)
class HeightField(_ReadOnly):
    """The lens's top: one grid of (m + 1) x (m + 1) heights per facet, cut along rays from ``eye_mm`` or vertically.

    A vertex at (u, v) on the reference plane with height h lies at ``eye + exp(-h / D) * (q - eye)``, where
    q = (u, v, thickness) and D is the eye's distance from the reference plane; so it moves along its eye ray
    and h is, to first order, its height above the plane. With vertical cells it lies at (u, v, thickness + h).

    heights_mm: (N, N, m + 1, m + 1) float64. eye_mm: (3,) float64, lens frame, or None for vertical cells.
    """

    lens: Lens
    heights_mm: FloatArray
    eye_mm: FloatArray | None
    metrics: Mapping[str, float] = field(default_factory=dict)

    @property
    def levels_mm(self) -> FloatArray:
        """(N, N) mean height of each facet."""
        levels: FloatArray = self.heights_mm.mean(axis=(2, 3))
        return levels

    def points_mm(self, u: FloatArray, v: FloatArray, heights: FloatArray) -> FloatArray:
        """(..., 3) where vertices at (u, v) with these heights lie; the three arrays broadcast."""
        u, v, h = np.broadcast_arrays(u, v, heights)
        plane = np.stack([u, v, np.full_like(h, self.lens.thickness_mm)], axis=-1)
        if self.eye_mm is None:
            upright: FloatArray = plane + np.stack([np.zeros_like(h), np.zeros_like(h), h], axis=-1)
            return upright
        rays = plane - self.eye_mm
        lifted: FloatArray = self.eye_mm + np.exp(h / rays[..., 2])[..., None] * rays
        return lifted

    def facet_points_mm(self) -> FloatArray:
        """(N, N, m + 1, m + 1, 3) where the facets' vertices lie."""
        lens, m = self.lens, self.lens.microfacets
        within = (np.arange(m + 1) / m - 0.5) * (lens.pitch_mm - lens.wall_mm)
        centres = lens.facet_centres_mm()[:, :, None, None]
        return self.points_mm(centres[..., 0] + within, centres[..., 1] - within[:, None], self.heights_mm)


@dataclass(frozen=True)
class Solid(_ReadOnly):
    """A closed triangle mesh, lens frame, mm, outward normals.

    vertices: (V, 3) float64. faces: (F, 3) int32.
    grid: (rows, columns) when the first rows * columns vertices are the top's regular grid, row-major, i along
    the image's rows, every cell cut from its top-left to its bottom-right corner, and each vertex on its ray from
    ``eye_mm`` (vertical line if None); None for a free mesh. The built-in tracer needs the grid.
    """

    vertices: FloatArray
    faces: IntArray
    grid: tuple[int, int] | None = None
    eye_mm: FloatArray | None = None
    metrics: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Transport:
    """What the eye sees is linear in the source: ``seen = matrix @ source``.

    matrix: (rows * columns, source_rows * source_columns) sparse; bilinear weights times transmission.
    shape: (rows, columns) of the picture. source_shape: (rows, columns) of the source raster.
    """

    matrix: csr_array
    shape: tuple[int, int]
    source_shape: tuple[int, int]

    def see(self, source: FloatArray) -> FloatArray:
        """(rows, columns, C) float32, linear light: the picture of a source (source_rows, source_columns, C)."""
        from magiclens.kernels.sparse import times

        a, pixels = self.matrix, self.source_shape[0] * self.source_shape[1]
        flat = np.ascontiguousarray(source.reshape(pixels, -1), np.float32)
        seen: FloatArray = times(a.indptr, a.indices, a.data, flat).reshape(*self.shape, -1)
        return seen

    def turned(self, quarter_turns: int) -> Transport:
        """The matrix after so many counter-clockwise quarter turns of lens and eye together; rasters are square."""
        if quarter_turns % 4 == 0:
            return self
        pixels, sources = (
            np.rot90(np.arange(rows * columns, dtype=np.int32).reshape(rows, columns), turns).ravel()
            for (rows, columns), turns in ((self.shape, quarter_turns), (self.source_shape, -quarter_turns))
        )
        picture = self.matrix[pixels]
        matrix = type(picture)((picture.data, sources[picture.indices], picture.indptr), picture.shape)
        return replace(self, matrix=matrix)
