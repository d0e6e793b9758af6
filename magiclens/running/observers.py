"""Observers show the progress of a run: not at all, as lines of a log, or as bars on a terminal."""

from __future__ import annotations

import sys
from time import perf_counter
from typing import IO, TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID


class Observer:
    """Base of all observers. This one shows no progress; it only prints notices.

    In all methods, ``name`` is the piece of work, such as ``matcher exhaustive``, and ``facets`` the number of facets
    that it works on, 0 if that number does not matter. Two pieces may be under way side by side. Methods may be called
    from several threads, never at the same time.
    """

    def started(self, name: str, facets: int) -> None:
        """A piece of work has begun."""

    def progressed(self, name: str, fraction: float) -> None:
        """A fraction, 0 to 1, of a piece of work is done."""

    def finished(self, name: str, seconds: float) -> None:
        """A piece of work has succeeded."""

    def reused(self, name: str) -> None:
        """A piece of work need not be done: its result is in the cache."""

    def notice(self, text: str) -> None:
        """The user should know this, although the run goes on."""
        print(f"note: {text}", file=sys.stderr)

    def stopped(self) -> None:
        """The run has succeeded or failed."""


class LineObserver(Observer):
    """One line of text per finished piece of work, for logs."""

    def __init__(self, stream: IO[str]):
        self._stream = stream
        self._facets: dict[str, int] = {}

    def started(self, name: str, facets: int) -> None:
        """Remember the number of facets, for the rate."""
        self._facets[name] = facets

    def finished(self, name: str, seconds: float) -> None:
        """Print name, seconds and rate."""
        line = f"{name:28}{seconds:8.2f} s  {_rate(self._facets[name], seconds)}"
        print(line.rstrip(), file=self._stream, flush=True)  # so that a log tells at once how far a run is

    def reused(self, name: str) -> None:
        """Print the name, and where the result comes from."""
        print(f"{name:28}    kept", file=self._stream, flush=True)


class BarObserver(Observer):
    """A progress bar per piece of work, for terminals."""

    def __init__(self, stream: IO[str]):
        from rich.console import Console
        from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn

        self._bars: Progress = Progress(
            SpinnerColumn(finished_text="[green]✓"),
            TextColumn("{task.description:28}"),
            BarColumn(bar_width=24),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[rate]}"),
            console=Console(file=stream),
        )
        self._under_way: dict[str, tuple[TaskID, int, float]] = {}

    def started(self, name: str, facets: int) -> None:
        """Add a bar, which pulses until its fraction is known."""
        self._bars.start()
        self._under_way[name] = self._bars.add_task(name, total=None, rate=""), facets, perf_counter()

    def progressed(self, name: str, fraction: float) -> None:
        """Move the bar, unless the work is over: a stage's threads may still tell of it."""
        if name in self._under_way:
            bar, facets, began = self._under_way[name]
            rate = _rate(facets * fraction, perf_counter() - began)
            self._bars.update(bar, total=1.0, completed=fraction, rate=rate)

    def finished(self, name: str, seconds: float) -> None:
        """Fill the bar."""
        bar, facets, _ = self._under_way.pop(name)
        self._bars.update(bar, total=1.0, completed=1.0, rate=_rate(facets, seconds))

    def reused(self, name: str) -> None:
        """Add a full bar."""
        self._bars.start()
        self._bars.add_task(name, total=1, completed=1, rate="kept")

    def notice(self, text: str) -> None:
        """Print the text above the bars."""
        self._bars.console.print(f"note: {text}", markup=False, highlight=False)

    def stopped(self) -> None:
        """Leave the bars on the terminal as they are."""
        self._bars.stop()


def terminal_observer(stream: IO[str]) -> Observer:
    """An observer that draws bars on a terminal, or prints lines into a file or a pipe."""
    return BarObserver(stream) if stream.isatty() else LineObserver(stream)


def _rate(facets: float, seconds: float) -> str:
    """Facets per second as text; empty below 0.01 s, where the rate would be noise."""
    return f"{facets / seconds:,.0f} facets/s" if facets and seconds > 0.01 else ""
