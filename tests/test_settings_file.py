"""Configuration files: plain values alone, and numbers as everybody writes them."""

import json

import pytest

from renet.errors import RenetError
from renet.settings_file import read_settings


def test_yaml_and_json_say_the_same(tmp_path):
    wanted = {"task": "Renet-Go1-Flat", "agent": {"algorithm": {"learning_rate": 0.001}}}
    (tmp_path / "a.json").write_text(json.dumps(wanted))
    (tmp_path / "a.yaml").write_text(
        "task: Renet-Go1-Flat\nagent:\n  algorithm:\n    learning_rate: 1e-3\n"
    )
    assert read_settings(tmp_path / "a.json") == wanted
    assert read_settings(tmp_path / "a.yaml") == wanted


@pytest.mark.parametrize("text", ["1e-3-lr", "3e4f5a9b", "2e5 robots"])
def test_a_text_that_begins_like_a_number_is_a_text(tmp_path, text):
    (tmp_path / "a.json").write_text(json.dumps({"agent": {"run_name": text}}))
    (tmp_path / "a.yaml").write_text(f"agent:\n  run_name: {text}\n")
    assert read_settings(tmp_path / "a.yaml") == read_settings(tmp_path / "a.json")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.toml", "", "give a .json, .yaml or .yml file"),
        ("a.yaml", "- 1\n", "must map names to values"),
        ("a.yaml", "a: [1", "is no YAML"),
        ("a.yaml", "!!python/object/apply:os.system ['true']", "is no YAML"),
        ("a.json", "{", "is not JSON"),
        ("a.json", "[1]", "must hold a JSON object"),
        ("b.yaml", None, "cannot read the configuration"),
    ],
)
def test_other_files_are_told_in_a_line(tmp_path, name, text, message):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(RenetError, match=message) as told:
        read_settings(tmp_path / name)
    assert "\n" not in str(told.value)
