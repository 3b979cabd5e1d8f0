# SPDX-License-Identifier: BSD-3-Clause
"""What the diagnosis says of recordings of real robots, and of the nominal robot of another simulation.

    python bench/real.py ../shared/real/icub_walk config/icub.yaml ../shared/real/icub_yoga/raw ROBOT.yaml

Nothing was chosen on these recordings, and nobody knows that the real robots were ever nominal: what is said is
reported, right or wrong. That of the other simulation (`other_robot`) is nominal, and its soles creep.

Others established that the iCub on one leg (`icub_yoga`) has wrench axes pitched by some 10 degrees on both feet, lost
motion of 4 to 7 mrad in the right hip pitch, soles that differ by 1.4 degrees by the encoders, and, in `raw`, zeros of
the foot sensors of hundreds of newtons; and that the wrenches of the walking iCub (`icub_walk`) are 30 to 60 ms late.
"""

from __future__ import annotations

import contextlib
import io
import sys
import tempfile
from pathlib import Path

from coman_reduced_model.cli.main import run


def main() -> None:
    """Print what `coman diagnose` prints of each recording."""
    for bag, config in zip(sys.argv[1::2], sys.argv[2::2], strict=True):
        with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()) as printed:
            code = run(["diagnose", bag, "--config", config, "--out", str(Path(folder) / "out")])
        if code:
            sys.exit(code)
        print(f"{bag}\n{printed.getvalue().partition('written:')[0]}", flush=True)


if __name__ == "__main__":
    main()
