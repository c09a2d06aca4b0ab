"""Online estimator adaptation follows the paper's schedule."""

from __future__ import annotations

import torch

from renet.training.modality import op_mask

DIFFICULT = torch.tensor([[0.0], [1.0], [0.0]])


def test_simple_terrain_alternates_and_difficult_terrain_keeps_vision():
    for iteration, simple in ((0, False), (19, False), (20, True), (39, True), (40, False)):
        assert op_mask("renet", iteration, DIFFICULT, 20).tolist() == [simple, False, simple]


def test_single_estimator_ablations_never_alternate():
    assert op_mask("op", 3, DIFFICULT, 20).all()
    assert not op_mask("vp", 25, DIFFICULT, 20).any()
    assert not op_mask("oracle", 25, DIFFICULT, 20).any()
