"""The errors that magiclens raises on purpose, by whose fault they are; each has an exit code of the command line."""

from __future__ import annotations


class MagicLensError(Exception):
    """Base of every error that magiclens raises on purpose.

    Attributes:
        exit_code: What the command line exits with.
        keys: Options at fault, the likeliest first: a stage's own by their names, others by their path in the spec,
            such as ``lens.relief``. A run puts the place where one of them was written before the message.
    """

    exit_code = 1
    keys: tuple[str, ...] = ()


class InputError(MagicLensError):
    """The user's input is wrong: a spec, an image, an option. Exit code 2.

    Attributes:
        message: What is wrong and what to do about it.
        where: ``file:line`` or the name of the option; None if it is not known.
        others: Further mistakes in the same file, in its order; some may follow from this one.
    """

    exit_code = 2

    def __init__(
        self,
        message: str,
        where: str | None = None,
        keys: tuple[str, ...] = (),
        others: tuple[InputError, ...] = (),
    ):
        self.message, self.where = _in_one_line(message), where and _in_one_line(where)
        self.keys, self.others = keys, others
        super().__init__(f"{self.where}: {self.message}" if where else self.message)

    def mistakes(self) -> list[dict[str, str | None]]:
        """This mistake and the others as JSON has them: ``where`` each is, and the ``message``."""
        return [{"where": each.where, "message": each.message} for each in (self, *self.others)]


class StageError(MagicLensError):
    """A stage or a plugin failed; the message names it, its package and its version. Exit code 1."""

    def __init__(self, message: str, keys: tuple[str, ...] = ()):
        super().__init__(_in_one_line(message))
        self.keys = keys


def _in_one_line(text: str) -> str:
    """The text with all that moves a terminal's cursor, or turns the order of letters, written out as in Python.

    Messages repeat what users, and writers of the files that they were given, have written.
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class Terminated(SystemExit):
    """A signal has asked the program to end.

    It is no error of the stage that is running, so it is no ``Exception``: a stage that catches all of these lets it
    pass.
    """
