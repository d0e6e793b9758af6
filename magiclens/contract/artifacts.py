"""The data that stages exchange: small frozen dataclasses of read-only arrays.

These conventions hold in the whole package:

- Lengths are millimetres, angles are degrees.
- The *world frame* is right-handed. Its origin is the centre of the lens's flat bottom; +z points toward the viewer,
  +x to the right and +y up, as the viewer sees it. The source lies at z = -gap. The *reference plane*, at
  z = thickness, is the mean height of the lens's top, and targets are what the eye sees on it.
- The *lens frame* turns with the lens, and is the world frame at rotation 0. A lens rotation is counter-clockwise, as
  the viewer sees it, about z.
- Arrays over the lens or over a picture are ``[i, j]``: i grows with the rows of the picture (row 0 is at +y) and j
  with its columns (column 0 is at -x). Vectors are (x, y) or (x, y, z) with +y up, so that i grows toward -y.
- Light is linear, 0 to 1; comparisons are made in display values (sRGB), as the paper does.

In shapes, N is the number of facets along a side, m the number of micro-facets along a side of a facet, K the number of
candidates of a facet, and C the number of channels, 1 (grey) or 3 (RGB). Numbers in brackets, such as (4.2), are
sections and equations of Papas et al., "The Magic Lens: Refractive Steganography" (ACM Trans. Graph. 31(6), 2012).
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
"""An array of floats, of any precision."""

IntArray = NDArray[np.integer]
"""An array of whole numbers, of any size."""

BoolArray = NDArray[np.bool_]
"""An array of truth values."""


class _ReadOnly:
    """Mixin that makes arrays of a frozen dataclass read-only and its mappings immutable, in every process."""

    def __post_init__(self) -> None:
        for f in fields(self):  # type: ignore[arg-type]
            value = getattr(self, f.name)
            if isinstance(value, np.ndarray):
                value.flags.writeable = False  # not of a copy: its maker can no longer write to it either
            elif isinstance(value, dict):
                object.__setattr__(self, f.name, MappingProxyType(dict(value)))

    def __reduce__(self) -> tuple[type[Any], tuple[Any, ...]]:
        """Pickle the fields, since arrays would not stay read-only and immutable mappings cannot be pickled."""
        values = (getattr(self, f.name) for f in fields(self))  # type: ignore[arg-type]
        return type(self), tuple(dict(v) if isinstance(v, MappingProxyType) else v for v in values)


@dataclass(frozen=True)
class Lens:
    """The lens that is to be designed, before any of its facets has a shape.

    Attributes:
        size_mm: Side of the lens's square on the reference plane.
        source_size_mm: Side of the source, which is centred below the lens.
        facets: Number N of facets along a side.
        microfacets: Number m of flat micro-facets along a side of a facet.
        thickness_mm: Height of the reference plane above the flat bottom.
        gap_mm: Height of the air gap between the source and the flat bottom.
        ior: Index of refraction of the lens's material; air has 1.
        wall_mm: Width of the strip, the wall, between two facets.
        relief_mm: Allowed height range of the top: a vertex is at most this far above or below the reference plane.
        max_slope_deg: Largest angle allowed between the normal of a micro-facet and +z.
        cells: What facets are cut along. With ``eye``, the walls between facets lie along rays from the eye, which sees
            them edge-on and so not at all; with ``vertical``, facets are upright prisms.
        bleed_mm: How far the outer facets go on beyond the lens's square. A tilted eye looks past the edge of facets
            that are lower than the reference plane, and shall not see the lens end there.
        floor_mm: Least side of the flat bottom. The sides of the slab lean out to it, so that a tilted eye looks at the
            source and not at a side.
        mark: Whether a mark stands out at the foot of the side at +y, which is up at rotation 0.
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
    mark: bool = False

    @property
    def pitch_mm(self) -> float:
        """Distance between the centres of two neighbouring facets on the reference plane, mm."""
        return self.size_mm / self.facets

    def facet_centres_mm(self) -> FloatArray:
        """Centres of the facets on the reference plane: (N, N, 2) float64 as (x, y), mm, lens frame."""
        c = (np.arange(self.facets) + 0.5) * self.pitch_mm - self.size_mm / 2
        return np.stack(np.broadcast_arrays(c[None, :], -c[:, None]), axis=-1)  # row 0 is at +y

    def cut_along(self, eye_mm: FloatArray) -> FloatArray | None:
        """The eye along whose rays facets are cut; None if they are cut vertically.

        Args:
            eye_mm: The eye that facets are designed for: (3,) float64, mm, lens frame.
        """
        return None if self.cells == "vertical" else eye_mm


