"""The results of a sweep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from magiclens.sweep.combine import Combination


@dataclass(frozen=True)
class SweepResult:
    """A combination with the manifest of its run, or with the reason why there is none."""

    combination: Combination
    manifest: Mapping[str, Any] | None
    error: str = ""

    @property
    def outcome(self) -> str:
        """How long the run took, or why it failed."""
        return f"{self.manifest['seconds']:.1f} s" if self.manifest else f"failed: {self.error}"


@dataclass(frozen=True)
class Sweep:
    """A finished sweep: its folder holds a run folder for each combination; ``spec`` is the name of the spec's file."""

    folder: Path
    spec: str
    results: tuple[SweepResult, ...]

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys of the spec that were changed."""
        return tuple(key for key, _ in self.results[0].combination.values)

    @property
    def failed(self) -> bool:
        """Whether some combination has no run."""
        return any(result.manifest is None for result in self.results)
