"""Scenes of a few geoms."""

import mujoco

PLANE = '<geom type="plane" size="0 0 1"/>'
ROBOT = """<body name="robot" pos="0 0 0.5"><freejoint/>
  <site name="foot" pos="0 0 -0.2"/><geom size="0.05" mass="1"/></body>"""


def scene(*bodies: str, extra: str = "") -> mujoco.MjModel:
    """A compiled world of bodies and geoms, beside `extra` elements of the model."""
    worldbody = f"<worldbody>{''.join(bodies)}</worldbody>"
    return mujoco.MjModel.from_xml_string(f"<mujoco>{extra}{worldbody}</mujoco>")
