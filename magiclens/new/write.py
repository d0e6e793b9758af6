"""Writes a commented spec for a scenario and a user's pictures."""

from __future__ import annotations

import json
import os
import re
import tempfile
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast, get_args

from magiclens.config.fabrication import listed_machine
from magiclens.config.model import DEFAULT_SIZE
from magiclens.config.suggest import unknown
from magiclens.contract.errors import InputError
from magiclens.contract.units import LENGTH
from magiclens.images import read_image
from magiclens.images.files import check_not_tiny
from magiclens.new.assess import AS_SUITS, Crop, Ground, Treatment, assess
from magiclens.new.layouts import LAYOUTS, ON_MACHINES, SPECIAL, Place, Request
from magiclens.new.palette import inks_for

_COMMENT_WIDTH = 110
"""Largest number of characters in a line of comment."""


@dataclass(frozen=True)
class Making:
    """How a lens is made and used.

    Attributes:
        machine: Name of the machine; None if it is left open.
        size: The lens's side, with its unit.
        place: Where the lens is used.
        facets: How many along a side; None for as many as suit machine and pictures.
        thickness: Its thickness, with its unit; None for what is usual.
        paper: Of the sheet to print, as the exporter ``sheet`` has it.
        jig: Whether to write a jig, too.
    """

    machine: str | None = None
    size: str = DEFAULT_SIZE
    place: str = "table"
    facets: int | None = None
    thickness: str | None = None
    paper: str = "auto"
    jig: bool = False


def new_spec(
    scenario: str,
    pictures: Sequence[Path],
    out: Path,
    source: Path | None = None,
    questions: Sequence[str] = (),
    making: Making = Making(),
    treatment: Treatment = AS_SUITS,
) -> str:
    """Write a spec for a user's pictures.

    Args:
        scenario: Type of the scenario, or the name of a shipped spec: its scenario, for its machine.
        pictures: Files of the pictures that the lens shall show.
        out: The file to write.
        source: File of the source; None for random discs.
        questions: For question-answer, one per picture or none.
        making: How the lens is made and used.
        treatment: What is done to the pictures, besides what suits them.

    Returns:
        The text that was written; ``mlens check`` accepts it.

    Raises:
        InputError: The scenario does not exist or does not take what is given, a picture cannot be read or has no
            contrast, or ``out`` exists already. Nothing is written.
    """
    scenario, usual = ON_MACHINES.get(scenario, (scenario, None))
    making = replace(making, machine=making.machine or usual)
    if scenario in SPECIAL:
        options = f"write it with 'mlens new {SPECIAL[scenario]}' and take the options of specs/{scenario}.yaml"
        raise InputError(f"{scenario} is {SPECIAL[scenario]} with special options: {options}", "SCENARIO")
    if scenario not in LAYOUTS:
        raise InputError(unknown("scenario", scenario, LAYOUTS), "SCENARIO")
    _check_request(scenario, len(pictures), source is not None, len(questions))
    _check_out(out)
    files = _Files(out.parent)
    if source:
        check_not_tiny(read_image(source), source)
    moving = LAYOUTS[scenario].moving
    assessed = tuple((files.path(path), assess(path, treatment, moving)) for path in pictures)
    inks = () if moving else inks_for([found for _, found in assessed])
    below = files.path(source) if source else None
    known = Request(assessed, below, tuple(questions), inks, *_checked(making))
    request = replace(known, facets=making.facets, thickness=making.thickness, paper=making.paper, jig=making.jig)
    text = _text(scenario, request, [path.name for path in pictures], out.name)
    _write(out, text)
    return text


@dataclass(frozen=True)
class _Files:
    """Writes paths as a spec in ``folder`` does."""

    folder: Path

    def path(self, file: Path) -> str:
        """A file's path relative to the folder, in quotes where YAML needs them."""
        try:
            found = Path(os.path.relpath(file.absolute(), self.folder.absolute())).as_posix()
        except ValueError:  # on another drive
            found = file.absolute().as_posix()
        return found if re.fullmatch(r"[A-Za-z_.][\w./-]*", found, re.ASCII) else json.dumps(found, ensure_ascii=False)


