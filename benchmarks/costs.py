"""Cost against size and length, shares of the time, gradients, everyday baselines, GPU."""

import math

import jax

from . import gradients, time_shares
from .baselines import numpy_rate, scipy_rate
from .cases import work
from .jax_runs import batched, vmapped
from .tables import rate, table
from .timing import first_calls, in_turn

SIZES = ((8, 4000), (512, 1000), (16384, 50), (64, 100), (64, 1000), (64, 50_000))
NO_GPU = "not measured: no GPU here"


def sizes(budget: float) -> str:
    """Cost of a step against batch size and length of the run."""
    rows = []
    for lanes, ticks in SIZES:
        runs = work("dfcmac", "float32", lanes, ticks)
        programs = {"rollouts": batched(runs, min(128, lanes), 1), "vmap": vmapped(runs)}
        times = in_turn(programs, first_calls(programs, 2), budget)
        cells = [f"{1e9 * t.cpu / runs.lane_steps:.0f}" for t in times.values()]
        cells += [f"{1e3 * t.best:.1f}" for t in times.values()]
        rows.append([f"{lanes} runs, {ticks} ticks", *cells])
    head = ("dfcmac float32, ATE", "rollouts ns", "vmap ns", "rollouts ms", "vmap ms")
    note = "ns of processor time per lane-step; ms of wall time per call."
    return table("Cost against batch size and length", head, rows, note)


def shares(budget: float, lanes: int = 64, ticks: int = 2000) -> str:
    """Where the time goes."""
    rows = []
    for dtype in ("float32", "float64"):
        programs = time_shares.programs(dtype, lanes, ticks)
        times = in_turn(programs, first_calls(programs, 2), budget, rounds=5)
        whole = times["all"].cpu
        rows += [
            [f"{dtype} {name}", f"{1e9 * s / lanes / ticks:.0f}", f"{100 * s / whole:.0f} %"]
            for name, s in (("everything", whole), *time_shares.shares(times).items())
        ]
    note = (
        "vmap, ns of processor time per lane-step and share of a run with all metrics, by leaving\n"
        "parts out: differences, which need not add up, because XLA fuses what is left anew."
    )
    return table(f"Where the time goes, {lanes} runs", ("part", "ns", "share"), rows, note)


def gradient_costs(budget: float, lanes: int = 64, ticks: int = 2000) -> str:
    """Cost of derivatives."""
    rows = []
    programs = gradients.programs("float32", lanes, ticks)
    times = in_turn(programs, first_calls(programs, 2), budget)
    for name, t in times.items():
        own = "engine, forward" if name.startswith("engine") else "forward"
        multiple = t.cpu / times[own].cpu
        rows.append([name, f"{t.cpu:.3f}", f"{multiple:.1f}", f"{t.compiling:.1f}"])
    head = ("float32", "CPU s", "x its forward", "comp. s")
    note = f"d ATE / d (8 gains) of {lanes} runs of {ticks} ticks; segments of {math.isqrt(ticks)}."
    return table("Gradients", head, rows, note)


def everyday(quick: bool) -> str:
    """numpy and scipy, from short runs."""
    rows = []
    for dtype, lanes in (("float64", 64), ("float64", 4096), ("float32", 4096)):
        speed, _ = numpy_rate(work("dfcmac", dtype, lanes, 100 if quick else 300))
        rows.append([f"numpy, {dtype}, {lanes} runs", rate(speed), f"{10_000 / speed * lanes:.1f}"])
    duration = 0.002 if quick else 0.01
    speed, calls = scipy_rate(work("dfcmac", "float64", 1, 200), duration)
    rows.append(["scipy solve_ivp RK45, 1 run", rate(speed), f"{10_000 / speed:.1f}"])
    note = (
        "Extrapolated from 100 to 300 ticks of a Python loop over numpy vectors, and from\n"
        f"{1e3 * duration:g} ms of the continuous loop ({calls} evaluations, smooth friction and "
        "switch)."
    )
    head = ("dfcmac", "lane-steps/s", "s for 1 s of all")
    return table("Everyday baselines", head, rows, note)


def gpu(budget: float) -> str:
    """The portable engine on a GPU, where JAX sees one."""
    try:
        device = jax.devices("gpu")[0]
    except RuntimeError:
        return f"\nGPU: {NO_GPU}"
    rows = []
    with jax.default_device(device):
        for dtype, lanes in ((d, n) for d in ("float32", "float64") for n in (4096, 65536)):
            runs = work("dfcmac", dtype, lanes, 200)
            programs = {"rollouts": batched(runs, lanes, 1), "vmap": vmapped(runs)}
            times = in_turn(programs, first_calls(programs), budget)
            cells = [rate(runs.lane_steps / t.best) for t in times.values()]
            rows.append([f"{dtype}, {lanes} runs", *cells])
    note = f"lane-steps per second on {device.device_kind}; rollouts in one tile."
    return table("GPU, dfcmac, ATE", ("", "rollouts", "vmap"), rows, note)
