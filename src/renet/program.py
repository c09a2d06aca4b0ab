"""The program whose command line is renet's: `renet`, or a user's own, which registers tasks."""

import sys
from pathlib import Path

_command = [sys.executable, "-m", "renet"]
"""Command line, without arguments, that `own_program` returns."""


def remember_program() -> None:
    """Note that the command line of this process is renet's.

    From then on `own_program` returns its program. Any other one, such as a loop over trainings,
    might do anything if it were started again.
    """
    global _command
    main = sys.modules["__main__"]
    spec = getattr(main, "__spec__", None)
    file = getattr(main, "__file__", None)
    # With `python -m`, imports relative to the package need the module's name.
    if spec is not None:
        _command = [sys.executable, "-m", spec.name.removesuffix(".__main__")]
    elif file is not None:
        _command = [sys.executable, str(Path(file).absolute())]


def own_program() -> list[str]:
    """Return the beginning of a command line that runs renet with the tasks of this process."""
    return list(_command)
