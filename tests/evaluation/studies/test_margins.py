import math
from dataclasses import asdict, replace
from functools import partial

import numpy as np
import pytest

from renet.evaluation.conditions import use_training_conditions
from renet.evaluation.env import SimEnv, study_env_cfg, terrain_env_cfg
from renet.evaluation.studies.margins import ALLOWED_LOSS, MARGIN_AXES, MarginsStudy, change, margin
from renet.tasks import VISUAL_GO1, env_cfg
from renet.tasks.sensors import depth_camera

flat_cfg = partial(terrain_env_cfg, {"flat": 1}, VISUAL_GO1)


def settings(cfg) -> dict:
    """What the axes may change."""
    camera = depth_camera(cfg)
    group = cfg.observations["proprioception"]
    actuators = cfg.scene.entities["robot"].articulation.actuators
    return {
        "delays": {(a.delay_min_lag, a.delay_max_lag) for a in actuators},
        "camera": (camera.delay, camera.mount.pitch),
        "sensors": (group.enable_corruption, asdict(group.terms["value"].noise)),
        **{name: event.params for name, event in cfg.events.items()},
    }


CHANGED = {
    "action_delay": "delays",
    "friction": "foot_friction",
    "joint_zeros": "joint_offset",
    "payload": "payload",
    "motor_strength": "motor_strength",
    **dict.fromkeys(("soft_gains", "stiff_gains"), "servo_gains"),
    **dict.fromkeys(("gravity", "gyro"), "sensors"),
    **dict.fromkeys(("camera_delay", "camera_down", "camera_up"), "camera"),
}
"""What each axis changes."""


@pytest.mark.parametrize("axis", MARGIN_AXES)
def test_an_axis_changes_one_thing_and_nothing_else(axis):
    before, cfg = settings(flat_cfg()), flat_cfg()
    change(cfg, axis, MARGIN_AXES[axis].levels[0])
    after = settings(cfg)
    assert {name for name in after if after[name] != before.get(name)} == {CHANGED[axis]}
    assert settings(flat_cfg()) == before, "the robot's own description is untouched"


def test_levels_are_in_the_units_they_are_shown_in():
    cfg = flat_cfg()
    for axis, level in (("camera_delay", 300), ("gravity", 10), ("motor_strength", 40)):
        change(cfg, axis, level)
    after = settings(cfg)
    assert after["motor_strength"]["effort_limit_range"] == (0.4, 0.4)
    assert after["camera"][0] == (0.3, 0.3)
    bias = after["sensors"][1]["bias"]
    seen = np.add(bias[3:6], (0.0, 0.0, -1.0))
    assert np.linalg.norm(seen) == pytest.approx(1.0)
    # A turn of 10 degrees about each of two axes is one of 14.1 degrees.
    assert -seen[2] == pytest.approx(math.cos(math.radians(10) * math.sqrt(2)))
    assert sum(map(abs, bias)) == pytest.approx(sum(map(abs, bias[3:6])))
    change(cfg, "action_delay", 20)
    assert settings(cfg)["delays"] == {(4, 4)}


def test_a_biased_sensor_keeps_the_noise_of_training():
    cfg = flat_cfg()
    use_training_conditions(cfg, env_cfg("Renet-Go1-Parkour"))
    low, high = (np.array(settings(cfg)["sensors"][1][end]) for end in ("n_min", "n_max"))
    change(cfg, "gyro", 0.5)
    gyro = np.arange(45) < 3  # The first terms of the proprioception.
    after = settings(cfg)["sensors"][1]
    np.testing.assert_allclose(after["n_min"], low + 0.5 * gyro)
    np.testing.assert_allclose(after["n_max"], high + 0.5 * gyro)


@pytest.mark.parametrize(("axis", "level"), [("soft_gains", 30), ("stiff_gains", 400)])
def test_gains_are_what_the_sweep_says_under_trainings_conditions_too(axis, level):
    cfg = flat_cfg()
    use_training_conditions(cfg, env_cfg("Renet-Go1-Parkour"))
    change(cfg, axis, level)
    robot = SimEnv(study_env_cfg(cfg, 0.6), [0, 1], 1, "native").env
    stiffness = robot.sim.model.actuator_gainprm[:, :, 0]
    damping = robot.sim.model.actuator_biasprm[:, :, 2]
    for drawn, field, place in ((stiffness, "gainprm", 0), (damping, "biasprm", 2)):
        nominal = robot.sim.get_default_field(f"actuator_{field}")[..., place]
        np.testing.assert_allclose(drawn / nominal, level / 100, rtol=1e-5)


def run(level: float | None, failed: float) -> dict:
    return {"axis": "payload" if level else "nominal", "level": level, "failed": failed}


def test_the_margin_ends_at_the_first_level_beyond_it():
    levels = MARGIN_AXES["payload"].levels
    held = [run(None, 0.0), *(run(level, ALLOWED_LOSS) for level in levels)]
    assert margin(held, "payload", levels) == {"margin": levels[-1], "broke": None, "held": 1.0}
    held[2]["failed"] = 0.1  # The second level; that a worse one is survived does not count.
    end = {"margin": levels[0], "broke": levels[1], "held": 1 / len(levels)}
    assert margin(held, "payload", levels) == end
    held[0]["failed"] = 0.1
    assert margin(held, "payload", levels) == {"margin": None, "broke": levels[0], "held": 0.0}


def test_robots_fall_at_the_violent_end_and_the_sweep_stops_there(tmp_path, monkeypatch):
    monkeypatch.setitem(
        MARGIN_AXES, "payload", replace(MARGIN_AXES["payload"], levels=(1.0, 90.0, 99.0))
    )
    where = {"axes": ("payload",), "grounds": ("flat",), "modes": ("blind",)}
    study = MarginsStudy(out=tmp_path, robots=1, seconds=2.0, conditions="nominal", **where)
    summary = study.run()
    runs = [(run["axis"], run["level"], run["failed"]) for run in summary["runs"]]
    assert runs == [("nominal", None, 0), ("payload", 1.0, 0), ("payload", 90.0, 1)]
    assert [(end["margin"], end["broke"]) for end in summary["margins"]] == [(1.0, 90.0)]
    assert (tmp_path / "margins.png").stat().st_size > 10_000
    assert study.tables(summary)[0][2] == [("payload", "1 kg")]
