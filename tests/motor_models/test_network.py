"""The network of a Go1's motors: its formula by hand, and the published file's own answers."""

import numpy as np
import pytest
import torch

from renet.motor_models.network import WEIGHTS, MotorNetwork, read_network

BY_HAND = MotorNetwork(
    robot="Nobody",
    stiffness=20.0,
    damping=0.5,
    layers=(
        # One unit adds the errors and subtracts the newest velocity, one is its bias alone.
        (np.array([[1.0, 1.0, 1.0, -1.0, 0.0, 0.0], [0.0] * 6]), np.array([0.0, 3.0])),
        (np.array([[2.0, 4.0]]), np.array([-2.0])),
        (np.array([[10.0]]), np.array([0.5])),
    ),
)


def test_its_formula_is_that_of_a_perceptron_with_softsign_units():
    # 0.3 + 0.2 + 0.1 - (-0.4) = 1, whose softsign is 1/2; that of 3 is 3/4.
    # 2 * 1/2 + 4 * 3/4 - 2 = 2, whose softsign is 2/3; 10 * 2/3 + 0.5.
    torque = BY_HAND.torque(np.array([[0.3, 0.2, 0.1]]), np.array([[-0.4, 9.0, 9.0]]))
    assert torque == pytest.approx([10 * 2 / 3 + 0.5])


SAMPLES = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.1, 0.1, 0.1, 0.0, 0.0, 0.0],
        [-0.2, -0.25, -0.3, 1.0, 0.5, 0.0],
        [0.6, 0.5, 0.4, -8.0, -6.0, -4.0],
        [0.0, 0.0, 0.0, 2.0, 2.0, 2.0],
    ]
)
PUBLISHED = [-0.0040675, -1.8722885, 3.9930902, -2.3659625, -1.5694690]
"""Torques that `torch.jit.load("unitree_go1.pt")` of walk-these-ways gives for the samples."""


def test_the_shipped_weights_are_the_published_ones():
    network = read_network()
    torque = network.torque(SAMPLES[:, :3], SAMPLES[:, 3:])
    np.testing.assert_allclose(torque, PUBLISHED, atol=2e-6)
    tensors = network.converted(torch.from_numpy)
    samples = torch.tensor(SAMPLES, dtype=torch.float32)
    np.testing.assert_allclose(tensors.torque(samples[:, :3], samples[:, 3:]), PUBLISHED, atol=1e-5)


def test_a_motor_pulls_towards_its_target_and_brakes():
    network = read_network()
    pulls, brakes = network.torque(np.full((2, 3), [[0.1], [0.0]]), np.full((2, 3), [[0.0], [3.0]]))
    assert -2.5 < pulls < -1.5  # Kp 20 times 0.1 rad.
    # More than the Kd of 0.5 that it was told.
    assert 0.7 < -brakes / 3.0 < 1.0


def test_other_gains_scale_what_the_network_sees():
    assert BY_HAND.scale_error(0.1, 40.0) == pytest.approx(0.2)
    assert BY_HAND.scale_velocity(3.0, 1.0) == pytest.approx(6.0)
    limp = BY_HAND.scale_error(np.array([0.1, 0.2]), np.array([0.0, 20.0]))
    np.testing.assert_allclose(limp, [0.0, 0.2])


def test_its_license_lies_beside_it():
    text = WEIGHTS.with_name("go1.LICENSE.txt").read_text()
    assert text.startswith("MIT License\n\nCopyright (c) 2022 MIT Improbable AI Lab\n")
