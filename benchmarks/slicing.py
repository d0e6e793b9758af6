"""Slicing: a lens as the archive of layers that a resin printer with a screen reads, by the exporter ``sl1``."""

from __future__ import annotations

import argparse
import io
import shutil
import subprocess
import tempfile
from functools import partial
from pathlib import Path
from zipfile import ZipFile

import numpy as np
from PIL import Image

from benchmarks.comparison import Comparison, require
from benchmarks.lenses import heights, planned
from magiclens.exporting.mesh_files import write_stl
from magiclens.exporting.slices import Sl1

_PEER = "PrusaSlicer"
_BED = ("120mm", "68mm", "150mm")


def comparisons(options: argparse.Namespace) -> list[Comparison]:
    """Against PrusaSlicer's export for the same printer; it reads the mesh from a file, which is part of its work."""
    from magiclens.geometry.solid import solid_from_heights

    size = ("lens.size=20mm", "lens.facets=8", "lens.thickness=8mm") if options.quick else ("lens.size=60mm",)
    stack = Sl1(dpi_x=540.0, dpi_y=540.0, layer="200um" if options.quick else "50um", bed=_BED)
    scene, solid = planned("single", *size)[1], solid_from_heights(heights("single", *size))
    scratch = Path(tempfile.mkdtemp(prefix="slicing-"))
    ours, theirs, mesh, settings = (scratch / name for name in ("ours.sl1", "theirs.sl1", "lens.stl", "ours.ini"))

    def slice_lens() -> Path:
        stack.export(scene, solid, ours)
        return ours

    slice_lens()
    settings.write_bytes(ZipFile(ours).read("prusaslicer.ini"))
    write_stl(solid.vertices, solid.faces, mesh)
    missing = () if shutil.which("prusa-slicer") else (_PEER,)
    peers = {} if missing else {_PEER: partial(_prusa_slicer, mesh, settings, theirs)}
    layers, pixels = len(_names(ours)), "{1} x {0}".format(*_layer(ours, 0).shape)
    task = f"{layers} layers of {pixels} pixels, {len(solid.faces):,} triangles"
    return [Comparison("slicing", task, slice_lens, peers, _layers_agree, missing)]


def _prusa_slicer(mesh: Path, settings: Path, out: Path) -> Path:
    options = ["--supports-enable=0", "--pad-enable=0", "--center", "60,34", "--output", out]
    command = ["prusa-slicer", "--export-sla", "--load", settings, *options, mesh]
    subprocess.run(command, check=True, capture_output=True)
    return out


def _names(archive: Path) -> list[str]:
    with ZipFile(archive) as file:
        return sorted(name for name in file.namelist() if name.endswith(".png") and "/" not in name)


def _layer(archive: Path, k: int) -> np.ndarray:
    """(rows, columns) whether the k-th layer is exposed."""
    with ZipFile(archive) as file:
        return np.asarray(Image.open(io.BytesIO(file.read(_names(archive)[k]))).convert("L")) > 127


def _layers_agree(ours: Path, theirs: Path) -> str:
    counts = [len(_names(archive)) for archive in (ours, theirs)]
    require(abs(counts[0] - counts[1]) <= 1, f"{counts[0]} and {counts[1]} layers")
    some = range(0, min(counts), max(1, min(counts) // 20))
    worst = max(float((_layer(ours, k) != _layer(theirs, k)).mean()) for k in some)
    return require(worst < 0.01, f"{counts[0]} and {counts[1]} layers, at most {worst:.1%} of the pixels differ")
