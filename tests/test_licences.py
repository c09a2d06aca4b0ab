"""What is distributed carries the licences of what it contains."""

import json
import tomllib
from pathlib import Path

from renet.page.writer import VENDOR

ROOT = Path(__file__).parents[1]
NOTICE = (ROOT / "NOTICE").read_text()


def test_the_wheel_carries_the_notice():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert {"LICENSE", "NOTICE"} <= set(project["license-files"])


def test_every_npm_package_of_the_page_is_named_with_its_version():
    packages = json.loads((ROOT / "web" / "package.json").read_text())["dependencies"]
    used = {name for name in packages if any(path.startswith(f"{name}/") for path in VENDOR)}
    assert used == packages.keys()
    for name, version in packages.items():
        assert f"{name} {version}" in NOTICE


def test_every_model_and_mesh_is_named():
    models = [*(ROOT / "src/renet/robots").glob("*.xml"), *(ROOT / "web/robots").iterdir()]
    assert models
    for model in models:
        assert model.relative_to(ROOT).as_posix() in NOTICE


def test_the_page_carries_the_notice():
    assert (ROOT / "web" / "NOTICE").read_text() == NOTICE
