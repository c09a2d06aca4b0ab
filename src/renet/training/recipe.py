"""The default recipe: how `renet train` departs from the paper, and why.

PAPER holds the paper's settings, or where it is silent those of the methods it builds on; nobody
has run its 1.5 billion steps. What both presets share is in docs/method.md. Settings that change
during training are schedules over environment steps (`config.Schedule`), so that they mean the same
for 64 robots and for 16,384.
"""

from __future__ import annotations

from copy import deepcopy
from typing import Any

from renet.errors import RenetError
from renet.models.config import ModelCfg
from renet.tasks.parkour_env_cfg import RandomizationCfg
from renet.training.config import AdaptationCfg, NP3OCfg, SupervisionCfg, WithholdingCfg

RENET: dict[str, Any] = {
    # A policy that already stands needs no noise of radians; what remains shrinks as it learns.
    # It knows which errors are usual: notices glare and occlusion two to eight times as often. It
    # also learns what sparse grass looks like (`renet calibrate`).
    "model": ModelCfg(initial_std=0.5, detector="variance", predict_map_error=True),
    "algorithm": NP3OCfg(
        # With a third of this the deviation fell to 2 degrees a joint, and gaps were crossed less.
        entropy="0.008@200M,0.001@300M",
        # Late, nearly all of the gradient is noise: smaller steps average over more of it.
        desired_kl="0.01@250M,0.004@280M",
        # With 0.95 most of the actor's gradient is noise; critics that see the truth explain the
        # returns well enough to take it out (benchmarks/NOTES.md).
        lam=0.8,
        # Gradients are half of an iteration's time; a fourth and fifth pass bring less than steps.
        num_learning_epochs=3,
        # A policy that walks hardly violates anything. With budgets of 0 the errors of three
        # critics keep all penalties on: noise that only very large batches average out.
        # Tighter ones press where robots leap and climb.
        cost_budget=(0.06, "0.5@10M,0.24@60M", 1.5),
    ),
    "supervision": SupervisionCfg(
        # Four gradient steps an iteration left VP's map without gaps.
        num_mini_batches=12,
        autoencoder_images=48,
        # The actor reads latents: late in training they must hold still.
        learning_rate="1e-3@20M,3e-4@150M,1e-4@300M",
    ),
    # In turns of 20 iterations an estimator forgets what the other one practises meanwhile.
    "adaptation": AdaptationCfg(period=4),
    # From the first step on, which costs no level.
    "withholding": WithholdingCfg(share=0.5),
    # Small batches learn to walk sooner; large ones carry less noise once little is left to learn.
    "batch_size": "12800@5M,51200@40M",
    "reward_weights": {
        # At the paper's -10 a touch outweighs all else and the clipped sum says nothing where a
        # robot tries to climb. The others are not the paper's: `tasks/mdp/rewards.py` says why.
        # Both teach a gait at first, and cost more than walking earns at the highest steps.
        "collision": "-1@12M,-0.3@24M",
        "foot_clearance": "-20@12M,-3@24M",
        "upright_tracking": 0.75,
        "standing_motion": -0.5,
    },
    # Robots practise where levels rise slowest.
    "terrain_proportions": {
        "rough": 1.0,
        "obstacles": 1.0,
        "stairs_up": 1.5,
        "stairs_down": 1.0,
        "gap": 2.0,
        "platform": 2.0,
    },
    "dense_tiles": True,
    # The paper's "variance 0.01" read as m^2 is 0.1 m, which hides narrow gaps; a RealSense has 1
    # to 3 cm at 2 m.
    "depth_noise_std": 0.03,
    # What a real robot adds. Late targets are missing: they cost most levels and a quarter of the
    # speed (`benchmarks/NOTES.md`).
    "randomization": RandomizationCfg(
        motor_strength=0.2,
        camera_delay=0.1,
        joint_offset=0.03,
        camera_position=0.03,
        camera_angle=0.14,
    ),
    # Sooner, a third of the steps goes to standing while levels could rise.
    "standing_after": 2e7,
    # Once the levels have risen, nobody meets a narrow gap, and its crossing is forgotten. On other
    # tiles it would give a quarter of the practice away.
    "easier_after": 5.5e7,
    "easier_kinds": ("gap",),
}

PAPER: dict[str, Any] = {
    "model": ModelCfg(),
    "algorithm": NP3OCfg(),
    "supervision": SupervisionCfg(),
    "adaptation": AdaptationCfg(),
    "withholding": WithholdingCfg(),
    "batch_size": 102_400,
    "average_over": 1,
    "reward_weights": {},
    "terrain_proportions": {},
    "dense_tiles": False,
    "depth_noise_std": 0.1,
    "randomization": RandomizationCfg(),
    # Iteration 3,900 of 15,000 with 4,096 robots.
    "standing_after": 4e8,
    "easier_after": None,
    "easier_kinds": (),
}

PRESETS = {"renet": RENET, "paper": PAPER}


def preset(name: str = "renet") -> dict[str, Any]:
    """A copy of a preset's settings; raises RenetError listing the known ones."""
    if name not in PRESETS:
        raise RenetError(f"unknown preset {name!r}: choose one of {', '.join(PRESETS)}")
    return deepcopy(PRESETS[name])
