"""Two-stage rivals: the student learns what its teachers do, goes on after a kill, counts steps."""

from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch
from tests.training.conftest import ToyEnv, single_precision  # noqa: F401  applies to all tests

from baselines import cheng, zhuang
from baselines.distillation import (
    STUDENT,
    TEACHER,
    DistillationCfg,
    DistillationRunner,
    StudentCfg,
)
from renet.curves import CURVES, read_curves
from renet.errors import RenetError
from renet.models.config import ModelCfg
from renet.models.oracle import true_image
from renet.terrain.tiles import PIT, TILE, GapTile, PlatformTile, tiles
from renet.training import checkpoint as checkpoints
from renet.training.config import RenetRunnerCfg, SupervisionCfg
from renet.training.export import load_networks
from renet.training.runner import RenetRunner


class TiledEnv(ToyEnv):
    """Robot n is on tile n % 6; levels are reported with the tiles' kinds."""

    def __init__(self, num_envs: int = 12, seed: int = 0) -> None:
        super().__init__(num_envs, seed)
        generator = SimpleNamespace(sub_terrains=tiles())
        kinds = torch.arange(num_envs) % len(tiles())
        self.levels = torch.zeros(num_envs, dtype=torch.long)
        self.passed = torch.zeros(num_envs, dtype=torch.bool)
        term = SimpleNamespace(levels=self.levels, passed=self.passed)
        self.curriculum_manager = SimpleNamespace(
            active_terms=["level"], get_term_cfg=lambda _: SimpleNamespace(func=term)
        )
        terrain = SimpleNamespace(
            cfg=SimpleNamespace(terrain_generator=generator),
            terrain_types=kinds,
            terrain_levels=self.levels.clone(),
            terrain_origins=torch.zeros(10, len(tiles()), 3),
            env_origins=torch.zeros(num_envs, 3),
        )
        self.scene = SimpleNamespace(terrain=terrain)


def teacher(folder, seed: int, level: int, perception: str = "oracle"):
    """A checkpoint of a policy that reads the truth."""
    torch.manual_seed(seed)
    env = TiledEnv()
    env.levels += level
    env.passed[:] = level > 5
    cfg = RenetRunnerCfg(model=ModelCfg(perception=perception), num_steps_per_env=10)
    runner = RenetRunner(env, asdict(cfg), str(folder), "cpu")
    runner.learn(1)
    return str(checkpoints.find(folder))


@pytest.fixture(scope="module")
def teachers(tmp_path_factory):
    """One for walking and one for gaps and platforms, who reached levels 2 and 7."""
    folder = tmp_path_factory.mktemp("teachers")
    walks, climbs = teacher(folder / "a", 1, 2), teacher(folder / "b", 2, 7)
    return (walks, zhuang.SKILLS["run"]), (climbs, ("gap", "platform"))


def student(folder, teachers, rate=1e-3, **distillation) -> DistillationRunner:
    torch.manual_seed(0)
    cfg = StudentCfg(
        task="toy",
        model=ModelCfg(**STUDENT),
        supervision=SupervisionCfg(learning_rate=rate, num_mini_batches=1, autoencoder_images=8),
        num_steps_per_env=15,
        distillation=DistillationCfg(tuple(teachers), **distillation),
    )
    return DistillationRunner(TiledEnv(), asdict(cfg), str(folder), "cpu")


def test_each_robot_is_taught_by_the_teacher_of_its_tile(teachers, tmp_path) -> None:
    alg, env = student(tmp_path, teachers).alg, TiledEnv(seed=5)
    first, second = env.get_observations(), env.get_observations()
    begins = torch.arange(12) % 5 == 0
    said = [alg.expert(first)]
    alg.act(first)
    alg.process_env_step(second, torch.zeros(12), begins, {"costs": torch.zeros(12, 3)})
    said.append(alg.expert(second))
    # Estimators tick every fifth step: until then a robot whose episode begins has no latent.
    for path, kinds in teachers:
        model = load_networks(Path(path))
        sensed, blank = first["proprioception"], torch.zeros(12, 64)
        image = true_image(first["height_map"]).half().float().unsqueeze(1).expand(-1, 2, -1, -1)
        history = sensed.unsqueeze(1).expand(-1, 10, -1)
        with torch.no_grad():
            latent = model.vp(history, image, torch.ones(12), blank)
            expected = [
                model.actor(obs["proprioception"], torch.cat((blank, latent * keep), dim=-1))
                for obs, keep in ((first, 1), (second, ~begins.unsqueeze(-1)))
            ]
        its = [kind in kinds for kind in list(tiles()) * 2]
        for mine, theirs in zip(said, expected, strict=True):
            torch.testing.assert_close(mine[its], theirs[its])


