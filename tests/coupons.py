"""Photographs of coupons that nobody has printed: path-traced, or by the built-in tracer."""

from __future__ import annotations

from math import atan, degrees, hypot
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from magiclens.contract.artifacts import FloatArray, Solid
from magiclens.coupon.shape import coupon_solid
from magiclens.coupon.sheet import SHEET_PX_PER_MM, sheet_picture
from magiclens.images import to_display
from magiclens.profiles.machines import Printer, machines
from magiclens.simulation.as_printed import as_printed


class Truth(NamedTuple):
    """What made a coupon, and how it was photographed.

    ``spread`` and ``levelling`` are mm; ``lying`` is the place of the coupon's middle, mm, and its turn, degrees;
    ``eye`` is the camera, which looks at ``aim``, mm; its picture is ``field`` mm and ``width`` pixels wide.
    """

    spread: float
    levelling: float
    ior: float
    lying: tuple[float, float, float] = (0.2, -0.15, 0.4)
    eye: tuple[float, float, float] = (60.0, -90.0, 260.0)
    aim: tuple[float, float] = (1.0, -0.5)
    field: float = 112.0
    width: int = 1200
    exposure: float = 0.6
    noise: float = 0.01


def printer(truth: Truth, machine: str = "sla") -> Printer:
    """A printer with the process of the truth, whose film has the thickness that makes its wavelength."""
    profile = machines()[machine]
    options: dict[str, Any] = {**profile.options, "blur": f"{truth.spread}mm", "polish": "0mm"}
    if truth.levelling:
        options["lacquer"] = {"wavelength": f"{truth.levelling}mm"}
    made = profile.model.model_validate(options)
    assert isinstance(made, Printer)
    return made


def made_coupon(truth: Truth) -> Solid:
    """The body that the printer makes, where it lies on the sheet."""
    maker = printer(truth)
    body = as_printed(coupon_solid(maker.layer), maker)
    x, y, turn = truth.lying
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    vertices = body.vertices @ np.array([(c, s, 0), (-s, c, 0), (0, 0, 1)]) + (x, y, 0.05)
    return Solid(vertices, body.faces)


def path_traced(truth: Truth, samples: int = 16) -> FloatArray:
    """(rows, columns) linear light: the coupon of the truth as Mitsuba sees it on its glowing sheet."""
    import mitsuba as mi

    from magiclens.rendering.variants import usable_variant

    mi.set_variant(usable_variant("auto"))
    solid = made_coupon(truth)
    mesh = _mesh(solid, truth.ior)
    t = mi.ScalarTransform4f()
    distance = hypot(truth.eye[0] - truth.aim[0], truth.eye[1] - truth.aim[1], truth.eye[2])
    sheet = sheet_picture()
    bitmap = mi.Bitmap(np.ascontiguousarray(sheet[::-1, :, None]))
    light = {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"}
    half = np.array(sheet.shape[::-1]) / SHEET_PX_PER_MM / 2
    world = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6, "rr_depth": 6, "block_size": 32},
        "coupon": mesh,
        "sheet": {
            "type": "rectangle", "to_world": t.scale([half[0], half[1], 1]),
            # a null surface would not be seen beside the coupon
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
            "emitter": {"type": "area", "radiance": light},
        },
        "sensor": {
            "type": "perspective", "fov": degrees(2 * atan(truth.field / 2 / distance)), "fov_axis": "x",
            "near_clip": 10.0, "far_clip": 1000.0,
            "to_world": t.look_at(origin=list(truth.eye), target=[*truth.aim, 0.0], up=[0, 1, 0]),
            "film": {
                "type": "hdrfilm", "width": truth.width, "height": round(0.9 * truth.width),
                "rfilter": {"type": "box"}, "pixel_format": "rgb",
            },
            "sampler": {"type": "multijitter", "sample_count": samples},
        },
    }  # fmt: skip
    seen = np.asarray(mi.render(mi.load_dict(world), seed=mi.UInt32(1)), np.float64)
    return np.ascontiguousarray(seen[..., 0])


