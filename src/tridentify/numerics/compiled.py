"""Machine code for loops that Python would be slow in, kept on disk.

numba compiles a function for one signature at the first use on a machine, which takes a second or
so, and keeps the result beside the source. A module whose functions are wrapped by `compiled` is
therefore imported where it is needed, not with the package.
"""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from llvmlite import binding
from numba.core import serialize
from numba.core.compiler import Flags
from numba.core.runtime import rtsys

Function = TypeVar("Function", bound=Callable[..., object])

KERNELS = (
    "numerics/recursive.py",
    "numerics/incomplete_kernels.py",
    "numerics/kernels/*.py",
    "online/kernels/*.py",
    "models/compiled_*.py",
    "estimation/*/compiled_*.py",
    "estimation/*/compiled/*.py",
)
"""Files with compiled functions that call one another, below the package."""

with contextlib.suppress(AttributeError):  # another numba
    # Machine code calls this for the type of each array or tuple that it returns. Were it Python's
    # code, an interruption that waited for the machine code to end would be raised in there and
    # come out as a SystemError; the cache, which answers all but the first calls, is none.
    serialize._numba_unpickle = cache(serialize._numba_unpickle)


def read_only(dimensions: int, kind: Any = numba.float64) -> Any:
    """The type of an array that a loop does not write."""
    return numba.types.Array(kind, dimensions, "C", readonly=True)


def compiled(
    signature: Any,
    *,
    inline: bool = False,
    wide: bool = False,
    free: bool = False,
    any_order: bool = False,
    inner: bool = False,
    value: bool = False,
    linked: bool = False,
) -> Callable[[Function], Function]:
    """Decorator: machine code for a signature, kept on disk where that is possible.

    The code of a function is made for that of the functions it calls, and what is kept would
    survive a change of theirs if these stand in another file. So it is stamped with the sources of
    all kernels.

    Parameters
    ----------
    signature : str or numba.core.typing.Signature
        As numba writes it.
    inline : bool
        Whether its code is put into that of its callers: a call hands over every array in seven
        pieces, which takes longer than a small function does.
    wide : bool
        Whether its loops are long enough for vector instructions; with loops over a few numbers
        these are slower.
    free : bool
        Whether other threads may run meanwhile (the interpreter's lock is released).
    any_order : bool
        Whether sums may be taken in any order, which lets the processor take several terms at once.
    inner : bool
        Whether other machine code alone calls it: what Python would call it by is not made then.
    value : bool
        Whether it is handed on to other machine code as a value, which calls it as C would.
    linked : bool
        Whether its code is compiled again with that of each caller, as suits what is small or runs
        once a sample.
    """
    # a test for a division by zero keeps a loop from being vectorised
    options: dict[str, Any] = {
        "forceinline": inline,
        "error_model": "numpy" if wide else "python",
        "nogil": free,
        "fastmath": {"reassoc", "nsz", "contract"} if any_order else False,
        # a tenth of all compiling
        "no_cfunc_wrapper": not value,
        "no_cpython_wrapper": inner,
    }

    def wrap(function: Function) -> Function:
        try:
            found: Any = numba.njit(**options, cache=True)(function)
            found._cache._cache_file._source_stamp = _stamp()
        except (AttributeError, RuntimeError):  # no folder can hold it, or another numba
            found = numba.njit(**options)(function)
        with contextlib.suppress(AttributeError):  # another numba
            found._compiler._customize_flags = _SameCallees
            load_alone(found)
        with _no_collections(), _no_clocks():
            found.compile(signature)
        found.disable_compile()
        if not inline and not linked:
            with contextlib.suppress(AttributeError, NameError, RuntimeError):  # another numba
                for made in found.overloads.values():
                    _call_by_address(made.library, made.fndesc)
        return cast(Function, found)

    return wrap


class _SameCallees(Flags):  # type: ignore[misc]
    """How a function is compiled, equal where what it calls of numba's is to be the same.

    numba compiles what it has of `numpy` anew for callers that differ in any option, even in how
    Python calls them.
    """

    OF_THE_CALLER = frozenset({"release_gil", "no_cpython_wrapper", "no_cfunc_wrapper"})

    def values(self) -> dict[str, Any]:
        """Values of the other options; asked for at each call that is compiled."""
        return {k: v for k, v in self._values.items() if k not in self.OF_THE_CALLER}


@contextlib.contextmanager
def _no_collections() -> Iterator[None]:
    """No search for garbage among all that the compiler holds: a tenth of its time."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


@contextlib.contextmanager
def _no_clocks() -> Iterator[None]:
    """No notes of when each call of LLVM begins and ends.

    There are ten thousands of them, and nobody reads what takes a tenth of the time of loading.
    """
    lock: Any = getattr(binding.ffi.lib, "_lock", None)
    noted = getattr(lock, "_cblist", None)
    if noted is None:  # another llvmlite
        yield
        return
    lock._cblist = []
    try:
        yield
    finally:
        lock._cblist = noted


def load_alone(dispatcher: Any) -> None:
    """Do not learn all that can be compiled before a function is loaded that was compiled before.

    Machine code asks for numba's runtime alone. The rest, tens of modules and thousands of
    functions of `numpy`, is a third of the time of loading; what is compiled looks for it on its
    own.

    Parameters
    ----------
    dispatcher : numba.core.dispatcher.Dispatcher
        With a cache, and nothing loaded yet.

    Raises
    ------
    AttributeError
        Another numba keeps things elsewhere.
    """
    rtsys.initialize(dispatcher.targetctx)
    dispatcher._cache.load_overload = dispatcher._cache._load_overload


def _call_by_address(library: Any, descriptor: Any) -> None:
    """Let callers call machine code where it stands, instead of compiling it again within them.

    numba links the code of a function into that of each caller, and optimises it there once more.
    Here they get a call of its address under a name that is the same in every process: what is kept
    on disk may come from several.
    """
    own, name = descriptor.llvm_func_name, f"{descriptor.modname}.{descriptor.qualname}"
    given = str(library._get_module_for_linking().get_function(own).global_value_type)
    kinds = given.removeprefix("i32 (").removesuffix(")")
    taken = ", ".join(f"{kind} %a{place}" for place, kind in enumerate(kinds.split(", ")))
    binding.add_symbol(name, library.get_pointer_to_function(own))
    library._shared_module = binding.parse_assembly(
        f'declare i32 @"{name}"({kinds}) nounwind\n'
        f'define linkonce_odr i32 @"{own}"({taken}) alwaysinline nounwind {{\n'
        f'%r = tail call i32 @"{name}"({taken})\nret i32 %r\n}}'
    )


linked = partial(compiled, linked=True)


@cache
def _stamp() -> tuple[tuple[str, float, int], ...]:
    """Names, times and sizes of all files with compiled functions."""
    package = Path(__file__).parent.parent
    files = [one for pattern in KERNELS for one in sorted(package.glob(pattern))]
    return tuple((one.name, one.stat().st_mtime, one.stat().st_size) for one in files)
