"""How the kernels of the matcher and of simulated traffic are compiled.

They allocate nothing: whoever calls them brings the arrays.  So neither numba's support for arrays that
kernels make themselves nor counts of references are compiled, which would take as long again; and ``inner``
kernels, which other kernels alone call, have no entrance from Python, which would unpack all those arrays.
"""

from typing import Any

from fleetlog.compiling import kernel

_OPTIONS: dict[str, Any] = {"_nrt": False, "error_model": "numpy", "no_cfunc_wrapper": True}

outer = kernel(**_OPTIONS)
inner = kernel(**_OPTIONS, no_cpython_wrapper=True)
fast_outer = kernel(**_OPTIONS, fastmath=True)
fast_inner = kernel(**_OPTIONS, fastmath=True, no_cpython_wrapper=True)
