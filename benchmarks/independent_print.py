"""What a print of a finished run shows, by a model of printing that shares no code with the simulation.

    python benchmarks/independent_print.py out/printed-single

The printed surface is built twice: from the layers in ``lens.slices.zip``, as a printer reads them, and from the
triangles in ``lens.stl``, which are cut into layers as a slicer does it, plainly. Material spreads like a Gaussian; the
body ends where its layers end, so that its edge is rounded, too. Mitsuba path traces the surface over the sources of
the run. The table compares PSNR, the mean over the views, with what the program says of the same slicing.
"""

from __future__ import annotations

import io
import json
import sys
from itertools import groupby
from pathlib import Path
from zipfile import ZipFile

import mitsuba as mi
import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter

from magiclens.contract.artifacts import Scene, Solid
from magiclens.images import score
from magiclens.profiles.machines import Printer
from magiclens.rendering.mitsuba import Mitsuba
from magiclens.rendering.variants import usable_variant
from magiclens.running.open_run import OpenRun, open_run
from magiclens.simulation.as_made import as_made

Heights = NDArray[np.float32]
"""(rows, columns) mm: tops of columns of pixels, row 0 at +y, in the middle of the lens frame."""
_POINT_MM = 0.05
"""Distance of the points of the printed surface, at most: it is smooth over some tenths of a millimetre."""
_ROWS_AT_ONCE = 200
_ASIDE_MM = ((0.0, 0.0), (1.1e-3, 0.4e-3))
"""Where rays are cast in a column: one that runs along an edge exactly may slip through the mesh."""


def heights_of_slices(archive: Path) -> tuple[Heights, tuple[float, float]]:
    """What a printer builds of an archive of ``slices``, and the width and depth of its pixels, mm."""
    with ZipFile(archive) as file:
        facts = json.loads(file.read("manifest.json"))
        share = np.zeros(256, np.float32)
        for value, height in facts.get("table", [[1, 1.0]]):  # black and white is read as 0 and 1
            share[value] = height
        total = np.zeros(facts["pixels"][::-1], np.float32)
        # most layers of a slab are alike
        for png, alike in groupby(file.read(f"layer-{k:05d}.png") for k in range(facts["layers"])):
            total += len(list(alike)) * share[np.asarray(Image.open(io.BytesIO(png)), np.uint8)]
    return total * np.float32(facts["layer_mm"]), tuple(facts["pixel_mm"])


def heights_of_mesh(mesh: Path, pixel_mm: tuple[float, float], layer_mm: float) -> Heights:
    """What a printer builds of a mesh that a slicer cuts: a voxel is filled if its centre is in the mesh."""
    body = trimesh.load_mesh(mesh)
    mi.set_variant(usable_variant("auto"))
    shape = mi.Mesh("lens", len(body.vertices), len(body.faces))
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = np.asarray(body.vertices, np.float32).ravel()
    parameters["faces"] = np.asarray(body.faces, np.uint32).ravel()
    parameters.update()
    scene = mi.load_dict({"type": "scene", "lens": shape})
    (left, down, _), (right, up, high) = body.bounds
    columns, rows = (round(side / pixel) for side, pixel in zip((right - left, up - down), pixel_mm, strict=True))
    x = (left + right) / 2 + (np.arange(columns) - (columns - 1) / 2) * pixel_mm[0]
    y = (down + up) / 2 - (np.arange(rows) - (rows - 1) / 2) * pixel_mm[1]
    start = high + 1.0
    tops = np.zeros((rows, columns), np.float32)
    for first in range(0, rows, _ROWS_AT_ONCE):
        for aside in _ASIDE_MM:
            at = np.stack([*np.meshgrid(x, y[first : first + _ROWS_AT_ONCE])], axis=-1).reshape(-1, 2) + aside
            ray = mi.Ray3f(mi.Point3f(at[:, 0], at[:, 1], np.full(len(at), start)), mi.Vector3f(0.0, 0.0, -1.0))
            fall = np.asarray(scene.ray_intersect_preliminary(ray, coherent=True).t)
            part = tops[first : first + _ROWS_AT_ONCE]
            np.maximum(part, np.where(np.isfinite(fall), start - fall, 0.0).reshape(-1, columns), out=part)
    return np.ceil(tops / np.float32(layer_mm) - np.float32(0.5)) * np.float32(layer_mm)


def printed(heights: Heights, pixel_mm: tuple[float, float], sigma_mm: float) -> Solid:
    """The closed body that is left when material has spread and the surface is polished."""
    smooth = gaussian_filter(heights, (sigma_mm / pixel_mm[1], sigma_mm / pixel_mm[0]), mode="constant")
    down, across = (max(int(_POINT_MM / pixel), 1) for pixel in pixel_mm[::-1])
    z = smooth[::down, ::across].astype(np.float64)
    rows, columns = smooth.shape
    y = ((rows - 1) / 2 - np.arange(0, rows, down)) * pixel_mm[1]
    x = (np.arange(0, columns, across) - (columns - 1) / 2) * pixel_mm[0]
    top = np.stack([*np.meshgrid(x, y), z], axis=-1).reshape(-1, 3)
    index = np.arange(z.size).reshape(z.shape)
    tl, tr, bl, br = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    rim = np.concatenate([index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]])  # counter-clockwise
    foot = z.size + np.arange(len(rim))
    beside, under = np.roll(rim, -1), np.roll(foot, -1)
    middle = np.full(len(rim), z.size + len(rim))
    faces = [
        *(np.stack(each, axis=-1).reshape(-1, 3) for each in ((tl, bl, br), (tl, br, tr))),
        *(np.stack(each, axis=-1) for each in ((rim, foot, under), (rim, under, beside), (foot, middle, under))),
    ]
    floor = np.concatenate([top[rim] * (1, 1, 0), np.zeros((1, 3))])
    return Solid(np.concatenate([top, floor]), np.concatenate(faces).astype(np.int32))


def shown_db(scene: Scene, body: Solid) -> float:
    """Mean PSNR of the path-traced body over the views, dB."""
    pictures = Mitsuba(resolution=512, samples=64).render(scene, body)
    scores = [score(picture, view.target) for picture, view in zip(pictures, scene.views, strict=True)]
    return float(np.mean([each.psnr_db for each in scores]))


def compare(run: OpenRun) -> dict[str, tuple[float, float]]:
    """PSNR in dB by this model and by the program's own, for slices and for the mesh.

    The run must have been exported as ``slices`` and ``stl``, and its machine be a printer whose finish is no lacquer.
    """
    assert run.plan.fabrication is not None
    printer, scene = run.plan.fabrication.machine, run.plan.on_medium(run.printed_scene)
    assert isinstance(printer, Printer)
    assert printer.lacquer is None, "this model knows no lacquer"
    sigma = float(np.hypot(printer.blur, printer.polish))
    sliced, pixel_mm = heights_of_slices(run.folder / "lens.slices.zip")
    cut = heights_of_mesh(run.folder / "lens.stl", printer.pixels_mm, printer.layer)
    found = {}
    for slicing, heights, pixels in (("diffused", sliced, pixel_mm), ("plain", cut, printer.pixels_mm)):
        own = as_made(printer.model_copy(update={"slicing": slicing}), scene, run.solid)
        assert own is not None
        found[slicing] = shown_db(scene, printed(heights, pixels, sigma)), own.psnr_db
    return found


def main(folder: str) -> None:
    """Print the comparison for a run folder."""
    print("slicing     independent    program")
    for slicing, (independent, own) in compare(open_run(Path(folder))).items():
        print(f"{slicing:<10} {independent:8.2f} dB {own:7.2f} dB", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
