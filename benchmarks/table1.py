"""The paper's Table I: every row trained with one recipe, one seed and one budget, then judged.

`python benchmarks/table1.py` trains and judges what is not done yet, row by row; after any kill the
same command goes on. `--status` says where it stands. `--table` prints it beside the paper's, and
which rows differ from SA by more than its seeds do.
What a row needs to go on lies in its folder: checkpoints of `renet train`, and the terrain study.
What is measured, with the curriculum's curves, is in `--results`, a file a row and seed.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from scipy import stats

from baselines import cheng, zhuang
from baselines.checkpoint_policy import CheckpointEvaluator
from baselines.distillation import STUDENT_TASK, DistillationCfg, Stage, StudentCfg
from facts import errors_in_one_line
from recipe_curves import level_curves
from renet.errors import RenetError
from renet.evaluation.results import plain, read_results, write_json
from renet.evaluation.studies.terrain import TABLE, TerrainStudy
from renet.models.config import ModelCfg
from renet.motor_models import IDEAL
from renet.training import checkpoint as checkpoints
from renet.training.config import from_dict, steps_per_env
from renet.training.train import TrainCfg, train

MEASURES = ("gap", "platform", "stairs", "collisions", "lin_vel_reward")


@dataclass(frozen=True)
class Row:
    """One method of the table."""

    name: str
    stages: tuple[Stage, ...]
    """The runs it takes, in their order; the last one's policy is judged."""
    paper: tuple[float, ...] | None
    """Levels of gap, platform and stairs, collisions, linear-velocity reward (RENet, Table I)."""
    mode: str = "camera"
    """Policy mode it is judged in."""

    @property
    def slug(self) -> str:
        """Name of its folder."""
        return self.name.lower().replace("/", "").replace(" ", "_")


def one(**model: Any) -> tuple[Stage, ...]:
    """A single run, of networks that differ from the recipe's in the named fields of ModelCfg."""
    return (Stage("run", 1.0, model),)


ROWS = (
    Row("Oracle", one(perception="oracle"), (9.96, 9.97, 9.93, 0.026, 0.5948)),
    Row("MLP", one(encoder="mlp"), (9.84, 9.88, 9.85, 0.070, 0.5598)),
    Row("SA", one(), (9.87, 9.85, 9.89, 0.077, 0.5556)),
    Row("w/o VEL", one(predict_velocity=False), (7.86, 4.28, 6.82, 0.254, 0.5221)),
    Row("w/o FH", one(predict_feet_height=False), (7.36, 7.20, 8.12, 0.071, 0.5506)),
    Row("w/o HF", one(predict_height_map=False), (5.49, 5.46, 6.44, 0.269, 0.5155)),
    Row("w/o HIM", one(him=False), (7.04, 7.67, 9.58, 0.076, 0.5572)),
    Row("One Obs", one(history=1), (9.32, 8.46, 8.79, 0.082, 0.5543)),
    Row("One Image", one(frames=1), (9.63, 8.86, 9.82, 0.104, 0.5537)),
    Row("VP-only", one(perception="vp"), None),
    Row("OP-only", one(perception="op"), None, "op"),
    Row("Zhuang", zhuang.STAGES, (6.71, 7.28, 7.75, 0.205, 0.5425)),
    Row("Cheng", cheng.STAGES, (8.58, 8.29, 8.89, 0.152, 0.5501)),
)


