"""A study's progress in the terminal, with the time that is left."""

from collections.abc import Iterable
from typing import TypeVar

from rich.console import Console
from rich.progress import track

console = Console(stderr=True)
Step = TypeVar("Step")


def progress(steps: Iterable[Step], title: str) -> Iterable[Step]:
    """The steps one after the other, beside a bar on standard error."""
    return track(steps, f"{title:<24}", console=console)
