"""How kernels are compiled that only other kernels call.

Nothing in them allocates, so counting references of sixty arrays at every access, which would take most of
the time, is switched off; and without an entrance from Python, which would unpack them all, a third of the
time of compiling is saved.
"""

from numba import njit

inner = njit(cache=True, _nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True)
