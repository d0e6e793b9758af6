"""One piece of work that magiclens and others do, timed side by side."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from time import perf_counter
from typing import Any

Work = Callable[[], Any]


@dataclass(frozen=True)
class Comparison:
    """A piece of work, and who does it.

    Attributes:
        topic: What of magiclens is compared.
        task: What is done, and how much of it.
        ours: Does it with magiclens.
        peers: Do the same otherwise, by name.
        agreement: Says, from our result and a peer's, how they agree; raises Disagreement if they do not.
        missing: Peers that are not installed here.
        once: Whether it takes so long that it is done only once, and timed then. Kernels are compiled before.
    """

    topic: str
    task: str
    ours: Work
    peers: Mapping[str, Work]
    agreement: Callable[[Any, Any], str]
    missing: tuple[str, ...] = field(default=())
    once: bool = False


@dataclass(frozen=True)
class Ratio:
    """How long a peer takes, in seconds, and how long we take, for one piece of work."""

    topic: str
    task: str
    peer: str
    ours_s: float
    peer_s: float
    agreement: str

    @property
    def times(self) -> float:
        """How many times as long the peer takes."""
        return self.peer_s / self.ours_s


class Disagreement(AssertionError):
    """A peer has another result, so that its time says nothing."""


def require(close: bool, what: str) -> str:
    """Returns what is said about the agreement. Raises Disagreement unless results are close."""
    if not close:
        raise Disagreement(f"results differ: {what}")
    return what


def measure(comparison: Comparison, repeats: int) -> list[Ratio]:
    """The ratios of one comparison: medians of repeats, in which all take turns, forward and backward.

    All do their work once before, untimed unless that is all they do: kernels are compiled, memory is there, results
    are compared.
    """
    works = {"": comparison.ours, **comparison.peers}
    seconds: dict[str, list[float]] = {name: [] for name in works}

    def timed(name: str) -> Any:
        began = perf_counter()
        result = works[name]()
        seconds[name].append(perf_counter() - began)
        return result

    results = {name: timed(name) for name in works}
    said = {peer: comparison.agreement(results[""], results[peer]) for peer in comparison.peers}
    del results
    if not comparison.once:
        for times in seconds.values():
            times.clear()
        for repeat in range(repeats):
            for name in list(works)[:: -1 if repeat % 2 else 1]:
                timed(name)
    median = {name: statistics.median(times) for name, times in seconds.items()}
    return [
        Ratio(comparison.topic, comparison.task, peer, median[""], median[peer], said[peer])
        for peer in comparison.peers
    ]  # fmt: skip


def installed(*packages: str) -> bool:
    """Whether some packages that peers need are here."""
    return all(find_spec(package) for package in packages)


def table(ratios: Iterable[Ratio]) -> str:
    """The ratios as a table in Markdown."""
    lines = [
        "| what | work | compared with | magiclens | other | other / magiclens | results |",
        "|---|---|---|--:|--:|--:|---|",
    ]
    for r in ratios:
        cells = [r.topic, r.task, r.peer, _time(r.ours_s), _time(r.peer_s), f"**{r.times:.3g}**", r.agreement]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _time(seconds: float) -> str:
    return f"{seconds:.3g} s" if seconds >= 1 else f"{1000 * seconds:.3g} ms"
