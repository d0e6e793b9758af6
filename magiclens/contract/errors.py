"""The errors that magiclens raises on purpose, by whose fault they are; each has an exit code of the command line."""


class MagicLensError(Exception):
    """Base of every error that magiclens raises on purpose.

    Attributes:
        exit_code: What the command line exits with.
    """

    exit_code = 1


class InputError(MagicLensError):
    """The user's input is wrong: a spec, an image, an option. Exit code 2.

    Attributes:
        message: What is wrong and what to do about it.
        where: ``file:line`` or the name of the option; None if it is not known.
    """

    exit_code = 2

    def __init__(self, message: str, where: str | None = None):
        super().__init__(f"{where}: {message}" if where else message)
        self.message, self.where = message, where


class StageError(MagicLensError):
    """A stage or a plugin failed; the message names it, its package and its version. Exit code 1."""


class Terminated(SystemExit):
    """A signal has asked the program to end.

    It is no error of the stage that is running, so it is no ``Exception``: a stage that catches all of these lets it
    pass.
    """
