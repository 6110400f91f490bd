"""Back end for this processor: C++ kernels on vectors of runs."""
