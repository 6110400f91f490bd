"""What this machine gives: devices, precision, cache, and a one-second speed test."""

import platform
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import jaxlib.version

from jaxstage import Timing, __version__, build, replace
from jaxstage.batch import rollouts
from jaxstage.runtime import cache_folder, cpu_cores

LANES = 128
TICKS = 1000


def examine() -> dict[str, Any]:
    """The object that ``jaxstage doctor --json`` prints."""
    devices = jax.local_devices()
    return {
        "jaxstage": __version__,
        "python": platform.python_version(),
        "jax": jax.__version__,
        "jaxlib": jaxlib.version.__version__,
        "backend": jax.default_backend(),
        "devices": [d.device_kind for d in devices],
        "cores": cpu_cores(),
        "cores_used": len(devices) if jax.default_backend() == "cpu" else 0,
        "precision": "double" if jnp.zeros(()).dtype == jnp.float64 else "single",
        "cache": cache_folder(),
        "lane_steps_per_s": speed(),
        "speed_of": f"dfcmac-circle, {LANES} runs at once, all default metrics",
    }


def speed() -> float:
    """Lane-steps per second of the batch engine: `LANES` runs at once, for about a second."""
    case = build("dfcmac-circle", Timing(lap_time=1.0, laps=1))
    slopes = jnp.linspace(0.5, 4.0, LANES)
    gains = replace(case.gains, slope=jnp.stack([slopes, slopes], axis=1))
    axes = replace(jax.tree.map(lambda _: None, case.gains), slope=0)

    def once() -> Any:
        run = rollouts(
            case.loop, gains, case.scenario, case.path, TICKS,
            in_axes=(axes, None, None), tile=LANES // 2,
        )  # fmt: skip
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
