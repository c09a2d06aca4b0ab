"""The table's trainer: goes on after a kill, judges the checkpoint, and never invents a number."""

from __future__ import annotations

import importlib.util
import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from renet.errors import RenetError
from renet.evaluation.studies.terrain import TerrainStudy
from renet.training import checkpoint as checkpoints

PATH = Path(__file__).parents[2] / "benchmarks" / "table1.py"
SPEC = importlib.util.spec_from_file_location("table1", PATH)
assert SPEC is not None
assert SPEC.loader is not None
table1 = sys.modules["table1"] = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(table1)

STUDY = TerrainStudy(levels=(1,), robots=1, seconds=1.0)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """The Oracle, killed after one iteration of two, then run to its end with another row."""
    # 8 robots take 12,800 steps an iteration by the recipe; 25 control steps of each do here.
    out = tmp_path_factory.mktemp("table1")
    with pytest.MonkeyPatch.context() as patch:
        short = lambda self, row, made=table1.Cfg.training: replace(  # noqa: E731
            made(self, row), num_steps_per_env=25, max_iterations=2
        )
        patch.setattr(table1.Cfg, "training", short)
        cfg = table1.Cfg(out=out, rows=("Oracle", "Cheng"), steps=400, num_envs=8, study=STUDY)
        killed = replace(short(cfg, table1.ROWS[0]), max_iterations=1)
        table1.train(killed)
        first = checkpoints.load_state(table1.newest(cfg, table1.ROWS[0]))
        half = table1.table(cfg), table1.status(cfg)
        table1.main(cfg)
        yield cfg, first, half


def test_goes_on_from_where_it_was_killed(done) -> None:
    cfg, first, _ = done
    last = checkpoints.load_state(table1.newest(cfg, table1.ROWS[0]))
    assert (first["iteration"], first["steps"]) == (1, 200)
    assert (last["iteration"], last["steps"]) == (2, 400)
    assert len(list((cfg.out / "oracle" / "run").glob("*/*"))) == 1, "one run, not two"


def test_an_unfinished_row_is_missing(done) -> None:
    _, _, (table, status) = done
    assert table.count("missing") == 2 * 11
    assert "Oracle       0.00 M of 0.0004 M steps, not judged" in status


def test_prints_what_the_study_measured_beside_the_papers(done) -> None:
    cfg, _, _ = done
    summary = json.loads((cfg.out / "oracle" / "terrain" / "summary.json").read_text())
    oracle, cheng = table1.table(cfg).splitlines()[2:]
    assert f"{summary['levels']['gap']:.2f} (9.96)" in oracle
    assert f"{summary['lin_vel_reward']:.3f} (0.5948)" in oracle
    assert "missing" not in oracle
    assert cheng.count("missing") == 11
    assert {run["mode"] for run in summary["runs"]} == {"vp"}
    assert "judged" in table1.status(cfg)


def test_nothing_is_done_twice(done, monkeypatch) -> None:
    cfg, _, _ = done
    monkeypatch.setattr(table1, "train", lambda cfg: pytest.fail("trained again"))
    monkeypatch.setattr(table1, "judge_row", lambda *a: pytest.fail("judged again"))
    table1.main(cfg)


def test_a_damaged_or_foreign_folder_is_refused(done, tmp_path) -> None:
    cfg, _, _ = done
    shutil.copytree(cfg.out, tmp_path, dirs_exist_ok=True)
    with pytest.raises(RenetError, match="another model, seed"):
        table1.train_row(replace(cfg, out=tmp_path, seed=2), table1.ROWS[0])


def test_every_row_differs_from_the_recipe_in_what_it_names() -> None:
    cfg = table1.Cfg()
    base = cfg.training(next(row for row in table1.ROWS if row.name == "SA"))
    for row in table1.ROWS:
        if row.model is None:
            with pytest.raises(RenetError, match="nothing here trains"):
                cfg.training(row)
            continue
        ours = cfg.training(row)
        changed = {k for k, v in vars(ours.model).items() if v != getattr(base.model, k)}
        assert changed == set(row.model)
        assert replace(ours, model=base.model, log_root=base.log_root) == base


def test_budget_is_reached_and_not_by_more_than_an_iteration() -> None:
    cfg = table1.Cfg().training(table1.ROWS[0])
    total = sum(512 * n for n in [table1.steps_per_env(None, 12800, 512, 0)])
    assert table1.iterations(replace(cfg, batch_size=12800), 15e6) == -(-15_000_000 // total)


def test_unknown_rows_are_refused() -> None:
    with pytest.raises(RenetError, match="unknown row 'Nobody'"):
        table1.Cfg(rows=("Nobody",))
