"""Bundles with untrained networks."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from renet.bundle import Bundle, write_bundle
from renet.bundle.manifest import Manifest
from renet.models.config import ModelCfg
from renet.models.renet import RENet
from renet.robots import GO2
from renet.selector import SelectorSpec
from renet.training.export import camera_spec, export_models, robot_spec


@pytest.fixture(scope="session")
def networks() -> RENet:
    torch.manual_seed(0)
    return RENet(ModelCfg(), critic_size=10).eval()


@pytest.fixture(scope="session")
def manifest() -> Manifest:
    return Manifest(robot_spec(), camera_spec(), SelectorSpec(beta=0.02))


@pytest.fixture(scope="session")
def models(networks) -> dict[str, bytes]:
    return export_models(networks)


@pytest.fixture
def bundle_path(tmp_path, models, manifest) -> Path:
    return write_bundle(tmp_path / "bundle", models, manifest)


@pytest.fixture(scope="session")
def bundle(tmp_path_factory, models, manifest) -> Bundle:
    """Untrained networks reconstruct badly: the largest beta, so that only real faults count."""
    easy = replace(manifest, selector=SelectorSpec(beta=0.25))
    return Bundle.load(write_bundle(tmp_path_factory.mktemp("b") / "bundle", models, easy))


@pytest.fixture(scope="session")
def go2_bundle(tmp_path_factory, models) -> Path:
    """The same networks, for the Go2."""
    manifest = Manifest(robot_spec(GO2), camera_spec(GO2), SelectorSpec(beta=0.25))
    return write_bundle(tmp_path_factory.mktemp("go2") / "untrained", models, manifest)
