"""Contract tests, for authors of plugins. Subclass one class per stage, and pytest does the rest:

    from magiclens.testing import ExporterContract

    class TestMine(ExporterContract):
        stage = Mine()

The tests check what runs rely on: equal seeds give equal artifacts, inputs are not changed, and artifacts have the
shapes and units that ``magiclens.contract.stages`` promises. A subclass may set ``scenes`` to other scenes than the
usual two, and tolerances to other numbers than the usual ones.
"""

from magiclens.testing.annealer import AnnealerContract
from magiclens.testing.art import ArtContract
from magiclens.testing.encoder import EncoderContract
from magiclens.testing.executor import ExecutorContract
from magiclens.testing.exporter import ExporterContract
from magiclens.testing.finisher import FinisherContract
from magiclens.testing.integrator import IntegratorContract
from magiclens.testing.matcher import MatcherContract
from magiclens.testing.renderer import RendererContract
from magiclens.testing.scenario import ScenarioContract
from magiclens.testing.scenes import bumpy_solid, one_view, two_eyes, two_turns
from magiclens.testing.stage import StageContract

__all__ = [
    "AnnealerContract",
    "ArtContract",
    "EncoderContract",
    "ExecutorContract",
    "ExporterContract",
    "FinisherContract",
    "IntegratorContract",
    "MatcherContract",
    "RendererContract",
    "ScenarioContract",
    "StageContract",
    "bumpy_solid",
    "one_view",
    "two_eyes",
    "two_turns",
]
