"""The recipe: departures from the paper's task and agent, and the reason for each.

The paper trains for 1.5 billion steps; this recipe is for 230 million. Settings that change during
training do so over five phases, `PHASES`; benchmarks/NOTES.md has all values in one table.
docs/how_it_works.md explains what recipe and paper share.
"""

from typing import Any, cast

from mjlab.managers.curriculum_manager import CurriculumTermCfg
from mjlab.managers.reward_manager import RewardTermCfg

from renet.interface import MAX_SPEED
from renet.models.config import ModelCfg
from renet.tasks import mdp
from renet.tasks.env import RenetEnvCfg
from renet.tasks.mdp.commands import COMMAND, DriveCommandCfg, GoalCommandCfg
from renet.tasks.parkour_env_cfg import randomize
from renet.tasks.schedule import Schedule, value_at
from renet.tasks.sensors import depth_camera
from renet.terrain.tiles import barriers, dense_tiles
from renet.training.config import NP3OCfg, RenetRunnerCfg, SupervisionCfg, WithholdingCfg

PHASES = {"walk": 12, "climb": 40, "cross": 150, "practise": 205, "settle": 230}
"""Millions of environment steps at which each phase of a run ends.

In the first phase robots learn a gait. In the second they learn to follow velocities in all
directions, and penalties fade that teach the gait but cost more than climbing earns. The third,
which is the longest, is for crossing obstacles. In the fourth robots practise what they have met
too seldom: standing, and narrow gaps that they saw only briefly. In the last one learning rates
fall, so that the weights settle.
"""


def over_phases(*values: float) -> Schedule:
    """Return a schedule that reaches a value at the end of each phase, linear in between.

    Until the end of the first phase it has the first value.
    """
    points = []
    for value, end in zip(values, PHASES.values(), strict=True):
        points.append(f"{value:g}@{end}M")
    return ",".join(points)


def recipe(env: RenetEnvCfg, agent: RenetRunnerCfg) -> None:
    """Apply the recipe in place to a task of `parkour_env_cfg.py` and to the paper's agent."""
    set_learning(agent)
    set_command(env)
    set_rewards(env)
    set_differences(env)
    # Goals to stand begin after climbing, because a third of all steps would go to standing while
    # levels could rise. They are short at first: stopping is learned at their beginning, and a
    # robot that stands meets no edges. They last longer in the end, because OP stands still on
    # stairs only for as long as it has practised.
    env.curriculum["command_stage"].params |= {
        "after": 1e6 * PHASES["climb"],
        "standing_time": over_phases(0.4, 0.4, 0.4, 1.0, 1.0),
    }
    if "level" in env.curriculum:
        set_tiles(env)


def set_learning(agent: RenetRunnerCfg) -> None:
    """Set networks, policy optimisation and supervision for millions of steps, not billions."""
    # The policy already stands at the beginning, so that it needs less noise than the paper's. The
    # variance detector knows which errors of the camera are usual: it notices glare and occlusion
    # two to eight times as often. It also learns how sparse grass looks (see `Supervision`).
    # The expectation notices images that look healthy and contradict what the robot remembers.
    agent.model = ModelCfg(
        initial_std=0.5,
        detector="variance",
        predict_map_error=True,
        predict_far_map=True,
        expect_image=True,
    )
    agent.algorithm = NP3OCfg(
        # With a third of 0.008 robots crossed fewer gaps.
        entropy=over_phases(0.008, 0.008, 0.008, 0.004, 0.001),
        # Robots that are told a low speed, or to walk backward, begin to step by noise alone. Their
        # mean action learns to start once there is little of it.
        max_std=over_phases(0.5, 0.2, 0.12, 0.12, 0.1),
        # Late, nearly all of the gradient is noise: smaller steps average over more of it.
        desired_kl=over_phases(0.015, 0.01, 0.01, 0.01, 0.004),
        # With 0.95 most of the actor's gradient is noise. The critics see the true state and
        # explain the returns well enough for a smaller lambda, which removes that noise.
        lam=0.8,
        # Gradients take half of an iteration. A fourth and fifth pass bring less than the
        # environment steps that fit in their time.
        num_learning_epochs=3,
        # A policy that walks violates hardly any constraint. With budgets of 0 the errors of three
        # critics keep all penalties active, as noise that only very large batches average out.
        # Tighter budgets hinder robots that leap and climb.
        cost_budget=(0.06, over_phases(0.5, 0.4, 0.24, 0.24, 0.24), 1.5),
        # Without it a policy walks to one side and stands when told to go to the other, and no
        # robot walks straight ahead. With a weight of 1 levels fell.
        mirror_loss=0.3,
    )
    agent.supervision = SupervisionCfg(
        # With four gradient steps per iteration VP's map showed no gaps.
        num_mini_batches=12,
        autoencoder_images=48,
        # The actor reads the latents, which must change little late in training.
        learning_rate=over_phases(1e-3, 1e-3, 3e-4, 3e-4, 1e-4),
    )
    # In turns of 20 iterations an estimator forgets how to walk while the other one learns.
    agent.adaptation.period = 4
    # Images are withheld from the first step on, which costs no level. Later, robots practise
    # narrow gaps that they saw only briefly: most gaps of their own level cannot be crossed unseen.
    agent.withholding = WithholdingCfg(
        share=0.5,
        easier_shortest=over_phases(0.3, 0.3, 0.3, 2.0, 2.0),
        easier_sight=over_phases(4.0, 4.0, 4.0, 0.6, 0.6),
    )
    # Many small steps teach new directions, and robots walk sooner; large batches have less noise
    # once progress is slow.
    agent.batch_size = over_phases(12_800, 12_800, 51_200, 51_200, 51_200)
    agent.average_over = 100


