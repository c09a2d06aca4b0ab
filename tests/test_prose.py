"""The length of documents: what counts as a line, a sentence and a word."""

import pytest

from prose import problems


def words(number: int) -> str:
    return "\n".join(["w"] * number)


LONG = "a sentence of 31 words: w w w w w w w w …"


@pytest.mark.parametrize(
    ("text", "most_words", "expected"),
    [
        (f"One.\n\n{'x' * 121}", None, [(3, "121 characters, at most 120")]),
        (f"First.\n{words(31)}.", None, [(2, LONG)]),
        (f"- {words(31)}", None, [(1, LONG)]),
        ("one two three", 2, [(1, "3 words, at most 2")]),
        # Code, cells, items and addresses do not count.
        (f"```\n{words(40)}\n```", None, []),
        (f"{words(29)}. {words(29)}", None, []),
        (f"| {' | '.join(['w w w'] * 11)} |", None, []),
        (f"- {words(20)}\n- {words(20)}", None, []),
        (f"{words(29)} [w](https://example.org/a/b)", None, []),
        (f"{words(29)} `{'w ' * 20}`", None, []),
    ],
)
def test_too_long_is_named_with_its_line(text, most_words, expected):
    assert list(problems(text, most_words)) == expected
