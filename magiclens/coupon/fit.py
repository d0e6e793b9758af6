"""Finds the parameters of a coupon's process and material that explain a photograph."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray, IntArray
from magiclens.contract.errors import InputError
from magiclens.coupon.model import CouponModel, LayeredTop, Unknowns, camera_axes
from magiclens.coupon.photograph import CouponPhotograph
from magiclens.coupon.shape import DEPTH_MM, WIDTH_MM, off_borders

_PROCESS = ("variance", "fourth")
_BODY = ("ior", "gap", "shift_x", "shift_y", "turn")
_CAMERA = ("lean_x", "lean_y", "lean_z", "camera_x", "camera_y", "camera_z", "log_focal", "distortion", "blur_px")
_STEPS = {
    "variance": 5e-4, "fourth": 2e-3, "ior": 2e-3, "gap": 5e-3, "shift_x": 5e-3, "shift_y": 5e-3, "turn": 2e-4,
    "lean_x": 1e-4, "lean_y": 1e-4, "lean_z": 1e-4, "camera_x": 0.05, "camera_y": 0.05, "camera_z": 0.05,
    "log_focal": 2e-4, "distortion": 1e-3, "blur_px": 0.05,
}  # fmt: skip
"""Steps of the numerical derivatives: changes that move what is seen by about a tenth of a pixel."""
_BOUNDS = {"variance": (0.0, 0.25), "fourth": (0.0, 40.0), "ior": (1.3, 1.8), "gap": (0.0, 1.0), "blur_px": (0.1, 6.0)}
_RAYS_MM = 0.035
"""Largest distance of rays where they meet the coupon: eleven to the finest wave."""
_MARGIN_MM = 0.35
_RIM_MM = 4.0
"""How far outside the coupon its sides may hide the sheet."""
_BLOCK_PX = 16
"""Side of the blocks of pixels whose errors count as independent of other blocks'."""


@dataclass(frozen=True)
class Fitted:
    """A number and its standard error."""

    value: float
    error: float


@dataclass(frozen=True)
class Reading:
    """What a photograph says of a process.

    Attributes:
        spread: Sigma of the Gaussian by which surfaces were evened out, mm.
        levelling: Wavelength of which a coat left 1/e, mm; None if no coat is seen.
        ior: The index of refraction.
        gap: Air below the coupon, mm.
        distance: From the sheet to the camera, mm, roughly: it hardly changes what is seen.
        misfit: Root mean square of what is left unexplained, as a share of the sheet's contrast.
    """

    spread: Fitted
    levelling: Fitted | None
    ior: Fitted
    gap: Fitted
    distance: float
    misfit: float

    def spec(self, machine: str) -> dict[str, Any]:
        """What a spec says for this machine as it was measured. Its blur then stands for all of the spread."""
        own: dict[str, Any] = {"machine": machine, "blur": f"{self.spread.value:.4f}mm", "polish": "0mm"}
        if self.levelling:
            own["lacquer"] = {"wavelength": f"{self.levelling.value:.3f}mm"}
        return {"fabrication": own, "lens": {"ior": round(self.ior.value, 4)}}

    def as_text(self, machine: str) -> str:
        """The numbers with their standard errors, and the lines of a spec."""
        rows = [("blur (sigma), mm", self.spread), ("levelling wavelength, mm", self.levelling),
                ("index of refraction", self.ior), ("air below the coupon, mm", self.gap)]  # fmt: skip
        shown = [f"{name:<30}{f'{e.value:.4f} +- {e.error:.4f}' if e else 'none'}" for name, e in rows]
        made, lens = self.spec(machine).values()
        inside = ", ".join(f"{key}: {_flow(value)}" for key, value in made.items())
        shown.append(f"{'distance of the camera, mm':<30}{self.distance:.0f}")
        left = f"{'unexplained':<30}{self.misfit:.1%} of the contrast"
        return "\n".join([*shown, left, "", "In a spec:", f"fabrication: {{{inside}}}", f"lens: {_flow(lens)}"])


def _flow(value: Any) -> str:
    """A value as YAML writes it within a line."""
    return f"{{{', '.join(f'{k}: {v}' for k, v in value.items())}}}" if isinstance(value, dict) else str(value)


def read_coupon(raster: LayeredTop, photograph: CouponPhotograph) -> Reading:
    """Fit process, material, camera and place of the coupon to a photograph, from coarse to fine.

    Raises:
        InputError: The photograph does not look like one of this coupon.
    """
    at = _located(raster, photograph)
    full = _Fit(raster, photograph, 1, at)
    at = full.solved(at, (*_PROCESS, *_BODY, "blur_px"))
    at = full.solved(at, (*_PROCESS, *_BODY, *_CAMERA))
    return full.reading(at)


