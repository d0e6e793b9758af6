"""Artifacts as plain data: what describes them, and the arrays that a file keeps of them."""

from __future__ import annotations

import hashlib
import json
import operator
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magiclens.contract.artifacts import Assignment, Candidates, HeightField, Lens, Scene, Solid, View

_CLASSES: dict[str, type[Any]] = {
    cls.__name__: cls for cls in (Lens, View, Scene, Candidates, Assignment, HeightField, Solid)
}
_INPUT = "input "
"""How names of arrays begin that an input holds already, so that they are not kept twice."""


class NotPlain(TypeError):
    """A value that is not made of artifacts, arrays, numbers and text, and so cannot be kept."""


def digest_of(document: Any) -> str:
    """SHA-256 of JSON data, the same for every order of keys."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), default=_bare)
    return hashlib.sha256(text.encode()).hexdigest()


def array_digest(array: NDArray[Any]) -> str:
    """SHA-256 of an array: type, shape, order in memory and content."""
    dense, axes = _dense(array)
    found = hashlib.sha256(f"{dense.dtype.str} {dense.shape} {axes}".encode())
    found.update(dense.data if dense.size else b"")
    return found.hexdigest()


def described(value: Any) -> Any:
    """A value as JSON data, with digests in place of arrays: equal descriptions are of equal values.

    Raises:
        NotPlain: It holds something else than artifacts, arrays, numbers and text.
    """
    if isinstance(value, np.ndarray):
        return f"array {array_digest(value)[:32]}"
    if type(value) in _CLASSES.values():
        return {f.name: described(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): described(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        # by name where there are names: then a difference between two descriptions says which view has changed
        names = [getattr(each, "name", None) for each in value]
        if names and all(isinstance(name, str) for name in names) and len(set(names)) == len(names):
            return {f"{k} {each.name}": described(each) for k, each in enumerate(value)}
        return [described(each) for each in value]
    return _bare(value)


def settled(value: Any) -> Any:
    """The value with all arrays as they would be read from a file, so that sums over both are the same.

    Only arrays that are a part or a repetition of others are copied.
    """
    if isinstance(value, np.ndarray):
        return value if _order_in_memory(value) else np.array(value, order="C")
    if type(value) in _CLASSES.values():
        new = {f.name: settled(getattr(value, f.name)) for f in fields(value)}
        return replace(value, **new) if any(new[name] is not getattr(value, name) for name in new) else value
    if type(value) in (list, tuple):
        each = [settled(one) for one in value]
        return value if all(map(operator.is_, each, value)) else type(value)(each)
    return value


def packed(value: Any, inputs: Sequence[Any]) -> tuple[Any, dict[str, NDArray[Any]]]:
    """A value as JSON data and arrays; arrays that are those of inputs are only named.

    Args:
        value: Artifacts, arrays, numbers and text, in lists, tuples and mappings.
        inputs: What the value was made from.

    Returns:
        The data, for ``unpacked``, and the arrays by name.

    Raises:
        NotPlain: It holds something else.
    """
    packer = _Packer({id(array): name for name, array in _arrays_of(dict(enumerate(inputs))).items()})
    return packer.pack(value), packer.arrays


def unpacked(document: Any, arrays: Mapping[str, NDArray[Any]], inputs: Mapping[int, Any]) -> Any:
    """The value that ``packed`` was given; ``inputs`` are those that are ``borrowed``, by their places."""
    known: dict[str, NDArray[Any]] = {}

    def unpack(data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        kind, content = next(iter(data.items()))
        if kind == "array":
            name, axes = content
            if name not in known:  # once, so that views which shared an array still do
                named = arrays[name] if name in arrays else _arrays_of(inputs)[name]
                known[name] = named.transpose(np.argsort(axes)) if axes else named
            return known[name]
        if kind == "list":
            return [unpack(each) for each in content]
        if kind == "tuple":
            return tuple(unpack(each) for each in content)
        if kind == "mapping":
            return {key: unpack(each) for key, each in content}
        return _CLASSES[kind](**{key: unpack(each) for key, each in content.items()})

    return unpack(document)


def borrowed(document: Any) -> set[int]:
    """Which of the inputs ``unpacked`` needs for this data, by their places."""
    if isinstance(document, list):
        return set().union(*map(borrowed, document))
    if not isinstance(document, dict):
        return set()
    name = str(document["array"][0]) if "array" in document else ""
    own = {int(name.removeprefix(_INPUT).partition(".")[0])} if name.startswith(_INPUT) else set()
    return own.union(*map(borrowed, document.values()))


class _Packer:
    """Takes a value apart; see ``packed``."""

    def __init__(self, shared: Mapping[int, str]):
        self.arrays: dict[str, NDArray[Any]] = {}
        self._shared = shared
        self._seen: dict[int, Any] = {}

    def pack(self, value: Any) -> Any:
        """A value as JSON data."""
        if isinstance(value, np.ndarray):
            return {"array": self._array(value)}
        if type(value) in _CLASSES.values():
            return {type(value).__name__: {f.name: self.pack(getattr(value, f.name)) for f in fields(value)}}
        if isinstance(value, Mapping):
            return {"mapping": [[str(key), self.pack(each)] for key, each in value.items()]}
        if isinstance(value, list | tuple):
            return {"list" if isinstance(value, list) else "tuple": [self.pack(each) for each in value]}
        return _bare(value)

    def _array(self, array: NDArray[Any]) -> Any:
        if id(array) in self._shared:
            return [self._shared[id(array)], None]
        if id(array) not in self._seen:
            dense, axes = _dense(array)
            name = f"a{len(self.arrays)}"
            self.arrays[name] = dense
            self._seen[id(array)] = [name, None if axes == sorted(axes) else axes]
        return self._seen[id(array)]


def _dense(array: NDArray[Any]) -> tuple[NDArray[Any], list[int]]:
    """The array with its axes in the order in which they lie in memory, and that order."""
    if array.dtype.hasobject:
        raise NotPlain("an array of objects cannot be kept")
    axes = _order_in_memory(array)
    return (array.transpose(axes), axes) if axes else (np.array(array, order="C"), [*range(array.ndim)])


def _order_in_memory(array: NDArray[Any]) -> list[int]:
    """The order of an array's axes in memory, slowest first; empty if it has gaps or repetitions, or no axes."""
    axes = sorted(range(array.ndim), key=lambda axis: -abs(array.strides[axis]))
    return axes if array.transpose(axes).flags.c_contiguous else []


def _arrays_of(inputs: Mapping[int, Any]) -> dict[str, NDArray[Any]]:
    """All arrays of inputs, by names that tell where they are."""
    found: dict[str, NDArray[Any]] = {}

    def collect(value: Any, name: str) -> None:
        if isinstance(value, np.ndarray):
            found[name] = value
        elif type(value) in _CLASSES.values():
            for f in fields(value):
                collect(getattr(value, f.name), f"{name}.{f.name}")
        elif isinstance(value, list | tuple):
            for k, each in enumerate(value):
                collect(each, f"{name}.{k}")

    for k, each in inputs.items():
        collect(each, f"{_INPUT}{k}")
    return found


def _bare(value: Any) -> Any:
    """A number, a text, a truth value or None, as JSON has them."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Real):
        return float(value)
    raise NotPlain(f"{type(value).__name__} cannot be kept")
