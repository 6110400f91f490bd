"""Toolchain, launch of kernels, and the JAX primitives that carry them."""
