# SPDX-License-Identifier: BSD-3-Clause
"""The application: its commands, and what becomes of errors.

Exit codes: 0 success; 2 bad usage or bad input, with one line that says what and where; 1 a failure of our own;
130 Ctrl-C, where that is not the usual end (live, replay).
"""

from __future__ import annotations

import errno
import gc
import os
import sys
import traceback
from collections.abc import Callable, Sequence
from typing import Any

import typer

from ..errors import ComanError
from ..resources import version
from .archive import archive
from .baseline import baseline
from .check import check
from .config import config
from .demo import demo
from .diagnose import diagnose
from .export import export
from .identify import identify
from .init import init
from .interrupt import answered, came, listen
from .isolability import isolability
from .judge import judge
from .live import live
from .missing import remedy
from .predict import predict
from .record import record
from .replay import replay
from .report import report
from .tune import tune
from .validate import validate
from .view import view
from .worlds import worlds

app = typer.Typer(
    name="coman",
    help="Online prediction of the centre of mass of a compliant humanoid.",
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)
# Groups of commands as `coman --help` shows them, each with the example at the end of its own help.
_COMMANDS: dict[str, dict[Callable[..., None], str]] = {
    "Your robot": {
        init: "coman init --urdf config/coman.urdf --bag bags/test1 --out my_robot.yaml",
        config: "coman config my_robot.yaml --set monitor.threshold=7",
        check: "coman check bags/test1 --config my_robot.yaml",
    },
    "Predictions and diagnosis of recorded bags": {
        predict: "coman predict bags/test1 --config my_robot.yaml --out result",
        report: "coman report result",
        view: "coman view bags/test1 --out walk.rrd",
        diagnose: "coman diagnose bags/test1 --holdout bags/test2 --out found",
        isolability: "coman isolability bags/test1 bags/test2 --size 0.3",
        export: "coman export found/model.yaml --mjcf my_robot.xml --out found.xml",
        baseline: "coman baseline bags/test1 bags/test2 --out my_robot_usual.yaml",
    },
    "Parameters of the model": {
        identify: "coman identify load decay --out identified.yaml",
        tune: "coman tune bags/test1 --out tuned.yaml",
        validate: "coman validate bags/test1 --holdout bags/test2 --out validated",
    },
    "Virtual robots": {
        record: "coman record --gait test1 --duration 10 --out walk --hide backlash:where=LKneeSag,width=0.01",
        worlds: "coman worlds creeping",
        judge: "coman judge prediction --out judged --seeds 0:1",
    },
    "ROS 2": {
        live: "coman live --duration 60",
        demo: "coman demo --rate 1",
        replay: "coman replay bags/test1 --rate 0.5 --await joint_states",
    },
}
for group, commands in _COMMANDS.items():
    for command, example in commands.items():
        app.command(rich_help_panel=group, epilog=f"Example: `{example}`")(command)

app.add_typer(
    archive,
    name="archive",
    rich_help_panel="Predictions and diagnosis of recorded bags",
    epilog="Example: `coman archive walks --predict --diagnose --out results`",
)

# typer brings its own click; its exceptions are found by way of one that it makes public.
_CLICK_ERROR: Any = typer.BadParameter.__mro__[2]
_OUR_FAULT = (errno.ENOSPC, errno.EIO, errno.ENOMEM, errno.EDQUOT, errno.EMFILE, errno.ENFILE)


def _version(value: bool) -> None:
    if value:
        print(f"coman {version()}")
        raise typer.Exit()


@app.callback()
def _main(
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Print the version."),
) -> None:
    """Online prediction of the centre of mass of a compliant humanoid."""


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command line and return its exit code; without arguments, print the help."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        command = typer.main.get_command(app)
        result = command.main(args=given or ["--help"], prog_name="coman", standalone_mode=False)
        sys.stdout.flush()
        return result if isinstance(result, int) else 0
    except typer.Exit as error:
        return error.exit_code
    except (KeyboardInterrupt, typer.Abort):
        return 130
    except ComanError as error:
        return _say(str(error), 2)
    except BrokenPipeError:  # `coman ... | head`: nobody reads on, which is no error
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _say(f"{where}{error.strerror or error}", 1 if error.errno in _OUR_FAULT else 2)
    except _CLICK_ERROR as error:
        return _say(error.format_message() or "see --help", 2)
    except Exception as error:
        if isinstance(error, ModuleNotFoundError) and (line := remedy(error)):
            return _say(line, 2)
        if came():
            return 130
        traceback.print_exc()
        return _say("internal error, please report the lines above", 1)


def _say(sentence: str, code: int) -> int:
    print(f"coman: {' '.join(sentence.split())}", file=sys.stderr)
    return code


def main() -> None:
    """Entry point."""
    listen()
    try:
        code = run()
    except KeyboardInterrupt:  # a second time, between its being handled and here
        code = 130
    answered()  # all is done; while Python ends, a Ctrl-C would change the exit code
    gc.freeze()  # else Python, as it ends, looks once more through all that numba has loaded
    sys.exit(code)


if __name__ == "__main__":
    main()
