"""Names and docstrings of the code: python tools/lint_names.py [FOLDER ...], src by default.

A variable, an argument or an attribute is a noun: none is named by a bare participle or an
adjective of `REFUSED`, whatever underscores surround it. A docstring is a full sentence or noun
phrase: none begins with "Of".
"""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

REFUSED = ("found", "own", "known", "asked", "wanted", "told")


def new_name(node: ast.AST) -> str | None:
    """The name that a node binds: of a variable, an argument or an attribute."""
    match node:
        case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
            return name
        case ast.arg(arg=name):
            return name
        case ast.ExceptHandler(name=str(name)) | ast.MatchAs(name=str(name)):
            return name
    return None


def problems(source: str) -> Iterator[tuple[int, str]]:
    """The line and the description of each problem in a module's source."""
    for node in ast.walk(ast.parse(source)):
        name = new_name(node)
        if name is not None and name.strip("_") in REFUSED:
            yield node.lineno, f"'{name}' is no noun: name what it holds"
        match node:
            case ast.Expr(value=ast.Constant(value=str(text))) if text.lstrip().startswith("Of "):
                yield node.lineno, 'a docstring begins with "Of": write a sentence or a noun phrase'


def main(folders: list[str]) -> int:
    """Print the problems of all Python files in the folders; 1 if there are any."""
    lines = [
        f"{path}:{line}: {problem}"
        for folder in folders
        for path in sorted(Path(folder).rglob("*.py"))
        for line, problem in problems(path.read_text())
    ]
    print("\n".join(lines) or "names: all are nouns")
    return bool(lines)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or ["src"]))
