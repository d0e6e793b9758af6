"""Simulates the pictures of docs/how-to/when-it-does-not-work.md: what one lens shows when something is wrong with it.

``python docs/draw_symptoms.py`` designs a small lens, and writes ``docs/images/symptoms/*.png``.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import magiclens
from magiclens.config.model import Medium
from magiclens.contract.artifacts import FloatArray, Solid, View
from magiclens.images.files import write_png
from magiclens.plan.compile import load_plan
from magiclens.profiles.machines import Printer
from magiclens.rendering.poses import Pose, PosedLens
from magiclens.simulation.as_made import exposed
from magiclens.simulation.as_printed import as_printed

IMAGES = Path(__file__).parent / "images" / "symptoms"
SIDE, SAMPLES = 160, 4
SPEC: Mapping[str, Any] = {
    "name": "symptoms",
    "scenario": {
        "type": "single",
        "source": {"type": "circles", "seed": 7, "radius": ["0.4mm", "1.6mm"]},
        "target": {"art": "panda"},
    },
    "lens": {"size": "50mm", "facets": 20, "microfacets": 16, "thickness": "20mm"},
    "report": {"analyses": []},
}
"""The lens that everything happens to."""


@dataclass(frozen=True)
class Bench:
    """The lens, its view, and what else pictures are taken with."""

    lens: PosedLens
    view: View
    printed: PosedLens

    def seen(self, pose: Pose = Pose(), **changes: Any) -> FloatArray:  # noqa: B008
        """(SIDE, SIDE, C) linear light: what the eye sees, of another view if there are changes."""
        return self.lens.picture(replace(self.view, **changes), pose)

    def both_eyes(self) -> FloatArray:
        """The mean of what two eyes see, 62 mm apart."""
        left, right = (self.seen(Pose(eye_x_mm=x)) for x in (-31.0, 31.0))
        return np.asarray((left + right) / 2)


SYMPTOMS: Mapping[str, Callable[[Bench], FloatArray]] = {
    "as-designed": lambda bench: bench.seen(),
    "sheet-aside": lambda bench: bench.seen(Pose(shift_x_mm=0.4, shift_y_mm=0.2)),
    "sheet-turned": lambda bench: bench.seen(Pose(rotation_deg=2.0)),
    "sheet-too-small": lambda bench: bench.seen(Pose(scale_percent=-3.0)),
    "sheet-mirrored": lambda bench: bench.seen(source=np.ascontiguousarray(bench.view.source[:, ::-1])),
    "wrong-edge-up": lambda bench: bench.seen(rotation_deg=90.0),
    "eye-too-near": lambda bench: bench.seen(Pose(eye_z_mm=-150.0)),
    "eye-aside": lambda bench: bench.seen(Pose(eye_x_mm=12.0)),
    "both-eyes": Bench.both_eyes,
    "lifted": lambda bench: bench.seen(Pose(gap_mm=2.0)),
    "leaning": lambda bench: bench.seen(Pose(tilt_x_deg=1.5)),
    "other-material": lambda bench: bench.seen(Pose(ior=0.07)),
    "pale-ink": lambda bench: bench.seen(source=Medium(black="30%").shown(bench.view.source)),
    "printer-unknown": lambda bench: bench.printed.picture(bench.view, Pose()),
}
"""What is seen, by the name of the file."""


def pictures() -> Iterator[tuple[str, FloatArray]]:
    """Every picture, (SIDE, SIDE, C) linear light, by its name."""
    bench = _bench()
    for name, take in SYMPTOMS.items():
        [picture] = exposed([take(bench)], [bench.view])
        yield name, picture


def _bench() -> Bench:
    with tempfile.TemporaryDirectory() as folder:
        run = magiclens.run(SPEC, Path(folder) / "run")
        spec = Path(folder) / "run" / "spec.yaml"
        making = load_plan(spec, ["fabrication={machine: sla}"]).fabrication
    assert making is not None
    assert isinstance(making.machine, Printer)
    scene, solid = run.result.scene, run.result.solid
    return Bench(_posed(solid, scene.lens), scene.views[0], _posed(as_printed(solid, making.machine), scene.lens))


def _posed(solid: Solid, lens: Any) -> PosedLens:
    return PosedLens(solid, lens, SIDE, SAMPLES)


if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    for found, drawn in pictures():
        write_png(IMAGES / f"{found}.png", drawn)
