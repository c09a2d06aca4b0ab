"""JSON becomes dataclasses, and one line says what is wrong with it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import pytest

from renet.conversion import MAX_TEXT, from_json
from renet.errors import RenetError


@dataclass(frozen=True)
class Leg:
    length: float

    def __post_init__(self) -> None:
        if self.length < 0.0:
            raise RenetError(f"length must not be negative, got {self.length:g}")


@dataclass(frozen=True)
class Animal:
    name: str
    legs: tuple[Leg, ...] = ()
    ears: int = 2
    weights: Mapping[str, float] = field(default_factory=dict)


def convert(value):
    return from_json(Animal, value, "the animal cat.json", "draw it anew")


def test_nested_values():
    animal = convert({"name": "cat", "legs": [{"length": 1}], "weights": {"head": 2}})
    assert animal == Animal("cat", (Leg(1.0),), weights={"head": 2.0})
    assert type(animal.legs[0].length) is float


@pytest.mark.parametrize(
    ("value", "problem"),
    [
        ([], "Expected `object`, got `array`"),
        ({}, "Object missing required field `name`"),
        ({"name": "cat", "tail": 1}, "there is no field 'tail'"),
        (
            {"name": "cat", "legs": [{"length": 1.0}, {"length": 1.0, "toes": 5}]},
            "there is no field 'legs[1].toes'",
        ),
        ({"name": "cat", "legs": [{"length": "1"}]}, "legs[0].length: Expected `float`, got `str`"),
        ({"name": "cat", "legs": [{"length": -1}]}, "length must not be negative, got -1"),
        ({"name": "cat", "ears": 2.0}, "ears: Expected `int`, got `float`"),
        ({"name": "cat", "ears": True}, "ears: Expected `int`, got `bool`"),
        (
            {"name": "cat", "weights": {"head": float("inf")}},
            "weights.head must be a finite number",
        ),
        ({"name": "cat\x1b[2J"}, f"name must be at most {MAX_TEXT} printable characters"),
        ({"name": "c" * (MAX_TEXT + 1)}, f"name must be at most {MAX_TEXT} printable characters"),
        ({"name": "cat", "ta\nil": 1}, "there is no field 'ta\N{REPLACEMENT CHARACTER}il'"),
    ],
)
def test_the_line_names_source_field_and_remedy(value, problem):
    with pytest.raises(RenetError) as error:
        convert(value)
    assert str(error.value) == f"cannot use the animal cat.json: {problem}; draw it anew"
