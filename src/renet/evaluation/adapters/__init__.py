"""Policies of other projects in renet's studies.

`base` defines the interface, `models` opens model files, `evaluator` runs a study with an adapter
and a model. An adapter is a module of some fifty lines with a class `Adapter`, which says what the
policy observes and what its actions mean; `evaluator.ADAPTERS` names those that come with renet.
"""
