"""The shipped checkpoint's torch networks against its exported bundle, on a robot that walks."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import numpy as np
import torch

from renet.deploy.bundle import Bundle
from renet.deploy.cameras.faulty import FaultyCamera
from renet.deploy.cameras.sim import SimCamera
from renet.deploy.controller import Controller
from renet.deploy.observation import heading, observe
from renet.deploy.robots.mujoco import MujocoRobot
from renet.deploy.robots.scene import build_scene
from renet.deploy.safety import Mode, SafetyCfg
from renet.deploy.teleop import TeleopCommand
from renet.faults import parse_fault
from renet.interface import CONTROL_DT
from renet.models.actor_critic import fuse
from renet.models.memory import EstimatorMemory
from renet.training import checkpoint as checkpoints
from renet.training.bundle import ExportCfg, export, load_networks

CHECKPOINT = Path(str(files("renet").joinpath("pretrained", "checkpoint")))
SECONDS = 20.0
FAULTS = ("blackout@2s+2s", "frozen:3@9s", "salt_and_pepper:2@14s+1s")


def test_the_shipped_checkpoint_acts_alike_in_torch_and_on_the_robot(tmp_path):
    """20 s of closed loop with faults: the robot obeys the bundle, torch shadows it."""
    bundle = Bundle.load(export(ExportCfg(checkpoint=CHECKPOINT, out=tmp_path / "bundle")))
    found = checkpoints.find(CHECKPOINT)
    networks = load_networks(checkpoints.load(found), found)
    memory = EstimatorMemory(networks.cfg, 1, "cpu")
    model, ground = build_scene("flat")
    robot = MujocoRobot(model, bundle.manifest.robot, ground)
    source = SimCamera(robot, bundle.manifest.camera, seed=2)
    camera = FaultyCamera(source, [parse_fault(text) for text in FAULTS], robot.now, seed=2)
    controller = Controller(bundle, SafetyCfg(stand_up_seconds=0.5))
    camera.start()
    last, yaw, modes, worst, walked = np.zeros(12), None, [], 0.0, 0
    for step in range(round((SECONDS + 1.0) / CONTROL_DT)):
        state, now = robot.read(), robot.now()
        shown = camera.latest()
        robot.write(controller.tick(state, shown, TeleopCommand(speed=0.6, arm=step == 1), now))
        robot.wait(now + CONTROL_DT)
        decision = controller.decision
        if decision.mode is not Mode.WALKING:
            assert walked == 0, controller.machine.reason
            continue
        yaw = heading(state.quaternion) if yaw is None else yaw
        observation = observe(state, controller.robot, 0.6, yaw, last)[None]
        memory.push(torch.tensor(observation))
        if walked % 5 == 0:
            memory.see(torch.tensor(shown.image[None]).half())
            memory.tick(networks.advance)
        with torch.no_grad():
            latent = fuse(memory.latent_op, memory.latent_vp, torch.tensor([not decision.vision]))
            action = networks.actor(torch.tensor(observation), latent)[0].numpy()
        clip = controller.robot.action_clip
        worst = max(worst, float(np.abs(decision.action - action.clip(-clip, clip)).max()))
        last, walked = decision.action, walked + 1
        modes.append(decision.vision)
    assert walked >= SECONDS / CONTROL_DT
    assert np.abs(np.diff(modes)).sum() >= 4, "the flight must switch to and fro"
    assert worst < 1e-4
