"""YAML that would take a machine's time or memory, or fail without a line, is refused at once and names its line."""

from __future__ import annotations

import resource
import time
from pathlib import Path

import pytest

from magiclens.config.document import read_document
from magiclens.config.yaml_limits import MOST_DIGITS, MOST_LEVELS, MOST_LINES, MOST_SPEC_BYTES
from magiclens.contract.errors import InputError


def aliases(levels: int, first: str, line: str) -> str:
    """Each line repeats the one above nine times."""
    lines = [f"a{k}: &a{k} {line.format(*[f'*a{k - 1}'] * 9)}" for k in range(1, levels)]
    return "\n".join([f"a0: &a0 {first}", *lines])


NINE = ", ".join("{}" for _ in range(9))
KEYED = ", ".join(f"k{k}: {{}}" for k in range(9))
BOMBS: dict[str, tuple[str, int]] = {
    "lists of lists": (aliases(10, "[x, x, x, x]", f"[{NINE}]"), 5),
    "mappings of mappings": (aliases(10, "{x: 1}", f"{{{{{KEYED}}}}}"), 5),
    "merges of merges": (aliases(12, "{x: 1}", f"{{{{<<: [{NINE}]}}}}"), 5),
    "a long list": ("a: [" + "1," * 240_000 + "1]", 1),
    "a list that is far too long": ("a: [" + "1," * 2_500_000 + "1]", 1),
    "many keys": ("\n".join(f"a{k}: 1" for k in range(30_000)), 10_000),
    "deep lists": ("name: x\na: " + "[" * 5000 + "]" * 5000, 2),
    "deep mappings": ("\n".join(" " * k + "a:" for k in range(900)), MOST_LEVELS + 1),
    "a merge of itself": ("name: x\na: &a {<<: *a}", 2),
    "a list of itself": ("name: x\na: &a [*a]", 2),
    "an endless integer": ("name: x\na: " + "9" * 5000, 2),
    "an endless hexadecimal": ("name: x\na: 0x" + "f" * 5000, 2),
    "an endless fraction": ("name: x\na: 1." + "0" * 5000, 2),
    "a month that is none": ("name: x\na: 2024-13-45", 2),
    "an hour that is none": ("name: x\na: 2024-01-01 25:00:00", 2),
    "a tag": ("name: x\na: !!float abc", 2),
    "code": ("name: x\na: !!python/object/apply:os.system [x]", 2),
    "bytes": ("name: x\na: !!binary abc", 2),
    "an unknown alias": ("name: x\na: *b", 2),
    "two anchors of one name": ("a: &a 1\nb: &a 2", 2),
    "a character that is none": ("name: x\na: \x00", 2),
    "an end that is missing": ("\n" * MOST_LINES + "a: [", MOST_LINES + 1),
    "empty lines": ("name: x\n" + "\n" * 400_000, MOST_LINES + 1),
    "a tab": ("name: x\n\ta: 1", 2),
    "a key twice": ("a: 1\na: 2", 2),
    "a mapping as key": ("name: x\n{a: 1}: 2", 2),
    "a mapping in a mapping as key": ("name: x\na: {{b: {c: 1}}: 2}", 2),
    "a list as key": ("name: x\n? [1, {a: 2}]\n: 2", 2),
    "an alias as key": ("name: &a {b: 1}\n*a : 2", 2),
}


@pytest.mark.parametrize("kind", BOMBS)
def test_what_a_spec_never_needs_is_refused_at_once_with_its_line(kind: str, tmp_path: Path) -> None:
    text, line = BOMBS[kind]
    path = tmp_path / "spec.yaml"
    path.write_text(text, encoding="utf-8")
    began, before = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError) as raised:
        read_document(path)
    assert time.process_time() - began < 3
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000, "kB"
    where = str(raised.value).removeprefix(f"{path}:").split(":")[0]
    if kind in ("many keys",):
        assert int(where) >= line
    else:
        assert int(where) == line
    assert "\n" not in str(raised.value)


def test_a_file_without_an_end_is_not_read_to_the_end() -> None:
    with pytest.raises(InputError, match=f"longer than {MOST_SPEC_BYTES // 1000} kB|not YAML"):
        read_document("/dev/zero")


@pytest.mark.parametrize("value", ["[[[[1]]]]", "'2024-13-45'", "0x1F", "12e3", "2024-02-29", "x: {<<: {a: 1}}"])
def test_ordinary_values_are_read(value: str, tmp_path: Path) -> None:
    path = tmp_path / "spec.yaml"
    path.write_text(f"first: &first {{a: 1}}\nsecond: *first\nthird:\n  {value}\n", encoding="utf-8")
    assert read_document(path).data["second"] == {"a": 1}


def read(text: str, tmp_path: Path) -> object:
    path = tmp_path / "spec.yaml"
    path.write_text(text, encoding="utf-8")
    return read_document(path).data


def test_the_limits_themselves_are_allowed(tmp_path: Path) -> None:
    """One byte, level or digit more is not."""
    longest = "a: 1\n" + "#" * (MOST_SPEC_BYTES - 5)
    deepest = "a: " + "[" * (MOST_LEVELS - 1) + "]" * (MOST_LEVELS - 1)
    number = "a: " + "9" * MOST_DIGITS
    for text, more in ((longest, "#"), (number, "9")):
        read(text, tmp_path)
        with pytest.raises(InputError):
            read(text + more, tmp_path)
    read(deepest, tmp_path)
    with pytest.raises(InputError, match=":1: this is nested too deeply"):
        read(deepest.replace("[]", "[[]]"), tmp_path)


ALIASES = "a: &a {k: [x, x]}\nb: *a\nc: &c 1\nd: *c\n"
"""The file's mapping, 4 keys, a mapping of 5 (itself, key, list and 2 items) that stands there twice, and 1 twice."""


def test_values_count_as_often_as_aliases_repeat_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("magiclens.config.yaml_limits.MOST_VALUES", 17)
    assert read(ALIASES, tmp_path) == {"a": {"k": ["x", "x"]}, "b": {"k": ["x", "x"]}, "c": 1, "d": 1}
    monkeypatch.setattr("magiclens.config.yaml_limits.MOST_VALUES", 16)
    with pytest.raises(InputError, match=":4: here are more than 16 values"):
        read(ALIASES, tmp_path)


@pytest.mark.parametrize("value", ["'9999-99-99'", "'" + "9" * 500 + "'", "! x", "x" * 500])
def test_text_is_no_number_and_no_date(value: str, tmp_path: Path) -> None:
    assert read(f"a: {value}", tmp_path) == {"a": value.strip("'! ")}
