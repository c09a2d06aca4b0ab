"""Result files that somebody sends."""

import json
import sys
from importlib.util import find_spec, module_from_spec

import pytest

from renet.errors import RenetError
from renet.evaluation.benchmark.results import read_result

from .rows import result


def read(tmp_path, content):
    path = tmp_path / "result.json"
    path.write_text(json.dumps(content, default=float))
    return read_result(path)


def test_a_result_is_read(tmp_path):
    assert read(tmp_path, result([2] * 20))["policy"]["name"] == "ours"


def changed(**others):
    return result([2] * 20) | others


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (changed(version=2), "is no result of renet-faults, version 3"),
        (changed(benchmark="other"), "is no result of renet-faults"),
        (changed(episodes="full"), "memory lacks episodes"),
        (changed(scores={"memory": {}, "blind": {}}), "blind lacks episodes"),
        (changed(rows=[{"entry": "memory"}]), "is a required property"),
        (result([3] + [2] * 19), "more obstacles crossed than there are"),
        (changed(policy={"name": 1, "method": "", "robot": "", "sha256": "a"}), "policy"),
    ],
)
def test_other_files_are_refused_in_one_line(tmp_path, content, message):
    with pytest.raises(RenetError, match=message) as error:
        read(tmp_path, content)
    assert "\n" not in str(error.value)


def test_a_number_cannot_be_missing(tmp_path):
    content = result([2] * 20)
    del content["rows"][3]["joules"]
    with pytest.raises(RenetError, match="joules"):
        read(tmp_path, content)


def test_only_a_reader_of_results_needs_their_schemas_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "jsonschema", None)
    spec = find_spec("renet.evaluation.benchmark.results")
    again = module_from_spec(spec)
    spec.loader.exec_module(again)
    with pytest.raises(ModuleNotFoundError, match="jsonschema"):
        again._validator()