class Viewpoint:
    """Mixin of what is seen from an eye, through a lens that may be turned.

    Attributes:
        eye_mm: Position of the eye, a pinhole: (3,) float64, mm, world frame.
        rotation_deg: The lens's rotation, counter-clockwise as the viewer sees it: a multiple of 90. The source and the
            eye do not turn.
    """

    eye_mm: FloatArray
    rotation_deg: float

    @property
    def quarter_turns(self) -> int:
        """Number of counter-clockwise quarter turns of the lens, 0 to 3."""
        return round(self.rotation_deg / 90.0) % 4

    @property
    def eye_in_lens_frame_mm(self) -> FloatArray:
        """Position of the eye in the lens frame: (3,) float64, mm."""
        return self.to_lens_frame(self.eye_mm)

    def to_lens_frame(self, vector: FloatArray) -> FloatArray:
        """A vector (3,) of the world frame in the lens frame: (3,) float64."""
        # cosine and sine of quarter turns, exact
        c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[self.quarter_turns]
        x, y, z = vector
        return np.array([c * x + s * y, -s * x + c * y, z])


@dataclass(frozen=True)
class View(Viewpoint, _ReadOnly):
    """One picture that the lens must show: through it, the eye sees ``target`` when ``source`` lies below.

    Every scenario is a list of views (4.6). All views of a scene have the same number C of channels.

    Attributes:
        name: The view's name in the run folder.
        source: The source: (H, W, C) float32, linear light, world frame. It is a square of ``Lens.source_size_mm``.
        target: The target: (H, W, C) float32, linear light, world frame. It covers the lens's square on the reference
            plane.
        eye_mm: See ``Viewpoint``.
        rotation_deg: See ``Viewpoint``.
        source_name: Name of the source's file in the run folder; views with equal names share one source.
        target_name: Name of the target's file in the run folder.
    """

    name: str
    source: FloatArray
    target: FloatArray
    eye_mm: FloatArray
    rotation_deg: float = 0.0
    source_name: str = "source"
    target_name: str = "target"

    def in_lens_frame(self) -> View:
        """The same view in the lens frame: the rotation is 0; source, target and eye are turned back instead."""
        k = self.quarter_turns  # rot90 turns counter-clockwise, as the lens does, so -k turns back
        return View(
            self.name,
            # rot90 gives a view with other strides; to numba that is another type, for which it compiles again
            np.ascontiguousarray(np.rot90(self.source, -k)),
            np.ascontiguousarray(np.rot90(self.target, -k)),
            self.eye_in_lens_frame_mm,
            0.0,
            self.source_name,
            self.target_name,
        )


@dataclass(frozen=True)
class Scene(_ReadOnly):
    """A lens to design and everything that it must show.

    Attributes:
        lens: The lens.
        views: What it must show, at least one view.
        reserved: Pixels of the source to which no facet of a universal lens may map and which no encoder may paint
            (5.1): (H, W) bool, world frame. It covers the source, in a resolution of its own; None reserves nothing.
    """

    lens: Lens
    views: tuple[View, ...]
    reserved: BoolArray | None = None

    @property
    def reference_eye_mm(self) -> FloatArray:
        """The eye that facets are designed for, the mean of all eyes: (3,) float64, mm, lens frame."""
        eye: FloatArray = np.mean([v.eye_in_lens_frame_mm for v in self.views], axis=0)
        return eye

    @property
    def cut_eye_mm(self) -> FloatArray | None:
        """The eye along whose rays facets are cut: (3,) float64, mm, lens frame; None if they are cut vertically."""
        return self.lens.cut_along(self.reference_eye_mm)


