"""Scenarios: what a lens is asked to show. Each turns its part of a spec into views; later stages only know views."""

from magiclens.scenarios.base import Scenario, Shot

__all__ = ["Scenario", "Shot"]
