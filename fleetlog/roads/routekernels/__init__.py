"""Compiled searches on the edge graph; the module ``kernels`` is imported only where it is called."""