def _located(raster: LayeredTop, photograph: CouponPhotograph) -> Unknowns:
    """A first fit, on pixels three times as large, from several beginnings."""
    start = _beginning(photograph)
    coarse = _Fit(raster, photograph, 3, start)
    start = coarse.solved(start, _CAMERA, inside=False)
    moved = [start._replace(shift_x=x, shift_y=y) for x in _around(0.75, 7) for y in _around(0.75, 7)]
    best = min(moved, key=coarse.misfit)
    finishes = [best._replace(variance=v, fourth=f) for v in (0.001, 0.008, 0.02) for f in (0.0, 0.03, 0.4, 2.0)]
    lying = coarse.solved(min(finishes, key=coarse.misfit), ("shift_x", "shift_y", "turn"))
    finishes = [lying._replace(variance=each.variance, fourth=each.fourth) for each in finishes]
    best = coarse.solved(min(finishes, key=coarse.misfit), (*_PROCESS, *_BODY))
    if coarse.misfit(best) > 0.3:
        wish = f"this differs from what a coupon can show, by {coarse.misfit(best):.0%} of the contrast"
        raise InputError(f"{wish}; is it the coupon of this folder, top up, between the corner marks of its sheet?")
    return best


def _around(far: float, count: int) -> FloatArray:
    return np.linspace(-far, far, count)


def _beginning(photograph: CouponPhotograph) -> Unknowns:
    """The camera by the markers alone, and usual values for everything else."""
    from scipy.optimize import least_squares

    width, height = photograph.size
    focal = photograph.focal or math.hypot(width, height)
    size = np.linalg.norm(np.ptp(photograph.points_px, axis=0)) / np.linalg.norm(np.ptp(photograph.points_mm, axis=0))

    def missed(p: FloatArray) -> FloatArray:
        axes = camera_axes((p[0], p[1], p[2]))
        rays = (np.column_stack([photograph.points_mm, np.zeros(len(photograph.points_mm))]) - p[3:6]) @ axes.T
        found = math.exp(p[6]) * rays[:, :2] / rays[:, 2:] + np.array([width, height]) / 2
        stated = (p[6] - math.log(focal)) / (0.02 if photograph.focal else 0.2)
        return np.append((found - photograph.points_px).ravel(), stated)

    first = np.array([0, 0, _turn(photograph), 0, 0, focal / size, math.log(focal)])
    p = least_squares(missed, first, x_scale=[0.01, 0.01, 0.01, 1, 1, 1, 0.01]).x
    lean = p[0], p[1], p[2]
    return Unknowns(0.006, 0.0, 1.5, 0.02, 0, 0, 0, *lean, p[3], p[4], p[5], p[6], 0.0, 0.7)


def _turn(photograph: CouponPhotograph) -> float:
    """How far the camera is turned about its axis, roughly: a photograph may be on its side or upside down."""
    px, mm = (points - points.mean(axis=0) for points in (photograph.points_px, photograph.points_mm))
    a, b = px[:, 0] + 1j * -px[:, 1], mm[:, 0] + 1j * mm[:, 1]
    return -float(np.angle((a * b.conj()).sum()))


