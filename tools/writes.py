"""Find code in src that writes, renames or deletes files beside files.py and folders.py.

    python tools/writes.py

prints each place, and fails if there is any.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1] / "src" / "renet"
ALLOWED = {"files.py", "folders.py"}
METHODS = re.compile(
    "write_text|write_bytes|touch|unlink|rmdir|rmtree|removedirs|rename|copytree|copyfile|copy2"
    "|symlink_to|hardlink_to|mkdtemp|mkstemp|NamedTemporaryFile|memmap|tofile|savez|save_file"
)
"""Names of functions and methods that write, whatever they belong to."""
FUNCTIONS = re.compile(
    r"os\.(remove|replace|truncate|link|symlink)|shutil\.(copy|move)|np\.save(txt)?|torch\.save"
)
FLAGS = {"O_CREAT", "O_WRONLY", "O_RDWR", "O_TRUNC", "O_APPEND"}


def writes(source: str) -> Iterator[tuple[int, str]]:
    """Line and code of every call in a module that may write, rename or delete a file."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and _writes(node):
            yield node.lineno, ast.unparse(node)


def _writes(call: ast.Call) -> bool:
    code = ast.unparse(call.func)
    # A file in memory has no name, and what is written to nowhere is kept by nobody.
    if any(name in ast.unparse(call) for name in ("os.memfd_create", "os.devnull")):
        return False
    name = code.rpartition(".")[2]
    if METHODS.fullmatch(name) or FUNCTIONS.fullmatch(code):
        return True
    if name == "replace":  # Path's has one argument, str's two, a dataclass' and a date's keywords.
        return len(call.args) == 1 and not call.keywords
    if name == "savefig":  # A format is given with a buffer; a path's ending says it.
        return all(keyword.arg != "format" for keyword in call.keywords)
    if code == "os.open":
        return any(flag in ast.unparse(call) for flag in FLAGS)
    if name == "open":
        values = [*call.args[:2], *(k.value for k in call.keywords if k.arg == "mode")]
        modes = [v.value for v in values if isinstance(v, ast.Constant)]
        return any(re.fullmatch("[rwaxbt+]*[wax+][rwaxbt+]*", str(mode)) for mode in modes)
    return False


def main() -> int:
    """Print a line for each place; 1 if there is any."""
    places = [
        f"{path.relative_to(ROOT.parent)}:{line}: {code[:80]}"
        for path in sorted(ROOT.rglob("*.py"))
        if path.relative_to(ROOT).as_posix() not in ALLOWED
        for line, code in writes(path.read_text())
    ]
    print("\n".join(places) or "all writing goes through files.py and folders.py")
    return 1 if places else 0


if __name__ == "__main__":
    sys.exit(main())
