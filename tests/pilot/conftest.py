"""The tests' bundles."""

from ..bundle.conftest import bundle, bundle_path, manifest, models, networks  # noqa: F401
