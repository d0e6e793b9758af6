"""Every built-in stage keeps the contract that plugins are held to, and each contract fails for one that breaks it."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from broken_stages import EXPECTED
from magiclens.annealing.heat_bath import HeatBath
from magiclens.annealing.metropolis import Metropolis
from magiclens.encoding.least_squares import LeastSquaresEncoder
from magiclens.exporting.gltf import Glb
from magiclens.exporting.height_map import HeightMap
from magiclens.exporting.jig import Jig
from magiclens.exporting.mesh_files import Obj, Ply, Stl
from magiclens.exporting.monitor import Monitor
from magiclens.exporting.print_sheet import PrintSheet
from magiclens.exporting.slices import Slices
from magiclens.exporting.three_mf import ThreeMf
from magiclens.images.art import ART
from magiclens.integration.least_squares import LeastSquaresIntegrator
from magiclens.integration.poisson import Poisson
from magiclens.matching.dart_throwing import DartThrowing
from magiclens.matching.exhaustive import Exhaustive
from magiclens.matching.multi_view import MultiViewMatcher
from magiclens.meshing.manifold import ManifoldFinisher
from magiclens.meshing.pymeshlab import Pymeshlab
from magiclens.milling.gcode import Gcode
from magiclens.milling.rml import Rml
from magiclens.rendering.mitsuba import Mitsuba
from magiclens.rendering.tracer import Tracer
from magiclens.scenarios.universal_animation import UniversalAnimation
from magiclens.testing import (
    AnnealerContract,
    ArtContract,
    EncoderContract,
    ExporterContract,
    FinisherContract,
    IntegratorContract,
    MatcherContract,
    RendererContract,
    one_view,
    two_eyes,
    two_turns,
)
from magiclens.testing.exporter import Mesh
from magiclens.testing.scenario import ScenarioContract
from test_exchange_files import mesh_of, read_3mf, vertices_3mf


class TestExhaustive(MatcherContract):
    stage = Exhaustive(candidates=16, polish=8)


class TestMultiView(MatcherContract):
    stage = MultiViewMatcher(candidates=16, polish=8)
    scenes = (one_view, two_eyes)


class TestDartThrowing(MatcherContract):
    stage = DartThrowing(reach="15%")


class TestHeatBath(AnnealerContract):
    stage = HeatBath()
    scenes = (one_view, two_turns, two_eyes)


class TestMetropolis(AnnealerContract):
    stage = Metropolis(rounds=20)


class TestPoisson(IntegratorContract):
    stage = Poisson()
    offset_tolerance_mm = 0.3


class TestLeastSquaresIntegrator(IntegratorContract):
    stage = LeastSquaresIntegrator()


class TestPymeshlab(FinisherContract):
    stage = Pymeshlab()


class TestSmoothing(FinisherContract):
    stage = Pymeshlab(smoothing="1um")


class TestManifold(FinisherContract):
    stage = ManifoldFinisher(self_intersections="always")


class TestEncoding(EncoderContract):
    stage = LeastSquaresEncoder()


class TestStl(ExporterContract):
    stage = Stl()


class TestPly(ExporterContract):
    stage = Ply()


class TestObj(ExporterContract):
    stage = Obj()


class Test3mf(ExporterContract):
    stage = ThreeMf()

    def read_mesh(self, path: Path) -> Mesh | None:
        """By lib3mf; faces of the solid."""
        mesh = mesh_of(read_3mf(path))
        return vertices_3mf(path), np.array([triangle.Indices[:] for triangle in mesh.GetTriangleIndices()])


class TestGlb(ExporterContract):
    stage = Glb()

    def read_mesh(self, path: Path) -> Mesh | None:
        """glTF is in metres, +y up."""
        mesh = super().read_mesh(path)
        assert mesh
        return 1000 * mesh[0] @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]), mesh[1]


class TestJig(ExporterContract):
    stage = Jig()


class TestHeightMap(ExporterContract):
    stage = HeightMap()


class TestSlices(ExporterContract):
    stage = Slices()


class TestGcode(ExporterContract):
    stage = Gcode()


class TestRml(ExporterContract):
    stage = Rml()


class TestSheet(ExporterContract):
    stage = PrintSheet()


class TestMonitor(ExporterContract):
    stage = Monitor(ppi=92)


class TestTracer(RendererContract):
    stage = Tracer(resolution=128)


class TestMitsuba(RendererContract):
    stage = Mitsuba(resolution=96)


class TestUniversalAnimation(ScenarioContract):
    scenario = UniversalAnimation.model_validate({"frames": {"art": "worm", "length": 3}})


class TestPanda(ArtContract):
    draw = staticmethod(ART["panda"])


@pytest.fixture(scope="module")
def outcome() -> dict[str, set[str]]:
    """Those tests of ``broken_stages.py`` that must fail and did, by class."""
    flags = ["-q", "--tb=no", "-rfE", "-p", "no:cacheprovider"]
    asked = [f"{Path(__file__).with_name('broken_stages.py')}::{name}::{test}" for name, test in EXPECTED.items()]
    command = [sys.executable, "-m", "pytest", "-n0", *flags, *asked]
    said = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300).stdout
    failed: dict[str, set[str]] = {name: set() for name in EXPECTED}
    for name, test in re.findall(r"^(?:FAILED|ERROR) \S+::(\w+)::(\w+)", said, re.MULTILINE):
        failed[name].add(test)
    return failed


@pytest.mark.tools
@pytest.mark.parametrize("broken", EXPECTED)
def test_the_contract_fails_for_a_stage_that_breaks_it(broken: str, outcome: dict[str, set[str]]) -> None:
    assert EXPECTED[broken] in outcome[broken]


def test_every_clause_of_every_contract_is_broken_once() -> None:
    contracts = (
        MatcherContract, AnnealerContract, IntegratorContract, FinisherContract, EncoderContract, ExporterContract,
        RendererContract,
    )  # fmt: skip
    clauses = {name for cls in contracts for name in dir(cls) if name.startswith("test_")}
    assert clauses <= set(EXPECTED.values())
