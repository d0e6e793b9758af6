"""Path tracing of the solid as it is exported, by Mitsuba 3: an independent check of the built-in tracer.

The lens stays as the file holds it; a lens rotation turns the source and the eye the other way round instead, which
shows the same picture and leaves the vertices untouched.

Conventions of Mitsuba that matter here: the v axis of a ``rectangle`` grows with the bitmap's rows from -y to +y, so
bitmaps are handed over bottom row first; a camera that looks straight down with +y up has +x on its right; a positive
``principal_point_offset`` moves what is seen left and up, by shares of the film's width and height.
"""

from __future__ import annotations

from math import atan, degrees
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field, field_validator

from magiclens.contract.artifacts import FloatArray, Lens, Scene, Solid, View
from magiclens.contract.stages import Progress, Renderer, silent
from magiclens.kernels.resuming import resumable

SMALLEST_GAP_MM = 0.05
"""Smallest distance of the source from the slab's bottom, mm: Mitsuba's ray epsilon skips one that is closer."""


class Mitsuba(Renderer):
    """Path traces the mesh as exported: float32 vertices, flat faces, a smooth or a rough (GGX) dielectric."""

    type: ClassVar[str] = "mitsuba"

    samples: int = Field(64, ge=4, le=4**8, description="paths per pixel: 4, 16, 64, 256, ... (stratified in squares)")
    resolution: int = Field(256, ge=1, le=4096, description="pixels along the picture's side")
    roughness: float = Field(
        0.0, ge=0.0, le=1.0, description="GGX alpha of the surface (Walter et al. 2007); 0: smooth"
    )
    variant: Literal["auto", "llvm_ad_rgb", "scalar_rgb", "cuda_ad_rgb"] = Field(
        "auto",
        description="Mitsuba's variant; `auto`: compiled by LLVM (17 or newer) if that works here, else scalar; "
        "`cuda_ad_rgb`: on an NVIDIA GPU, where pictures of equal seeds differ by rounding",
    )
    max_depth: int = Field(8, ge=3, le=1000, description="longest path, in surfaces; 3: straight through to the source")
    seed: int = Field(0, ge=0, lt=2**32, description="seed of the samples; equal seeds give equal pictures")

    @field_validator("samples")
    @classmethod
    def _is_power_of_four(cls, samples: int) -> int:
        """Only then are Mitsuba's strata square, and LLVM's sums over a pixel always in the same order."""
        below = 4 ** ((samples.bit_length() - 1) // 2)
        if samples != below:
            raise ValueError(f"must be a power of four; the nearest are {below} and {4 * below}")
        return samples

    def surroundings(self) -> object:
        """The LLVM libraries that are installed, since the variants of Mitsuba round differently."""
        from magiclens.rendering.variants import library_files

        return library_files() if self.variant in ("auto", "llvm_ad_rgb") else None

    def render(self, scene: Scene, solid: Solid, progress: Progress = silent) -> list[FloatArray]:
        """One (resolution, resolution, C) float32 picture per view, in linear light."""
        import mitsuba as mi

        from magiclens.rendering.variants import usable_variant

        mi.set_variant(usable_variant(self.variant))
        mesh = self._lens(solid, scene.lens.ior)
        pictures = np.zeros((len(scene.views), self.resolution, self.resolution, 3), np.float32)
        size: tuple[int, ...] = ()
        for index, view in resumable(list(enumerate(scene.views)), pictures):
            source = _bitmap(view)
            if source.shape != size:
                world, size = mi.load_dict(self._world(scene.lens, mesh, view)), source.shape
            # As long as no shape moves, Embree need not sort the triangles again; a bitmap keeps its size.
            parameters = mi.traverse(world)
            parameters["source.emitter.radiance.data"] = source
            parameters.update()
            eye = mi.load_dict(self._eye(scene.lens, view))
            pictures[index] = np.asarray(mi.render(world, sensor=eye, seed=mi.UInt32(self.seed + index)))
            progress((index + 1) / len(scene.views))
        wanted = [view.source.shape[-1] for view in scene.views]
        return [np.ascontiguousarray(picture[..., :c]) for picture, c in zip(pictures, wanted, strict=True)]

    def _lens(self, solid: Solid, ior: float) -> Any:
        """The mesh, with the vertices that an STL file holds; without vertex normals its faces are flat."""
        import mitsuba as mi

        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict(self._glass(ior))
        mesh = mi.Mesh("lens", len(solid.vertices), len(solid.faces), props=properties)
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = solid.vertices.astype(np.float32).ravel()
        parameters["faces"] = solid.faces.astype(np.uint32).ravel()
        parameters.update()
        return mesh

    def _glass(self, ior: float) -> dict[str, Any]:
        glass = {"type": "dielectric", "int_ior": ior, "ext_ior": 1.0}
        if self.roughness > 0:
            glass |= {"type": "roughdielectric", "distribution": "ggx", "alpha": self.roughness}
        return glass

    def _world(self, lens: Lens, mesh: Any, view: View) -> dict[str, Any]:
        """The lens as it is, over the source and under the eye, both turned back by the lens rotation."""
        return {
            "type": "scene",
            # The block size is pinned since the samples' seeds depend on it, and its default on the number of cores.
            "integrator": {"type": "path", "max_depth": self.max_depth, "rr_depth": self.max_depth, "block_size": 32},
            "lens": mesh,
            "source": _source(lens, view),
            "sensor": self._eye(lens, view),
        }

    def _eye(self, lens: Lens, view: View) -> dict[str, Any]:
        """A pinhole that looks straight down, its film the lens's square on the reference plane."""
        from mitsuba import ScalarTransform4f

        x, y, z = (float(c) for c in view.eye_mm)
        distance = z - lens.thickness_mm
        straight_down = ScalarTransform4f().look_at(origin=[x, y, z], target=[x, y, 0.0], up=[0, 1, 0])
        turn = ScalarTransform4f().rotate([0, 0, 1], -90 * view.quarter_turns)
        return {
            "type": "perspective",
            "fov": degrees(2 * atan(lens.size_mm / 2 / distance)),
            "principal_point_offset_x": -x / lens.size_mm,
            "principal_point_offset_y": y / lens.size_mm,
            "near_clip": distance / 10,
            "far_clip": 10 * (z + lens.gap_mm),
            "to_world": turn @ straight_down,
            "film": {
                "type": "hdrfilm",
                "width": self.resolution,
                "height": self.resolution,
                "rfilter": {"type": "box"},
                "pixel_format": "rgb",
            },
            "sampler": {"type": "multijitter", "sample_count": self.samples},
        }


def _source(lens: Lens, view: View) -> dict[str, Any]:
    """The source as light that leaves a plane evenly into all directions."""
    from mitsuba import Bitmap, ScalarTransform4f

    half = lens.source_size_mm / 2
    light = {"type": "bitmap", "bitmap": Bitmap(_bitmap(view)), "raw": True, "wrap_mode": "clamp"}
    return {
        "type": "rectangle",
        "to_world": ScalarTransform4f().translate([0, 0, -max(lens.gap_mm, SMALLEST_GAP_MM)]).scale([half, half, 1]),
        # Paths end here; a black surface would end them too, but only after a shadow ray.
        "bsdf": {"type": "null"},
        "emitter": {"type": "area", "radiance": light},
    }


def _bitmap(view: View) -> FloatArray:
    """The source turned back by the lens rotation, bottom row first: (H, W, C)."""
    return np.ascontiguousarray(np.rot90(view.source, -view.quarter_turns)[::-1], np.float32)
