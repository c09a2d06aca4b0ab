"""Models of a depth camera's faults, in five severities: pure NumPy, for any policy."""

from renet.faults.base import SEVERITIES, Fault, Frames
from renet.faults.catalogue import FAULTS, fault_class
from renet.faults.injection import FaultSchedule, Injection, Injector, parse_fault
from renet.faults.physical import PhysicalFault, ViewPerturbation

__all__ = [
    "FAULTS",
    "SEVERITIES",
    "Fault",
    "FaultSchedule",
    "Frames",
    "Injection",
    "Injector",
    "PhysicalFault",
    "ViewPerturbation",
    "fault_class",
    "parse_fault",
]
