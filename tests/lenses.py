"""Real lenses, small ones, each designed once, whichever file and process asks for it first.

Sessions share the results of stages as runs of users do: what the sources do not change is not designed again.
"""

from __future__ import annotations

import pickle
import time
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path

import pytest

from magiclens import Run, load_plan
from magiclens.cache.store import Cache
from magiclens.running.pipeline import run_plan

SPECS = Path(__file__).parent.parent / "specs"
SHIPPED = sorted(path.stem for path in SPECS.glob("*.yaml"))
FEW = (
    "lens.size=25mm",
    "lens.facets=8",
    "lens.microfacets=8",
    "pipeline.exporters=[{type: stl}, {type: 3mf}]",
    "pipeline.renderers=[{type: tracer, resolution: 128, samples: 2}]",
    "report.analyses=[]",
)
HEART, HEART_AND_STAR = "scenario.target={art: heart}", "scenario.targets=[{art: heart}, {art: star}]"
MITSUBA_TOO = (
    "pipeline.renderers=[{type: tracer, resolution: 128, samples: 2}, {type: mitsuba, resolution: 128, samples: 64}]"
)
SMALL: dict[str, tuple[str, ...]] = {
    "single": (HEART,),
    "milled": (HEART,),
    "multi-pair": ("scenario.pairs.0.target={art: heart}", "scenario.pairs.1.target={art: star}"),
    "rotating": (
        HEART_AND_STAR,
        "scenario.angles=[0deg, 90deg]",
        MITSUBA_TOO,
        "report.analyses=[ideal-picture, contact-sheet, surface]",
    ),
    "rotating-codesign": (
        HEART_AND_STAR,
        "scenario.angles=[0deg, 90deg]",
        "pipeline.codesign=1",
        "report.analyses=[source-changes]",
    ),
    "multi-view": (
        MITSUBA_TOO,
        "lens.microfacets=12",
        "scenario.source.size=60mm",
        "scenario.views.0.target={art: heart}",
        "scenario.views.1.target={art: star}",
        "report.analyses=[ideal-picture]",
    ),
    "stable-zone": (
        HEART,
        "scenario.source.size=29mm",
        "scenario.cone=3deg",
        "pipeline.renderers=[{type: tracer, resolution: 48, samples: 4}]",
        "report.analyses=[contact-sheet]",
    ),
    "printed-single": (HEART,),
    "printed-lcd": (HEART,),
    "printed-rotating": (HEART_AND_STAR, "scenario.angles=[0deg, 90deg]"),
    "printed-universal": ("lens.microfacets=24",),
    "universal-animation": ("scenario.frames={art: worm, length: 2}", "lens.microfacets=24"),
    "question-answer-universal": ("lens.size=50mm", "lens.facets=16"),
    "question-answer-source-optimized": (),
}
"""By shipped spec: what it has of its own, besides ``FEW``."""
COARSE = {"magiclens.rendering.transports.LEAST_RESOLUTION": 192, "magiclens.analysis.stable_zone.RESOLUTION": 48}
"""Sides of pictures, in pixels, that are enough for small lenses."""
RECIPES = sha256(Path(__file__).read_bytes()).hexdigest()[:16]
"""Another one, once this file says other sizes: the cache does not know of those in ``COARSE``."""
CACHE_BYTES = 10**9
"""How much room results of earlier sessions may take."""
PATIENCE_S = 600
"""How long a process waits for a lens that another one designs."""


@dataclass
class Lenses:
    """Designs lenses into a folder that the session's processes share. Nothing in it may be changed.

    Attributes:
        folder: Where they are.
        cache: What sessions have in common; None designs everything anew.
        known: The lenses that this process has asked for.
    """

    folder: Path
    cache: Cache | None = None
    known: dict[str, Run] = field(default_factory=dict)

    def shipped(self, name: str, *overrides: str) -> Run:
        """The small lens of a shipped spec, or a variant of it."""
        text = (SPECS / f"{name}.yaml").read_text(encoding="utf-8")
        return self.designed(text, *FEW, *SMALL.get(name, ()), *overrides)

    def designed(self, text: str, *overrides: str) -> Run:
        """The lens of a spec."""
        key = sha256(repr((text, overrides)).encode()).hexdigest()[:16]
        if key not in self.known:
            self.known[key] = _shared(self.folder / key, text, overrides, self.cache)
        return self.known[key]


def _shared(folder: Path, text: str, overrides: tuple[str, ...], cache: Cache | None) -> Run:
    """The process that succeeds in making the lens's folder designs it; the others wait for it."""
    kept = folder / "run.pickle"
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        return _awaited(kept)
    try:
        (folder / "spec.yaml").write_text(text, encoding="utf-8")
        with pytest.MonkeyPatch.context() as patch:
            for constant, pixels in COARSE.items():
                patch.setattr(constant, pixels)
            run = run_plan(load_plan(folder / "spec.yaml", overrides), folder / "out", cache=cache)
        run = replace(run, result=replace(run.result, redesign=None))
        (folder / "unfinished").write_bytes(pickle.dumps(run))
    except BaseException:
        (folder / "unfinished").touch()
        raise
    finally:
        (folder / "unfinished").rename(kept)
    return run


def _awaited(kept: Path) -> Run:
    """What another process has kept."""
    end = time.monotonic() + PATIENCE_S
    while not kept.exists():
        assert time.monotonic() < end, f"{kept.parent.name} was not designed in time"
        time.sleep(0.1)
    content = kept.read_bytes()
    assert content, f"{kept.parent.name} could not be designed; see the test that asked for it first"
    run: Run = pickle.loads(content)
    return run
