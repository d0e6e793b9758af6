"""What a lens can be asked to show. A scenario is a small function from spec to views; nothing after it knows which."""

from magiclens.scenarios.base import Scenario, Shot

__all__ = ["Scenario", "Shot"]