def treatment_of(crop: str, contrast: float = 0.0, ground: str = "auto") -> Treatment:
    """The treatment that these names and this share stand for. Raises InputError if there is none."""
    if not 0 <= contrast < 1:
        raise InputError(f"contrast {contrast:g} is not between 0 and 1", "contrast")
    way = cast(Crop, _one_of(get_args(Crop), "way to crop", crop, "--crop"))
    return Treatment(way, contrast, cast(Ground, _one_of(get_args(Ground), "ground", ground, "ground")))


def _one_of(names: Sequence[str], kind: str, name: str, key: str) -> str:
    if name not in names:
        raise InputError(unknown(kind, name, names), key)
    return name


def _check_request(scenario: str, pictures: int, source: bool, questions: int) -> None:
    layout = LAYOUTS[scenario]
    if not layout.least <= pictures <= layout.most:
        many = f"{layout.least} to {layout.most} pictures" if layout.most > 1 else "one picture"
        raise InputError(f"{scenario} takes {many}, got {pictures}", "PICTURES")
    if source and not layout.source:
        raise InputError(f"{scenario} makes its sources itself; leave this out", "--source")
    if questions and not layout.questions:
        raise InputError(f"{scenario} asks nothing; choose question-answer, or leave this out", "--question")
    if questions and questions != pictures:
        raise InputError(f"{questions} questions for {pictures} pictures; write one for each", "--question")


def _checked(making: Making) -> tuple[str | None, float, Place]:
    """The machine, the lens's side, mm, and the place."""
    if making.machine is not None:
        listed_machine(making.machine, "--machine")
    place = cast(Place, _one_of(get_args(Place), "place", making.place, "--for"))
    try:
        return making.machine, LENGTH.parse(making.size), place
    except ValueError as error:
        raise InputError(str(error), "--size") from None


def _check_out(out: Path) -> None:
    if out.is_dir() or not out.parent.is_dir():
        raise InputError(f"'{out}' cannot be a file: name a spec file (.yaml) in a folder that is there", "--out")
    if out.exists():
        raise InputError(f"'{out}' is there already; choose another, or remove it", "--out")


def _text(scenario: str, request: Request, names: Sequence[str], out: str) -> str:
    """The whole spec."""
    layout = LAYOUTS[scenario]
    below, lens, pipeline = layout.scenario(request), layout.lens(request), layout.pipeline(request)
    return "\n".join(
        [
            *_comment(f"{layout.title}, made by 'mlens new {scenario}' from {', '.join(names)}.", ""),
            f"#   mlens check {out}    is it right?",
            f"#   mlens run {out}      design the lens; look at report.html in its run folder",
            "seed: 0                                   # another seed, another lens of about the same quality",
            "",
            "scenario:",
            f"  type: {scenario}",
            *_indented(below),
            "",
            "lens:",
            *_indented(lens),
            "",
            request.viewer,
            "",
            *([f"fabrication: {{machine: {request.machine}}}", ""] if request.machine else []),
            "pipeline:",
            *_indented(pipeline),
            "",
        ]
    )


def _indented(lines: Sequence[str]) -> list[str]:
    """Lines of a mapping; those that start with ``#`` are comments and are wrapped."""
    out = []
    for line in lines:
        text = line.lstrip()
        space = " " * (2 + len(line) - len(text))
        out += _comment(text.removeprefix("# "), space) if text.startswith("# ") else [f"{space}{text}"]
    return out


def _comment(text: str, space: str) -> list[str]:
    plain = "".join(letter if letter.isprintable() else " " for letter in text)
    return textwrap.wrap(plain, _COMMENT_WIDTH, initial_indent=f"{space}# ", subsequent_indent=f"{space}# ")


def _write(out: Path, text: str) -> None:
    """Write the spec beside its final path, and move it there when it has passed the check."""
    from magiclens.plan.compile import load_plan

    handle, name = tempfile.mkstemp(prefix=f".{out.stem}-", suffix=".yaml", dir=out.parent)
    trial = Path(name)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        load_plan(trial)
        trial.chmod(0o644)
        os.replace(trial, out)
    finally:
        trial.unlink(missing_ok=True)