@dataclass
class Cfg:
    """Train and judge the rows of the paper's Table I."""

    out: Path = Path("results/table1")
    """A folder for each row: its runs, and how it was judged."""
    results: Path = Path("results/table1")
    """Folder of the rows' results, ROW_SEED.json."""
    rows: tuple[str, ...] = tuple(row.name for row in ROWS)
    """Rows, in the order in which they are trained."""
    steps: float = 15e6
    """Environment steps of each row."""
    num_envs: int = 512
    """Robots side by side."""
    num_steps_per_env: int | None = None
    """Control steps of each robot in an iteration, in place of the recipe's; for quick trials."""
    seed: int = 1
    """Seed of training; the rows are judged with `study.seed`."""
    study: TerrainStudy = field(default_factory=lambda: TerrainStudy(conditions="nominal"))
    """How rows are judged; its mode, folder and bundle are the row's."""
    status: bool = False
    """Only print where each row stands."""
    table: bool = False
    """Only print the table."""

    def __post_init__(self) -> None:
        unknown = set(self.rows) - {row.name for row in ROWS}
        if unknown:
            names = ", ".join(row.name for row in ROWS)
            raise RenetError(f"unknown row {sorted(unknown)[0]!r}: choose among {names}")
        if self.num_envs < 1 or self.steps <= 0:
            raise RenetError(f"num-envs {self.num_envs} and steps {self.steps} must be above 0")

    @property
    def chosen(self) -> list[Row]:
        """The rows asked for."""
        return [row for name in self.rows for row in ROWS if row.name == name]

    def folder(self, row: Row, stage: Stage) -> Path:
        """Where a stage's run is."""
        return self.out / row.slug / stage.name

    def result(self, row: Row) -> Path:
        """The file of a row's results."""
        return self.results / f"{row.slug}_{self.seed}.json"

    def training(self, row: Row, stage: Stage) -> TrainCfg:
        """The recipe with the stage's differences; stages before it are done."""
        task = STUDENT_TASK if stage.teachers else stage.task
        cfg = TrainCfg.from_task(task, log_root=self.folder(row, stage))
        cfg.env.scene.num_envs = self.num_envs
        agent = cfg.agent
        agent.seed, agent.num_steps_per_env = self.seed, self.num_steps_per_env
        agent.model = replace(agent.model, **stage.model)
        share = stage.share + sum(earlier.share for earlier in parents(row, stage))
        agent.max_iterations = iterations(cfg, share * self.steps)
        for kind, tile in cfg.env.scene.terrain.terrain_generator.sub_terrains.items():
            if stage.kinds and kind not in stage.kinds:
                tile.proportion = 1e-9  # Which leaves one robot, mjlab's least.
        if isinstance(agent, StudentCfg):
            teachers = tuple(
                (str(newest(self, row, earlier)), stage.teachers[earlier.name])
                for earlier in row.stages
                if earlier.name in stage.teachers
            )
            agent.distillation = DistillationCfg(teachers, **stage.distillation)
        return cfg


def parents(row: Row, stage: Stage) -> list[Stage]:
    """The stages it goes on from, the latest first: their steps and iterations count on."""
    before = [earlier for earlier in row.stages if earlier.name == stage.after]
    return before + [first for earlier in before for first in parents(row, earlier)]


def iterations(cfg: TrainCfg, steps: float) -> int:
    """Iterations after which `steps` environment steps are first done."""
    robots, done, count = cfg.env.scene.num_envs, 0, 0
    while done < steps:
        fixed, batch_size = cfg.agent.num_steps_per_env, cfg.agent.batch_size
        done += robots * steps_per_env(fixed, batch_size, robots, done)
        count += 1
    return count


def newest(cfg: Cfg, row: Row, stage: Stage) -> Path | None:
    """The stage's newest checkpoint."""
    try:
        with redirect_stderr(io.StringIO()):  # It is told each time.
            return checkpoints.find(cfg.folder(row, stage))
    except RenetError:
        return None


def train_stage(cfg: Cfg, row: Row, stage: Stage) -> Path:
    """Train the rest of a stage's budget; returns its last checkpoint.

    Raises:
        RenetError: its checkpoint is of other settings.
    """
    training, checkpoint = cfg.training(row, stage), newest(cfg, row, stage)
    if checkpoint is not None:
        state = checkpoints.load_state(checkpoint)
        stored = from_dict(ModelCfg, state["agent"]["model"])
        same = stored == training.agent.model and state["agent"]["seed"] == cfg.seed
        if not same or state["env"]["scene"]["num_envs"] != cfg.num_envs:
            raise RenetError(
                f"{checkpoint} was trained with another model, seed or number of robots: choose"
                " another --out, or the settings it was begun with"
            )
        if state["iteration"] >= training.agent.max_iterations:
            return checkpoint
    for earlier in parents(row, stage)[:1]:
        checkpoint = checkpoint or newest(cfg, row, earlier)
    train(replace(training, resume=None if checkpoint is None else str(checkpoint)))
    return checkpoints.find(cfg.folder(row, stage))


