"""Configuration of the networks; each row of the paper's ablation table is one field."""

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
    """Latents that the actor reads: those of both estimators in turn (paper), of VP, of OP, or of a
    VP that sees the true height map (Oracle)."""
    encoder: Encoder = "attention"
    """Feature fusion: single-layer single-head self-attention (SA) or an MLP (paper)."""
    history: int = HISTORY
    """Number H1 of proprioceptions that an estimator reads; 1 is the row "One Obs"."""
    frames: int = FRAMES
    """Number H2 of depth images that VP reads; 1 is the row "One Image"."""
    predict_velocity: bool = True
    """Velocity head of both estimators; False is the row "w/o VEL"."""
    predict_feet_height: bool = True
    """Head of VP for the heights of the feet; False is the row "w/o FH"."""
    predict_height_map: bool = True
    """Head of VP for the height map; False is the row "w/o HF"."""
    predict_map_error: bool = False
    """Head of VP for the variance of the height map's error, which grows as its memory of the
    ground gets old (not the paper's). It needs the height map."""
    predict_far_map: bool = False
    """Head of VP for the ground beyond the height map, as far as images reach (not the paper's).
    Only its loss is used: VP remembers what it learns to predict."""
    expect_image: bool = False
    """Expectation of the next image from VP's memory, which notices images that lie plausibly (not
    the paper's)."""
    him: bool = True
    """Hybrid internal model loss on both estimators; False is the row "w/o HIM"."""
    detector: Detector = "reconstruction"
    """Anomaly detector: `reconstruction` is the paper's, scored by its squared error (eq. 4);
    `variance` also predicts the variance of its error, and is scored by their ratio."""
    actor_hidden: tuple[int, ...] = (256, 256, 128)
    """Hidden units of the actor. All three ONNX models together must stay below 3 MB."""
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
            choices = get_args(kind)
            value = getattr(self, name)
            if value not in choices:
                raise RenetError(f"model.{name} must be one of {', '.join(choices)}, got {value!r}")
        if not self.initial_std > 0:
            raise RenetError(f"model.initial_std must be above 0, got {self.initial_std}")
        if self.history < 1:
            raise RenetError(f"model.history must be at least 1, got {self.history}")