def set_command(env: RenetEnvCfg) -> None:
    """Add velocities in all directions to the paper's goals."""
    goals = env.commands[COMMAND]
    assert isinstance(goals, GoalCommandCfg)
    shares = {"plane": 0.7, "rough": 0.8, "obstacles": 0.5}
    drive = DriveCommandCfg(**vars(goals), free_shares=shares)
    drive.told = "twist"
    # Robots hardly practise what they are told at the edge of a range: the draw goes beyond it.
    # Backward, sideways and on the spot are learned last, and alone harder than while walking.
    drive.forward = (-0.7, MAX_SPEED)
    drive.sideways = 0.6
    drive.straight_share = 0.4
    drive.spot_share = 0.2
    env.commands[COMMAND] = drive
    # No robot begins to walk backward or sideways by chance. One that is given the velocity it is
    # told need only keep it. Once robots follow velocities they have to learn to start by
    # themselves.
    kicks = {"schedule": over_phases(1.0, 0.5, 0.25, 0.25, 0.25)}
    env.curriculum["kick_share"] = CurriculumTermCfg(func=mdp.kick_share, params=kicks)
    env.rewards["linear_velocity"].func = mdp.velocity_tracking
    # A robot that is rewarded for its heading turns as fast as it can.
    env.rewards["yaw"].func = mdp.turn_tracking


def set_rewards(env: RenetEnvCfg) -> None:
    """Weaken the penalty on collisions, and add four rewards."""
    height = {"standing_height": env.robot.map_height - env.robot.foot_radius}
    env.rewards |= {
        # `tasks/mdp/rewards.py` says why.
        "stepping": RewardTermCfg(func=mdp.stepping, weight=0.75),
        "standing_motion": RewardTermCfg(func=mdp.standing_motion, weight=-0.5),
        "foot_clearance": RewardTermCfg(func=mdp.foot_clearance, weight=0.0, params=height),
        "upright_tracking": RewardTermCfg(func=mdp.upright_tracking, weight=0.75, params=height),
    }
    # At the paper's -10 a single contact outweighs all other rewards, and their sum, which is
    # clipped at zero, does not tell good attempts to climb from bad ones. Both penalties teach a
    # gait at first; at the highest steps they cost more than walking earns.
    follow(env, "collision", over_phases(-1.0, -0.3, -0.3, -0.3, -0.3))
    follow(env, "foot_clearance", over_phases(-20.0, -3.0, -3.0, -3.0, -3.0))


def follow(env: RenetEnvCfg, reward: str, schedule: Schedule) -> None:
    """Let the weight of a reward, by its name, follow a schedule."""
    env.rewards[reward].weight = value_at(schedule, 0.0)
    params = {"reward": reward, "schedule": schedule}
    env.curriculum[f"{reward}_weight"] = CurriculumTermCfg(func=mdp.reward_weight, params=params)


def set_differences(env: RenetEnvCfg) -> None:
    """Randomize what differs between real robots, and set the noise of a real camera."""
    # Delays of joint targets are not among them: they cost most levels and a quarter of the speed
    # (`benchmarks/NOTES.md`). Real motors have up to twice the damping that they are told, with
    # which a robot that has not trained so climbs no stairs.
    randomize(
        env,
        motor_strength=0.2,
        damping=(0.7, 2.2),
        joint_friction=0.2,
        camera_delay=0.1,
        joint_offset=0.03,
        camera_position=0.03,
        camera_angle=0.14,
    )
    # The paper's "variance 0.01" read as m^2 is 0.1 m, which hides narrow gaps; a RealSense has 1
    # to 3 cm at 2 m.
    depth_camera(env).noise.gaussian_std = 0.03


def set_tiles(env: RenetEnvCfg) -> None:
    """Set tiles with more edges, and put more robots where they learn slowest."""
    terrain = env.scene.terrain
    assert terrain is not None
    assert terrain.terrain_generator is not None
    tiles = dense_tiles() | barriers()
    shares = {"rough": 5.0, "stairs_up": 1.5, "gap": 2.0, "platform": 2.0}
    shares |= {"wall": 0.5, "ledge": 0.5}
    for kind, share in shares.items():
        tiles[kind].proportion = share
    # Velocities are learned on rough ground. Robots that follow them need less of it.
    later = {
        "rough": over_phases(5.0, 5.0, 3.0, 3.0, 3.0),
        "gap": over_phases(2.0, 2.0, 3.0, 3.0, 3.0),
        "platform": over_phases(2.0, 2.0, 3.0, 3.0, 3.0),
    }
    params = {"shares": later}
    env.curriculum["tile_shares"] = CurriculumTermCfg(func=mdp.tile_shares, params=params)
    terrain.terrain_generator.sub_terrains = cast(Any, tiles)
    # Level 0 is flat.
    terrain.max_init_terrain_level = 0
    # Once levels have risen, robots meet no narrow gaps any more and forget how to cross them. On
    # tiles other than gaps, easier levels would take a quarter of the practice and bring nothing.
    env.curriculum["level"].params |= {
        "easier_kinds": ("gap",),
        "easier_share": over_phases(0.0, 0.0, 0.25, 0.6, 0.6),
        "easier_levels": over_phases(10, 10, 10, 4, 4),
    }
