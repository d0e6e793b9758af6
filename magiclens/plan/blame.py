"""Turns whatever goes wrong in a plugin into one error that names the plugin."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from magiclens.config.document import Document, Keys, dotted
from magiclens.contract.errors import InputError, StageError, Terminated
from magiclens.plan.capture import captured_output
from magiclens.plan.staying import without_exits


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
        with captured_output(owner), without_exits():
            yield
    except (InputError, Blamed, KeyboardInterrupt, Terminated):
        raise
    except StageError as error:
        raise Blamed(f"{owner}: {error}", error.keys) from error
    except BaseException as error:  # a plugin may call sys.exit(), which must not end a sweep
        raise Blamed(f"{owner} failed: {type(error).__name__}: {error}") from error


@contextmanager
def locating(document: Document, at: Keys) -> Iterator[None]:
    """Let errors from inside the ``with`` block say where in a spec the option at fault was written.

    Args:
        document: The spec.
        at: The place of the stage or the scenario that is called; options are looked for there.

    Raises:
        InputError, Blamed: The same as inside. Those that name a file already, or no options, pass unchanged.
    """
    try:
        yield
    except InputError as error:
        if error.where or not error.keys:
            raise
        place = place_of(error.keys, document, at)
        raise InputError(f"{dotted(place)}: {error.message}", document.where(place)) from error
    except Blamed as error:
        if not error.keys:
            raise
        place = place_of(error.keys, document, at)
        raise Blamed(f"{document.where(place)}: {dotted(place)}: {error}") from error


def place_of(options: tuple[str, ...], document: Document, at: Keys) -> Keys:
    """Where in a spec an option is: the first of several that was written, else what they are options of.

    Args:
        options: A stage's own by their names, others by their path, such as ``lens.relief``.
        document: The spec.
        at: The place of the stage; where no option is written, that is where one would be. Without it, the first
            option's own place.
    """
    named = [tuple(key.split(".")) if "." in key else (*at, key) for key in options]
    return next((keys for keys in named if document.written(keys)), at or named[0])
