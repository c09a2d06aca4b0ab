"""Bundles: three ONNX models and the manifest that says how to use them."""

from renet.deploy.bundle.bundle import (
    DEFAULT,
    MANIFEST,
    Bundle,
    pretrained,
    read_manifest,
    write_bundle,
    write_manifest,
)
from renet.deploy.bundle.models import MODELS, model_shapes

__all__ = [
    "DEFAULT",
    "MANIFEST",
    "MODELS",
    "Bundle",
    "model_shapes",
    "pretrained",
    "read_manifest",
    "write_bundle",
    "write_manifest",
]
