"""Other people's policies in renet's studies: what each senses, and what its outputs mean.

`base` is the interface, `models` opens files, `evaluator` puts both into a study. An adapter is a
module of some fifty lines with a class `Adapter`; `ADAPTERS` names those that come with renet.
"""
