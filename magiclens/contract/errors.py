"""What can go wrong, and whose fault it is. The command line maps these to exit codes 2 and 1."""


class MagicLensError(Exception):
    """Base of every error that magiclens raises on purpose."""

    exit_code = 1


class InputError(MagicLensError):
    """The user's input is wrong: a spec, an image, an option. Exit code 2.

    ``where`` is ``file:line`` or the name of the option, when it is known.
    """

    exit_code = 2

    def __init__(self, message: str, where: str | None = None):
        super().__init__(f"{where}: {message}" if where else message)
        self.message, self.where = message, where


class StageError(MagicLensError):
    """A stage or a plugin failed; the message names it, its package and its version. Exit code 1."""


class Terminated(SystemExit):
    """A signal has asked the program to end; nobody who happens to be at work is to blame."""
