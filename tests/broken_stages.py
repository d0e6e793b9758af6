"""Stages that each break one clause of their contract; ``test_contracts.py`` checks that the contract's tests fail."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydantic import field_serializer

from magiclens.annealing.metropolis import Metropolis
from magiclens.config.model import Viewer
from magiclens.contract.artifacts import (
    Assignment,
    Candidates,
    FloatArray,
    HeightField,
    Lens,
    Scene,
    Solid,
    Transport,
    View,
)
from magiclens.contract.stages import Encoder, Progress, silent
from magiclens.exporting.mesh_files import Stl
from magiclens.images import resize
from magiclens.integration.poisson import Poisson
from magiclens.matching.exhaustive import Exhaustive
from magiclens.meshing.pymeshlab import Pymeshlab
from magiclens.rendering.tracer import Tracer
from magiclens.scenarios.single import Single
from magiclens.testing import (
    AnnealerContract,
    ArtContract,
    EncoderContract,
    ExporterContract,
    FinisherContract,
    IntegratorContract,
    MatcherContract,
    RendererContract,
    ScenarioContract,
    one_view,
)

EXPECTED: dict[str, str] = {}
"""The test that must fail, by the name of a test class below."""


def must_fail(test: str) -> Callable[[type], type]:
    """Note which test a contract class must fail; one scene is enough."""

    def note(cls: type) -> type:
        EXPECTED[cls.__name__] = f"test_{test}"
        cls.scenes = (one_view,)  # type: ignore[attr-defined]
        return cls

    return note


class Matching(Exhaustive):
    """A good matcher whose candidates are spoilt before they are returned."""

    spoil: ClassVar[Callable[[Candidates], Candidates]]

    def match(self, scene: Scene, rng: np.random.Generator, progress: Progress = silent) -> Candidates:
        return type(self).spoil(super().match(scene, rng, progress))


def matcher(spoil: Callable[[Candidates], Candidates]) -> Matching:
    cls = type("Spoilt", (Matching,), {"spoil": staticmethod(spoil), "__module__": __name__})
    return cls(candidates=4, polish=0)  # type: ignore[no-any-return]


@must_fail("equal_seeds_give_equal_artifacts")
class TestMatcherOfItsOwnLuck(MatcherContract):
    stage = matcher(lambda c: replace(c, errors=c.errors + np.float32(random.random())))


@must_fail("its_artifact_is_valid")
class TestMatcherOfNothing(MatcherContract):
    stage = matcher(lambda c: replace(c, errors=np.full_like(c.errors, np.nan)))


@must_fail("its_artifact_is_valid")
class TestMatcherOfAnotherShape(MatcherContract):
    stage = matcher(lambda c: replace(c, offsets_mm=c.offsets_mm[..., :1]))


@must_fail("its_artifact_is_valid")
class TestMatcherWithWordsForMetrics(MatcherContract):
    stage = matcher(lambda c: replace(c, metrics={"mood": "good"}))  # type: ignore[dict-item]


@must_fail("the_best_candidate_comes_first")
class TestMatcherWorstFirst(MatcherContract):
    stage = matcher(
        lambda c: Candidates(c.offsets_mm[:, :, ::-1].copy(), c.maps[:, :, ::-1].copy(), c.errors[:, :, ::-1].copy())
    )


@must_fail("patches_lie_on_the_source")
class TestMatcherInMicrometres(MatcherContract):
    stage = matcher(lambda c: replace(c, offsets_mm=c.offsets_mm * 1000))


@must_fail("no_candidate_needs_a_slope_beyond_the_limit")
class TestMatcherBeyondRefraction(MatcherContract):
    stage = matcher(lambda c: replace(c, offsets_mm=np.sign(c.offsets_mm) * np.float32(11)))


@must_fail("candidates_are_as_good_as_their_errors_say")
class TestMatcherUpsideDown(MatcherContract):
    stage = matcher(lambda c: replace(c, offsets_mm=c.offsets_mm * np.float32([1, -1])))


@must_fail("candidates_are_as_good_as_their_errors_say")
class TestMatcherThatBoasts(MatcherContract):
    stage = matcher(lambda c: replace(c, errors=c.errors / 10))


@must_fail("best_candidates_show_the_target_better_than_a_flat_lens")
class TestMatcherThatLooksAway(MatcherContract):
    stage = matcher(lambda c: replace(c, offsets_mm=0 * c.offsets_mm, maps=c.maps * 0 + np.float32([1.5, 0, 1.5])))


class Selfish(Exhaustive):
    """Paints over the source it was given."""

    def match(self, scene: Scene, rng: np.random.Generator, progress: Progress = silent) -> Candidates:
        found = super().match(scene, rng, progress)
        source = scene.views[0].source
        source.flags.writeable = True
        source[0] = 0.5
        return found


@must_fail("inputs_stay_as_they_are")
class TestSelfishMatcher(MatcherContract):
    stage = Selfish(candidates=4, polish=0)


class Forgetful(Exhaustive):
    """Rematches without maps."""

    def rematch(self, scene: Scene, candidates: Candidates, *_: Any) -> Candidates:
        return replace(candidates, maps=candidates.maps[..., :2])


@must_fail("rematching_gives_valid_candidates_and_changes_no_input")
class TestForgetfulMatcher(MatcherContract):
    stage = Forgetful(candidates=4, polish=0)


class Backward(Exhaustive):
    """Its progress falls."""

    def match(self, scene: Scene, rng: np.random.Generator, progress: Progress = silent) -> Candidates:
        progress(0.7)
        progress(0.2)
        return super().match(scene, rng)


@must_fail("progress_is_told_in_fractions_that_grow")
class TestBackwardMatcher(MatcherContract):
    stage = Backward(candidates=4, polish=0)


class Rounding(Exhaustive):
    """What it writes to a spec is not what it is."""

    @field_serializer("acceptance")
    def _short(self, value: float) -> float:
        return round(value, 1)


@must_fail("its_options_can_be_written_to_a_spec_and_read_again")
class TestRoundingMatcher(MatcherContract):
    stage = Rounding(candidates=4, polish=0, acceptance=0.07)


class Nameless(Exhaustive):
    """A spec could not pick it."""

    type: ClassVar[Any] = 3


@must_fail("its_class_is_accepted")
class TestNamelessMatcher(MatcherContract):
    stage = Nameless(candidates=4, polish=0)


class Annealing(Metropolis):
    """A good annealer whose assignment is spoilt before it is returned."""

    spoil: ClassVar[Callable[[Candidates, Assignment], Assignment]]

    def anneal(
        self, scene: Scene, candidates: Candidates, rng: np.random.Generator, progress: Progress = silent
    ) -> Assignment:
        return type(self).spoil(candidates, super().anneal(scene, candidates, rng, progress))


def annealer(spoil: Callable[[Candidates, Assignment], Assignment]) -> Annealing:
    cls = type("Spoilt", (Annealing,), {"spoil": staticmethod(spoil), "__module__": __name__})
    return cls(rounds=3)  # type: ignore[no-any-return]


def picked(candidates: Candidates, choice: Any, found: Assignment) -> Assignment:
    return Assignment.pick(candidates, np.broadcast_to(choice, found.choice.shape), dict(found.metrics))


@must_fail("the_energy_is_never_worse")
class TestAnnealerUphill(AnnealerContract):
    stage = annealer(lambda _, a: replace(a, metrics={"energy_before": 1.0, "energy_after": 1.1}))


@must_fail("the_energy_is_never_worse")
class TestAnnealerWithoutEnergy(AnnealerContract):
    stage = annealer(lambda _, a: replace(a, metrics={}))


@must_fail("what_is_assigned_is_what_was_chosen")
class TestAnnealerOfItsOwnOffsets(AnnealerContract):
    stage = annealer(lambda _, a: replace(a, offsets_mm=a.offsets_mm + 1))


@must_fail("its_artifact_is_valid")
class TestAnnealerOfMissingCandidates(AnnealerContract):
    stage = annealer(lambda c, a: picked(c, c.errors.shape[-1] - 1, a))


@must_fail("a_single_candidate_is_chosen")
class TestAnnealerOfTheSecond(AnnealerContract):
    stage = annealer(lambda c, a: picked(c, np.isfinite(c.errors).sum(axis=-1) - 2, a))


class Building(Poisson):
    """A good integrator whose heights are spoilt before they are returned."""

    spoil: ClassVar[Callable[[FloatArray], FloatArray]]

    def integrate(self, scene: Scene, assignment: Assignment, progress: Progress = silent) -> HeightField:
        built = super().integrate(scene, assignment, progress)
        return replace(built, heights_mm=type(self).spoil(built.heights_mm))


def spoilt(cls: type[Poisson], spoil: Callable[[FloatArray], FloatArray], **options: int) -> Poisson:
    made = type("Spoilt", (cls,), {"spoil": staticmethod(spoil), "__module__": __name__})
    return made(**options)  # type: ignore[no-any-return]


def integrator(spoil: Callable[[FloatArray], FloatArray]) -> Poisson:
    return spoilt(Building, spoil)


@must_fail("its_artifact_is_valid")
class TestIntegratorOfNothing(IntegratorContract):
    stage = integrator(lambda h: h * np.nan)


@must_fail("the_surface_stays_within_its_relief")
class TestIntegratorTooTall(IntegratorContract):
    stage = integrator(lambda h: h + 2.5)


@must_fail("no_micro_facet_is_steeper_than_the_limit")
class TestIntegratorTooSteep(IntegratorContract):
    stage = integrator(lambda h: np.clip(h + 1.5 * (np.indices(h.shape)[3] % 2), -2, 2))


@must_fail("facets_show_their_patches")
class TestIntegratorUpsideDown(IntegratorContract):
    stage = integrator(lambda h: h[:, :, ::-1].copy())


class Refining(Poisson):
    """A good integrator whose refined heights are spoilt before they are returned."""

    spoil: ClassVar[Callable[[FloatArray], FloatArray]]

    def refine(self, scene: Scene, built: HeightField, progress: Progress = silent) -> HeightField:
        refined = super().refine(scene, built, progress)
        return replace(refined, heights_mm=type(self).spoil(refined.heights_mm))


def refiner(spoil: Callable[[FloatArray], FloatArray]) -> Poisson:
    return spoilt(Refining, spoil, refinement=1)


@must_fail("refining_keeps_the_limits")
class TestRefinerOfNothing(IntegratorContract):
    stage = refiner(lambda h: h * np.nan)


@must_fail("refining_keeps_the_limits")
class TestRefinerOfHalfALens(IntegratorContract):
    stage = refiner(lambda h: h[:2].copy())


@must_fail("refining_keeps_the_limits")
class TestRefinerTooTall(IntegratorContract):
    stage = refiner(lambda h: h + 2.5)


@must_fail("refining_keeps_the_limits")
class TestRefinerTooSteep(IntegratorContract):
    stage = refiner(lambda h: np.clip(h + 1.5 * (np.indices(h.shape)[3] % 2), -2, 2))


@must_fail("refining_twice_gives_the_same")
class TestRefinerOfItsOwnLuck(IntegratorContract):
    stage = refiner(lambda h: h + 1e-3 * random.random())


class Careless(Poisson):
    """Refines in place."""

    def refine(self, scene: Scene, built: HeightField, progress: Progress = silent) -> HeightField:
        built.heights_mm.flags.writeable = True
        built.heights_mm[:] *= 0.99
        return built


@must_fail("refining_changes_no_input")
class TestCarelessRefiner(IntegratorContract):
    stage = Careless()


class Returning(Poisson):
    """Starts again in the middle."""

    def refine(self, scene: Scene, built: HeightField, progress: Progress = silent) -> HeightField:
        progress(0.7)
        return super().refine(scene, built, progress)


@must_fail("refining_tells_its_progress_in_fractions_that_grow")
class TestReturningRefiner(IntegratorContract):
    stage = Returning(refinement=1)


class Finishing(Pymeshlab):
    """A good finisher whose solid is spoilt before it is returned."""

    spoil: ClassVar[Callable[[Solid], Solid]]

    def finish(self, scene: Scene, solid: Solid, progress: Progress = silent) -> Solid:
        return type(self).spoil(super().finish(scene, solid, progress))


def finisher(spoil: Callable[[Solid], Solid]) -> Finishing:
    cls = type("Spoilt", (Finishing,), {"spoil": staticmethod(spoil), "__module__": __name__})
    return cls(check=False)  # type: ignore[no-any-return]


@must_fail("the_solid_is_closed")
class TestFinisherWithAHole(FinisherContract):
    stage = finisher(lambda s: replace(s, faces=s.faces[1:].copy()))


@must_fail("it_is_as_large_as_before")
class TestFinisherThatGrows(FinisherContract):
    stage = finisher(lambda s: replace(s, vertices=s.vertices * 1.01))


@must_fail("it_shows_the_same")
class TestFinisherThatFlattens(FinisherContract):
    stage = finisher(
        lambda s: replace(s, vertices=np.where(s.vertices[:, 2:] > 10, s.vertices * (1, 1, 0) + (0, 0, 20), s.vertices))
    )


class Painting(Encoder):
    """Changes views by a function."""

    type: ClassVar[str] = "painting"
    change: ClassVar[Callable[[View], View]]

    def encode(
        self, scene: Scene, transports: Sequence[Transport], rng: np.random.Generator, progress: Progress = silent
    ) -> Scene:
        return replace(scene, views=tuple(type(self).change(view) for view in scene.views))


def encoder(change: Callable[[View], View]) -> Painting:
    cls = type("Spoilt", (Painting,), {"change": staticmethod(change), "__module__": __name__})
    return cls()  # type: ignore[no-any-return]


@must_fail("reserved_pixels_stay_as_they_are")
class TestEncoderOverEverything(EncoderContract):
    stage = encoder(lambda v: replace(v, source=np.full_like(v.source, 0.5)))


@must_fail("its_artifact_is_valid")
class TestEncoderOfOtherTargets(EncoderContract):
    stage = encoder(lambda v: replace(v, target=v.target[::-1].copy()))


@must_fail("its_artifact_is_valid")
class TestEncoderBeyondWhite(EncoderContract):
    stage = encoder(lambda v: replace(v, source=v.source * 2))


class Contrary(Encoder):
    """Paints dark what shall be seen bright, but for what is reserved."""

    type: ClassVar[str] = "contrary"

    def encode(
        self, scene: Scene, transports: Sequence[Transport], rng: np.random.Generator, progress: Progress = silent
    ) -> Scene:
        assert scene.reserved is not None
        (view,), (seen,) = scene.views, transports
        wanted = resize(view.target, seen.shape)
        bright = (seen.matrix.T @ (wanted - wanted.mean()).reshape(-1, 1)).reshape(view.source.shape) > 0
        source = np.where(scene.reserved[..., None], view.source, np.where(bright, 0, 1)).astype(np.float32)
        return replace(scene, views=(replace(view, source=source),))


@must_fail("the_lens_shows_its_targets_no_worse")
class TestContraryEncoder(EncoderContract):
    stage = Contrary()


class Exporting(Stl):
    """A good exporter of a spoilt solid; then it may do more."""

    spoil: ClassVar[Callable[[Solid], Solid]]
    more: ClassVar[Callable[[Path], None]]

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        super().export(scene, type(self).spoil(solid), path)
        type(self).more(path)


def exporter(
    spoil: Callable[[Solid], Solid] = lambda s: s, more: Callable[[Path], object] = lambda path: None
) -> Exporting:
    methods = {"spoil": staticmethod(spoil), "more": staticmethod(more), "__module__": __name__}
    return type("Spoilt", (Exporting,), methods)()  # type: ignore[no-any-return]


@must_fail("equal_seeds_give_equal_artifacts")
class TestExporterWithADate(ExporterContract):
    stage = exporter(more=lambda p: p.with_suffix(".txt").write_text(time.strftime("%F", time.localtime(time.time()))))


@must_fail("its_artifact_is_valid")
class TestExporterOfNothing(ExporterContract):
    stage = exporter(more=lambda p: p.unlink())


@must_fail("its_artifact_is_valid")
class TestExporterThatLitters(ExporterContract):
    stage = exporter(more=lambda p: p.with_name("notes.txt").write_text("hello"))


@must_fail("a_mesh_in_the_file_is_closed")
class TestExporterOfAHole(ExporterContract):
    stage = exporter(lambda s: replace(s, faces=s.faces[1:].copy()))


@must_fail("a_mesh_in_the_file_is_as_large_as_the_solid")
class TestExporterInInches(ExporterContract):
    stage = exporter(lambda s: replace(s, vertices=s.vertices / 25.4))


class Rendering(Tracer):
    """A good renderer whose pictures are spoilt before they are returned."""

    spoil: ClassVar[Callable[[FloatArray], FloatArray]]

    def render(self, scene: Scene, solid: Solid, progress: Progress = silent) -> list[FloatArray]:
        return [type(self).spoil(picture) for picture in super().render(scene, solid, progress)]


def renderer(spoil: Callable[[FloatArray], FloatArray]) -> Rendering:
    cls = type("Spoilt", (Rendering,), {"spoil": staticmethod(spoil), "__module__": __name__})
    return cls(resolution=96)  # type: ignore[no-any-return]


@must_fail("its_artifact_is_valid")
class TestRendererOfHalfAPicture(RendererContract):
    stage = renderer(lambda p: p[:48].copy())


@must_fail("light_is_never_negative")
class TestRendererOfDarkness(RendererContract):
    stage = renderer(lambda p: p - 0.01)


@must_fail("it_agrees_with_the_built_in_tracer")
class TestRendererUpsideDown(RendererContract):
    stage = renderer(lambda p: p[::-1].copy())


PICTURES: dict[str, Any] = {"source": {"type": "circles", "seed": 7}, "target": {"art": "bat"}}


class Doubled(Single):
    """Two views of one name."""

    def shots(self, lens: Lens, viewer: Viewer) -> Any:
        return super().shots(lens, viewer) * 2


@must_fail("views_have_names_of_their_own_and_an_eye_above_the_lens")
class TestDoubledScenario(ScenarioContract):
    scenario = Doubled(**PICTURES)


class Glaring(Single):
    """Its targets are brighter than white."""

    def make_views(self, lens: Lens, viewer: Viewer, art: Mapping[str, Any]) -> Any:
        return tuple(replace(view, target=view.target * 2) for view in super().make_views(lens, viewer, art))


@must_fail("pictures_are_light_of_the_same_channels_and_the_same_each_time")
class TestGlaringScenario(ScenarioContract):
    scenario = Glaring(**PICTURES)


@must_fail("it_is_light_of_the_size_that_was_asked_for")
class TestArtOfOneSize(ArtContract):
    draw = staticmethod(lambda size: np.ones((64, 64, 1), np.float32))


@must_fail("it_is_drawn_the_same_each_time")
class TestArtOfChance(ArtContract):
    draw = staticmethod(lambda size: np.full((size, size, 1), random.random(), np.float32))
