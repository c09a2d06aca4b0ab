"""Velocities in the robots' own frames: how they are drawn, told and rewarded."""

import math
from types import SimpleNamespace

import pytest
import torch

from renet.errors import RenetError
from renet.tasks import env_cfg
from renet.tasks.mdp import goal, kick_share, stepping, turn_tracking, velocity_tracking
from renet.tasks.mdp.commands import COMMAND, DriveCommandCfg
from renet.tasks.parkour_env_cfg import flat_env_cfg
from renet.tasks.sensors import FEET_CONTACT

ROBOTS = 512


def drive_cfg(**settings):
    """Flat ground on which every command is a velocity."""
    cfg = flat_env_cfg()
    goals = vars(cfg.commands[COMMAND]) | {"told": "twist"}
    shares = {"free_shares": {"plane": 1.0}}
    cfg.commands[COMMAND] = DriveCommandCfg(**goals, **shares | settings)
    return cfg


@pytest.fixture(scope="module")
def drivers():
    from renet.tasks import make_env

    env = make_env(drive_cfg(), ROBOTS)
    yield env
    env.close()


@pytest.fixture
def env(drivers):
    drivers.reset(seed=1)
    goal(drivers).fixed_twist = None
    return drivers


def drive(env, twist, velocity, rate=0.0, heading=0.0):
    """Tell every robot a twist and let it move so, in its own frame, at a heading."""
    goal(env).fixed_twist = torch.tensor(twist).repeat(env.num_envs, 1)
    env.reset()
    quaternion = torch.tensor((math.cos(heading / 2), 0.0, 0.0, math.sin(heading / 2)))
    env.sim.data.qpos[:, 3:7] = quaternion
    cos, sin = math.cos(heading), math.sin(heading)
    x, y = velocity
    env.sim.data.qvel[:] = 0.0
    env.sim.data.qvel[:, 0] = cos * x - sin * y
    env.sim.data.qvel[:, 1] = sin * x + cos * y
    env.sim.data.qvel[:, 5] = rate
    env.sim.forward()
    goal(env)._update_command(None)


def test_velocities_span_their_ranges(env):
    command = goal(env)
    assert command.free.all()
    forward, left, turn = command.command.unbind(-1)
    assert forward.min() < -0.4
    assert 0.8 < forward.max() <= 1.0
    assert left.abs().max() <= 0.5
    assert turn.abs().max() <= 1.0
    on_the_spot = (command.speed == 0.0) & (turn != 0.0)
    assert 0.08 < on_the_spot.float().mean() < 0.3
    assert torch.allclose(command.speed, torch.hypot(forward, left))


def test_a_twist_is_told_as_it_is(env):
    drive(env, (-0.3, 0.2, 0.5), (0.0, 0.0))
    torch.testing.assert_close(goal(env).command[0], torch.tensor((-0.3, 0.2, 0.5)))


def test_a_robot_told_not_to_turn_is_led_back_to_its_heading(env):
    drive(env, (0.5, 0.0, 0.0), (0.0, 0.0), heading=0.2)
    goal(env).yaw[:] = 0.0
    goal(env)._update_command(None)
    torch.testing.assert_close(goal(env).command[:, 2], torch.full((ROBOTS,), -0.3))


@pytest.mark.parametrize("heading", [0.0, 2.0])
@pytest.mark.parametrize(
    ("velocity", "expected"),
    [
        ((-0.4, 0.3), 1.0),
        ((-0.2, 0.15), 0.5),
        ((0.0, 0.0), 0.0),
        ((0.2, -0.15), -0.5),
        ((0.8, -0.6), -1.0),
    ],
)
def test_reward_of_a_velocity(env, heading, velocity, expected):
    drive(env, (-0.4, 0.3, 0.5), velocity, heading=heading)
    torch.testing.assert_close(
        velocity_tracking(env), torch.full((ROBOTS,), expected), atol=1e-3, rtol=0.0
    )


@pytest.mark.parametrize(
    ("velocity", "rate", "expected"),
    [
        ((0.0, 0.0), 1.0, 1.0),
        ((0.15, 0.0), 1.0, 0.5),
        ((0.0, 0.0), 0.5, 0.5),
        ((0.0, 0.0), 0.0, 0.0),
        ((0.0, 0.0), -1.0, 0.0),
        ((0.45, 0.0), 1.0, -0.5),
    ],
)
def test_reward_of_turning_on_the_spot(env, velocity, rate, expected):
    drive(env, (0.0, 0.0, 1.0), velocity, rate)
    torch.testing.assert_close(
        velocity_tracking(env), torch.full((ROBOTS,), expected), atol=1e-3, rtol=0.0
    )
    assert not goal(env).stands.any()


