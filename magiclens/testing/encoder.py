"""The contract of encoders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from magiclens.contract.artifacts import Scene, Transport
from magiclens.contract.checks import check_encoded
from magiclens.contract.stages import Encoder, Progress
from magiclens.images import resize, score
from magiclens.testing.scenes import bumpy_solid
from magiclens.testing.stage import StageCall, StageContract

_SOURCE_PX, _PICTURE_PX = 120, 64
"""Sides of the source and of the picture, small so that the test is quick."""

_SAMPLES = 3
"""Rays along a side of a pixel."""

_SLACK_DB = 0.05
"""Loss of PSNR that is accepted, since encoders may round to the 8 bits of files."""


class EncoderContract(StageContract):
    """Checks that reserved pixels stay, and that the lens shows its targets no worse than before."""

    stage: Encoder

    def inputs(self, scene: Scene) -> tuple[Any, ...]:
        """See StageContract. The first rows of the source are reserved."""
        small = {view.source_name: resize(view.source, (_SOURCE_PX, _SOURCE_PX)) for view in scene.views}
        views = tuple(replace(view, source=small[view.source_name]) for view in scene.views)
        reserved = np.zeros((_SOURCE_PX, _SOURCE_PX), np.bool_)
        # a part only, so that there is something left to paint
        reserved[: _SOURCE_PX // 3] = True
        given = replace(scene, views=views, reserved=reserved)
        return given, _transports(given)

    def call(self, inputs: tuple[Any, ...], rng: np.random.Generator, progress: Progress) -> Scene:
        """See StageContract."""
        scene, transports = inputs
        return self.stage.encode(scene, transports, rng, progress)

    def check(self, inputs: tuple[Any, ...], artifact: Any) -> None:
        """See StageContract."""
        check_encoded(inputs[0], artifact)

    def test_the_lens_shows_its_targets_no_worse(self, outcome: StageCall) -> None:
        """The mean PSNR of all views, each after one exposure, does not fall."""
        before, after = (_shown_db(scene, outcome.inputs[1]) for scene in (outcome.inputs[0], outcome.artifact))
        assert after >= before - _SLACK_DB, f"the targets were shown at {before:.2f} dB, and now at {after:.2f} dB"

    def test_reserved_pixels_stay_as_they_are(self, outcome: StageCall) -> None:
        """They are equal bit by bit."""
        for old, new in zip(outcome.inputs[0].views, outcome.artifact.views, strict=True):
            same = new.source[outcome.inputs[0].reserved] == old.source[outcome.inputs[0].reserved]
            assert same.all(), f"{(~same).any(axis=-1).sum()} reserved pixels of {old.source_name} have changed"


def _transports(scene: Scene) -> list[Transport]:
    from magiclens.rendering.transports import transport

    solid = bumpy_solid(scene)
    return [transport(solid, scene.lens, view, _PICTURE_PX, _SAMPLES) for view in scene.views]


def _shown_db(scene: Scene, transports: Sequence[Transport]) -> float:
    pairs = zip(scene.views, transports, strict=True)
    return float(np.mean([score(transport.see(view.source), view.target).psnr_db for view, transport in pairs]))
