"""Mills the top along straight lines and writes that in a machine's language: what the languages share."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING

from magiclens.contract.artifacts import Scene, Solid
from magiclens.contract.errors import InputError
from magiclens.milling.exporter import first_of, numbered
from magiclens.milling.options import MillingOptions

if TYPE_CHECKING:
    from magiclens.milling.program import MillingProgram, MillingSetup
    from magiclens.milling.toolpath import Moves


class LineMilling(MillingOptions):
    """A program that mills the lens's top out of a plate: roughing in levels, then finishing along straight lines.

    The cutter's shape is compensated exactly: nothing of the lens is cut away, whatever the cutter; what the cutter
    cannot reach, such as the bottom of a valley narrower than itself, is left standing. Undercuts are left out: the
    highest surface counts. The plate's sides stay as they are. A second file, ``lens<suffix>.txt``, tells the maker
    how to set up: the plate, the cutters, where zero is, how long it takes. ``mlens machined`` runs the programs of a
    run folder without a machine and shows what their lens will show.
    """

    @abstractmethod
    def write(self, program: MillingProgram, comments: list[str]) -> str:
        """The text of a program, ASCII, with comments at its head if the language has any."""

    @abstractmethod
    def parse(self, text: str, setup: MillingSetup) -> Moves:
        """The moves in the text of a program: the inverse of ``write``.

        Args:
            text: as in the file.
            setup: of this program, for languages in which a program does not name its cutter.

        Raises:
            InputError: something is not understood.
        """

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        """Write the first program, others beside it as ``lens-2`` and so on, and the setup sheet as text.

        Raises InputError if a cutter is too short, the plate too thin or the bed too small.
        """
        from magiclens.milling.job import milling_job
        from magiclens.milling.setup_sheet import head_comments, setup_sheet

        job = milling_job(self, solid)
        files = [numbered(path, k + 1) for k in range(len(job.programs))]
        for file, program in zip(files, job.programs, strict=True):
            file.write_text(self.write(program, head_comments(job, program)), encoding="ascii")
        sheet = setup_sheet(self, job, [file.name for file in files])
        _sheet_of(path).write_text(sheet, encoding="utf-8")

    def read_program(self, path: Path) -> MillingProgram:
        """The program in a file that ``export`` has written. Raises InputError naming what is not understood."""
        from magiclens.milling.program import MillingProgram

        try:
            text = path.read_text(encoding="utf-8")
            setup = self.read_setup(path, text)
            return MillingProgram(self.parse(text, setup), setup)
        except InputError as error:
            raise InputError(error.message, f"{path}, {error.where}" if error.where else str(path)) from None
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"cannot be read: {error}", str(path)) from None

    def read_setup(self, path: Path, text: str) -> MillingSetup:
        """The setup of the program with this text: what the setup sheet says, unless the language has comments."""
        from magiclens.milling.setup_sheet import read_setup

        return read_setup(_sheet_of(first_of(path)).read_text(encoding="utf-8"), path.name)


def _sheet_of(path: Path) -> Path:
    """Where the setup sheet of an export is: beside its first program."""
    return path.with_name(f"{path.name}.txt")
