"""Pictures of robots."""

import mujoco
import numpy as np

from renet.evaluation.report.video import Painter, VideoCfg

TILE = """<mujoco><worldbody>
<light pos="0 0 4" diffuse=".7 .7 .7"/><light pos="1 0 4" diffuse=".7 .7 .7"/>
<light pos="0 1 4" diffuse=".7 .7 .7"/>
<geom type="box" size="4 4 .1" pos="0 0 -.1" rgba="1 1 1 1"/>
<geom type="box" size="1 1 .1" pos="1 1 .1" rgba="1 1 1 1"/>
<body pos="0 0 .3"><freejoint/><geom type="sphere" size=".1"/></body>
</worldbody></mujoco>"""


def test_white_ground_under_three_lights_shows_its_edges():
    picture = Painter(mujoco.MjSpec.from_string(TILE), 1, VideoCfg()).draw(
        np.array([[0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0]])
    )[0]
    assert (picture == 255).all(-1).mean() < 0.02, "nothing is overexposed"
    below = picture[picture.shape[0] // 2 :]
    assert len({tuple(pixel) for pixel in below[::20, ::20].reshape(-1, 3)}) > 3
