"""A numba target for kernels: no machine code is made of those that only other kernels call.

For every function numba makes machine code, and a wrapper by which Python calls it. A kernel that is compiled because
another one calls it needs neither: what LLVM made of it is linked into its caller, which holds all the machine code
that runs. The same is true of what numba itself is made of, such as ``np.zeros``.

The target is the processor, as numba's own. Kernels of both targets may call each other.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import llvmlite.binding as llvm
import numba
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen, RuntimeLinker
from numba.core.compiler import Compiler
from numba.core.compiler_lock import global_compiler_lock
from numba.core.environment import Environment, lookup_environment
from numba.core.registry import CPUDispatcher, CPUTarget, cpu_target
from numba.core.sigutils import normalize_signature
from numba.core.target_extension import CPU, dispatcher_registry, jit_registry, target_registry
from numba.core.targetconfig import ConfigStack

from magiclens.kernels.shortcuts import QuickFlags, steps_needed

TARGET = "magiclens"
"""The name by which ``numba.njit(_target=...)`` knows the target."""


class _Library(JITCodeLibrary):
    """The code of one function and of those that it calls; machine code only if somebody asks for its address."""

    _linked_only = False

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout
        # numba's highest level finds little more at this point, and what it finds the whole module's passes find, too
        passes, builder = self._codegen._function_pass_manager(opt=1)
        for function in module.functions:
            if not function.is_declaration:
                passes.run(function, builder)

    def _optimize_final_module(self) -> None:
        # numba finds functions that call themselves by their addresses
        names = (variable.name for variable in self._final_module.global_variables)
        self._linked_only &= not any(name.startswith(RuntimeLinker.PREFIX) for name in names)
        if self._linked_only:
            # all of it is optimised in every caller; what nobody refers to would keep a kernel from going to the disk
            passes = llvm.create_new_module_pass_manager()
            passes.add_global_opt_pass()
            passes.add_global_dead_code_eliminate_pass()
            passes.run(self._final_module, self._codegen._pass_builder(opt=1))
        else:
            super()._optimize_final_module()

    def add_ir_module(self, module: Any) -> None:
        self._linked_only = len(ConfigStack()) > 1
        super().add_ir_module(module)

    def _finalize_final_module(self) -> None:
        if self._linked_only:
            self._finalize_dynamic_globals()
            self._finalized = True
        else:
            super()._finalize_final_module()
            # of functions that are linked in, too: nobody has done it for them
            for variable in self._final_module.global_variables:
                if environment := lookup_environment(variable.name):
                    self._codegen.set_env(variable.name, environment)  # type: ignore[attr-defined]

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        if self._linked_only and any(function.name == name for function in self.get_defined_functions()):
            self._linked_only = False
            self._optimize_final_module()
            self._finalize_final_module()
        pointer: int = super().get_pointer_to_function(name)
        return pointer

    def serialize_using_object_code(self) -> Any:
        return self.serialize_using_bitcode() if self._linked_only else super().serialize_using_object_code()

    @classmethod
    def _unserialize(cls, codegen: Any, state: tuple[str, str, Any]) -> Any:
        name, kind, data = state
        if kind != "bitcode":
            return super()._unserialize(codegen, state)
        library = codegen.create_library(name)
        library._linked_only = True
        library._final_module = llvm.parse_bitcode(data)
        library._finalize_final_module()
        return library


class _Codegen(JITCPUCodegen):
    _library_class = _Library

    def set_env(self, name: str, environment: Environment) -> None:
        if self._engine.is_symbol_defined(name):  # else LLVM would end the process
            super().set_env(name, environment)


class _KernelTarget(CPU):
    """The processor, for code that is linked into its callers."""


class _Descriptor(CPUTarget):
    """Types, and what there is to call, are those of numba's own target for the processor."""

    @cached_property
    def _toplevel_target_context(self) -> Any:
        codegen = _Codegen("magiclens.exec")
        return cpu_target.target_context.subtarget(target=_KernelTarget, target_name=TARGET, _internal_codegen=codegen)

    @property
    def typing_context(self) -> Any:
        return cpu_target.typing_context


class _KernelCompiler(Compiler):
    """Leaves out the wrapper for Python while another function is being compiled, which calls this one."""

    def __init__(self, *arguments: Any):
        super().__init__(*arguments)
        flags: Any = QuickFlags(self.state.flags)
        self.state.flags = flags
        self._no_wrapper, self._release_gil = flags.no_cpython_wrapper or bool(ConfigStack()), flags.release_gil
        # what is called is compiled anew for callers with other flags, even for such as concern the wrapper only
        flags.no_cpython_wrapper, flags.release_gil = True, False

    def define_pipelines(self) -> Any:
        """Put back the flags, when the callees have been told them."""
        self.state.flags.no_cpython_wrapper, self.state.flags.release_gil = self._no_wrapper, self._release_gil
        pipelines = super().define_pipelines()
        for pipeline in pipelines:
            pipeline.passes = steps_needed(pipeline.passes, self.state.func_id.code)
            pipeline.finalize()
        return pipelines


class _KernelCache(FunctionCache):
    """Keeps apart what Python and what other kernels call."""

    def _index_key(self, *arguments: Any) -> tuple[Any, ...]:
        return (*super()._index_key(*arguments), bool(ConfigStack()))


class _Kernel(CPUDispatcher):
    """A numba dispatcher, with its arguments, whose kernels have a wrapper for Python only once Python calls them."""

    targetdescr = _Descriptor(TARGET)

    def __init__(self, py_func: Callable[..., Any], locals: Any = None, targetoptions: Any = None):
        super().__init__(py_func, locals or {}, targetoptions or {}, _KernelCompiler)

    def enable_caching(self) -> None:
        """Keep on disk what is compiled."""
        self._cache = _KernelCache(self.py_func)

    def add_overload(self, result: Any) -> None:
        """Add what has been compiled; Python does not get to see what it cannot call."""
        if _has_wrapper(result):
            super().add_overload(result)
        else:
            self.overloads[tuple(result.signature.args)] = result

    def compile(self, signature: Any) -> Any:
        """Compile for a signature, again if this is for Python and what there is can be called by kernels only."""
        with global_compiler_lock:
            arguments = tuple(normalize_signature(signature)[0])
            known = self.overloads.get(arguments)
            if ConfigStack():
                return super().compile(signature)
            if known and not _has_wrapper(known):
                del self.overloads[arguments]
            return _in_one_piece(super().compile, signature)


def _in_one_piece(function: Callable[..., Any], argument: Any) -> Any:
    """Call a function that calls others to a great depth.

    Python keeps what is local to calls in pieces of 16 KB. It asks the system for the next one, and gives it back,
    whenever a call crosses the end of a piece, which in a compilation happens 100,000 times a second. A call that takes
    more than half a MB gets a piece of 1 MB, and leaves the rest to those below.
    """
    return function(argument)


# in numbers of 8 bytes
_in_one_piece.__code__ = _in_one_piece.__code__.replace(co_stacksize=66_000)


def _has_wrapper(result: Any) -> bool:
    return bool(result.library.get_pointer_to_function(result.fndesc.llvm_cpython_wrapper_name))


def _jit_for_kernels(**options: Any) -> Callable[..., Any]:
    """The decorator of what numba has written in Python, such as ``np.zeros``, which only compiled functions call."""
    options |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_target": TARGET}
    decorator: Callable[..., Any] = numba.jit(**options)
    return decorator


target_registry[TARGET] = _KernelTarget
dispatcher_registry[_KernelTarget] = _Kernel
jit_registry[_KernelTarget] = _jit_for_kernels
