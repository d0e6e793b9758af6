"""Tracing: what the eye sees through the lens of ``specs/rotating.yaml``, sample by sample, and the picture of it."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from benchmarks.comparison import Comparison, Work, installed, require
from benchmarks.lenses import heights, planned
from magiclens.contract.artifacts import FloatArray, Scene, Solid
from magiclens.rendering.mitsuba import Mitsuba
from magiclens.rendering.tracer import picture, trace


def comparisons(options: argparse.Namespace) -> list[Comparison]:
    """Against Mitsuba, whose scene is ready, by both of its variants; and against Embree, followed by NumPy."""
    from magiclens.geometry.solid import solid_from_heights

    resolution, samples = (64, 2) if options.quick else (512, 4)
    small = ("lens.facets=16", "lens.microfacets=8") if options.quick else ()
    scene, solid = planned("rotating", *small)[1], solid_from_heights(heights("rotating", *small))
    task = f"{resolution}² pixels x {samples**2} paths, {len(solid.faces):,} triangles"

    def ours() -> FloatArray:
        view = scene.views[0]
        hits = trace(solid, scene.lens, view, resolution, samples)
        return picture(hits, view.in_lens_frame().source, scene.lens.source_size_mm)

    peers = {f"Mitsuba {v}": _mitsuba(scene, solid, v, (resolution, samples**2)) for v in _variants()}
    found = [Comparison("tracing", task, ours, peers, _pictures_agree)]
    missing = () if installed("embreex") else ("Embree",)
    rays = {} if missing else {"Embree and NumPy": _embree(scene, solid, resolution)}
    points = lambda: trace(solid, scene.lens, scene.views[0], resolution, 1)  # noqa: E731
    found.append(Comparison("tracing", f"{resolution}² paths, source points", points, rays, _points_agree, missing))
    return found


def _variants() -> list[str]:
    from magiclens.rendering.variants import usable_variant

    return sorted({usable_variant("auto"), "scalar_rgb"})


def _mitsuba(scene: Scene, solid: Solid, variant: str, size: tuple[int, int]) -> Work:
    import mitsuba as mi

    mi.set_variant(variant)
    renderer = Mitsuba(resolution=size[0], samples=size[1])
    world = mi.load_dict(renderer._world(scene.lens, renderer._lens(solid, scene.lens.ior), scene.views[0]))

    def render() -> FloatArray:
        mi.set_variant(variant)
        return np.asarray(mi.render(world, seed=mi.UInt32(0)), np.float32)

    return render


def _pictures_agree(ours: FloatArray, theirs: FloatArray) -> str:
    """In 16 x 16 parts, and as well as paths at random places, of which a part has so many, can tell."""
    side = len(ours) // 16
    parts = np.abs((ours - theirs).reshape(16, side, 16, side, -1).mean(axis=(1, 3, 4)))
    noise = 0.6 / np.sqrt(side * side * 4)
    return require(parts.mean() < max(noise, 0.01), f"256 parts of the picture equal to {parts.mean():.1g} of 1")


def _embree(scene: Scene, solid: Solid, resolution: int) -> Work:
    """The same paths, straight through: Embree finds where they enter the lens, and NumPy refracts them."""
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    lens, eye = scene.lens, scene.views[0].eye_in_lens_frame_mm
    world = rtcore_scene.EmbreeScene()
    triangles = np.ascontiguousarray(solid.vertices[solid.faces], np.float32)
    TriangleMesh(world, triangles)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]).astype(np.float64)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    at = ((np.arange(resolution) + 0.5) / resolution - 0.5) * lens.size_mm
    aims = np.stack(np.broadcast_arrays(*np.meshgrid(at, -at), lens.thickness_mm), axis=-1).reshape(-1, 3)

    def points() -> FloatArray:
        ways = aims - eye
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        starts = np.ascontiguousarray(np.broadcast_to(eye, ways.shape), np.float32)
        met: Any = world.run(starts, np.ascontiguousarray(ways, np.float32), output=1)
        entry, normal = eye + ways * met["tfar"][:, None], normals[np.maximum(met["primID"], 0)]
        inside = _refracted(ways, normal, lens.ior)
        again = world.run(
            np.ascontiguousarray(entry + 1e-3 * inside, np.float32), np.ascontiguousarray(inside, np.float32), output=1
        )
        leave = entry + inside * (again["tfar"][:, None] + 1e-3)
        outside = _refracted(inside, np.broadcast_to([0.0, 0.0, 1.0], inside.shape), 1 / lens.ior)
        source = leave - outside * (lens.gap_mm / outside[:, 2:])
        lands = np.abs(leave[:, 2]) < 1e-2
        return np.where(lands[:, None], source, np.nan)[:, :2].reshape(resolution, resolution, 2)

    return points


def _refracted(ways: FloatArray, normals: FloatArray, eta: float) -> FloatArray:
    """Snell's law for unit vectors (F, 3); nan on total reflection."""
    cos_i = -(ways * normals).sum(axis=1)
    with np.errstate(invalid="ignore"):
        bend = cos_i / eta - np.sqrt(1 - (1 - cos_i**2) / eta**2)
    return ways / eta + bend[:, None] * normals


def _points_agree(ours: FloatArray, theirs: FloatArray) -> str:
    """Paths that go straight through end at the same points; those that meet walls go on differently."""
    same = np.abs(ours[:, :, 0, :2] - theirs).max(axis=-1) < 0.02
    return require(same.mean() > 0.8, f"{same.mean():.0%} of the points equal to 0.02 mm, the others met walls")
