"""From ``--set lens.facets=16,32`` to combinations of values."""

from __future__ import annotations

import hashlib
import itertools
import re
from collections.abc import Iterable
from dataclasses import dataclass

from magiclens.contract.errors import InputError

_LONGEST_NAME = 100
"""Most letters of a label in the name of a folder."""


@dataclass(frozen=True)
class Combination:
    """One value for each key that a sweep changes, both as the user wrote them."""

    values: tuple[tuple[str, str], ...]

    @property
    def overrides(self) -> tuple[str, ...]:
        """``key=value`` for each key, as ``load_plan`` takes them."""
        return tuple(f"{key}={value}" for key, value in self.values)

    @property
    def label(self) -> str:
        """The values for people: ``facets=16, window=10%``. Keys are cut to their last parts if these differ."""
        lasts = [key.rpartition(".")[2] for key, _ in self.values]
        keys = lasts if len(set(lasts)) == len(lasts) else [key for key, _ in self.values]
        return ", ".join(f"{key}={value}" for key, (_, value) in zip(keys, self.values, strict=True))

    @property
    def folder(self) -> str:
        """Name of the run folder: the same in every sweep, and different for different combinations."""
        plain = self.label.replace(", ", "_")
        name = re.sub(r"[^A-Za-z0-9._=%+-]+", "-", plain).lstrip(".-")[:_LONGEST_NAME]
        return name if name == plain else f"{name}-{hashlib.sha256(plain.encode()).hexdigest()[:8]}"


def combinations(settings: Iterable[str]) -> list[Combination]:
    """List all combinations of the values of ``key=value,value`` settings; the values of the last key change fastest.

    Raises:
        InputError: A key comes twice, or one of several values is empty.
    """
    choices: dict[str, list[str]] = {}
    for text in settings:
        key, equals, values = text.partition("=")
        key = key.strip()
        if not equals or not key:
            raise InputError("write key=value,value, such as lens.facets=16,32", f"--set {text}")
        if key in choices:
            raise InputError(f"'{key}' is set twice; write all of its values after one --set", f"--set {text}")
        choices[key] = list(dict.fromkeys(split_values(values)))
        if len(choices[key]) > 1 and "" in choices[key]:
            raise InputError("there is nothing between two commas", f"--set {text}")
    if not choices:
        raise InputError("say what to change, such as --set lens.facets=16,32,64", "--set")
    return [Combination(tuple(zip(choices, values, strict=True))) for values in itertools.product(*choices.values())]


def split_values(text: str) -> list[str]:
    """Split a text at its commas, but not within brackets, braces or quotes, which belong to a value as in YAML."""
    parts, depth, quote = [""], 0, ""
    for letter in text:
        if letter == "," and not depth and not quote:
            parts.append("")
            continue
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "'\"" and (depth or not parts[-1].strip()):
            quote = letter
        else:
            depth += (letter in "[{") - (letter in "]}")
        parts[-1] += letter
    return [part.strip() for part in parts]
