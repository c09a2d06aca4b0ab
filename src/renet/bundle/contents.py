"""Names of the files in a bundle's folder."""

from renet.bundle.models import MODELS

MANIFEST, PREVIOUS = "manifest.json", "manifest.previous.json"
OURS = (MANIFEST, PREVIOUS, *(f"{name}.onnx" for name in MODELS))
"""Every file of a bundle."""
CARD = "README.md"
"""The model card."""
COMPANIONS = (CARD, "LICENSE", ".gitattributes", ".gitignore", ".git", ".cache")
"""What git, the Hugging Face Hub and `renet bundle card` keep beside them, which is never read."""
SHARED = (*(name for name in OURS if name != PREVIOUS), CARD, "LICENSE")
"""The files that are loaded from the Hub and pushed to it."""
