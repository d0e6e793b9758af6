"""Turns whatever goes wrong in a plugin into one error that names the plugin."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from magiclens.contract.errors import InputError, StageError, Terminated
from magiclens.plan.capture import captured_output


class Blamed(StageError):
    """A StageError whose message already names the plugin or the stage that failed."""


@contextmanager
def blaming(owner: str) -> Iterator[None]:
    """Call a plugin inside the ``with`` block: its errors become StageErrors that name it, and so does its output.

    Args:
        owner: The name, such as ``matcher exhaustive (magiclens 0.1.0)``.

    Raises:
        Blamed: The code inside raised anything, even what is meant to end the program.
        InputError: The code inside raised it: the user's input is wrong, not the plugin.
        KeyboardInterrupt: The user has interrupted the program.
        Terminated: A signal has asked the program to end.
    """
    try:
        with captured_output(owner):
            yield
    except (InputError, Blamed, KeyboardInterrupt, Terminated):
        raise
    except StageError as error:
        raise Blamed(f"{owner}: {error}") from error
    except BaseException as error:  # a plugin may call sys.exit(), which must not end a sweep
        raise Blamed(f"{owner} failed: {type(error).__name__}: {error}") from error
