"""Arrays whose users numba does not count.

It counts them, atomically, wherever a kernel takes an array out of a tuple or hands a tuple to a function. In a loop
that does little else, as the tracer's, that takes a fifth of the time.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.core.errors import TypingError
from numba.extending import intrinsic


def _typed(typing_context, value):
    _require_countless(value)

    def generate(context, builder, signature, arguments):
        return _without_counters(context, builder, value, arguments[0])

    return value(value), generate


uncounted: Any = intrinsic(_typed)
"""In a kernel: the same arrays, for as long as its caller keeps them; takes an array, a number or a tuple of such.

Raises:
    TypingError: The value holds something else.
"""


def _require_countless(kind):
    if isinstance(kind, types.BaseTuple):
        for part in getattr(kind, "types", ()):
            _require_countless(part)
    elif not isinstance(kind, types.Array | types.Number | types.Boolean):
        raise TypingError(f"only arrays and numbers can go uncounted, not {kind}")


def _without_counters(context, builder, kind, value):
    """The value, whose arrays have no pointers to their counters."""
    if isinstance(kind, types.BaseTuple):
        for k, part in enumerate(getattr(kind, "types", ())):
            value = builder.insert_value(
                value, _without_counters(context, builder, part, builder.extract_value(value, k)), k
            )
        return value
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo, array.parent = array.meminfo.type(None), array.parent.type(None)
        return array._getvalue()
    return value
