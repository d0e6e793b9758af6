"""The base class of exporters whose files a milling machine runs."""

from __future__ import annotations

import re
from abc import abstractmethod
from itertools import count, takewhile
from pathlib import Path
from typing import TYPE_CHECKING

from magiclens.contract.stages import Exporter

if TYPE_CHECKING:
    from magiclens.milling.program import MillingProgram


class MillingExporter(Exporter):
    """An exporter of milling programs that can read them back.

    ``mlens machined`` asks it for the programs of a run folder and runs them without a machine.
    """

    def program_files(self, path: Path) -> list[Path]:
        """The programs that ``export`` has written for ``path``, in the order in which they run; empty if none.

        Unless an exporter has names of its own, these are ``path`` itself and then ``numbered(path, k)``.
        """
        further = (numbered(path, k) for k in count(2))
        return [path, *takewhile(Path.is_file, further)] if path.is_file() else []

    @abstractmethod
    def read_program(self, path: Path) -> MillingProgram:
        """The program in one of these files. Raises InputError naming the file and what is not understood in it."""


def numbered(path: Path, number: int) -> Path:
    """Where the second, third, ... program of an export is: ``lens-2.ngc`` beside ``lens.ngc``."""
    return path if number == 1 else path.with_name(f"{path.stem}-{number}{path.suffix}")


def first_of(path: Path) -> Path:
    """Where the first program of the same export is: the inverse of ``numbered``."""
    return path.with_name(re.sub(r"-\d+$", "", path.stem) + path.suffix)
