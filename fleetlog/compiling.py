"""How kernels are compiled: kept on disk until numba or any kernel changes.

numba itself looks only at the file that a kernel is in.  Not at the kernels in other files that were compiled
into it, and not at the records that it takes, whose old names it would fail to find after an upgrade."""

import gc
import hashlib
import re
import secrets
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, TypeVar

from numba import njit, types
from numba.core.bytecode import FunctionIdentity
from numba.core.compiler import Flags

# numba counts functions from 1 and names their code after the number.  Two processes give the same number to
# functions of one name that hold different values; whoever loads both from disk runs one for the other.
FunctionIdentity._unique_ids = iter(partial(secrets.randbits, 64), None)

F = TypeVar("F", bound=Callable[..., Any])


def kernel(**options: Any) -> Callable[[F], F]:
    """Return the decorator of a kernel; ``options`` are those of ``numba.njit``."""

    def compiled(function: F) -> F:
        try:
            made = njit(cache=True, **options)(function)
        except RuntimeError:  # numba found no folder that it can write
            made = njit(**options)(function)
        made._compiler._customize_flags = _Flags
        made._compiler.compile = partial(_quietly, made._compiler.compile)
        template = made.get_call_template
        made.get_call_template = lambda args, kws: template(tuple(map(_wide, args)), kws)
        kept = getattr(getattr(made, "_cache", None), "_cache_file", None)
        if kept is not None:  # it is not kept, or numba was told not to compile
            kept._version = f"{kept._version} {stamp(Path(__file__).parent)}"
            kept.save = partial(_save, kept)
        return made  # type: ignore[no-any-return]

    return compiled


def _save(kept: Any, key: Any, data: Any) -> None:
    """Keep the code for some types. numba numbers files and writes the index first: of two processes that
    compile a kernel for two types at once, one would run the code that the other made, and die of it."""
    name = kept._data_name_pattern.replace("{number:d}", hashlib.sha256(repr(key).encode()).hexdigest()[:16])
    kept._save_data(name, data)
    kept._save_index({**kept._load_index(), key: name})


def _wide(kind: Any) -> Any:
    """The type for which a kernel is compiled that another one calls: a loop's counter begins as the literal
    0, and numbers of trucks and edges are of 32 bits where they are kept and of 64 where they are counted."""
    kind = types.unliteral(kind)
    return types.int64 if kind == types.int32 else kind


class _Flags(Flags):  # type: ignore[misc]
    """The options of a kernel, told apart by those that are set.  numba asks for every operator of a kernel,
    some dozens of times, whether it knows it with these options: a tenth of its time."""

    def __hash__(self) -> int:
        return len(self._values)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Flags) and self._values == other._values


def _quietly(compile: Callable[..., Any], *what: Any) -> Any:
    """Python looks for no garbage while a kernel is compiled: a tenth of that time for nothing, since what
    numba makes of a kernel lasts until it is compiled."""
    was = gc.isenabled()
    gc.disable()
    try:
        return compile(*what)
    finally:
        if was:
            gc.enable()


@lru_cache
def stamp(root: Path) -> str:
    """Return what changes with any file of kernels below a folder."""
    own = sorted(p for p in root.rglob("*.py") if re.search("kernels|compiling", f"{p.parent.name} {p.stem}"))
    seen = [f"{p.relative_to(root)} {p.stat().st_mtime_ns} {p.stat().st_size}" for p in own]
    return hashlib.sha256("\n".join(seen).encode()).hexdigest()[:16]


# The kernels of the matcher, of motion and of simulated traffic allocate nothing: whoever calls them brings
# the arrays.  So neither numba's support for arrays that kernels make themselves nor counts of references are
# compiled, which would take as long again; and ``inner`` kernels, which other kernels alone call, have no
# entrance from Python, which would unpack all those arrays.  Nor is a whole row assigned at once: what numba
# compiles to say that its length is wrong takes longer than a filter.
# ``no_rewrites`` leaves out passes over their code that serve closures, array expressions and ``raise``.
_OPTIONS = {"_nrt": False, "error_model": "numpy", "no_cfunc_wrapper": True, "no_rewrites": True}

outer = kernel(**_OPTIONS)
inner = kernel(**_OPTIONS, no_cpython_wrapper=True)
once = kernel(**_OPTIONS, inline="always")  # called at one place
free = kernel(**_OPTIONS, nogil=True)  # Other threads run meanwhile
fast_outer = kernel(**_OPTIONS, fastmath=True)
# Written into their callers: as kernels of their own they gave the matcher's sums, which may be taken in any
# order, other last digits in the process that compiled them than in those that load the callers from disk.
fast_inner = kernel(**_OPTIONS, fastmath=True, inline="always")
# Sums in any order, but what is not a number stays so.
sum_outer = kernel(**_OPTIONS, fastmath={"contract", "reassoc", "nsz"})
sum_inner = kernel(**_OPTIONS, fastmath={"contract", "reassoc", "nsz"}, no_cpython_wrapper=True)