@pytest.mark.parametrize(
    ("rate", "expected"), [(0.5, 1.0), (0.25, 0.5), (0.0, 0.0), (-0.3, 0.0), (0.75, 0.5)]
)
def test_reward_of_a_turn_rate(env, rate, expected):
    drive(env, (0.5, 0.0, 0.5), (0.5, 0.0), rate)
    torch.testing.assert_close(
        turn_tracking(env), torch.full((ROBOTS,), expected), atol=1e-3, rtol=0.0
    )


def test_feet_in_the_air_count_for_a_swing_of_robots_told_to_move(env, monkeypatch):
    drive(env, (0.3, 0.0, 0.0), (0.0, 0.0))
    goal(env).speed[:2] = 0.0
    term = stepping(None, env)
    touches = torch.zeros(ROBOTS, 4)
    touches[:, 0] = 1.0
    touches[2] = torch.tensor((1.0, 1.0, 1.0, 0.0))
    sensor = SimpleNamespace(data=SimpleNamespace(found=touches))
    monkeypatch.setitem(env.scene.sensors, FEET_CONTACT, sensor)
    shares = torch.stack([term(env, swing=0.1) for _ in range(7)])
    # Three feet count as two; the rest of the fifth step on is no swing any more.
    torch.testing.assert_close(shares[:5, 3], torch.ones(5))
    torch.testing.assert_close(shares[:5, 2], torch.full((5,), 0.5))
    assert (shares[5:] == 0.0).all()
    assert (shares[:, :2] == 0.0).all(), "told to stand"
    touches[:] = 1.0
    term(env, swing=0.1)
    touches[:] = 0.0
    assert (term(env, swing=0.1)[2:] == 1.0).all(), "a new swing"


def test_a_velocity_owes_no_distance(env):
    env.step(torch.zeros(ROBOTS, 12))
    assert (goal(env).commanded_distance == 0.0).all()


def in_own_frame(env):
    """Planar velocity in the robot's own frame and turn rate of every robot, [N, 3]."""
    w, _, _, z = env.sim.data.qpos[:, 3:7].unbind(-1)
    heading = 2.0 * torch.atan2(z, w)
    x, y = env.sim.data.qvel[:, 0], env.sim.data.qvel[:, 1]
    cos, sin = heading.cos(), heading.sin()
    return torch.stack((cos * x + sin * y, cos * y - sin * x, env.sim.data.qvel[:, 5]), dim=-1)


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_a_share_of_new_velocities_is_given_at_once(env, share):
    command = goal(env)
    command.kick_share = share
    # Robots that face in all directions, lie flat and do not move.
    heading = torch.linspace(-3.0, 3.0, ROBOTS)
    env.sim.data.qpos[:, 3:7] = 0.0
    env.sim.data.qpos[:, 3] = (heading / 2).cos()
    env.sim.data.qpos[:, 6] = (heading / 2).sin()
    env.sim.data.qvel[:] = 0.0
    command._resample_command(torch.arange(ROBOTS))
    command.kick_share = 0.0

    moves = in_own_frame(env)
    told = torch.cat((command.velocity, command.free_turn.unsqueeze(-1)), dim=-1)
    given = moves.abs().sum(-1) > 0.0
    torch.testing.assert_close(moves[given], told[given], atol=1e-5, rtol=0.0)
    asked = told.abs().sum(-1) > 0.0
    assert given[asked].float().mean().item() == pytest.approx(share, abs=0.07)
    assert (env.sim.data.qvel[:, 2:5] == 0.0).all()


def test_share_of_kicks_follows_its_schedule(env):
    env.common_step_counter = 10
    share = kick_share(env, torch.arange(4), schedule=f"1@0,0.5@{20 * ROBOTS}")
    assert share.item() == pytest.approx(0.75)
    assert goal(env).kick_share == pytest.approx(0.75)
    goal(env).kick_share = 0.0


def test_only_named_tiles_have_velocities(build):
    env = build("Renet-Go1-Parkour", 120)
    command = goal(env)
    kinds = list(env.scene.terrain.cfg.terrain_generator.sub_terrains)
    shares = env_cfg("Renet-Go1-Parkour").commands[COMMAND].free_shares
    for number, kind in enumerate(kinds):
        here = env.scene.terrain.terrain_types == number
        assert command.free[here].any() == (kind in shares), kind
        assert not command.free[here].all()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"forward": (1.0, 0.2)}, "commands.forward must be two numbers, the smaller one first"),
        ({"speed": (0.2, math.inf)}, "commands.speed must be"),
        ({"resampling_time_range": (math.nan, 1.0)}, "commands.resampling_time_range must be"),
        ({"sideways": -0.1}, "commands.sideways must be at least 0"),
        ({"turn": math.nan}, "commands.turn must be at least 0"),
        ({"free_shares": {"rough": 1.5}}, r"commands.free_shares\['rough'\] must be from 0 to 1"),
        ({"kick_share": -1.0}, "commands.kick_share must be from 0 to 1"),
    ],
)
def test_settings_that_make_no_sense_are_refused_by_name(settings, message):
    with pytest.raises(RenetError, match=message):
        DriveCommandCfg(**settings)
