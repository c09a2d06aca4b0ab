"""Names of the files in a bundle's folder."""

from renet.bundle.models import MODELS

MANIFEST = "manifest.json"
"""The manifest."""
PREVIOUS = "manifest.previous.json"
"""The manifest before its last change."""
OURS = (MANIFEST, PREVIOUS, *(f"{name}.onnx" for name in MODELS))
"""Files that renet writes."""
CARD_FILE = "README.md"
"""The model card."""
COMPANIONS = (CARD_FILE, "LICENSE", ".gitattributes", ".gitignore", ".git", ".cache")
"""Files of git, the Hugging Face Hub and `renet bundle card`, which are never read."""
SHARED = (*(name for name in OURS if name != PREVIOUS), CARD_FILE, "LICENSE")
"""The files that are loaded from the Hub and pushed to it."""
