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
from magiclens.testing.stage import Made, StageContract

SOURCE_PX, SEEN_PX, SAMPLES = 120, 64, 3
SLACK_DB = 0.05


class EncoderContract(StageContract):
    """Sources change where they may, and the lens shows the targets better, not worse."""

    stage: Encoder

    def given(self, scene: Scene) -> tuple[Any, ...]:
        """See StageContract. The first rows of the source are reserved."""
        small = {view.source_name: resize(view.source, (SOURCE_PX, SOURCE_PX)) for view in scene.views}
        views = tuple(replace(view, source=small[view.source_name]) for view in scene.views)
        reserved = np.zeros((SOURCE_PX, SOURCE_PX), np.bool_)
        reserved[: SOURCE_PX // 3] = True
        given = replace(scene, views=views, reserved=reserved)
        return given, _transports(given)

    def work(self, given: tuple[Any, ...], rng: np.random.Generator, progress: Progress) -> Scene:
        """See StageContract."""
        scene, transports = given
        return self.stage.encode(scene, transports, rng, progress)

    def check(self, given: tuple[Any, ...], artifact: Any) -> None:
        """See StageContract."""
        check_encoded(given[0], artifact)

    def test_the_lens_shows_its_targets_no_worse(self, made: Made) -> None:
        """PSNR after one exposure, the mean of all views."""
        before, after = (_shown_db(scene, made.given[1]) for scene in (made.given[0], made.artifact))
        assert after >= before - SLACK_DB, f"the targets were shown at {before:.2f} dB, and now at {after:.2f} dB"

    def test_reserved_pixels_stay_as_they_are(self, made: Made) -> None:
        """Bit for bit."""
        for old, new in zip(made.given[0].views, made.artifact.views, strict=True):
            same = new.source[made.given[0].reserved] == old.source[made.given[0].reserved]
            assert same.all(), f"{(~same).any(axis=-1).sum()} reserved pixels of {old.source_name} have changed"


def _transports(scene: Scene) -> list[Transport]:
    from magiclens.rendering.transports import transport

    solid = bumpy_solid(scene)
    return [transport(solid, scene.lens, view, SEEN_PX, SAMPLES) for view in scene.views]


def _shown_db(scene: Scene, transports: Sequence[Transport]) -> float:
    pairs = zip(scene.views, transports, strict=True)
    return float(np.mean([score(transport.see(view.source), view.target).psnr_db for view, transport in pairs]))
