"""Which steps of a plan a run would do, and why, found out without doing any of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NoReturn, TypeVar, cast

from magiclens.cache.store import Cache, Entry
from magiclens.plan.compile import Plan
from magiclens.running.answers import Questions
from magiclens.running.ingredients import Kept, MadeOf, generator_in, key_of, of_run
from magiclens.running.making import export_lens, make_lens
from magiclens.running.observers import Observer
from magiclens.running.steps import Draws, Steps

_T = TypeVar("_T")

_MOST_REASONS = 3
"""Most differences of one step that are told."""
_KEY_LENGTH = 64
"""Letters of a key: an input of this length is the result of another step."""


@dataclass(frozen=True)
class Expected:
    """What is expected of one step.

    Attributes:
        step: Its name, as observers are told it.
        kept: Whether its result is in the cache, so that it need not be done.
        why: Reasons for doing it: what differs from the most similar result that is kept.
    """

    step: str
    kept: bool
    why: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{'kept' if self.kept else 'runs'}  {self.step:28}{'; '.join(self.why)}".rstrip()


def forecast(plan: Plan, cache: Cache | None) -> list[Expected]:
    """What a run of a plan would do, in the order of its steps.

    Pictures of the spec are made for that, but no stage is called. Where it depends on a result that is not there how
    the run goes on, the longer way is expected.

    Raises:
        InputError: The pictures cannot be made.
    """
    steps = _Forecast(plan, cache)
    if cache is None:
        return [Expected(step.name, False, ("nothing is kept: the cache is off",)) for step in plan.steps]
    drafts = make_lens(plan, steps.known(plan.scene()), Path(), steps)
    export_lens(plan, drafts, Path(), steps)
    Questions(plan, drafts, Path(), steps).analyse()
    return steps.expected


def whole_run_kept(plan: Plan, cache: Cache) -> bool:
    """Whether all files of a run are in the cache, so that it would do nothing but copy them."""
    made_of = of_run(plan)
    entry = cache.find(key_of(made_of)) if made_of else None
    return entry is not None and cache.has_files(entry)


class _Unknown(Exception):
    """A result is asked for that is not there."""


class _Forecast(Steps):
    """Steps that are looked up and never done."""

    def __init__(self, plan: Plan, cache: Cache | None):
        super().__init__(plan, Observer(), cache)
        self.expected: list[Expected] = []

    @cached_property
    def _entries(self) -> list[Entry]:
        """All results that are kept, those used last first."""
        return list(self.cache.entries()) if self.cache else []

    def files(
        self, name: str, made_of: MadeOf | None, folder: Path, work: Callable[[Path], _T], shown: bool = True
    ) -> _T:
        """Look up whether the files are there."""
        if shown:
            self._look_up(name, made_of)
        return cast(_T, None)

    def holds(self, question: Callable[[], bool]) -> bool:
        """The answer, or True where results are missing: then more steps follow."""
        try:
            return question()
        except _Unknown:
            return True

    def _made(
        self,
        name: str,
        made_of: MadeOf | None,
        inputs: Mapping[str, Kept[Any]],
        work: Callable[..., Any],
        draws: Draws | None = None,
    ) -> Kept[Any]:
        entry = self._look_up(name, made_of)
        if entry is None or self.cache is None:
            return Kept(made_of and key_of(made_of), _raise_unknown)
        if draws and entry.rng:
            draws.rng = generator_in(entry.rng)
        return Kept(entry.key, partial(self.cache.value, entry))

    def _look_up(self, name: str, made_of: MadeOf | None) -> Entry | None:
        if made_of is None:
            self.expected.append(Expected(name, False, ("its results, or those it is made from, are never kept",)))
            return None
        assert self.cache is not None
        entry = self.cache.find(key_of(made_of))
        there = entry is not None and self.cache.has_files(entry)
        why = () if there else tuple(_reasons(made_of, self._entries))
        self.expected.append(Expected(name, there, why))
        return entry if there else None


def _raise_unknown() -> NoReturn:
    raise _Unknown


def _reasons(made_of: MadeOf, entries: Iterable[Entry]) -> list[str]:
    """What differs from the most similar result of the same step; of equally similar ones the latest counts."""
    new = dict(_flat(made_of))
    found = [dict(_flat(entry.made_of)) for entry in entries if entry.made_of["step"] == made_of["step"]]
    if not found:
        return ["nothing of it is kept yet"]
    differences = [[key for key in {**old, **new} if old.get(key) != new.get(key)] for old in found]
    least = min(range(len(found)), key=lambda k: len(differences[k]))
    told = dict.fromkeys(_reason(key, found[least].get(key), new.get(key)) for key in differences[least])
    more = [f"and {len(told) - _MOST_REASONS} more"] if len(told) > _MOST_REASONS else []
    return [*list(told)[:_MOST_REASONS], *more] or ["its files have been removed to make room"]


def _flat(data: Any, at: str = "") -> Iterator[tuple[str, Any]]:
    """Values of nested JSON data by their path."""
    parts: Iterable[tuple[Any, Any]] = ()
    if isinstance(data, dict):
        parts = data.items()
    elif isinstance(data, list):
        parts = enumerate(data)
    else:
        yield at, data
    for key, each in parts:
        yield from _flat(each, f"{at}.{key}" if at else str(key))


def _reason(path: str, old: Any, new: Any) -> str:
    """One difference in words."""
    part, _, rest = path.partition(".")
    if part == "sources":
        return f"the code of {rest} has changed"
    if part == "processor":
        return "another processor"
    if part == "rng":
        return f"seed: {old} -> {new}" if rest == "entropy" else "the seed, or what was drawn before, differs"
    name = rest if part in ("options", "packages", "inputs") else path
    # what a result in between was made of, such as the mesh of heights; and a plan is what the spec says
    name = name.rpartition(".inputs.")[2].removeprefix("plan.")
    if any(isinstance(value, str) and _is_content(value) for value in (old, new)):
        return f"{name} is another one"
    return f"{name}: {_text(old)} -> {_text(new)}"


def _is_content(value: str) -> bool:
    """Whether a text is a hash: the key of a result, or the content of an array or a file."""
    return value.startswith("array ") or (len(value) == _KEY_LENGTH and set(value) <= set("0123456789abcdef"))


def _text(value: Any) -> str:
    return "nothing" if value is None else str(value)
