"""The length of documents: what counts as a line, a sentence and a word."""

import pytest

from prose import problems


def words(number: int) -> str:
    return "\n".join(["w"] * number)


@pytest.mark.parametrize(
    ("text", "most_words", "problem"),
    [
        (f"One.\n\n{'x' * 121}", None, (3, "121 characters, at most 120")),
        (f"First.\n{words(31)}.", None, (2, "a sentence of 31 words: w w w w w w w w …")),
        (f"- {words(31)}", None, (1, "a sentence of 31 words: w w w w w w w w …")),
        ("one two three", 2, (1, "3 words, at most 2")),
    ],
)
def test_too_long_is_named_with_its_line(text, most_words, problem):
    assert list(problems(text, most_words)) == [problem]


@pytest.mark.parametrize(
    "text",
    [
        f"```\n{words(40)}\n```",
        f"{words(29)}. {words(29)}",
        f"| {' | '.join(['w w w'] * 11)} |",
        f"- {words(20)}\n- {words(20)}",
        f"{words(29)} [w](https://example.org/a/b)",
        f"{words(29)} `{'w ' * 20}`",
    ],
)
def test_code_cells_items_and_addresses_are_not_counted(text):
    assert list(problems(text)) == []