def test_a_tile_without_a_teacher_or_a_teacher_without_sight_is_refused(teachers, tmp_path) -> None:
    with pytest.raises(RenetError, match="nobody teaches on gap"):
        student(tmp_path, teachers[:1])
    blind = teacher(tmp_path / "blind", 3, 0, perception="op")
    with pytest.raises(RenetError, match="cannot teach"):
        student(tmp_path, [(blind, ())])


def test_the_loss_is_that_of_the_actions_taken(teachers, tmp_path) -> None:
    runner = student(tmp_path, teachers, rate=0.0, norm=1)
    said, ask = [], runner.alg.expert
    runner.alg.expert = lambda obs: said.append(ask(obs)) or said[-1]
    runner.learn(1)
    rollout = runner.alg._rollout
    assert rollout.done.any(), "episodes end between ticks, too"
    expected = (rollout.mean - torch.stack(said)).abs().sum(-1).mean().item()
    (loss,) = read_curves(tmp_path / CURVES)["Loss/imitation"].values()
    assert loss == pytest.approx(expected, rel=1e-4)


def test_goes_on_after_a_kill_from_the_levels_of_its_teachers(teachers, tmp_path) -> None:
    first = student(tmp_path, teachers)
    hard = torch.isin(first.env.scene.terrain.terrain_types, torch.tensor([4, 5]))
    assert (first.env.levels == torch.where(hard, 7, 2)).all()
    assert torch.equal(first.env.passed, hard), "not those of another teacher's robots"
    first.learn(1)
    second = student(tmp_path, teachers)
    second.load(str(tmp_path))
    second.learn(1)
    assert checkpoints.load_state(checkpoints.find(tmp_path))["iteration"] == 2
    losses = read_curves(tmp_path / CURVES)["Loss/imitation"]
    assert [*losses] == [0, 1]
    assert losses[1] < losses[0]
    assert "Loss/surrogate" not in read_curves(tmp_path / CURVES)


def test_its_actor_begins_as_its_teachers(teachers, tmp_path) -> None:
    actor = student(tmp_path, teachers, starts_as_teacher=True).alg.model.actor.state_dict()
    for name, weights in load_networks(Path(teachers[0][0])).actor.state_dict().items():
        torch.testing.assert_close(actor[name], weights)


@pytest.mark.parametrize(("over", "drives"), [(0.0, False), (1e9, True), (1e-9, False)])
def test_teachers_drive_ever_less(teachers, tmp_path, over, drives) -> None:
    alg = student(tmp_path, teachers, teacher_drives=over).alg
    alg.iteration = 1
    seen = TiledEnv().get_observations()
    extras = {"costs": torch.zeros(12, 3)}
    alg.act(seen)
    alg.process_env_step(seen, torch.zeros(12), torch.ones(12), extras)  # All begin anew.
    said, ask = [], alg.expert
    alg.expert = lambda obs: said.append(ask(obs)) or said[-1]
    taken = alg.act(seen)
    torch.testing.assert_close(taken, said[0] if drives else alg._steps.newest["mean"])


@pytest.mark.parametrize("soft", [False, True])
def test_soft_platforms_give_way_and_soft_gaps_are_shallow(soft) -> None:
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="terrain")
    PlatformTile(low=0.3).function(0.0, spec, np.random.default_rng(0))
    GapTile(low=0.5).function(0.0, spec, np.random.default_rng(0))
    foot = spec.worldbody.add_body(pos=(TILE / 2 + 2.0, TILE / 2, 0.33))
    foot.add_freejoint()
    foot.add_geom(size=(0.02, 0, 0), mass=3.0, priority=1, solref=(0.01, 1.0))
    if soft:
        zhuang.soften(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 1000)
    sunk = 0.32 - data.qpos[2]
    assert 0.05 < sunk < 0.15 if soft else abs(sunk) < 0.01
    floor = [g for g in range(model.ngeom) if np.allclose(model.geom_rgba[g], PIT)]
    top = model.geom_pos[floor, 2] + model.geom_size[floor, 2]
    assert top == pytest.approx(-0.1 if soft else -1.0)
    assert np.isfinite(data.qvel).all()


@pytest.mark.parametrize("stages", [cheng.STAGES, zhuang.STAGES])
def test_stages_spend_the_budget_and_build_on_earlier_ones(stages) -> None:
    assert sum(stage.share for stage in stages) == pytest.approx(1.0)
    for number, stage in enumerate(stages):
        before = {earlier.name for earlier in stages[:number]}
        assert {*stage.teachers, *filter(None, [stage.after])} <= before
        assert dict(stage.model) == (STUDENT if stage.teachers else TEACHER)
    assert stages[-1].teachers
