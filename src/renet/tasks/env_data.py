"""A robot's state that is derived once for each run of the engine, not for each term that asks."""

from __future__ import annotations

from typing import Any

from mjlab.entity import EntityData

from renet.sim.engine import NativeSimulation


def _once(name: str) -> property:
    """EntityData's property `name`, remembered until the engine has run again."""
    derive = getattr(EntityData, name).fget

    def get(self: DerivedOnce) -> Any:
        if self.runs != self.simulation.runs:
            self.runs = self.simulation.runs
            self.known.clear()
        if name not in self.known:
            self.known[name] = derive(self)
        return self.known[name]

    return property(get, doc=getattr(EntityData, name).__doc__)


class DerivedOnce(EntityData):
    """What follows from the poses and velocities that the native engine computed.

    They change only when it runs: writing a state does not touch them. Callers must not change what
    they get in place.
    """

    root_link_pose_w = _once("root_link_pose_w")  # type: ignore[assignment]
    root_link_vel_w = _once("root_link_vel_w")  # type: ignore[assignment]
    root_link_lin_vel_b = _once("root_link_lin_vel_b")  # type: ignore[assignment]
    root_link_ang_vel_b = _once("root_link_ang_vel_b")  # type: ignore[assignment]
    projected_gravity_b = _once("projected_gravity_b")  # type: ignore[assignment]
    heading_w = _once("heading_w")  # type: ignore[assignment]

    def __init__(self, data: EntityData, simulation: NativeSimulation) -> None:
        """Stand in for an entity's data."""
        super().__init__(**vars(data))
        self.simulation, self.runs = simulation, simulation.runs
        self.known: dict[str, Any] = {}
