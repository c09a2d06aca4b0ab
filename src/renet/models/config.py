"""What is learned, as one dataclass: every row of the paper's ablation table is one field."""

from dataclasses import dataclass
from typing import Literal, get_args

from renet.errors import RenetError
from renet.interface import FRAMES, HISTORY

Encoder = Literal["attention", "mlp"]
Perception = Literal["renet", "vp", "op", "oracle"]
Detector = Literal["reconstruction", "variance"]


@dataclass
class ModelCfg:
    """Networks of RENet (paper, Method A) and the switches of its Table I."""

    perception: Perception = "renet"
    """Which latents the actor reads: both estimators in turn (paper), VP only, OP only, or those of
    a VP that sees the true height map (Oracle)."""
    encoder: Encoder = "attention"
    """Feature fusion: single-layer single-head self-attention (SA) or an MLP (paper)."""
    history: int = HISTORY
    """H1, proprioceptions an estimator sees; 1 is the row "One Obs"."""
    frames: int = FRAMES
    """H2, depth images the VP estimator sees; 1 is the row "One Image"."""
    predict_velocity: bool = True
    """False is the row "w/o VEL"."""
    predict_feet_height: bool = True
    """False is the row "w/o FH"."""
    predict_height_map: bool = True
    """False is the row "w/o HF"."""
    predict_map_error: bool = False
    """Predict the variance of the height map's error, too, which tells when VP's memory of the
    ground is stale (not the paper's); only beside a height map."""
    predict_far_map: bool = False
    """Predict the ground beyond the height map, too, as far as images reach (not the paper's): VP
    remembers what it is taught. Nobody reads the prediction."""
    him: bool = True
    """Hybrid internal model loss on both estimators; False is the row "w/o HIM"."""
    detector: Detector = "reconstruction"
    """Anomaly detector: the paper's, scored by its squared error (eq. 4), or one that also predicts
    the variance of its error and is scored by their ratio."""
    actor_hidden: tuple[int, ...] = (256, 256, 128)
    """Hidden units of the actor; with the other two ONNX models it must stay below 3 MB."""
    critic_hidden: tuple[int, ...] = (256, 256, 128)
    """Hidden units of the reward critic."""
    cost_critic_hidden: tuple[int, ...] = (128, 64)
    """Hidden units of each constraint-cost critic."""
    initial_std: float = 1.0
    """Standard deviation of the untrained policy, in policy units."""

    def __post_init__(self) -> None:
        if not 1 <= self.frames <= FRAMES:
            raise RenetError(f"model.frames must be 1..{FRAMES}, got {self.frames}")
        kinds = {"perception": Perception, "encoder": Encoder, "detector": Detector}
        for name, kind in kinds.items():
            choices, value = get_args(kind), getattr(self, name)
            if value not in choices:
                raise RenetError(f"model.{name} must be one of {', '.join(choices)}, got {value!r}")
        if not self.initial_std > 0:
            raise RenetError(f"model.initial_std must be above 0, got {self.initial_std}")
        if self.history < 1:
            raise RenetError(f"model.history must be at least 1, got {self.history}")