@dataclass(frozen=True)
class Candidates(_ReadOnly):
    """Up to K facet-patch transformations per facet (4.2), best first.

    A facet-patch transformation says which patch of the source a facet shows. Through the point ``c + p`` of the
    reference plane, where c is the facet's centre, the eye sees the source at ``c + offset + M p``, with the *map*
    M = [[xx, xy], [xy, yy]]. M is symmetric because the displacement field of a lenslet is a gradient. The identity
    shows the patch at its own size, smaller entries magnify it, and negative ones show it mirrored.

    Attributes:
        offsets_mm: Offsets from each facet's centre to the centre of its patch: (N, N, K, 2) float32 as (x, y), mm,
            lens frame.
        maps: The maps M: (N, N, K, 3) float32 as (xx, xy, yy), without unit, lens frame.
        errors: Mean squared differences of display values (0 to 1) between patch and tile of the target, plus the
            distance term of (4.2): (N, N, K) float32. They ascend; inf fills the list of a facet that has fewer than K.
        metrics: Numbers for the manifest, by name.
        heights_mm: Heights of the facets above the reference plane for which the errors are right: (N, N) float64;
            None for the reference plane itself.
    """

    offsets_mm: FloatArray
    maps: FloatArray
    errors: FloatArray
    metrics: Mapping[str, float] = field(default_factory=dict)
    heights_mm: FloatArray | None = None


@dataclass(frozen=True)
class Assignment(_ReadOnly):
    """One facet-patch transformation per facet, chosen from the candidates (4.4).

    Attributes:
        choice: Index of the chosen candidate of each facet: (N, N) int64.
        offsets_mm: The chosen offsets: (N, N, 2), as in ``Candidates``.
        maps: The chosen maps: (N, N, 3), as in ``Candidates``.
        errors: The chosen candidates' errors: (N, N), as in ``Candidates``.
        metrics: Numbers for the manifest, by name.
    """

    choice: IntArray
    offsets_mm: FloatArray
    maps: FloatArray
    errors: FloatArray
    metrics: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def pick(cls, candidates: Candidates, choice: IntArray, metrics: Mapping[str, float] | None = None) -> Assignment:
        """Make the assignment of some choice.

        Args:
            candidates: The candidates to choose from.
            choice: Index of the chosen candidate of each facet: (N, N) whole numbers.
            metrics: Numbers for the manifest, by name.
        """
        i, j = np.indices(choice.shape)
        return cls(
            np.array(choice, np.int64),  # a copy: the artifact makes its arrays read-only, the caller's stays as it is
            candidates.offsets_mm[i, j, choice],
            candidates.maps[i, j, choice],
            candidates.errors[i, j, choice],
            dict(metrics or {}),
        )


