"""Bundles round-trip, and nothing damaged or foreign is ever run."""

import json
import math
import os
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import onnx
import pytest

from renet.bundle import (
    DEFAULT,
    MANIFEST,
    PREVIOUS,
    SHIPPED,
    Bundle,
    pretrained,
    write_bundle,
    write_manifest,
)
from renet.bundle.models import remembers
from renet.errors import RenetError
from renet.files import temporary_path
from renet.models.config import ModelCfg
from renet.models.renet import RENet
from renet.training.export import export_models


def edit(path, change) -> None:
    value = json.loads((path / MANIFEST).read_text())
    change(value)
    (path / MANIFEST).write_text(json.dumps(value))


def test_round_trip(bundle_path, manifest, models):
    bundle = Bundle.load(bundle_path)
    assert replace(bundle.manifest, sha256={}) == manifest
    assert bundle.manifest.robot.default_position[:3] == (0.1, 0.9, -1.8)
    assert set(bundle.manifest.sha256) == {f"{name}.onnx" for name in models}
    write_manifest(bundle_path, manifest)
    with pytest.raises(RenetError, match="sha256 differs"):
        Bundle.load(bundle_path)
    edit(bundle_path, lambda m: m.update(sha256=dict(bundle.manifest.sha256)))
    assert Bundle.load(bundle_path).sha256 == bundle.sha256


@pytest.mark.parametrize("name", ["notes.txt", "extra.onnx", ".manifest.json.partial", "sub/x"])
def test_a_bundle_with_foreign_entries_is_refused(bundle_path, name):
    for companion in ("README.md", ".gitattributes"):
        (bundle_path / companion).touch()
    (bundle_path / ".git").mkdir()
    temporary_path(bundle_path / MANIFEST).touch()  # Of a killed program.
    Bundle.load(bundle_path)
    (bundle_path / name).parent.mkdir(exist_ok=True)
    (bundle_path / name).touch()
    with pytest.raises(RenetError, match=f"holds {name.split('/')[0]}, which"):
        Bundle.load(bundle_path)


@pytest.mark.parametrize("name", [MANIFEST, "actor.onnx", "README.md", PREVIOUS])
def test_a_bundle_with_links_is_refused(bundle_path, name):
    (bundle_path / name).unlink(missing_ok=True)
    (bundle_path / name).symlink_to(pretrained("go1-parkour") / name)
    with pytest.raises(RenetError, match=f"holds {name}, which is a link"):
        Bundle.load(bundle_path)


def test_a_folder_comes_before_the_bundle_that_ships_under_its_name(bundle_path, monkeypatch):
    for name in SHIPPED:
        monkeypatch.chdir(pretrained(name))
        assert Bundle.load(name).path == pretrained(name)
        monkeypatch.chdir(bundle_path.rename(bundle_path.with_name(name)).parent)
        assert Bundle.load(name).path == Path(name)
        bundle_path = bundle_path.with_name(name)
    assert Bundle.load().path == pretrained(DEFAULT)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("go1-parcour", "did you mean go1-parkour"),
        ("someone/walks", "is hf://someone/walks"),
        ("mine", "or go1-parkour or go1-driven or go2-parkour or go2-driven, which ship"),
    ],
)
def test_a_name_of_no_bundle_is_answered_with_what_to_write(tmp_path, monkeypatch, name, words):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RenetError, match=f"^no bundle at {name}: .*{words}"):
        Bundle.load(name)
    with pytest.raises(RenetError) as refused:
        Bundle.load(tmp_path / "nowhere")
    assert "hf://" not in str(refused.value)


