"""How much memory and time a run takes, by a small model of its largest parts.

The constants were measured with single and rotating lenses of 8 to 32 facets a side, 8 to 128 micro-facets and windows
of 77 to 333 offsets a side, one part after the other, and those of printed lenses with one of 60 mm. Memory is right
within a factor of two, time within three.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from magiclens.config.document import Keys
from magiclens.config.model import LensSpec
from magiclens.contract.artifacts import Lens
from magiclens.encoding.least_squares import LeastSquaresEncoder
from magiclens.exporting.mesh_files import MeshExporter
from magiclens.integration.poisson import Poisson
from magiclens.matching.dart_throwing import DartThrowing
from magiclens.matching.exhaustive import resolved_scales
from magiclens.matching.options import LatticeOptions, MatchingOptions
from magiclens.plan.compile import Plan
from magiclens.profiles.machines import Printer
from magiclens.rendering.mitsuba import Mitsuba
from magiclens.rendering.tracer import Tracer
from magiclens.rendering.transports import LEAST_RESOLUTION
from magiclens.scenarios.pictures import Circles, Plain, TextSource, pixels_of

_PROGRAM_BYTES = 300e6
"""Python, its libraries and compiled kernels."""
_WIDEST_RASTER = 2200
"""Nodes along the side of a made surface above which ``through_process`` cannot hold it."""


@dataclass(frozen=True)
class Need:
    """What a part of a run needs.

    Attributes:
        name: What it is, such as ``mesh``.
        bytes: Memory that it needs at its peak.
        seconds: Processor time that it needs.
        keys: What it grows with, the strongest first; options of ``step`` by their names, others by their path.
        advice: What makes it smaller.
        at: Where the stage that it belongs to is in the spec.
    """

    name: str
    bytes: float
    seconds: float
    keys: tuple[str, ...]
    advice: str
    at: Keys = ()


@dataclass(frozen=True)
class Estimate:
    """What a run needs.

    Attributes:
        parts: Its largest parts, in the order of the run.
        files: Bytes of each mesh file, without what a tolerance leaves out.
    """

    parts: tuple[Need, ...]
    files: Mapping[str, float] = field(default_factory=dict)

    @property
    def largest(self) -> Need:
        """The part that needs most memory."""
        return max(self.parts, key=lambda part: part.bytes)

    @property
    def longest(self) -> Need:
        """The part that takes most time."""
        return max(self.parts, key=lambda part: part.seconds)

    @property
    def bytes(self) -> float:
        """Memory at the peak: pictures are held all the time, and parts follow one another."""
        return _PROGRAM_BYTES + self.parts[0].bytes + max(part.bytes for part in self.parts[1:])

    @property
    def seconds(self) -> float:
        """Processor time of all parts."""
        return sum(part.seconds for part in self.parts)


def estimate(plan: Plan) -> Estimate:
    """What a run of a plan needs; stages of plugins are not counted."""
    seen = _Seen.of(plan)
    rounds = (plan.spec.pipeline.codesign + 1) * (plan.spec.pipeline.rematch + 1)
    later = (*_matching(plan, seen), *_surface(plan, seen, rounds), *_looking(plan, seen), _asking(plan, seen))
    meshes = (step.stage for step in plan.exporters if isinstance(step.stage, MeshExporter))
    files = {f"lens{mesh.suffix}": 2 * mesh.triangle_bytes * _grid_points(plan.lens) for mesh in meshes}
    return Estimate((_pictures(plan, seen), *later), files)


@dataclass(frozen=True)
class _Seen:
    """The pictures of a plan, by their sizes.

    Attributes:
        side: Pixels along a source.
        channels: Of one picture.
        views: How many there are.
        sources: How many different ones there are.
        eyes: How many different ones there are.
        discs: Random discs in all sources.
    """

    side: int
    channels: int
    views: int
    sources: int
    eyes: int
    discs: float

    @classmethod
    def of(cls, plan: Plan) -> _Seen:
        shots, lens = plan.shots(), plan.lens
        sources = {shot.source_name: shot.source for shot in shots}
        grey = all(_is_grey(source) for source in sources.values()) and not any(shot.target.image for shot in shots)
        return cls(
            pixels_of(lens.source_size_mm),
            1 if grey else 3,
            len(shots),
            len(sources),
            len({tuple(shot.eye_in_lens_frame_mm.round(6)) for shot in shots}),
            sum(s.count(lens.source_size_mm) for s in sources.values() if isinstance(s, Circles)),
        )


def _is_grey(source: Any) -> bool:
    return isinstance(source, Plain | TextSource) or (isinstance(source, Circles) and source.grey)


def _pictures(plan: Plan, seen: _Seen) -> Need:
    painted = 2 if plan.encoder else 1
    held = 16.0 * painted * seen.sources * seen.side**2 * seen.channels + 8e6 * seen.views * seen.channels
    keys = ("scenario.source.radius", "scenario.source.layers", "scenario.source.size", "lens.size")
    return Need("pictures", held + 250 * seen.discs, 2e-5 * seen.discs, keys, "larger discs, or a smaller source")


def _matching(plan: Plan, seen: _Seen) -> Iterator[Need]:
    stage, lens, at = plan.matcher.stage, plan.lens, plan.place(plan.matcher)
    if isinstance(stage, MatchingOptions):
        facets, channels = lens.facets**2, seen.channels * seen.views
        levels = 60.0 * seen.side**2 * (channels if seen.eyes == 1 else seen.channels * seen.sources)
        pools = facets * (200.0 * stage.candidates + 16 * channels * (2 * stage.pixels) ** 2)
        polishing = 2e-5 * facets * min(stage.polish, stage.candidates) * seen.views
        yield Need(
            "matching", levels + pools, polishing, ("lens.facets", "candidates", "lens.size", "scenario.source.size"),
            "fewer facets or candidates, or a smaller source", at,
        )  # fmt: skip
    if isinstance(stage, LatticeOptions):
        window, px = stage.window_on(lens), lens.pitch_mm / stage.pixels
        scales = resolved_scales(stage.scales, px, lens.source_size_mm / seen.side)
        maps = len(scales) if stage.isotropic else 4 * len(scales) ** 2
        trials = lens.facets**2 * (2 * window.half / window.step + 1) ** 2 * maps
        finest = min(window.step, min(scales) * px)
        samples = (lens.source_size_mm / finest) ** 2 * seen.channels * seen.views if seen.eyes == 1 else 0.0
        seconds = 5e-9 * trials * seen.views + 1e-8 * samples * maps
        yield Need(
            "search", 20 * samples, seconds, ("step", "window", "scales", "lens.facets"),
            "a larger step or a smaller window", at,
        )  # fmt: skip
    if isinstance(stage, DartThrowing):
        side = lens.pitch_mm / stage.subdivisions
        near = lens.facets**2 * (2 * stage.reach.mm(lens.source_size_mm) / side + 1) ** 2
        yield Need(
            "dart throwing", 60 * near, 2e-6 * near, ("reach", "subdivisions", "lens.facets"),
            "a smaller reach or fewer subdivisions", at,
        )  # fmt: skip


def _surface(plan: Plan, seen: _Seen, rounds: int) -> Iterator[Need]:
    lens, stage = plan.lens, plan.integrator.stage
    points = _grid_points(lens)
    keys = tuple(
        f"lens.{key}" for key in sorted(("microfacets", "facets"), key=lambda key: -_times_the_usual(lens, key))
    )
    # all steps but Mitsuba hold little besides the mesh, 48 bytes a point: they look at some faces at a time
    path_traced = any(isinstance(renderer.stage, Mitsuba) for renderer in plan.renderers)
    yield Need("mesh", (300 if path_traced else 250) * points, 5e-6 * points, keys, "fewer micro-facets or facets")
    steps = stage.refinement if isinstance(stage, Poisson) and plan.matcher.stage.uses_pictures else 0
    # measured: four views take twice as long as one
    facets_alone = (1e-6 + 4e-7 * steps) * points * math.sqrt(seen.views)
    refining = (steps and _through_process(plan)) or facets_alone
    solving = 0.12e-6 * points * lens.microfacets * rounds
    yield Need(
        "heights", 250 * points, solving + refining, ("refinement", *keys), "fewer micro-facets or steps of refinement",
        plan.place(plan.integrator),
    )  # fmt: skip


def _through_process(plan: Plan) -> float:
    """Processor time of ``refine_through``, by the nodes of its raster; 0 if facets are refined alone."""
    stage = plan.integrator.stage
    process = stage.process if isinstance(stage, Poisson) and plan.lens.cells == "vertical" else None
    side = 1.2 * plan.lens.size_mm / process.finest_mm if process and process.finest_mm else math.inf
    return 4.5e-5 * side**2 if side < _WIDEST_RASTER else 0.0


def _asking(plan: Plan, seen: _Seen) -> Need:
    """What analyses take that trace the lens again: at other places, and as its printer makes it."""
    wanted, machine = plan.spec.report.analyses, plan.fabrication and plan.fabrication.machine
    asked = {name for name in ("tolerances", "as-made", "ray-error") if wanted is None or name in wanted}
    seconds = 0.5 + 1.6 * min(seen.views, 4) if "tolerances" in asked else 0.0
    if isinstance(machine, Printer):
        columns = min(plan.lens.size_mm**2 / math.prod(machine.pixels_mm), 4e7)
        seconds += 8e-7 * columns * (("as-made" in asked) + 1.5 * ("ray-error" in asked))
    return Need("analyses", 0.0, seconds, ("report.analyses",), "fewer analyses")


def _looking(plan: Plan, seen: _Seen) -> Iterator[Need]:
    for renderer in plan.renderers:
        stage = renderer.stage
        if isinstance(stage, Tracer | Mitsuba):
            square = stage.samples**2 if isinstance(stage, Tracer) else stage.samples
            rays = float(stage.resolution**2 * square)
            # views that share an eye share its rays
            tracer = isinstance(stage, Tracer)
            held, seconds = (16 * rays, 3e-7 * seen.eyes) if tracer else (3e3 * stage.resolution**2, 2e-6 * seen.views)
            yield Need(
                f"renderer {stage.type}", held, seconds * rays, ("resolution", "samples"),
                "a lower resolution or fewer samples", plan.place(renderer),
            )  # fmt: skip
    encoder = plan.encoder and plan.encoder.stage
    if plan.encoder or plan.spec.pipeline.rematch:
        pixels = float(max(LEAST_RESOLUTION, plan.lens.facets) ** 2)
        solver = 3e-7 * encoder.iterations * seen.views if isinstance(encoder, LeastSquaresEncoder) else 0.0
        yield Need(
            "matrices", 900 * pixels * seen.eyes, (2e-5 * seen.eyes + solver) * pixels,
            ("pipeline.encoder.iterations", "lens.facets"), "fewer facets or iterations",
        )  # fmt: skip


def _times_the_usual(lens: Lens, key: str) -> float:
    """How far a key of the lens is above its default."""
    return float(getattr(lens, key) / LensSpec.model_fields[key].default)


def _grid_points(lens: Lens) -> float:
    """Vertices of the top of the mesh."""
    return float((lens.facets * (lens.microfacets + 1) + 2) ** 2)
