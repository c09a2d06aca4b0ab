"""Every way a depth camera fails, in five severities: pure NumPy, for any policy."""

from renet.faults.catalogue import FAULTS, fault_class
from renet.faults.injection import Injection, Injector, Schedule
from renet.faults.stream import SEVERITIES, TICK, Fault, Frames
from renet.faults.view import PhysicalFault, View

__all__ = [
    "FAULTS",
    "SEVERITIES",
    "TICK",
    "Fault",
    "Frames",
    "Injection",
    "Injector",
    "PhysicalFault",
    "Schedule",
    "View",
    "fault_class",
]