class _Fit:
    """Compares a photograph with the model."""

    def __init__(self, raster: LayeredTop, photograph: CouponPhotograph, step: int, at: Unknowns):
        apart = at.camera_z / math.exp(at.log_focal)
        # coarse pixels make do with rays that lie as far apart as fine pixels
        rays = max(math.ceil(apart / _RAYS_MM), 1) if step == 1 else step
        self._model = CouponModel(raster, photograph, step, rays)
        rows, columns = (n * step for n in self._model.shape)
        blocks = photograph.light[:rows, :columns].reshape(self._model.shape[0], step, self._model.shape[1], step)
        self._light = blocks.mean(axis=(1, 3))
        self._inside, self._outside = self._areas(at)

    def _areas(self, at: Unknowns) -> tuple[BoolArray, BoolArray]:
        """The pixels that show the coupon's top, and those beside it."""
        _, x, y, top_x, top_y = np.moveaxis(self._model.seen(at), -1, 0)
        inside = off_borders(top_x, top_y, _MARGIN_MM)
        outside = np.maximum(np.abs(x) - WIDTH_MM / 2, np.abs(y) - DEPTH_MM / 2) > _RIM_MM
        outside &= ~_border(outside.shape)
        return inside, outside

    def _parts(self, inside: bool) -> Iterable[BoolArray]:
        return (self._outside, self._inside) if inside else (self._outside,)

    def left(self, at: Unknowns, inside: bool = True) -> FloatArray:
        """What is left unexplained, as a share of the contrast: (P,), part after part.

        Exposure, stray light and slopes of the lighting are fitted to each part, as these are linear.
        """
        shown = self._model.light(at)
        return np.concatenate([_unexplained(shown, self._light, part) for part in self._parts(inside)])

    def misfit(self, at: Unknowns) -> float:
        """Root mean square of ``left`` on the coupon."""
        return float(np.sqrt(np.mean(_unexplained(self._model.light(at), self._light, self._inside) ** 2)))

    def solved(self, at: Unknowns, names: tuple[str, ...], inside: bool = True) -> Unknowns:
        """The best values of some unknowns, begun at these."""
        from scipy.optimize import least_squares

        def values(p: Iterable[float]) -> Unknowns:
            return at._replace(**dict(zip(names, p, strict=True)))

        low, high = zip(*(_BOUNDS.get(name, (-np.inf, np.inf)) for name in names), strict=True)
        found = least_squares(
            lambda p: self.left(values(p), inside), [getattr(at, name) for name in names],
            lambda p: self._slopes(values(p), names, inside), bounds=(low, high),
            x_scale=[_STEPS[name] for name in names], loss="soft_l1", f_scale=0.1, xtol=1e-6, ftol=1e-6, max_nfev=15,
        )  # fmt: skip
        return values(found.x.tolist())

    def _slopes(self, at: Unknowns, names: tuple[str, ...], inside: bool) -> FloatArray:
        here = self.left(at, inside)
        return np.column_stack([(self.left(_moved(at, n), inside) - here) / _step(at, n) for n in names])

    def reading(self, at: Unknowns) -> Reading:
        """The parameters of interest; no coat if its wavelength is not clearly more than nothing."""
        names: tuple[str, ...] = (*_PROCESS, *_BODY, *_CAMERA)
        errors = self._errors(at, names)
        if at.fourth < 3 * errors["fourth"]:
            names = tuple(name for name in names if name != "fourth")
            at = self.solved(at._replace(fourth=0.0), names)
            errors = self._errors(at, names)
        spread = math.sqrt(at.variance)
        levelling = at.fourth**0.25
        return Reading(
            # the variance has the error 2 s ds, the fourth power 4 l^3 dl
            Fitted(spread, errors["variance"] / (2 * max(spread, 1e-3))),
            Fitted(levelling, errors["fourth"] / (4 * levelling**3)) if at.fourth else None,
            Fitted(at.ior, errors["ior"]), Fitted(at.gap, errors["gap"]),
            at.camera_z, self.misfit(at),
        )  # fmt: skip

    def _errors(self, at: Unknowns, names: tuple[str, ...]) -> dict[str, float]:
        """Standard errors that allow for errors that neighbouring pixels share (the cluster-robust covariance)."""
        scale = np.array([_STEPS[name] for name in names])
        slopes, left = self._slopes(at, names, True) * scale, self.left(at)
        inverse = np.linalg.inv(slopes.T @ slopes)
        block = np.concatenate([_blocks(part) for part in self._parts(True)])
        sums = np.zeros((int(block.max()) + 1, len(names)))
        np.add.at(sums, block, slopes * left[:, None])
        covariance = inverse @ (sums.T @ sums) @ inverse
        return dict(zip(names, (scale * np.sqrt(np.diag(covariance))).tolist(), strict=True))


def _unexplained(shown: FloatArray, light: FloatArray, part: BoolArray) -> FloatArray:
    rows, columns = np.nonzero(part)
    predicted, seen = shown[part], light[part]
    u, v = columns / light.shape[1] - 0.5, rows / light.shape[0] - 0.5
    design = np.column_stack([np.ones_like(u), predicted, predicted * u, predicted * v])
    factors = np.linalg.solve(design.T @ design + 1e-9 * np.eye(4), design.T @ seen)
    return np.asarray((design @ factors - seen) / max(abs(factors[1]), 1e-6))


def _step(at: Unknowns, name: str) -> float:
    # the steps of what spans decades grow with it
    return _STEPS[name] + (0.01 * getattr(at, name) if name in _PROCESS else 0.0)


def _moved(at: Unknowns, name: str) -> Unknowns:
    return at._replace(**{name: getattr(at, name) + _step(at, name)})


def _blocks(part: BoolArray) -> IntArray:
    rows, columns = np.nonzero(part)
    return np.asarray((rows // _BLOCK_PX) * (part.shape[1] // _BLOCK_PX + 1) + columns // _BLOCK_PX)


def _border(shape: tuple[int, ...]) -> BoolArray:
    """Where the camera's blur brings in what is beyond the raster."""
    border = np.ones(shape, bool)
    border[6:-6, 6:-6] = False
    return border
