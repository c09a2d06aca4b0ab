"""What `renet bundle inspect` prints of a bundle."""

import dataclasses
import math

import pytest

from renet.bundle import SHIPPED, pretrained, read_manifest
from renet.bundle.inspect import FIELD_UNITS, InspectCfg, field_rows, input_rows, inspect


def test_every_field_has_a_line_and_every_unit_a_field():
    manifest = read_manifest(pretrained("go2-parkour"))
    fields = set()
    for part in (manifest.provenance, manifest.selector, manifest.camera):
        rows = {name: (value, unit) for name, value, unit in field_rows(part)}
        for field in dataclasses.fields(part):
            fields.add(field.name)
            assert any(name.split(".")[0] == field.name for name in rows)
    assert FIELD_UNITS.keys() <= fields
    camera = {name: (value, unit) for name, value, unit in field_rows(manifest.camera)}
    ahead, left, up = map(float, camera["position"][0].split(", "))
    assert math.dist((ahead, left, up), manifest.camera.position) < 1e-6
    assert camera["position"][1].startswith("m: ahead, left, up")
    assert camera["pitch"] == ("0.4", "rad, downward")
    thresholds = {row[0]: float(row[1]) for row in field_rows(manifest.selector) if "." in row[0]}
    assert len(thresholds) == len(manifest.selector.thresholds)


@pytest.mark.parametrize("name", SHIPPED)
def test_nothing_is_printed_as_python_writes_it(name, capsys):
    inspect(InspectCfg(pretrained(name)))
    told = capsys.readouterr().out
    for words in ("Spec(", "{'", "=None", "float64"):
        assert words not in told


def test_the_command_is_named_as_the_policy_is_told_it():
    for name, last in (("go1-parkour", "cos(c_yaw - yaw)"), ("go1-driven", "omega_z")):
        rows = input_rows(read_manifest(pretrained(name)))
        assert [row[0] for row in rows] == list(range(45))
        assert rows[8][1] == f"command {last}"
