"""Every way a depth camera fails, in five severities: pure NumPy, for any policy."""

from renet.faults.base import SEVERITIES, Fault, Frames
from renet.faults.catalogue import FAULTS, fault_class
from renet.faults.injection import Injection, Injector, Schedule, parse_fault
from renet.faults.physical import PhysicalFault, ViewPerturbation

__all__ = [
    "FAULTS",
    "SEVERITIES",
    "Fault",
    "Frames",
    "Injection",
    "Injector",
    "PhysicalFault",
    "Schedule",
    "ViewPerturbation",
    "fault_class",
    "parse_fault",
]
