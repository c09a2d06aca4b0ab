"""Length of the documents: python tools/prose.py [FILE ...], all tracked pages by default.

No line has more than 120 characters and no sentence more than 30 words; README and the notes have
a limit of words. Code and addresses of links are no words; a table's cell is a sentence.
"""

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

LONGEST_LINE, LONGEST_SENTENCE = 120, 30
MOST_WORDS = {"README.md": 500, "benchmarks/NOTES.md": 3000}
EXEMPT = {"CHANGELOG.md"}
ENDS = r"\n\s*\n|\n(?=\s*(?:[-*#>|]|\d+\.)\s?)|\||[.!?](?=[\s*)]|$)"
"""What ends a sentence: a blank line, a list item, a heading, a cell, or a mark."""


def sentences(text: str) -> Iterator[tuple[int, list[str]]]:
    """Line number and words of each sentence of a Markdown text."""
    blocks = re.compile(r"^```.*?^```|^\$\$.*?^\$\$", re.DOTALL | re.MULTILINE)
    text = blocks.sub(lambda block: "\n" * block[0].count("\n"), text)
    text = re.sub(r"`[^`\n]*`|\$[^$\n]+\$", "code", text)
    text = re.sub(r"!?\[([^]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"\b(e\.g|i\.e|et al|eq|Fig|vs)\.", r"\1", text)
    start = 0
    for end in [*re.finditer(ENDS, text), None]:
        sentence = text[start : end.start() if end else len(text)]
        line = text.count("\n", 0, start + len(sentence) - len(sentence.lstrip())) + 1
        yield line, re.findall(r"\w[\w'’.,/-]*", sentence)
        start = end.end() if end else start


def problems(text: str, most_words: int | None = None) -> Iterator[tuple[int, str]]:
    """Line number and description of what is too long in a page."""
    if most_words is not None and len(text.split()) > most_words:
        yield 1, f"{len(text.split())} words, at most {most_words}"
    for number, line in enumerate(text.splitlines(), 1):
        if len(line) > LONGEST_LINE and "|---" not in line:
            yield number, f"{len(line)} characters, at most {LONGEST_LINE}"
    for number, words in sentences(text):
        if len(words) > LONGEST_SENTENCE:
            yield number, f"a sentence of {len(words)} words: {' '.join(words[:8])} …"


def main(files: list[str]) -> int:
    """Print the problems of all pages; 1 if there are any."""
    listing = ["git", "ls-files", "*.md", ":!benchmarks/results"]
    tracked = subprocess.check_output(listing, text=True).splitlines()
    lines = [
        f"{page}:{line}: {problem}"
        for page in files or [name for name in tracked if name not in EXEMPT]
        for line, problem in problems(Path(page).read_text(), MOST_WORDS.get(page))
    ]
    print("\n".join(lines) or "prose: no line, sentence or page is too long")
    return bool(lines)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
