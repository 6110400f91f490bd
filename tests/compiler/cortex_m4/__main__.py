"""``python -m tests.compiler.cortex_m4 [LOOP ...]``: what exported laws need on a Cortex-M4F."""

import sys
import tempfile
from pathlib import Path

import jaxstage as js
from tests.compiler.cortex_m4.machine import build, emulate, needs
from tuning.app.export_folder import CForm, export

#: one loop of each law, whole or for one axis
LOOPS = (
    "cascade-circle", "sliding-circle", "cmac-circle", "dfcmac-circle", "dfcmac-circle:x",
    "asmc-s4", "asmc-mrac", "none", "pid-ccc", "af-pid-ccc",
)  # fmt: skip


def main() -> None:
    """Print a table in Markdown."""
    js.configure(precision="double")
    print("| loop | code | gains | memory | stack | instructions | difference |")
    print("|---|---|---|---|---|---|---|")
    for name in sys.argv[1:] or LOOPS:
        loop, _, axis = name.partition(":")
        with tempfile.TemporaryDirectory() as folder:
            export(js.build(loop), Path(folder), CForm(True, axis or None, "control"))
            found = needs(Path(folder))
            build(Path(folder), "replay.c")
            off = emulate(Path(folder)).split(",")[1].split(": ")[1]
        print(f"| {name} | " + " | ".join(map(str, found)) + f" | {off} |", flush=True)


main()
