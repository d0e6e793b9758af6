"""Other people's programs that judge meshes. They are looked for where they are used: without them, tests fail."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import manifold3d
import numpy as np
import trimesh


def prusa_slicer(mesh: Path) -> dict[str, str]:
    """What PrusaSlicer says about a mesh file; it exits with 0 on broken ones, too."""
    said = subprocess.run(["prusa-slicer", "--info", mesh], check=True, capture_output=True, text=True).stdout
    return dict(re.findall(r"^(\w+) = +(\S+)$", said, re.MULTILINE))


def admesh(stl: Path) -> dict[str, int]:
    """What admesh had to repair in an STL file."""
    # its report has bytes of its memory in it, behind the file's name
    said = subprocess.run(["admesh", stl], check=True, capture_output=True).stdout.decode(errors="replace")
    return {name: int(count) for name, count in re.findall(r"^([A-Z][a-z ]+?) *: +(\d+)\s*$", said, re.MULTILINE)}


def volume_of_self_union(stl: Path) -> tuple[float, float]:
    """The volume of a mesh, and that of its union with itself by manifold3d: they differ where it overlaps itself."""
    mesh = trimesh.load_mesh(stl)
    body = manifold3d.Manifold(
        manifold3d.Mesh64(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.uint64))
    )
    assert body.status() == manifold3d.Error.NoError
    return float(mesh.volume), float((body + body).volume())


SOUND = {"manifold", "number_of_parts", "number_of_facets", "volume"}
"""What PrusaSlicer says of a sound mesh, but for its extent; of others it adds what it has repaired."""


def assert_sliceable(mesh: Path) -> dict[str, str]:
    """PrusaSlicer takes the file as it is, as one part; what it says of it."""
    found = prusa_slicer(mesh)
    assert {name for name in found if not name.startswith(("size_", "min_", "max_"))} == SOUND
    assert (found["manifold"], found["number_of_parts"]) == ("yes", "1")
    return found


def assert_accepted(stl: Path) -> None:
    """All three accept the file as it is."""
    assert_sliceable(stl)
    repaired = admesh(stl)
    assert {name: repaired[name] for name in ("Edges fixed", "Facets reversed", "Facets added", "Facets removed")} == {
        "Edges fixed": 0, "Facets reversed": 0, "Facets added": 0, "Facets removed": 0,
    }  # fmt: skip
    volume, union = volume_of_self_union(stl)
    assert abs(union / volume - 1) < 1e-6
