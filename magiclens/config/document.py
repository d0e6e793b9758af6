"""Reads a YAML file into plain data, and remembers where every key was written: on a line, or in a ``--set``."""

from __future__ import annotations

import datetime
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from magiclens.config.suggest import advice, nearest_choice
from magiclens.config.yaml_limits import MOST_SPEC_BYTES, check_yaml
from magiclens.contract.errors import InputError

Keys = tuple[str | int, ...]
"""The path to a value: mapping keys and list indices from the top, such as ("scenario", "targets", 1, "art")."""


@dataclass(frozen=True)
class Override:
    """One ``--set key.path=value``.

    Attributes:
        text: What was given to ``--set``.
        keys: The path to the value, list indices as integers.
    """

    text: str
    keys: Keys

    @property
    def where(self) -> str:
        """The override as errors name it."""
        return f"--set {self.text}"


@dataclass(frozen=True)
class Document:
    """A spec as plain data, and where each part of it was written.

    Attributes:
        name: The file, as the user wrote its path.
        data: Plain dicts, lists and scalars, overrides included.
        lines: The line of every key, counted from 1; empty if the spec was no file.
        overrides: What was laid over the file, in the order in which it was given.
    """

    name: str
    data: dict[str, Any]
    lines: Mapping[Keys, int] = field(default_factory=dict)
    overrides: tuple[Override, ...] = ()

    @property
    def folder(self) -> Path:
        """The folder that paths in the spec are relative to."""
        return Path(self.name).parent

    def where(self, at: Keys) -> str:
        """Where a key was written, as errors say it: ``file:line`` or ``--set ...``.

        A key that was not written counts as written where the innermost mapping around it was. A spec that was no file
        has no lines.
        """
        override = self._override(at)
        if override:
            return override.where
        return f"{self.name}:{self._line(at)}" if self.lines else self.name

    def order(self, at: Keys) -> tuple[int, int]:
        """A sort key that puts keys in the order in which they were written: by line, overrides last."""
        override = self._override(at)
        return (1, self.overrides.index(override)) if override else (0, self._line(at))

    def written(self, at: Keys) -> bool:
        """Whether the user wrote this key, in the file or in an override."""
        return at in self.lines or self._override(at) is not None

    def get(self, at: Keys) -> Any:
        """The value at a path; None if there is none."""
        node: Any = self.data
        for key in at:
            node = child(node, key)
        return node

    def _override(self, at: Keys) -> Override | None:
        # later overrides win, as their values do
        return next((o for o in reversed(self.overrides) if at[: len(o.keys)] == o.keys), None)

    def _line(self, at: Keys) -> int:
        return next((self.lines[at[:n]] for n in range(len(at), 0, -1) if at[:n] in self.lines), 1)


def dotted(at: Keys) -> str:
    """Keys as ``--set`` and messages write them: ``scenario.targets.1.art``."""
    return ".".join(str(key) for key in at)


def read_document(path: str | Path, overrides: Iterable[str] = ()) -> Document:
    """Read a YAML spec and lay overrides over it.

    Args:
        path: The file; errors name it as it is written here.
        overrides: Values to change, as text ``key.path=value``; later ones win.

    Raises:
        InputError: The file cannot be read, is not YAML or holds no mapping, or an override names no key.
    """
    name = str(path)
    tree = _parse(_read(Path(path)), name)
    lines: dict[Keys, int] = {(): 1}
    data = _plain(tree, (), lines)
    if not isinstance(data, dict):
        found = "is empty" if data is None else f"holds {_kind(data)} instead of a mapping"
        raise InputError(f"the file {found}; a spec starts with a line such as 'scenario:'", f"{name}:1")
    return Document(name, data, lines, tuple(_apply(data, text) for text in overrides))


def document_of(data: Mapping[str, Any], overrides: Iterable[str] = ()) -> Document:
    """A document of a spec that is a dict already. Tuples become lists; paths in it start at the current folder."""
    copy = _copied(data)  # overrides are laid over it in place
    return Document("spec", copy, {}, tuple(_apply(copy, text) for text in overrides))


def _copied(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _copied(child) for key, child in value.items()}
    if isinstance(value, list | tuple):
        return [_copied(child) for child in value]
    return str(value) if isinstance(value, Path) else value


def _read(path: Path) -> str:
    try:
        with path.open("rb") as file:
            # one more than is allowed, which is then refused: the file may have no end
            return file.read(MOST_SPEC_BYTES + 1).decode("utf-8")
    except FileNotFoundError:
        raise InputError(missing_file(path), str(path)) from None
    except IsADirectoryError:
        raise InputError("this is a folder; name a spec file (.yaml)", str(path)) from None
    except UnicodeDecodeError:
        raise InputError("this is not a text file; a spec is YAML in UTF-8", f"{path}:1") from None
    except OSError as error:
        raise InputError(f"the file cannot be read: {error.strerror}", str(path)) from None


