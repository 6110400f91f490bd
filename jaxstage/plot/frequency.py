"""Bode, Nyquist and sensitivity plots of a loop, with the sine sweep of the full loop as dots."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from jaxstage import __version__
from jaxstage.frequency.analysis import FrequencyView
from jaxstage.frequency.response import sensitivity
from jaxstage.plot.pictures import save
from jaxstage.plot.style import AXIS_COLOURS, LARGE, NORMAL, REFERENCE, SMALL

#: |S| of circles that a Nyquist plot shows: Ms = 1.6 guarantees 36 deg and 8.5 dB
CIRCLES = (1.6,)
#: markers of the amplitudes of a sine sweep
MARKERS = "osD^v"


def _sheet(seen: FrequencyView, title: str, rows: int, size: tuple[float, float]) -> Figure:
    drawn = Figure(figsize=size, dpi=100, layout="constrained", facecolor="white")
    engine = drawn.get_layout_engine()
    assert engine is not None
    engine.set(rect=(0.01, 0.03, 0.98, 0.89))  # type: ignore[call-arg]
    speeds = ", ".join(
        f"{name} {1e3 * v:g} mm/s" for name, v in zip(seen.axes, seen.at, strict=True)
    )
    where = "at what reaches the plant" if seen.cut == "input" else "at the measured position"
    steady = "" if seen.unsteadiness <= 1e-6 else "; the law adapts: a frozen picture"
    drawn.text(0.012, 0.985, f"{seen.case.name}: {title}", va="top", fontsize=LARGE, weight="bold")
    drawn.text(
        0.012, 0.945, f"operating point {speeds}; cut {where}{steady}", va="top", fontsize=SMALL
    )
    drawn.text(0.012, 0.008, f"jaxstage {__version__}", fontsize=SMALL, color="#555555")
    drawn.subplots(rows, 1, sharex=rows > 1)
    return drawn


def _dress(ax: Axes, x: str, y: str) -> None:
    ax.set_xlabel(x, fontsize=NORMAL)
    ax.set_ylabel(y, fontsize=NORMAL)
    ax.grid(True, which="both", color="#DDDDDD", linewidth=0.6)
    ax.tick_params(labelsize=SMALL)


def _responses(seen: FrequencyView) -> np.ndarray:
    """S of each axis, the other axes closed: (w, axes)."""
    return np.einsum("wii->wi", sensitivity(seen.model)(seen.omega))


def bode(seen: FrequencyView) -> Figure:
    """|L| in dB and arg L in deg against frequency, per axis, with the margins marked."""
    drawn = _sheet(seen, "loop gain L", 2, (9.0, 7.0))
    size, phase = drawn.axes
    hertz = seen.omega / (2 * math.pi)
    for name, colour, s in zip(seen.axes, AXIS_COLOURS, _responses(seen).T, strict=False):
        with np.errstate(divide="ignore"):
            gain = 1 / s - 1
            size.semilogx(hertz, 20 * np.log10(np.abs(gain)), color=colour, label=f"axis {name}")
        turned = np.unwrap(np.angle(gain))
        # -180 deg stands where the loop crosses |L| = 1
        crossing = int(np.argmin(np.abs(np.log(np.abs(gain) + 1e-300))))
        turned -= 2 * math.pi * np.round((turned[crossing] + math.pi) / (2 * math.pi))
        phase.semilogx(hertz, np.degrees(turned), color=colour)
        size.plot(hertz[crossing], 0, "o", color=colour, markersize=5)
        phase.plot(hertz[crossing], np.degrees(turned[crossing]), "o", color=colour, markersize=5)
    size.axhline(0, color=REFERENCE, linewidth=0.8)
    phase.axhline(-180, color=REFERENCE, linewidth=0.8)
    phase.yaxis.set_major_locator(MultipleLocator(45))
    _dress(size, "", "|L| in dB")
    _dress(phase, "frequency in Hz", "arg L in deg")
    size.legend(fontsize=SMALL, frameon=False)
    return drawn


def nyquist(seen: FrequencyView) -> Figure:
    """L in the complex plane near -1, with the unit circle and the circle of Ms = 1.6."""
    drawn = _sheet(seen, "Nyquist plot of L", 1, (7.6, 7.6))
    (ax,) = drawn.axes
    angle = np.linspace(0, 2 * math.pi, 361)
    across, up = np.cos(angle), np.sin(angle)
    ax.plot(across, up, color=REFERENCE, linewidth=0.8, label="|L| = 1")
    for ms in CIRCLES:
        label = f"Ms = {ms:g}"
        ax.plot(across / ms - 1, up / ms, "--", color="#888888", linewidth=1, label=label)
    for name, colour, s in zip(seen.axes, AXIS_COLOURS, _responses(seen).T, strict=False):
        with np.errstate(divide="ignore"):
            gain = 1 / s - 1
        ax.plot(np.real(gain), np.imag(gain), color=colour, label=f"axis {name}")
    ax.plot(-1, 0, "+", color="#B00020", markersize=12, markeredgewidth=2)
    ax.set(xlim=(-3, 1.5), ylim=(-2.25, 2.25), aspect="equal")
    _dress(ax, "Re L", "Im L")
    ax.legend(fontsize=SMALL, frameon=False, loc="upper left")
    return drawn


def sensitivities(seen: FrequencyView) -> Figure:
    """|S| and |T| against frequency; dots: |S| that a sine sweep of the full loop measured."""
    drawn = _sheet(seen, "sensitivity S and complementary sensitivity T", 2, (9.0, 7.0))
    upper, lower = drawn.axes
    hertz = seen.omega / (2 * math.pi)
    for name, colour, s in zip(seen.axes, AXIS_COLOURS, _responses(seen).T, strict=False):
        upper.loglog(hertz, np.abs(s), color=colour, label=f"axis {name}, linear")
        lower.loglog(hertz, np.maximum(np.abs(1 - s), 1e-6), color=colour)
        swept = seen.sines.get(name)
        for i, amplitude in enumerate(swept.amplitude if swept else ()):
            assert swept is not None
            upper.loglog(
                swept.omega / (2 * math.pi),
                np.abs(swept.sensitivity[i]),
                MARKERS[i % len(MARKERS)],
                color=colour,
                markersize=4,
                fillstyle="none",
                label=f"axis {name}, sine of {amplitude:g} {seen.case.loop.plant.command_unit}",
            )
    for ax, label in ((upper, "|S|"), (lower, "|T|")):
        ax.axhline(1, color=REFERENCE, linewidth=0.8)
        _dress(ax, "frequency in Hz" if ax is lower else "", label)
    upper.axhline(CIRCLES[0], color="#888888", linestyle="--", linewidth=1)
    upper.legend(fontsize=SMALL, frameon=False)
    return drawn


#: the plots of a frequency view by name
FREQUENCY_PLOTS: dict[str, Callable[[FrequencyView], Figure]] = {
    "bode": bode,
    "nyquist": nyquist,
    "sensitivity": sensitivities,
}


def frequency_plots(seen: FrequencyView, folder: Path) -> tuple[Path, ...]:
    """Draw all plots of a view into a folder that exists; returns the files."""
    files = []
    for name, draw in FREQUENCY_PLOTS.items():
        save(draw(seen), folder / f"{name}.png")
        files.append(folder / f"{name}.png")
    return tuple(files)
