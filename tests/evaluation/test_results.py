"""Numbers of results as text."""

from renet.evaluation.results import as_text


def test_numbers_are_scaled_and_what_was_not_measured_is_a_dash():
    assert as_text(0.1234, ".1f", 100) == "12.3"
    assert as_text(2.0, ".2f") == "2.00"
    assert as_text(0.0, ".0f") == "0"
    assert as_text(None, ".2f") == "-"
