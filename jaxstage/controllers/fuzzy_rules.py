"""Fuzzy rule bases of a controller as text, before and after a run."""

from typing import Any, TypeVar

import jax
import numpy as np

from jaxstage.controllers.fuzzy_pid_contour import FuzzyPidContour, FuzzyPidMemory
from jaxstage.controllers.parts.fuzzy import REACH, rules_text

T = TypeVar("T")

#: field of the rules -> what they give
OUTPUTS = {"proportional": "K_P in 1/s2", "integral": "K_I in 1/s3", "derivative": "K_D in 1/s"}


def readable(gains: Any, memory: Any) -> str | None:
    """All fuzzy rules among the gains of a controller, at the start and at the end of a run.

    Args:
        gains: of one controller, composed or not.
        memory: of the same controller at the last tick, such as ``run.final.memory``.

    Returns:
        The rule bases as text, or None where the gains hold no fuzzy rules.
    """
    laws, memories = fuzzy_laws(gains), _of(FuzzyPidMemory, memory)
    texts = [_text(law, end) for law, end in zip(laws, memories, strict=True)]
    return "\n\n".join(texts) + "\n" if texts else None


def fuzzy_laws(gains: Any) -> list[FuzzyPidContour]:
    """Gains of every fuzzy law among those of a controller, composed or not."""
    return _of(FuzzyPidContour, gains)


def _of(kind: type[T], tree: Any) -> list[T]:
    leaves = jax.tree.leaves(tree, is_leaf=lambda node: isinstance(node, kind))
    return [leaf for leaf in leaves if isinstance(leaf, kind)]


def _text(gains: FuzzyPidContour, memory: FuzzyPidMemory) -> str:
    scales = gains.scales
    parts = [
        f"X1 = {REACH:g} tanh(-E / {float(scales.deviation) * 1e6:g} um), "
        f"X2 = {REACH:g} tanh(-E' / {float(scales.rate) * 1e3:g} mm/s)\n"
        "E >= 0: contour error, E': its rate\n"
        + "\n".join(
            f"sets of {name}: centres {' '.join(f'{c:g}' for c in np.asarray(sets.centres))}, "
            f"width {float(sets.width):.4g}"
            for name, sets in (("X1", gains.error_sets), ("X2", gains.rate_sets))
        )
    ]
    for field, output in OUTPUTS.items():
        for when, rules in (("start", gains.rules), ("end", memory.learned)):
            parts.append(rules_text(getattr(rules, field), f"{output}, at the {when}"))
    return "\n\n".join(parts)
