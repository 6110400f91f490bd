"""Where a loop cannot be compiled: an error, or one line that it runs as a scan."""

import functools
import warnings


def fall_back(reason: str, strict: bool) -> None:
    """Refuse to run as a scan, or say that it happens, once for each reason in a process.

    Args:
        reason: Why there is no kernel.
        strict: Whether only a compiled run will do.

    Raises:
        RuntimeError: With the reason, when `strict`.
    """
    if strict:
        raise RuntimeError(f"engine = compiled, but this loop cannot be: {reason}")
    _warn(reason)


@functools.cache
def _warn(reason: str) -> None:
    warnings.warn(f"runs as a slower lax.scan: {reason}", RuntimeWarning, stacklevel=3)
