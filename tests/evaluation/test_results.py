"""Results as text, and the command that made them."""

import csv
import sys

from renet.evaluation.results import Provenance, as_text, table_rows, write_csv, write_summary


def test_numbers_are_scaled_and_what_was_not_measured_is_a_dash():
    assert as_text(0.1234, ".1f", 100) == "12.3"
    assert as_text(2.0, ".2f") == "2.00"
    assert as_text(0.0, ".0f") == "0"
    assert as_text(None, ".2f") == "-"


def test_a_column_that_holds_a_list_in_any_row_is_in_no_row_of_a_table(tmp_path):
    runs = [
        {"mode": "camera", "done": [0.5, 0.0, 0.1], "power": 80.0},
        {"mode": "blind", "done": None, "power": None},
    ]
    for order in (runs, runs[::-1]):
        write_csv(tmp_path / "summary.csv", table_rows(order))
        with (tmp_path / "summary.csv").open() as file:
            rows = list(csv.DictReader(file))
        powers = {row["mode"]: row["power"] for row in rows}
        assert powers == {"camera": "80.0", "blind": ""}
        assert "done" not in rows[0]


def test_a_command_with_bytes_that_are_no_utf_8_can_be_written(tmp_path, monkeypatch):
    # Python reads the argument b"Stra\xdfe", in Latin-1, with a surrogate.
    monkeypatch.setattr(sys, "argv", ["/bin/renet", "demo", "--out", "Stra\udcdfe", "Straße"])
    origin = Provenance("b", "0", "native", 1)
    assert origin.command == "renet demo --out 'Stra\N{REPLACEMENT CHARACTER}e' 'Straße'"
    assert origin.line.encode().decode() == origin.line
    write_summary(tmp_path / "summary.md", "title", [], [], origin)
    assert "Straße" in (tmp_path / "summary.md").read_text(encoding="utf-8")