def missing_file(path: Path) -> str:
    """The message about a file that does not exist; it proposes a file with a similar name."""
    near = nearest_choice(path.name, (p.name for p in path.parent.iterdir())) if path.parent.is_dir() else None
    return f"there is no file '{path}'" + (f"; did you mean '{path.parent / near}'?" if near else "")


def _parse(text: str, name: str) -> Any:
    """The round-trip tree of a YAML text, since only that tree knows line numbers."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    try:
        check_yaml(text, name)
        return YAML(typ="rt").load(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line if mark else 0
        raise InputError(_syntax(str(error.problem)), f"{name}:{line + 1}") from None
    except RecursionError:  # the parser calls itself for every level
        raise InputError("this is nested too deeply", f"{name}:1") from None
    except (YAMLError, ValueError) as error:
        line = text.count("\n", 0, getattr(error, "position", 0)) + 1  # of a character that YAML does not allow
        raise InputError(f"this is not YAML: {str(error).splitlines()[0]}", f"{name}:{line}") from None


def _syntax(problem: str) -> str:
    duplicate = re.match(r'found duplicate key "([^"]*)"', problem)
    if duplicate:
        return f"the key '{duplicate[1]}' appears twice in one mapping; keep one of them"
    if r"'\t'" in problem:
        return "a tab indents this line; YAML is indented with spaces"
    return f"this is not YAML: {problem}"


def _plain(node: Any, at: Keys, lines: dict[Keys, int]) -> Any:
    """Plain Python data of a round-trip tree; ``lines`` is filled with the line of every key."""
    if isinstance(node, dict):
        return {str(key): _plain(node[key], _mark(node, key, at, lines), lines) for key in node}
    if isinstance(node, list):
        return [_plain(item, _mark(node, i, at, lines), lines) for i, item in enumerate(node)]
    return _scalar(node)


def _mark(node: Any, key: Any, at: Keys, lines: dict[Keys, int]) -> Keys:
    """The path to a child, whose line is noted; keys that a merge (``<<``) brought in have no line."""
    path = (*at, key if isinstance(node, list) else str(key))
    position = (node.lc.data or {}).get(key)
    if position:
        lines[path] = position[0] + 1  # ruamel counts lines from 0
    return path


def _scalar(node: Any) -> Any:
    from ruamel.yaml.scalarbool import ScalarBoolean

    # ruamel's scalars remember how they were written; pydantic, where it is strict, accepts plain ones only.
    # ScalarBoolean is an int, so it is asked for before int
    if node is None or isinstance(node, bool):
        return node
    if isinstance(node, ScalarBoolean):
        return bool(node)
    for plain in (int, float, str):
        if isinstance(node, plain):
            return plain(node)
    return node.isoformat() if isinstance(node, datetime.date) else str(node)


def _apply(data: dict[str, Any], text: str) -> Override:
    """Lay one ``key.path=value`` over the data, in place."""
    path, equals, value = text.partition("=")
    if not equals or not all(path.split(".")):
        raise InputError("write key.path=value, such as lens.facets=64", f"--set {text}")
    where = f"--set {text}"
    *parents, last = path.strip().split(".")
    node: Any = data
    keys: Keys = ()
    for part in parents:
        keys = (*keys, _index(node, part, keys, where))
        node = _descend(node, keys[-1])
    keys = (*keys, _index(node, last, keys, where))
    # read as YAML, so that 64 is a number and [a, b] a list; its lines are not lines of the file, so they are dropped
    node[keys[-1]] = _plain(_parse(value, where), (), {})
    return Override(text, keys)


def _descend(node: Any, key: str | int) -> Any:
    """The value at a key of a mapping or list. A key that a mapping lacks gets an empty mapping."""
    if isinstance(node, dict) and node.get(str(key)) is None:
        node[key] = {}
    return node[key]


def _index(node: Any, part: str, at: Keys, where: str) -> str | int:
    """The key or list index that ``part`` names in ``node``."""
    if isinstance(node, dict):
        return part
    if not isinstance(node, list):
        raise InputError(f"'{dotted(at)}' is {_kind(node)}, it has no '{part}'", where)
    choices = [str(i) for i in range(len(node))]
    if part not in choices:
        raise InputError(f"'{dotted(at)}' is a list of {len(node)}; {advice(part, choices)}", where)
    return int(part)


def child(node: Any, key: str | int) -> Any:
    """The value at one key or index of a mapping or list; None if there is none."""
    if isinstance(node, dict):
        return node.get(key)
    inside = isinstance(node, list) and isinstance(key, int) and key < len(node)
    return node[key] if inside else None


def _kind(value: object) -> str:
    names = {list: "a list", dict: "a mapping", bool: "true or false", int: "a number", float: "a number"}
    return names.get(type(value), "text")