@dataclass(frozen=True)
class HeightField(_ReadOnly):
    """The top of the lens: a grid of (m + 1) x (m + 1) vertices per facet (4.5).

    With cells along eye rays, the vertex of the point q = (u, v, thickness) of the reference plane lies at
    ``eye + exp(-h / D) * (q - eye)``, where h is its height and D the eye's distance from the reference plane. So it
    moves along its eye ray, and h is, to first order, its height above the plane. With vertical cells, it lies at
    (u, v, thickness + h).

    Attributes:
        lens: The lens.
        heights_mm: Heights h of the vertices above the reference plane: (N, N, m + 1, m + 1) float64, mm. The last two
            axes are those of a picture, as the first two are.
        eye_mm: The eye along whose rays facets are cut: (3,) float64, mm, lens frame; None for vertical cells.
        metrics: Numbers for the manifest, by name.
    """

    lens: Lens
    heights_mm: FloatArray
    eye_mm: FloatArray | None
    metrics: Mapping[str, float] = field(default_factory=dict)

    @property
    def levels_mm(self) -> FloatArray:
        """Mean height of each facet: (N, N) float64, mm."""
        levels: FloatArray = self.heights_mm.mean(axis=(2, 3))
        return levels

    def points_mm(self, u: FloatArray, v: FloatArray, heights: FloatArray) -> FloatArray:
        """Positions of vertices, for arguments of shapes that broadcast.

        Args:
            u: x of the vertices' points on the reference plane, mm, lens frame.
            v: y of these points.
            heights: Heights of the vertices, mm.

        Returns:
            (..., 3) float64, mm, lens frame.
        """
        u, v, h = np.broadcast_arrays(u, v, heights)
        plane = np.stack([u, v, np.full_like(h, self.lens.thickness_mm)], axis=-1)
        if self.eye_mm is None:
            upright: FloatArray = plane + np.stack([np.zeros_like(h), np.zeros_like(h), h], axis=-1)
            return upright
        rays = plane - self.eye_mm  # from the eye down, so that their z is -D
        lifted: FloatArray = self.eye_mm + np.exp(h / rays[..., 2])[..., None] * rays
        return lifted

    def facet_points_mm(self, rows: slice = slice(None)) -> FloatArray:
        """Positions of all vertices of some rows of facets: (R, N, m + 1, m + 1, 3) float64, mm, lens frame."""
        lens, m = self.lens, self.lens.microfacets
        # a facet ends half a wall before its cell does
        within = (np.arange(m + 1) / m - 0.5) * (lens.pitch_mm - lens.wall_mm)
        centres = lens.facet_centres_mm()[rows, :, None, None]
        return self.points_mm(centres[..., 0] + within, centres[..., 1] - within[:, None], self.heights_mm[rows])


@dataclass(frozen=True)
class Solid(_ReadOnly):
    """A closed triangle mesh with outward normals.

    Attributes:
        vertices: (V, 3) float64, mm, lens frame.
        faces: Indices of the corners of each triangle, counter-clockwise seen from outside: (F, 3) int32.
        grid: (rows, columns) if the first rows * columns vertices are the regular grid of the top; None for any other
            mesh. The grid is row-major as a picture is, each of its cells is cut from the top-left to the bottom-right
            corner, and each vertex lies on its ray from ``eye_mm``. The built-in tracer needs the grid.
        eye_mm: The eye along whose rays facets are cut: (3,) float64, mm, lens frame; None for vertical cells.
        metrics: Numbers for the manifest, by name.
    """

    vertices: FloatArray
    faces: IntArray
    grid: tuple[int, int] | None = None
    eye_mm: FloatArray | None = None
    metrics: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Transport:
    """The matrix from a source to what the eye of one view sees: ``picture = matrix @ source``, in linear light.

    Attributes:
        matrix: (rows * columns, source_rows * source_columns) sparse: bilinear weights times transmission.
        shape: (rows, columns) of the picture.
        source_shape: (source_rows, source_columns) of the source's raster.
    """

    matrix: csr_array
    shape: tuple[int, int]
    source_shape: tuple[int, int]

    def see(self, source: FloatArray) -> FloatArray:
        """The picture that the eye sees of a source.

        Args:
            source: (source_rows, source_columns, C), linear light.

        Returns:
            (rows, columns, C) float32, linear light.
        """
        from magiclens.kernels.sparse import times

        a, pixels = self.matrix, self.source_shape[0] * self.source_shape[1]
        flat = np.ascontiguousarray(source.reshape(pixels, -1), np.float32)
        seen: FloatArray = times(a.indptr, a.indices, a.data, flat).reshape(*self.shape, -1)
        return seen

    def turned(self, quarter_turns: int) -> Transport:
        """The matrix after counter-clockwise quarter turns of lens and eye together; both rasters must be square."""
        if quarter_turns % 4 == 0:
            return self
        # turning both rasters renumbers the rows and columns of the matrix; its entries stay. The picture turns with
        # the lens; seen from the lens the source turns the other way, hence the minus
        pixels, sources = (
            np.rot90(np.arange(rows * columns, dtype=np.int32).reshape(rows, columns), turns).ravel()
            for (rows, columns), turns in ((self.shape, quarter_turns), (self.source_shape, -quarter_turns))
        )
        picture = self.matrix[pixels]
        matrix = type(picture)((picture.data, sources[picture.indices], picture.indptr), picture.shape)
        return replace(self, matrix=matrix)