def write_photograph(light: FloatArray, truth: Truth, path: Path) -> None:
    """A JPEG of it: exposed, with stray light and noise."""
    noise = np.random.default_rng(3).normal(0, truth.noise, light.shape)
    shown = to_display(np.clip(0.02 + truth.exposure * light + noise, 0, 1).astype(np.float32))
    Image.fromarray(np.rint(255 * shown).astype(np.uint8)).save(path, quality=92)


def _mesh(solid: Solid, ior: float) -> Any:
    import mitsuba as mi

    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "dielectric", "int_ior": ior, "ext_ior": 1.0})
    mesh = mi.Mesh("coupon", len(solid.vertices), len(solid.faces), props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = solid.vertices.astype(np.float32).ravel()
    parameters["faces"] = solid.faces.astype(np.uint32).ravel()
    parameters.update()
    return mesh


def traced(truth: Truth, machine: str = "printing", px_per_mm: float = 8.0) -> FloatArray:
    """(rows, columns) linear light: the same by the built-in tracer, from a camera that is then turned to the aim.

    Light that the tracer loses beside the coupon comes from the sheet.
    """
    import cv2

    from magiclens.contract.artifacts import Lens
    from magiclens.rendering.source_kernels import average_samples
    from magiclens.rendering.tracer import trace
    from scenes import grey_view

    maker = printer(truth, machine)
    body = as_printed(coupon_solid(maker.layer), maker)
    lens = Lens(size_mm=100.0, source_size_mm=100.0, thickness_mm=3.2, gap_mm=0.05, ior=truth.ior)
    side = round(100 * px_per_mm)
    x, y, turn = truth.lying
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    eye = np.array(truth.eye)
    own = np.array([c * (eye[0] - x) + s * (eye[1] - y), c * (eye[1] - y) - s * (eye[0] - x), eye[2]])
    view = grey_view(np.ones((16, 16)), np.ones((16, 16)), (own[0], own[1], own[2] - 0.05))
    hits = np.array(trace(body, lens, view, side, 2), np.float64)
    missed = hits[..., 2] <= 0
    at = (np.arange(side) + 0.5) / px_per_mm - 50
    straight = own[:2] + (np.stack(np.meshgrid(at, -at), axis=-1) - own[:2]) * own[2] / (own[2] - 3.25)
    hits[missed] = np.insert(np.broadcast_to(straight[:, :, None], (*missed.shape, 2))[missed], 2, 1.0, axis=1)
    turned = hits[..., :2] @ np.array([(c, s), (-s, c)]) + (x, y)
    sheet = np.zeros((round(100 * SHEET_PX_PER_MM),) * 2, np.float32)
    drawn = sheet_picture()
    top, left = ((len(sheet) - n) // 2 for n in drawn.shape)
    sheet[top : top + len(drawn), left : left + drawn.shape[1]] = drawn
    moved = np.concatenate([turned, hits[..., 2:]], axis=-1).astype(np.float32)
    seen = average_samples(moved, np.ascontiguousarray(sheet[..., None]), len(sheet) / 100)[..., 0]
    aimed = cv2.warpPerspective(seen, _turn(truth, own, c, s, side), (side, side), flags=cv2.INTER_CUBIC)
    return np.asarray(aimed, np.float64)


def _turn(truth: Truth, own: FloatArray, c: float, s: float, side: int) -> FloatArray:
    """The homography from the tracer's picture, straight down, to that of a camera that looks at the aim."""
    focal = (own[2] - 3.25) * side / 100
    middle = side / 2 - 0.5
    down = np.array([(focal, 0, middle + own[0] * side / 100), (0, focal, middle - own[1] * side / 100), (0, 0, 1.0)])
    forward = np.array([*truth.aim, 0.0]) - np.array(truth.eye)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0, 1.0, 0))
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward])  # right, down, forward on the sheet
    coupon = np.array([(c, s, 0), (s, -c, 0), (0, 0, -1.0)])  # the same of the straight camera
    turned = np.array([(focal, 0, middle), (0, focal, middle), (0, 0, 1.0)])
    out: FloatArray = turned @ axes @ coupon.T @ np.linalg.inv(down)
    return out
