"""Shortcuts through numba's compiler: the same machine code in less time.

numba asks the same questions again and again, or takes steps that have nothing to do for most functions. What is left
out here has no effect on what comes out.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import CodeType
from typing import Any

import numpy as np
from numba.core import ir, types
from numba.core.compiler import Flags
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NopythonRewrites
from numba.core.untyped_passes import InlineClosureLikes, MakeFunctionToJitFunction

_DEFAULTS = Flags().values()
_HASH = hash(Flags())
"""numba's hash of any flags: that of the options' names."""


class QuickFlags(Flags):
    """numba's flags of a compilation, whose values are at hand: it compares them at every call of a function."""

    __slots__ = ()

    def __hash__(self) -> int:
        return _HASH

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Flags):
            return NotImplemented
        return self._values == other._values or self.values() == other.values()

    def values(self) -> dict[str, Any]:
        """All values, by the names of the options."""
        return {**_DEFAULTS, **self._values}


@register_pass(mutates_CFG=True, analysis_only=False)
class QuickRewrites(NopythonRewrites):
    """numba's rewriting of expressions of whole arrays, where a function has any."""

    def run_pass(self, state: Any) -> bool:
        """Rewrite what there is to rewrite."""
        return bool(_to_be_rewritten(state) and super().run_pass(state))


def steps_needed(steps: Sequence[tuple[type, str]], code: CodeType) -> list[tuple[type, str]]:
    """The steps of a compilation without those that only functions within a function need.

    Args:
        steps: numba's passes, with their descriptions.
        code: of the function.
    """
    has_inner = any(isinstance(value, CodeType) for value in code.co_consts)
    useless = () if has_inner else (InlineClosureLikes, MakeFunctionToJitFunction)
    return [(QuickRewrites if step is NopythonRewrites else step, text) for step, text in steps if step not in useless]


def _to_be_rewritten(state: Any) -> bool:
    """Whether an expression makes an array of arrays or of constants, or picks a field by its name."""
    kinds = state.typemap
    if any(isinstance(kind, types.StringLiteral) for kind in kinds.values()):
        return True
    for block in state.func_ir.blocks.values():
        for assignment in block.find_insts(ir.Assign):
            value = assignment.value
            if not isinstance(value, ir.Expr):
                continue
            if value.op == "build_list":
                return True
            if value.op in ("unary", "binop", "call") and isinstance(kinds.get(assignment.target.name), types.Array):
                called = kinds.get(value.func.name) if value.op == "call" else None
                if called is None or isinstance(getattr(called, "typing_key", None), np.ufunc):
                    return True
    return False
