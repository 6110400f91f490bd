"""What this machine gives: devices, precision, cache, and a one-second speed test."""

import platform
import time
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import jaxlib.version

from jaxstage import Timing, __version__, build, explain, replace
from jaxstage.compiler.runtime.toolchain import compiler_name
from jaxstage.simulate.batch import rollouts
from jaxstage.system.runtime import cache_folder, cpu_cores, processor

LANES = 128
TICKS = 4000  # as many as the engine compiles


def examine() -> dict[str, Any]:
    """The object that ``jaxstage doctor --json`` prints."""
    devices = jax.local_devices()
    return {
        "jaxstage": __version__,
        "python": platform.python_version(),
        "jax": jax.__version__,
        "jaxlib": jaxlib.version.__version__,
        "backend": jax.default_backend(),
        "processor": processor(),
        "devices": [d.device_kind for d in devices],
        "cores": cpu_cores(),
        "cores_used": len(devices) if jax.default_backend() == "cpu" else 0,
        "precision": "double" if jnp.zeros(()).dtype == jnp.float64 else "single",
        "cache": cache_folder(),
        "compiler": compiler_name(),
        "lane_steps_per_s": speed(),
        "speed_of": f"dfcmac-circle, {LANES} runs at once, all default metrics",
    }


def text(answer: Mapping[str, Any]) -> str:
    """The object of `examine`, one line an entry."""
    lines = []
    for name, value in answer.items():
        told = f"{value:.3g}" if isinstance(value, float) else value
        lines.append(f"{name:18s}{', '.join(value) if isinstance(value, list) else told}")
    return "\n".join(lines)


def explained(name: str) -> tuple[dict[str, Any], str]:
    """What the engine makes of a loop: the object of ``jaxstage doctor LOOP --json``, and text."""
    case = build(name)
    engine = explain(case.loop, case.gains, case.scenario, case.path)
    answer = {
        "loop": name,
        "engine": engine.engine,
        "compiled_from_ticks": engine.shortest if engine.shortest < float("inf") else None,
        "compiler": engine.compiler,
        "compiled": engine.compiled,
        "kernels": [
            {
                "kernel": k.what,
                "reason": k.reason,
                "operations": k.nodes,
                "bytes": k.bytes,
                "compile_s": k.seconds,
                "graph_s": k.graph_seconds,
                "cached": k.cached,
            }
            for k in engine.kernels
        ],
    }
    return answer, f"{name}: {engine.text()}"


def speed() -> float:
    """Lane-steps per second of the batch engine: `LANES` runs at once, for about a second."""
    case = build("dfcmac-circle", Timing(lap_time=1.0, laps=1))
    slopes = jnp.linspace(0.5, 4.0, LANES)
    gains = replace(case.gains, slope=jnp.stack([slopes, slopes], axis=1))
    axes = replace(jax.tree.map(lambda _: None, case.gains), slope=0)

    def once() -> Any:
        run = rollouts(
            case.loop,
            gains,
            case.scenario,
            case.path,
            TICKS,
            in_axes=(axes, None, None),
            tile=LANES // 2,
        )
        return jax.block_until_ready(run.report)

    once()
    return LANES * TICKS * _rate(once)


def _rate(action: Callable[[], Any], seconds: float = 1.0) -> float:
    """Calls per second over about one second."""
    begin, count = time.perf_counter(), 0
    while time.perf_counter() - begin < seconds:
        action()
        count += 1
    return count / (time.perf_counter() - begin)
