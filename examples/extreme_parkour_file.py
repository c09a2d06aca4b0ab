"""Join Extreme Parkour's two files to one that the fault benchmark's adapter takes.

`python examples/extreme_parkour_file.py base_jit.pt vision_weight.pt --out extreme_parkour.pt`,
then `renet evaluate benchmark --policy extreme_parkour.pt --adapter extreme-parkour`. The two files
are what save_jit.py of github.com/chengxuxin/extreme-parkour leaves: the actor as TorchScript, and
the weights of the encoder of images.
"""

import sys
import warnings
from pathlib import Path

import torch
import tyro
from torch import Tensor, nn

from renet.errors import RenetError, reason
from renet.files import write_atomically

SIZES = {"image": (58, 87), "observation": (53,), "state": (512,)}  # Inputs of the encoder.
ACTOR_SIZE, LATENT_SIZE = 753, 32


class ImageEncoder(nn.Module):
    """Convolutions, the robot's observation and a GRU, with the names of the file's weights."""

    def __init__(self) -> None:
        super().__init__()
        self.base_backbone = nn.ModuleDict(
            {
                "image_compression": nn.Sequential(
                    nn.Conv2d(1, 32, kernel_size=5),
                    nn.MaxPool2d(2),
                    nn.ELU(),
                    nn.Conv2d(32, 64, kernel_size=3),
                    nn.ELU(),
                    nn.Flatten(),
                    nn.Linear(64 * 25 * 39, 128),
                    nn.ELU(),
                    nn.Linear(128, 32),
                )
            }
        )
        self.combination_mlp = nn.Sequential(nn.Linear(85, 128), nn.ELU(), nn.Linear(128, 32))
        self.rnn = nn.GRU(32, 512, batch_first=True)
        self.output_mlp = nn.Sequential(nn.Linear(512, LATENT_SIZE + 2), nn.Tanh())

    def forward(self, image: Tensor, observation: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Latents [N, 34] and new states [N, 512] of images, observations and states."""
        seen = nn.functional.elu(self.base_backbone["image_compression"](image[:, None]))
        mixed = self.combination_mlp(torch.cat((seen, observation), dim=1))
        output, state = self.rnn(mixed[:, None], state[None].contiguous())
        return self.output_mlp(output[:, 0]), state[0]


class ExtremeParkour(nn.Module):
    """Actor and encoder as the two methods that the adapter calls."""

    def __init__(self, actor: nn.Module, encoder: nn.Module) -> None:
        super().__init__()
        self.actor, self.encoder = actor, encoder

    def forward(self, observation: Tensor, latent: Tensor) -> Tensor:
        """Actions [N, 12] of the actor's inputs [N, 753] and latents [N, 32]."""
        return self.actor(observation.clone(), latent)  # It writes into its inputs.

    def encode(self, image: Tensor, observation: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Latents and new states; see `ImageEncoder.forward`."""
        return self.encoder(image, observation, state)


def read_encoder(path: Path) -> ImageEncoder:
    """Read the encoder's weights; raises RenetError if they are not those of Extreme Parkour."""
    encoder = ImageEncoder()
    try:
        weights = torch.load(path, map_location="cpu", weights_only=True)
        encoder.load_state_dict(weights["depth_encoder_state_dict"])
    except OSError as error:
        raise RenetError(f"cannot read {path}: {reason(error)}; name vision_weight.pt") from None
    except Exception as error:  # Those of PyTorch are long, and have no base class of their own.
        raise RenetError(
            f"{path} holds no weights of Extreme Parkour's encoder: name the vision_weight.pt of"
            " its save_jit.py"
        ) from error
    return encoder


def join(base: Path, vision: Path) -> torch.jit.ScriptModule:
    """Join the files; raises RenetError if one is not what its name says."""
    try:
        actor = torch.jit.load(base, map_location="cpu")
        module = ExtremeParkour(actor, read_encoder(vision)).eval()
        encoded = tuple(torch.zeros(2, *size) for size in SIZES.values())
        acted = (torch.zeros(2, ACTOR_SIZE), torch.zeros(2, LATENT_SIZE))
        # PyTorch's own GRU compares sizes, of which the tracer warns.
        with torch.no_grad(), warnings.catch_warnings(action="ignore"):
            return torch.jit.trace_module(module, {"forward": acted, "encode": encoded})
    except (RuntimeError, ValueError) as error:
        raise RenetError(
            f"{base} is not Extreme Parkour's actor: name the base_jit.pt of its save_jit.py"
        ) from error


def main(
    base: tyro.conf.Positional[Path],
    vision: tyro.conf.Positional[Path],
    out: Path = Path("extreme_parkour.pt"),
) -> None:
    """Join base_jit.pt and vision_weight.pt to one TorchScript file."""
    write_atomically(out, join(base, vision).save_to_buffer(), "policy")
    print(f"Wrote {out}")


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except RenetError as error:
        print(error, file=sys.stderr)
        raise SystemExit(2) from error
