"""The contract of named pictures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from magiclens.testing.stage import digest


class ArtContract:
    """Checks a named picture: it has any size, is linear light, and is drawn the same each time.

    Attributes:
        draw: The function, as ``staticmethod(function)``; a subclass sets it.
    """

    draw: Callable[[int], Any]

    @pytest.mark.parametrize("size_px", [16, 65, 300])
    def test_it_is_light_of_the_size_that_was_asked_for(self, size_px: int) -> None:
        """Its shape is (size, size, C), C = 1 or 3, and its light is within 0 to 1."""
        picture = np.asarray(self.draw(size_px))
        assert picture.shape in [(size_px, size_px, 1), (size_px, size_px, 3)], f"its shape is {picture.shape}"
        assert np.isfinite(picture).all(), "it has NaN or infinite values"
        assert picture.min() >= 0, "it has negative light"
        assert picture.max() <= 1, "it has light beyond 1"

    def test_it_is_drawn_the_same_each_time(self) -> None:
        """Equal specs give equal runs."""
        assert digest(np.asarray(self.draw(64))) == digest(np.asarray(self.draw(64))), "drawn twice, it differs"