def test_missing_folder_missing_model_and_tampered_model(bundle_path, tmp_path):
    with pytest.raises(RenetError, match="no bundle at"):
        Bundle.load(tmp_path / "nowhere")
    (bundle_path / "vision.onnx").unlink()
    with pytest.raises(RenetError, match=r"cannot read the model .*vision\.onnx"):
        Bundle.load(bundle_path)
    data = bytearray((bundle_path / "actor.onnx").read_bytes())
    data[len(data) // 2] ^= 1
    (bundle_path / "actor.onnx").write_bytes(data)
    with pytest.raises(RenetError, match=r"actor\.onnx is not the file the manifest describes"):
        Bundle.load(bundle_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.update(schema=99), "schema 99"),
        (lambda m: m.pop("robot"), "missing required field `robot`"),
        (lambda m: m.update(colour="red"), "there is no field 'colour'"),
        (
            lambda m: m["selector"].update(beta="high"),
            r"selector\.beta: Expected `float`, got",
        ),
        (lambda m: m["robot"]["joints"].reverse(), "joint order"),
        (lambda m: m["proprioception"].pop(), "proprioception differs"),
        (
            lambda m: m["robot"].update(stiffness=[1, "x"]),
            r"\.stiffness\[1\]: Expected `float`",
        ),
        (lambda m: m["robot"].update(action_scale=math.nan), r"action_scale must be a finite"),
        (lambda m: m["robot"].update(action_scale=10**400), r"action_scale: Number out of range"),
        (lambda m: m["robot"].update(action_clip=-1.0), r"robot\.action_clip must be positive"),
        (lambda m: m["robot"].update(stiffness=[-40.0] * 12), r"stiffness must not be negative"),
        (lambda m: m["robot"].update(damping=[1.0] * 11 + [-1.0]), r"damping must not be negative"),
        (lambda m: m["robot"].update(torque_limit=[0.0] * 12), r"torque_limit must be positive"),
        (lambda m: m["robot"].update(lower=[3.0] * 12), r"of FR_hip_joint, 0\.1 rad, must be betw"),
        (lambda m: m["robot"].update(default_position=[0.1] * 11), "12 numbers, it has 11"),
        (lambda m: m["camera"].update(fx=0.0), r"camera\.fx must be positive"),
        (lambda m: m["camera"].update(width=80), r"\(48, 64\), it is \(48, 80\)"),
        (
            lambda m: m["camera"].update(position=[0.3]),
            r"position: Expected `array` of length 3",
        ),
        (lambda m: m.update(history=0), "history must be 1 to 100, got 0"),
        (lambda m: m.update(frames=3), "frames must be 2, got 3"),
        (lambda m: m["robot"].update(joints=[]), r"robot\.joints must not be empty"),
    ],
)
def test_wrong_manifest(bundle_path, change, message):
    edit(bundle_path, change)
    with pytest.raises(RenetError, match=message):
        Bundle.load(bundle_path)


def test_the_shipped_bundle_is_the_one_its_results_name():
    results = (Path(__file__).parents[2] / "benchmarks" / "results" / "shipped").glob("*.json")
    named = [json.loads(path.read_text())["provenance"].get("bundle_hash") for path in results]
    assert {*named} - {None} == {Bundle.load().sha256}  # Those of version 1 have another form.
    page = Path(__file__).parents[2] / "docs" / "results.md"
    assert f"`go1-parkour`, bundle {Bundle.load().sha256[:12]}" in page.read_text()


def test_the_results_of_the_driven_robot_are_those_of_the_bundle_that_ships():
    folder = Path(__file__).parents[2] / "benchmarks" / "results" / "driving"
    names = ("go1-driven", "go1-parkour", "go2-driven", "go2-parkour")
    hashes = {name: set() for name in names}
    for path in folder.glob("*.json"):
        result = json.loads(path.read_text())
        if "bundle_sha256" in result:
            hashes[result["bundle"]].add(result["bundle_sha256"])
        else:
            hashes[result["provenance"]["bundle"]].add(result["provenance"]["bundle_hash"])
    assert hashes == {name: {Bundle.load(name).sha256} for name in hashes}


