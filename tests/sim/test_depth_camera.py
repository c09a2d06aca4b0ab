"""The camera's clock where its period is no multiple of the step."""

from __future__ import annotations

from types import SimpleNamespace

import mujoco
import torch

from renet.sim.depth.camera import DepthCameraCfg


def test_images_keep_their_rate_when_the_period_is_no_multiple_of_the_step():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom type="plane" size="0 0 1"/><body name="robot"/>'
        "</worldbody></mujoco>"
    )
    state = SimpleNamespace(
        qpos=torch.zeros(1, 0), xpos=torch.ones(1, 2, 3), xmat=torch.eye(3).expand(1, 2, 3, 3)
    )
    camera = DepthCameraCfg(name="depth", body="robot", period=0.05).build()
    camera.initialize(model, None, state, "cpu")
    last, new = camera.data, []
    for step in range(1, 11):
        camera.update(0.02)
        if camera.data is not last:
            last = camera.data
            new.append(step)
    assert new == [3, 5, 8, 10]