def train_row(cfg: Cfg, row: Row) -> Path:
    """Train what is left of a row's budget, stage by stage; returns the last one's checkpoint."""
    return [train_stage(cfg, row, stage) for stage in row.stages][-1]


def progress(cfg: Cfg, row: Row) -> tuple[int, float, bool]:
    """Environment steps and seconds of all stages of a row, and whether all are done.

    A stage that goes on from another one counts its steps and seconds on from there.
    """
    steps, seconds, complete = 0, 0.0, True
    for stage in row.stages:
        checkpoint = newest(cfg, row, stage)
        if checkpoint is None:
            return steps, seconds, False
        state = checkpoints.load_state(checkpoint)
        complete &= state["iteration"] >= cfg.training(row, stage).agent.max_iterations
        for earlier in parents(row, stage)[:1]:
            begun = checkpoints.load_state(newest(cfg, row, earlier) or checkpoint)
            steps, seconds = steps - begun["steps"], seconds - begun["seconds"]
        steps, seconds = steps + state["steps"], seconds + state["seconds"]
    return steps, seconds, complete


def stage_curves(cfg: Cfg, row: Row, stage: Stage) -> list[dict[str, float]]:
    """The curriculum's levels over a finished stage."""
    last = checkpoints.find(cfg.folder(row, stage))
    parent = next((newest(cfg, row, earlier) for earlier in parents(row, stage)), None)
    begun = 0 if parent is None else checkpoints.load_state(parent)["steps"]
    return level_curves(last.parents[1], begun)  # RUN/checkpoints/it_…


def judge_row(cfg: Cfg, row: Row, checkpoint: Path) -> None:
    """Run the terrain study of a row's last checkpoint and keep its results."""
    out = cfg.out / row.slug / "terrain"
    study = replace(cfg.study, out=out, modes=(row.mode,), bundle=None)
    evaluator = CheckpointEvaluator(checkpoint, study.engine, study.conditions, study.motors)
    summary = study.run(evaluator)
    steps, seconds, _ = progress(cfg, row)
    state = checkpoints.load_state(checkpoint)
    trained = {"steps": steps, "hours": seconds / 3600, "seed": cfg.seed, "code": state["code"]}
    curves = {stage.name: stage_curves(cfg, row, stage) for stage in row.stages}
    cfg.results.mkdir(parents=True, exist_ok=True)
    write_json(cfg.result(row), {"row": row.name, **trained, **summary, "curves": curves})


def measured(cfg: Cfg, row: Row) -> dict[str, Any] | None:
    """The row's results; None where it has not been judged so, at the whole budget."""
    path = cfg.result(row)
    results = read_results(path) if path.is_file() else None
    if results is None or results["steps"] < cfg.steps:
        return None
    names = ("robots", "quick", "seed", "speed", "seconds", "levels", "kinds", "fault")
    # Older results leave these out.
    defaults = {"conditions": "nominal", "motors": IDEAL, "scene": None}
    settings = defaults | results["settings"]
    same = all(settings[n] == plain(getattr(cfg.study, n)) for n in (*names, *defaults))
    return results if same else None


def passed(summary: dict[str, Any], column: str) -> tuple[int, int]:
    """Tiles of a column that robots passed, and those they tried."""
    runs = [run for run in summary["runs"] if run["kind"] in TABLE[column]]
    return sum(run["passed"] for run in runs), sum(run["robots"] for run in runs)


def passes(summary: dict[str, Any], column: str) -> str:
    """Tiles passed of those tried, with the Clopper-Pearson interval in per cent."""
    count, tried = passed(summary, column)
    if not tried:
        return "missing"
    low, high = stats.binomtest(count, tried).proportion_ci(0.95)
    return f"{count}/{tried} ({100 * low:.0f} to {100 * high:.0f} %)"


