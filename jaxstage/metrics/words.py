"""Numbers as people read them: lengths and times in the unit that fits."""


def length_unit(largest: float) -> tuple[float, str]:
    """Factor and name of the display unit for lengths up to ``largest`` in m: µm or mm."""
    return (1e6, "µm") if not largest >= 2e-3 else (1e3, "mm")


def length_text(length: float) -> str:
    """A length in m with three digits and its unit, e.g. ``16.1 µm``, ``1.2 mm``, ``1200 mm``."""
    factor, unit = (1e6, "µm") if float(f"{abs(length) * 1e6:.3g}") < 1e3 else (1e3, "mm")
    return f"{float(f'{length * factor:.3g}'):.15g} {unit}"


def time_text(time: float) -> str:
    """A time in s with its unit: µs, ms or s."""
    for unit, factor in (("µs", 1e6), ("ms", 1e3)):
        if abs(time) * factor < 1e3:
            return f"{time * factor:.4g} {unit}"
    return f"{time:.4g} s"
