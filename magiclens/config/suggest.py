"""Words for messages about wrong words: what was probably meant, or what there is to choose from."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

_SIMILARITY = 0.55
"""Similarity (``difflib``, 0 to 1) from which a choice is proposed; below it, proposals are more often wrong."""


def nearest_choice(word: str, choices: Iterable[str]) -> str | None:
    """The choice that is spelt most like a word; None if none is similar."""
    by_lower = {choice.lower(): choice for choice in choices}
    found = get_close_matches(word.lower(), by_lower, cutoff=_SIMILARITY)
    return by_lower[found[0]] if found else None


def unknown(noun: str, word: object, choices: Iterable[str]) -> str:
    """The message about a word that is none of the choices. ``noun`` says what it ought to be, such as ``scenario``."""
    return f"unknown {noun} {word!r}; {advice(word, choices)}"


def advice(word: object, choices: Iterable[str]) -> str:
    """``did you mean 'x'?``, or the list of choices if none is similar."""
    known = sorted(choices)
    best = nearest_choice(str(word), known)
    return f"did you mean {best!r}?" if best else f"choose one of: {', '.join(known) or '(there are none)'}"


def quoted(value: object) -> str:
    """A value of a spec as messages quote it; mappings and lists are too long for that, so their kind is named."""
    if value is None:
        return "nothing"
    if isinstance(value, dict):
        return "a mapping"
    return "a list" if isinstance(value, list) else repr(value)