def prediction_interval(values: Sequence[float]) -> tuple[float, float]:
    """Where one more value lies with a probability of 95 %, of a normal distribution; n > 1."""
    spread = np.std(values, ddof=1) * np.sqrt(1 + 1 / len(values))
    low, high = stats.t.interval(0.95, len(values) - 1, np.mean(values), spread)
    return float(low), float(high)


def differences(cfg: Cfg) -> str:
    """A line for each measure: what seeds of SA predict of one more, and which rows are outside."""
    results = {
        row.name: [r for seed_cfg in by_seed(cfg, row) if (r := measured(seed_cfg, row))]
        for row in ROWS
    }
    if len(results["SA"]) < 2:
        return "One seed of SA says nothing about how far seeds differ."
    lines = ["95 % prediction intervals of one more seed of SA:"]
    for name in (*TABLE, "collisions"):
        values = {
            row: [r[name] if name == "collisions" else passed(r, name)[0] for r in seeds]
            for row, seeds in results.items()
        }
        low, high = prediction_interval(values.pop("SA"))
        outside = [
            f"{row} {value:.3g}"
            for row, seeds in values.items()
            for value in seeds
            if not low <= value <= high
        ]
        lines.append(f"- {name} {low:.3g} to {high:.3g}; outside: {', '.join(outside) or 'none'}")
    return "\n".join(lines)


def table(cfg: Cfg) -> str:
    """Markdown: each measured number with the paper's in parentheses; nothing is filled in."""
    columns = [*TABLE, "collisions", "linear velocity", *(f"{c} passed" for c in TABLE)]
    columns += ["M steps", "hours", "seed"]
    lines = [["row", *columns], ["---"] * (len(columns) + 1)]
    for row in cfg.chosen:
        lines += [[row.name, *cells(seed_cfg, row, len(columns))] for seed_cfg in by_seed(cfg, row)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def by_seed(cfg: Cfg, row: Row) -> list[Cfg]:
    """The configuration with each seed that the row was judged with, or as it is."""
    paths = cfg.results.glob(f"{row.slug}_*.json")
    seeds = sorted(int(path.stem.rpartition("_")[2]) for path in paths)
    return [replace(cfg, seed=seed) for seed in seeds or [cfg.seed]]


def cells(cfg: Cfg, row: Row, count: int) -> list[str]:
    """What was measured of a row with one seed, in `count` columns."""
    results = measured(cfg, row)
    texts = []
    for number, name in enumerate(MEASURES):
        ours = None if results is None else {**results, **results["levels"]}.get(name)
        digits = 2 if name in TABLE else 3
        said = "missing" if ours is None else f"{ours:.{digits}f}"
        paper = "not in the paper" if row.paper is None else f"{row.paper[number]:g}"
        texts.append(f"{said} ({paper})")
    if results is None:
        return texts + ["missing"] * (count - len(texts))
    texts += [passes(results, column) for column in TABLE]
    return [*texts, f"{results['steps'] / 1e6:.2f}", f"{results['hours']:.1f}", str(cfg.seed)]


def status(cfg: Cfg) -> str:
    """Where each row stands, and the hours of training left at the speed of those begun."""
    lines, left, done, seconds = [], 0.0, 0, 0.0
    for row in cfg.chosen:
        steps, taken, _ = progress(cfg, row)
        done, seconds = done + steps, seconds + taken
        left += max(cfg.steps - steps, 0.0)
        judged = "judged" if measured(cfg, row) else "not judged"
        lines.append(
            f"{row.name:<10} {steps / 1e6:6.2f} M of {cfg.steps / 1e6:g} M steps, {judged}"
        )
    rate = f"{left * seconds / done / 3600:.1f} h" if done else "unknown: no row has begun"
    return "\n".join([*lines, f"left: {left / 1e6:.2f} M steps of training, {rate}"])


def main(cfg: Cfg) -> None:
    """Print, or train and judge what is left."""
    if cfg.status or cfg.table:
        print(status(cfg) if cfg.status else f"{table(cfg)}\n\n{differences(cfg)}")
        return
    for row in cfg.chosen:
        if not measured(cfg, row):
            judge_row(cfg, row, train_row(cfg, row))
    print(table(cfg))


if __name__ == "__main__":
    with errors_in_one_line():
        main(tyro.cli(Cfg))