def test_a_bundle_of_schema_1_loads_and_has_no_memory(bundle_path, tmp_path, networks, manifest):
    """Estimators of then have no input that says whether there is an image."""
    plain = export_models(networks)
    graph = (model := onnx.load_from_string(plain["estimator"])).graph
    graph.input.remove(next(node for node in graph.input if node.name == "has_image"))
    one = onnx.numpy_helper.from_array(np.ones((1, 1), np.float32), "has_image")
    graph.initializer.append(one)
    plain["estimator"] = model.SerializeToString()
    old = write_bundle(tmp_path / "old", plain, manifest)
    edit(old, lambda m: (m.update(schema=1), m["selector"].pop("longest_memory")))
    bundle = Bundle.load(old)
    assert not remembers(bundle.sessions["estimator"])
    assert bundle.manifest.selector.longest_memory == 0.0
    assert remembers(Bundle.load(bundle_path).sessions["estimator"])
    write_manifest(old, bundle.manifest)
    assert json.loads((old / MANIFEST).read_text())["schema"] == 2
    edit(old, lambda m: m["selector"].update(longest_memory=1.0))
    with pytest.raises(RenetError, match=r"estimator.onnx has no input has_image"):
        Bundle.load(old)


def test_models_of_another_architecture(tmp_path, manifest):
    other = export_models(RENet(ModelCfg(history=3), critic_size=10))
    refused = r"proprioception_history.*\(3, 45\).*expected .*\(10, 45\)"
    with pytest.raises(RenetError, match=refused):
        write_bundle(tmp_path / "other", other, manifest)
    path = write_bundle(tmp_path / "other", other, replace(manifest, history=3))
    edit(path, lambda m: m.update(history=10))
    with pytest.raises(RenetError, match=refused):
        Bundle.load(path)


def test_the_current_folder_can_become_a_bundle(tmp_path, manifest, models, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    Bundle.load(write_bundle(Path(), models, manifest))


OTHERS = ("notes.txt", ".git/config", "manifest.json.bak", "actor.onnx.old", "sub/actor.onnx")


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [(name, "years of work", "no part of a bundle") for name in OTHERS]
    + [(MANIFEST, t, "is not a bundle") for t in ('{"name": "x"}', "[]", '{"schema": 2}', "{")],
)
def test_an_export_never_touches_a_folder_that_holds_anything_else(
    tmp_path, bundle_path, manifest, models, name, content, reason
):
    """Beside our own models: another file, or a stranger's manifest in place of ours."""
    (bundle_path / name).parent.mkdir(exist_ok=True)
    (bundle_path / name).write_text(content)
    before = {p: p.read_bytes() for p in bundle_path.rglob("*") if p.is_file()}
    with pytest.raises(RenetError, match=reason):
        write_bundle(bundle_path, models, manifest)
    assert {p: p.read_bytes() for p in bundle_path.rglob("*") if p.is_file()} == before
    assert list(tmp_path.iterdir()) == [bundle_path], "nothing is left beside it"


def test_a_file_is_never_replaced(tmp_path, manifest, models):
    (tmp_path / "chapter.txt").write_text("years")
    with pytest.raises(RenetError, match="not a bundle"):
        write_bundle(tmp_path / "chapter.txt", models, manifest)
    assert (tmp_path / "chapter.txt").read_text() == "years"


def test_links_are_not_followed(tmp_path, bundle_path, manifest, models):
    (tmp_path / "elsewhere").write_bytes(b"mine")
    (bundle_path / "actor.onnx").unlink()
    (bundle_path / "actor.onnx").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(RenetError, match=r"actor\.onnx"):
        write_bundle(bundle_path, models, manifest)
    assert (tmp_path / "elsewhere").read_bytes() == b"mine"


def test_a_bundle_is_replaced_whole_or_not_at_all(bundle_path, manifest, models, monkeypatch):
    old = {p.name: p.read_bytes() for p in bundle_path.iterdir()}
    newer = replace(manifest, provenance=replace(manifest.provenance, iteration=7))
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", Mock(side_effect=OSError(28, "No space left on device")))
        with pytest.raises(RenetError, match="No space left"):
            write_bundle(bundle_path, models, newer)
    assert {p.name: p.read_bytes() for p in bundle_path.iterdir()} == old
    write_bundle(bundle_path, models, newer)
    assert Bundle.load(bundle_path).manifest.provenance.iteration == 7
    assert [*bundle_path.parent.iterdir()] == [bundle_path]
