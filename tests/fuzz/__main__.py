"""``python -m tests.fuzz [--cases N] [--seed S] [--kind K]``: random uses, counted by kind.

Ends with status 1 if any case had a traceback, a number that is none, a file left half-written, or
took longer than a minute. A case is made again by its seed: ``--kind K --seed S --cases 1``.
"""

import argparse
import os
import random
import sys
import tempfile
from collections import Counter
from pathlib import Path


def run_case(kind: str, seed: int) -> tuple[str, list[str]]:
    """One case in an empty folder."""
    from tests.fuzz.kinds import KINDS

    with tempfile.TemporaryDirectory(prefix="jaxstage-fuzz-") as name:
        return KINDS[kind][0](random.Random(f"{kind} {seed}"), Path(name))


def main() -> int:
    """Run the cases and print counts and faults; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", default=None)
    words = parser.parse_args()

    from jaxstage.system.runtime import configure
    from tests.fuzz.kinds import KINDS

    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    configure(precision="double", cache="default")
    # every command would configure again, which is too late in a process that computes already
    import jaxstage.system.runtime

    jaxstage.system.runtime.configure = lambda *_, **__: None  # type: ignore[assignment]
    if words.kind is not None and words.kind not in KINDS:
        parser.error(f"--kind {words.kind}: must be one of {', '.join(KINDS)}")
    kinds = [words.kind] if words.kind else list(KINDS)
    whole = sum(KINDS[kind][1] for kind in kinds)
    failures = 0
    for kind in kinds:
        count = max(1, round(words.cases * KINDS[kind][1] / whole))
        ended: Counter[str] = Counter()
        for seed in range(words.seed, words.seed + count):
            how, wrong = run_case(kind, seed)
            ended[how] += 1
            if wrong:
                failures += 1
                print(f"{kind} --seed {seed}: {'; '.join(wrong)}", flush=True)
        counts = ", ".join(f"{n} {how}" for how, n in sorted(ended.items()))
        print(f"{kind:15s} {count:6d} cases: {counts}", flush=True)
    print(f"{failures} cases with a fault")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
