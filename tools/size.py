"""Count lines of code and files in a folder; fail above the limits of size.json.

    python tools/size.py            compare with the limits
    python tools/size.py --lower    write today's numbers where they are below the limits

A change that raises a limit says why.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parent.parent
LIMITS = Path(__file__).with_suffix(".json")
CODE = {".py", ".cpp", ".h"}
WEB = {".js", ".css", ".html"}
PARTS = {"src": (("src",), CODE), "tests": (("tests",), CODE), "web": (("web", "src"), WEB)}
"""Folders and suffixes of what is counted together; the report's templates lie in src."""
ADDITIONS = Path(__file__).with_name("additions.json")
"""Lines that each commit of a new feature since 54c3052 added to src and to tests, less those it
deleted."""


def measure(root: Path = ROOT) -> dict[str, int]:
    """Today's numbers: lines of each part, and code files in the widest folder of src."""
    files = {
        part: [
            path
            for folder in folders
            for path in (root / folder).rglob("*")
            if path.suffix in suffixes and "node_modules" not in path.parts
        ]
        for part, (folders, suffixes) in PARTS.items()
    }
    lines = {f"{part}_lines": sum(map(count_lines, paths)) for part, paths in files.items()}
    features = json.loads(ADDITIONS.read_text()).values()
    for place, part in enumerate(("src", "tests")):
        added = sum(commit[place] for commits in features for commit in commits.values())
        lines[f"{part}_lines_without_features"] = lines[f"{part}_lines"] - added
    widest = max(Counter(path.parent for path in files["src"]).values(), default=0)
    return {**lines, "widest_folder": widest}


def count_lines(path: Path) -> int:
    """All lines of a file, blank ones and comments too."""
    return path.read_text().count("\n")


def main(arguments: list[str], root: Path = ROOT, limits: Path = LIMITS) -> int:
    """Print a line for each number; 1 if one of them is above its limit."""
    limit, sizes = json.loads(limits.read_text()), measure(root)
    above = {name for name in limit if sizes[name] > limit[name]}
    for name, size in sizes.items():
        print(
            f"{name}: {size}",
            f"of {limit[name]}" if name in limit else "",
            "TOO MANY" if name in above else "",
        )
    if "--lower" in arguments:
        lowered = {name: min(most, sizes[name]) for name, most in limit.items()}
        limits.write_text(json.dumps(lowered, indent=2) + "\n")
    return 1 if above else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
