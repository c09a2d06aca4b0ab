"""Settings of a training in a file, JSON or YAML, whole or in part."""

import re
from pathlib import Path
from typing import Any

from renet.errors import RenetError, install
from renet.files import MAX_JSON, read_bytes, read_object

YAML = (".yaml", ".yml")
"""Endings of files in YAML."""
EXPONENT = re.compile(r"[-+]?[0-9][0-9_]*(\.[0-9_]*)?[eE][-+]?[0-9]+$")
"""Numbers such as 1e-3, which YAML 1.1 takes for texts and YAML 1.2, as everybody, for numbers."""


def read_settings(path: Path) -> dict[str, Any]:
    """Read a JSON or YAML file whose top level is a mapping; raises RenetError for any other."""
    suffix = path.suffix.lower()
    if suffix == ".json":
        return read_object(path, "configuration")
    if suffix not in YAML:
        raise RenetError(f"{path} is no configuration: give a .json, .yaml or .yml file")
    try:
        import yaml
    except ModuleNotFoundError as error:
        raise RenetError(f"a configuration in YAML needs PyYAML: {install('train')}") from error

    class Loader(yaml.SafeLoader):
        """Builds plain values alone, and reads 1e-3 as a number."""

    Loader.add_implicit_resolver("tag:yaml.org,2002:float", EXPONENT, list("-+0123456789"))
    text = read_bytes(path, MAX_JSON, "configuration")
    try:
        settings = yaml.load(text, Loader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        first = " ".join(str(error).split())
        raise RenetError(f"the configuration {path} is no YAML: {first}") from error
    if not isinstance(settings, dict):
        raise RenetError(
            f"the configuration {path} must map names to values, as in `agent:` and `env:`, not"
            f" be a {type(settings).__name__}"
        )
    return settings
