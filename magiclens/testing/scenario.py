"""The contract of scenarios."""

from __future__ import annotations

import json

import numpy as np

from magiclens.config.model import Viewer
from magiclens.contract.artifacts import Lens
from magiclens.scenarios.base import Scenario
from magiclens.testing.stage import digest

_LENS = Lens(size_mm=20.0, source_size_mm=20.0, facets=4, microfacets=4)
"""The lens that scenarios are asked about: small, since sources have a least number of pixels per millimetre."""


class ScenarioContract:
    """Checks that views have different names, pictures with the same channels, and an eye above the lens.

    Attributes:
        scenario: The scenario to test; a subclass sets it.
    """

    scenario: Scenario

    def test_it_can_be_written_to_a_spec_and_read_again(self) -> None:
        """A run folder's ``spec.yaml`` has every key, and must give the same scenario again."""
        # through JSON, which has the same values as YAML: anything else would not survive in a file
        written = json.loads(json.dumps(self.scenario.model_dump(mode="json", context={"inputs": None})))
        assert type(self.scenario).model_validate(written) == self.scenario, f"read again, {written} is another one"

    def test_views_have_names_of_their_own_and_an_eye_above_the_lens(self) -> None:
        """Eyes are in the world frame, in millimetres."""
        lens, viewer = self.scenario.fitted_lens(_LENS, Viewer()), Viewer()
        shots = self.scenario.shots(lens, viewer)
        assert shots, "there are no views"
        assert len({shot.name for shot in shots}) == len(shots), "two views have the same name"
        assert all(shot.eye_mm[2] > lens.thickness_mm for shot in shots), "an eye is not above the reference plane"
        assert all(shot.rotation_deg % 90 == 0 for shot in shots), "rotations are quarter turns"

    def test_pictures_are_light_of_the_same_channels_and_the_same_each_time(self) -> None:
        """Pictures are (H, W, C), and their light is within 0 to 1."""
        from magiclens.images.art import ART

        lens, viewer = self.scenario.fitted_lens(_LENS, Viewer()), Viewer()
        views = self.scenario.make_views(lens, viewer, ART)
        pictures = [picture for view in views for picture in (view.source, view.target)]
        assert len({picture.shape[2:] for picture in pictures}) == 1, "some pictures have one channel, others three"
        assert pictures[0].shape[2] in (1, 3), f"pictures have {pictures[0].shape[2]} channels instead of 1 or 3"
        assert all(np.isfinite(p).all() and p.min() >= 0 and p.max() <= 1 for p in pictures), "light is within 0 to 1"
        assert digest(views) == digest(self.scenario.make_views(lens, viewer, ART)), "made twice, views differ"
