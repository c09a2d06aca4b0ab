"""RoboGauge's stress benchmark with renet's Go2 among its robots.

RoboGauge (github.com/wty-yy/RoboGauge, arXiv 2602.00678, MIT) is used as it is. This program adds
the robot `renet` to its register and runs its benchmark, in an environment that has both:

    python benchmarks/referee.py benchmarks/go2_driven --out go2_driven_blind.pt
    PYTHONPATH=ROBOGAUGE:src python benchmarks/robogauge_go2.py --task-name renet \
        --model-path go2_driven_blind.pt --headless --json renet.json

`--bundle` names the shipped bundle of these weights. Other options are RoboGauge's own;
`--task-name go2_moe` scores its mixture of experts. Results of one run are comparable with those of
runs with the same grounds, frictions and seeds.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import time
from pathlib import Path
from typing import Any

# As RoboGauge's own program does: its processes share the processor.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import robogauge.tasks  # noqa: F401  registers RoboGauge's tasks
from robogauge import ROBOGAUGE_ROOT_DIR
from robogauge.tasks.gauge.goal_data import GoalData
from robogauge.tasks.pipeline import StressPipeline, base_pipeline
from robogauge.tasks.robots import Go2, Go2Config, Go2TerrainConfig
from robogauge.tasks.simulator.sim_data import SimData
from robogauge.utils.helpers import parse_args
from robogauge.utils.task_register import task_register

from facts import facts, version_of
from renet.bundle import pretrained, read_manifest
from renet.deploy.robots.base import heading
from renet.deploy.safety.limits import limited_velocity
from renet.deploy.steering import STEERINGS
from renet.deploy.teleop.base import TeleopCommand
from renet.evaluation.adapters.base import LEFT_FIRST
from renet.files import write_atomically
from renet.interface import PROPRIOCEPTION, proprioception_slices


def bundle_option() -> argparse.ArgumentParser:
    """Return a parser of `--bundle` alone."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--bundle", default="go2-driven")
    return parser


# RoboGauge's processes have the same command line.
MANIFEST = read_manifest(pretrained(bundle_option().parse_known_args()[0].bundle))
ROBOT = MANIFEST.robot
COMMAND = proprioception_slices()["command"]
SCALES = {term.name: term.scale for term in PROPRIOCEPTION}


class RenetGo2(Go2):
    """renet's Go2, steered as `renet deploy` steers it: RoboGauge's commands, clipped to training's
    range, become a speed and the angle to a heading."""

    def __init__(self, cfg: Go2Config) -> None:
        super().__init__(cfg)
        self.steering = STEERINGS[MANIFEST.told]()
        self.walks = False

    def build_observation(self, sim_data: SimData, goal_data: GoalData) -> np.ndarray:
        """Return o_t, [45], whose other terms RoboGauge's own robot computes as renet does."""
        observation = super().build_observation(sim_data, goal_data)
        yaw = heading(sim_data.proprio.imu.quat)
        if not self.walks:
            self.steering.start(yaw)
            self.walks = True
        goal = goal_data.velocity_goal
        asked = TeleopCommand(goal.lin_vel_x, goal.lin_vel_y, goal.ang_vel_yaw)
        observation[COMMAND] = self.steering.command(limited_velocity(asked), yaw)
        return observation

    def reset(self) -> None:
        """Begin a new walk."""
        super().reset()
        self.walks = False


class RenetControl(Go2Config.control):
    """Gains, pose and order of joints of the bundle."""

    p_gains = ROBOT.arrays["stiffness"][LEFT_FIRST].tolist()
    d_gains = ROBOT.arrays["damping"][LEFT_FIRST].tolist()
    default_dof_pos = ROBOT.arrays["default_position"][LEFT_FIRST].tolist()
    mj2model_dof_indices = LEFT_FIRST.tolist()

    class scales(Go2Config.control.scales):
        """Scales of the observation and of the action."""

        ang_vel = SCALES["base_angular_velocity"]
        dof_pos = SCALES["joint_position"]
        dof_vel = SCALES["joint_velocity"]
        action = ROBOT.action_scale


class RenetConfig(Go2Config):
    """renet's Go2 on the flat."""

    robot_class = "RenetGo2"
    control = RenetControl


class RenetTerrainConfig(Go2TerrainConfig):
    """renet's Go2 on other ground, where RoboGauge commands less speed."""

    robot_class = "RenetGo2"
    control = RenetControl


def register() -> None:
    """Give every task of RoboGauge's Go2 a twin for renet's, `renet.flat` for `go2.flat`."""
    # RoboGauge finds the class of a robot by its name in this module.
    base_pipeline.RenetGo2 = RenetGo2
    for name in [name for name in task_register.robot_cfgs if name.startswith("go2.")]:
        terrain = issubclass(task_register.robot_cfgs[name], Go2TerrainConfig)
        task_register.register(
            name.replace("go2.", "renet."),
            task_register.pipeline_classes[name],
            task_register.sim_cfgs[name],
            task_register.gauger_cfgs[name],
            RenetTerrainConfig if terrain else RenetConfig,
        )


def main() -> None:
    """Run the benchmark and, if asked, write its results as JSON."""
    parser = bundle_option()
    parser.add_argument("--json", type=Path)
    parser.add_argument("--model-path", type=Path, required=True)
    own, others = parser.parse_known_args()
    args = parse_args([*others, "--model-path", str(own.model_path)])
    asked = {name: getattr(args, name) for name in ("stress_terrain_names", "frictions", "seeds")}
    asked["search_seeds"] = args.search_seeds
    begun = time.monotonic()
    summary = StressPipeline(args).run()
    if own.json is not None:
        record = {
            "task": args.task_name,
            "bundle": own.bundle,
            "model": own.model_path.name,
            "sha256": hashlib.sha256(own.model_path.read_bytes()).hexdigest(),
            "asked": asked,
            "minutes": round((time.monotonic() - begun) / 60, 1),
            "results": without_paths(summary),
            "robogauge": revision(),
            "dm_control": version_of("dm-control"),
            "facts": facts(),
        }
        text = json.dumps(record, indent=1) + "\n"
        write_atomically(own.json, text.encode(), "results")


def revision() -> str:
    """Return the commit of RoboGauge's working tree."""
    command = ["git", "-C", ROBOGAUGE_ROOT_DIR, "rev-parse", "HEAD"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def without_paths(summary: dict[str, Any]) -> dict[str, Any]:
    """Return RoboGauge's results without the path of the model on this machine."""
    return {name: value for name, value in summary.items() if name != "model_path"}


# RoboGauge's processes import this file as well.
register()
if __name__ == "__main__":
    main()
