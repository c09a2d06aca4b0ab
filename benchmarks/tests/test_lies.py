"""The comparison with and without monitors of expected images: counting, bundles without them."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import lies
from lies import Cfg, count_alarms, main, summarise, without_expectation
from renet.bundle import Bundle, write_bundle
from renet.errors import RenetError
from renet.models.config import ModelCfg
from renet.models.renet import RENet
from renet.selector.monitors import MONITORS
from renet.training.export import export_models


def test_two_surprising_images_in_a_row_are_one_alarm_and_each_is_withheld():
    run = np.full(36_000, 0.3)
    run[100] = 2.0
    run[1000:1002] = 2.0
    run[2000:2005] = 3.0
    counts = count_alarms(MONITORS["surprise"], [run, np.full(36_000, 0.3)], 2.0)
    assert counts["hours"] == pytest.approx(2.0)
    assert counts["alarms"] == 2
    assert counts["alarms_per_hour"] == pytest.approx(1.0)
    assert counts["images_withheld_per_hour"] == pytest.approx(4.0)
    assert count_alarms(MONITORS["stillness"], [run], 2.0)["alarms"] == 3


def study(crossed: dict[str, float], by_robot: list[float]) -> dict:
    runs = []
    for mode, share in crossed.items():
        measures = {"crossed": {"value": share}}
        runs.append({"fault": "turned", "mode": mode, "measures": measures})
    return {"runs": runs, "by_robot": {"memory": {"gap": {"crossed": by_robot}}}}


def test_the_gain_is_paired_by_robot():
    studies = {
        "with": study({"camera": 0.2, "memory": 0.75}, [1.0, 0.5, 1.0, 0.5]),
        "without": study({"memory": 0.25}, [0.5, 0.0, 0.5, 0.0]),
    }
    summary = summarise(studies, {}, {"surprise": 2.0})
    assert summary["gain"] == pytest.approx(0.5)
    assert summary["gain_ci95"] == pytest.approx([0.5, 0.5])
    row = {"fault": "turned", "camera": 0.2, "memory_with": 0.75, "memory_without": 0.25}
    assert summary["runs"] == [row]
    assert summary["gain_unseen"] is None


def test_faults_that_nobody_looked_at_are_summed_up_apart():
    studies = {}
    for name, shares in (("with", (0.8, 0.5)), ("without", (0.2, 0.4))):
        seen, unseen = (study({"memory": share}, [share]) for share in shares)
        unseen["runs"][0]["fault"] = lies.UNSEEN[0]
        studies[name] = seen | {"runs": seen["runs"] + unseen["runs"]}
    assert summarise(studies, {}, {})["gain_unseen"] == pytest.approx(0.1)


def test_a_bundle_without_the_monitor_is_the_same_otherwise(tmp_path: Path):
    networks = RENet(ModelCfg(detector="variance", expect_image=True), critic_size=10).eval()
    shipped = Bundle.load()
    limits = {"surprise": 2.0, "stillness": 0.5, "variance": 9.0}
    selector = replace(shipped.manifest.selector, thresholds=limits)
    manifest = replace(shipped.manifest, selector=selector)
    path = write_bundle(tmp_path / "expecting", export_models(networks), manifest)
    expecting = Bundle.load(path)
    other = Bundle.load(without_expectation(expecting, tmp_path / "other"))
    assert other.manifest.sha256 == expecting.manifest.sha256
    assert other.manifest.selector == replace(selector, thresholds={"variance": 9.0})


def test_a_bundle_that_expects_nothing_and_a_study_that_fails_are_named(monkeypatch, tmp_path):
    with pytest.raises(RenetError, match="go1-parkour has no threshold of surprise or stillness"):
        main(Cfg(Path("go1-parkour")))
    failed = SimpleNamespace(returncode=2, stderr=b"renet: no such fault\n")
    monkeypatch.setattr(lies.subprocess, "run", lambda *arguments, **options: failed)
    with pytest.raises(RenetError, match=r"evaluate faults .* failed: renet: no such fault"):
        lies.study(Path("b"), Cfg(Path("b")), ("memory",), tmp_path)
