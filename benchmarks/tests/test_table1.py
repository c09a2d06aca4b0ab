"""The table's trainer: goes on after a kill, judges the checkpoint, and never invents a number."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

import renet
import table1
from renet.errors import RenetError
from renet.evaluation.studies.terrain import TerrainStudy
from renet.training import checkpoint as checkpoints
from renet.training.provenance import to_json

STUDY = TerrainStudy(levels=(1,), robots=1, seconds=1.0, conditions="nominal")


ORACLE, ZHUANG = (next(r for r in table1.ROWS if r.name == n) for n in ("Oracle", "Zhuang"))


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """The Oracle, killed after one iteration of two, then run to its end beside an empty row."""
    out = tmp_path_factory.mktemp("table1")
    small = {"steps": 400, "num_envs": 8, "num_steps_per_env": 25}
    cfg = table1.Cfg(out=out, results=out / "results", rows=("Oracle",), study=STUDY, **small)
    begun = cfg.training(ORACLE, ORACLE.stages[0])
    begun.agent.max_iterations = 1
    table1.train(begun)
    first = checkpoints.load_state(table1.newest(cfg, ORACLE, ORACLE.stages[0]))
    both = replace(cfg, rows=("Oracle", "Cheng"))
    half = table1.table(both), table1.status(both)
    table1.main(cfg)
    return both, first, half


def test_goes_on_from_where_it_was_killed(done) -> None:
    cfg, first, _ = done
    last = checkpoints.load_state(table1.newest(cfg, ORACLE, ORACLE.stages[0]))
    assert (first["iteration"], first["steps"]) == (1, 200)
    assert (last["iteration"], last["steps"]) == (2, 400)
    assert len(list((cfg.out / "oracle" / "run").glob("*/*"))) == 1, "one run, not two"


def test_an_unfinished_row_is_missing(done) -> None:
    _, _, (table, status) = done
    assert table.count("missing") == 2 * 11
    assert "Oracle       0.00 M of 0.0004 M steps, not judged" in status


class Trainer:
    """Stands for `renet train`: writes the state a stage ends with, and is killed in one of them.

    300 seconds and as many steps as an iteration takes each.
    """

    def __init__(self, killed_in: str = "") -> None:
        self.killed_in, self.runs = killed_in, []

    def __call__(self, cfg) -> None:
        name = cfg.log_root.name
        self.runs.append(name)
        self.last = cfg
        begun = 0 if cfg.resume is None else int(Path(cfg.resume).name.removeprefix("it_"))
        reached = begun + 1 if name == self.killed_in else cfg.agent.max_iterations
        folder = cfg.log_root / cfg.task / "2026-01-01" / "checkpoints" / f"it_{reached:08d}"
        folder.mkdir(parents=True)
        state = {"format": checkpoints.FORMAT, "iteration": reached, "steps": 200 * reached}
        settings = {"agent": to_json(cfg.agent), "env": to_json(cfg.env)}
        state |= {"seconds": 300.0 * reached, "task": cfg.task, **settings}
        (folder / "state.json").write_text(json.dumps(state))
        if name == self.killed_in:
            raise KeyboardInterrupt


@pytest.mark.parametrize("killed_in", ["run", "climb", "student"])
def test_stages_build_on_each_other_and_go_on_after_a_kill(monkeypatch, tmp_path, killed_in):
    names = [stage.name for stage in ZHUANG.stages]
    cfg = table1.Cfg(out=tmp_path, steps=9600, num_envs=8, num_steps_per_env=25)
    first, second = Trainer(killed_in), Trainer()
    monkeypatch.setattr(table1, "train", first)
    with pytest.raises(KeyboardInterrupt):
        table1.train_row(cfg, ZHUANG)
    place = names.index(killed_in)
    assert first.runs == names[: place + 1]
    assert killed_in in first.last.log_root.parts
    assert not table1.progress(cfg, ZHUANG)[2]
    monkeypatch.setattr(table1, "train", second)
    table1.train_row(cfg, ZHUANG)
    assert second.runs == names[place:]
    # 16 iterations of walking, 4 + 4 for each skill after it, 16 of imitation.
    assert table1.progress(cfg, ZHUANG) == (9600, 300.0 * 48, True)
    teachers = second.last.agent.distillation.teachers
    taught = {Path(path).parts[-5]: kinds for path, kinds in teachers}
    assert taught == dict(ZHUANG.stages[-1].teachers)
    assert [Path(path).name for path, _ in teachers] == [
        "it_00000016",
        "it_00000024",
        "it_00000024",
    ]


def test_prints_what_the_study_measured_beside_the_papers(done) -> None:
    cfg, _, _ = done
    summary = json.loads((cfg.out / "oracle" / "terrain" / "summary.json").read_text())
    oracle, cheng = table1.table(cfg).splitlines()[2:]
    assert f"{summary['levels']['gap']:.2f} (9.96)" in oracle
    assert f"{summary['lin_vel_reward']:.3f} (0.5948)" in oracle
    assert "missing" not in oracle
    assert cheng.count("missing") == 11
    assert {run["mode"] for run in summary["runs"]} == {"camera"}
    kept = json.loads(cfg.result(ORACLE).read_text())
    assert kept["runs"] == summary["runs"]
    easier = replace(cfg, study=replace(cfg.study, levels=(2,)))
    harder = replace(cfg, study=replace(cfg.study, conditions="training"))
    judged = [table1.measured(one, ORACLE) is not None for one in (cfg, easier, harder)]
    assert judged == [True, False, False]
    assert table1.Cfg().study.conditions == "nominal", "as those that are kept"
    assert (kept["steps"], kept["seed"]) == (400, 1)
    assert renet.__version__ in kept["code"]
    assert "run" in kept["curves"]


def test_differences_are_from_what_seeds_predict() -> None:
    assert table1.prediction_interval([1.0, 3.0]) == pytest.approx((2 - 22.0, 2 + 22.0), abs=0.1)
    results = Path(table1.__file__).parent / "results" / "table1"
    lines = table1.differences(table1.Cfg(results=results)).splitlines()[1:]
    assert [line.split()[1] for line in lines] == ["gap", "platform", "stairs", "collisions"]
    assert lines[1].endswith("outside: w/o HIM 61, Zhuang 52")
    assert lines[2].endswith("outside: none")


def test_a_row_that_was_judged_with_ideal_motors_is_not_judged_with_others() -> None:
    results = Path(table1.__file__).parent / "results" / "table1"
    cfg = table1.Cfg(results=results)
    others = replace(cfg, study=replace(cfg.study, motors="go1"))
    judged = [table1.measured(one, ORACLE) is not None for one in (cfg, others)]
    assert judged == [True, False]


def test_results_outlive_their_runs_and_count_for_their_budget_alone(done, tmp_path) -> None:
    cfg, _, _ = done
    elsewhere = replace(cfg, out=tmp_path)
    assert "missing" not in table1.table(elsewhere).splitlines()[2]
    assert "missing" in table1.table(replace(elsewhere, steps=401)).splitlines()[2]
    shutil.copy(cfg.result(ORACLE), replace(cfg, seed=2).result(ORACLE))
    seeds = [line.split("|")[-2] for line in table1.table(elsewhere).splitlines()[2:]]
    assert seeds == [" 1 ", " 2 ", " missing "]
    assert "judged" in table1.status(cfg)


def test_nothing_is_done_twice(done, monkeypatch) -> None:
    cfg = replace(done[0], rows=("Oracle",))
    monkeypatch.setattr(table1, "train", lambda cfg: pytest.fail("trained again"))
    monkeypatch.setattr(table1, "judge_row", lambda *a: pytest.fail("judged again"))
    table1.main(cfg)


def test_a_checkpoint_is_judged_with_the_engine_of_the_study(monkeypatch, tmp_path) -> None:
    judges = []

    def run(study, evaluator):
        judges.append(evaluator)
        raise KeyboardInterrupt

    monkeypatch.setattr(TerrainStudy, "run", run)
    (checkpoint,) = (Path(renet.__file__).parent / "pretrained" / "checkpoint").glob("it_*")
    cfg = table1.Cfg(out=tmp_path, study=replace(STUDY, engine="warp"))
    with pytest.raises(KeyboardInterrupt):
        table1.judge_row(cfg, ORACLE, checkpoint)
    assert judges[0].engine == judges[0].provenance(1).engine == "warp"


def test_a_damaged_or_foreign_folder_is_refused(done, tmp_path) -> None:
    cfg, _, _ = done
    shutil.copytree(cfg.out, tmp_path, dirs_exist_ok=True)
    with pytest.raises(RenetError, match="another model, seed"):
        table1.train_row(replace(cfg, out=tmp_path, seed=2), ORACLE)


def test_every_row_differs_from_the_recipe_in_what_it_names() -> None:
    cfg = table1.Cfg()
    sa = next(row for row in table1.ROWS if row.name == "SA")
    base = cfg.training(sa, sa.stages[0])
    for row in (row for row in table1.ROWS if len(row.stages) == 1):
        ours = cfg.training(row, row.stages[0])
        model = vars(ours.agent.model).items()
        changed = {k for k, v in model if v != getattr(base.agent.model, k)}
        assert changed == set(row.stages[0].model)
        assert replace(ours.agent, model=base.agent.model) == base.agent
        assert to_json(ours.env) == to_json(base.env)


def test_budget_is_reached_and_not_by_more_than_an_iteration() -> None:
    cfg = table1.Cfg().training(ORACLE, ORACLE.stages[0])
    cfg.agent.batch_size = 12800
    total = sum(512 * n for n in [table1.steps_per_env(None, 12800, 512, 0)])
    assert table1.iterations(cfg, 15e6) == -(-15_000_000 // total)


def test_unknown_rows_are_refused() -> None:
    with pytest.raises(RenetError, match="unknown row 'Nobody'"):
        table1.Cfg(rows=("Nobody",))
