"""Who watches a run: nobody, a log, a terminal."""

from __future__ import annotations

import sys
from typing import IO, TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID


class Observer:
    """Base of all observers; this one only passes on what went wrong without stopping the run.

    ``name`` is what is being worked on, such as ``matcher exhaustive``; ``facets`` is on how many facets, 0 if their
    number does not matter.
    """

    def started(self, name: str, facets: int) -> None:
        """Work has begun."""

    def progressed(self, name: str, fraction: float) -> None:
        """A fraction, 0 to 1, of the work is done."""

    def finished(self, name: str, seconds: float) -> None:
        """Work has ended well."""

    def notice(self, text: str) -> None:
        """Something that the user should know, though the run goes on."""
        print(f"note: {text}", file=sys.stderr)

    def stopped(self) -> None:
        """The run has ended, well or not."""


class Lines(Observer):
    """One line of text per finished piece of work, for logs."""

    def __init__(self, stream: IO[str]):
        self._stream = stream
        self._facets = 0

    def started(self, name: str, facets: int) -> None:
        """Remembers how much there is to do."""
        self._facets = facets

    def finished(self, name: str, seconds: float) -> None:
        """Prints name, seconds and rate."""
        line = f"{name:28}{seconds:8.2f} s  {rate(self._facets, seconds)}"
        print(line.rstrip(), file=self._stream, flush=True)


class Bars(Observer):
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
        self._task: TaskID | None = None
        self._facets = 0

    def started(self, name: str, facets: int) -> None:
        """A new bar; it pulses until progress is told."""
        self._bars.start()
        self._task = self._bars.add_task(name, total=None, rate="")
        self._facets = facets

    def progressed(self, name: str, fraction: float) -> None:
        """Moves the bar."""
        if self._task is not None:
            elapsed = self._bars.tasks[-1].elapsed or 0.0
            self._bars.update(self._task, total=1.0, completed=fraction, rate=rate(self._facets * fraction, elapsed))

    def finished(self, name: str, seconds: float) -> None:
        """Fills the bar."""
        if self._task is not None:
            self._bars.update(self._task, total=1.0, completed=1.0, rate=rate(self._facets, seconds))

    def notice(self, text: str) -> None:
        """Prints above the bars."""
        self._bars.console.print(f"note: {text}", markup=False, highlight=False)

    def stopped(self) -> None:
        """Leaves the bars as they are."""
        self._bars.stop()


def watching(stream: IO[str]) -> Observer:
    """Bars on a terminal, lines elsewhere."""
    return Bars(stream) if stream.isatty() else Lines(stream)


def rate(facets: float, seconds: float) -> str:
    """Facets per second as text, nothing if it was too quick to tell."""
    return f"{facets / seconds:,.0f} facets/s" if facets and seconds > 0.01 else ""
