"""Did you mean."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


def nearest(word: str, choices: Iterable[str]) -> str | None:
    """The choice that looks most like a word, if any does."""
    by_lower = {choice.lower(): choice for choice in choices}
    found = get_close_matches(word.lower(), by_lower, n=1, cutoff=0.55)
    return by_lower[found[0]] if found else None


def unknown(noun: str, word: object, choices: Iterable[str]) -> str:
    """What to say about a word that is none of the choices."""
    return f"unknown {noun} {word!r}; {advice(word, choices)}"


def advice(word: object, choices: Iterable[str]) -> str:
    """``did you mean 'x'?``, or the list of choices when nothing is near."""
    known = sorted(choices)
    best = nearest(str(word), known)
    return f"did you mean {best!r}?" if best else f"choose one of: {', '.join(known) or '(there are none)'}"


def shown(value: object) -> str:
    """A value as a message quotes it."""
    if value is None:
        return "nothing"
    if isinstance(value, dict):
        return "a mapping"
    return "a list" if isinstance(value, list) else repr(value)
