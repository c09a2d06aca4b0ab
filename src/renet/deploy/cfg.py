"""The settings of `renet deploy`: which robot, camera and operator, and for how long."""

import argparse
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from renet import __version__, plug_ins
from renet.bundle import Bundle
from renet.bundle.models import remembers
from renet.deploy.cameras.base import CameraCfg
from renet.deploy.catalogue import CAMERAS, ROBOTS, TELEOPS
from renet.deploy.robots.base import DriverCfg
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.teleop.base import TeleopCfg
from renet.errors import RenetError, collected, demand_name, demand_none
from renet.faults import Injection, parse_fault
from renet.interface import CONTROL_DT, MAX_SPEED, OWN_GROUND, PilotMode, Unseen
from renet.plug_ins import load_plug_ins

UNSTEERED_SECONDS = 15.0
"""Length of a run that nobody steers, s."""
DEADMAN = 5.0
"""Time for which a real robot goes on without a sign of its operator, s."""
LIMP = 10.0
"""Stand-up error that no joint can have, rad; with it, a dry run does not check for any."""

NoPrefix = tyro.conf.arg(name="")


@dataclass(frozen=True)
class DeployCfg:
    """Run a bundle on a robot; leaves a recording, a timeline and a score."""

    bundle: tyro.conf.Positional[Path | None] = None
    """Bundle folder, or the name of one that ships: go1-parkour (the default), go1-driven (walks
    backward and sideways, too), go2-parkour (that of --robot go2), go2-driven; or hf://OWNER/NAME
    on the Hugging Face Hub."""
    robot: str = "mujoco"
    """mujoco: simulated in this process. go1: a Unitree Go1 in low-level mode. go2: a Unitree Go2
    EDU on a cable. Or the name of a robot that an installed package adds. Its own options are
    listed once it is chosen."""
    camera: str = "auto"
    """sim, realsense, replay or none. auto: sim for a simulated robot, realsense for a real one."""
    teleop: str = "auto"
    """auto: stands up and walks straight ahead (simulation only). keyboard, joystick, or ros2: the
    velocities of a topic."""
    deadman: float | None = None
    """Seconds without a key, a move of the joystick or a message after which the robot stands until
    there is one; by default 5 with a real robot, no limit in simulation, 0.5 with ros2. inf: no
    limit."""
    out: Path | None = None
    """Folder of the results, results/deploy/DATE_TIME by default; what an earlier run left in
    it is kept in its subfolders earlier-1, earlier-2, ..."""
    seconds: float | None = None
    """Length of the run on the robot's clock; 15 s by default, with an operator no end. Ctrl-C
    and the keyboard's q end it earlier, braked and logged."""
    speed: float = 0.6
    """Forward speed of the auto operator, 0 to 1 m/s."""
    fault: tuple[str, ...] = ()
    """What goes wrong with the camera: NAME[:SEVERITY]@SECONDS[+DURATION], e.g. blackout@5s,
    glare:3@4s+2s."""
    mode: PilotMode = "memory"
    """memory: all monitors, and the memory of the ground. switch: the paper's switch, by the
    reconstruction loss alone. camera: every image is used. blind: none is."""
    unseen: Unseen = "walk"
    """In mode memory, at the end of the ground that the robot has seen before its camera failed.
    walk: go on. slow: go on slowly. stop: stand until it sees again, or is sent another way."""
    dry_run: bool = False
    """Go through all that a run needs, a line with its time for each, then print commands; the
    robot is never moved."""
    seed: int = 1
    """Seed of the simulated camera's noise, the terrain and the faults."""
    safety: SafetyCfg = field(default_factory=SafetyCfg)
    """Limits."""
    robot_cfg: Annotated[DriverCfg, NoPrefix] = field(default_factory=DriverCfg)
    """Options of the robot; its defaults by default."""
    camera_cfg: Annotated[CameraCfg, NoPrefix] = field(default_factory=CameraCfg)
    """Options of the camera; its defaults by default."""
    teleop_cfg: Annotated[TeleopCfg, NoPrefix] = field(default_factory=TeleopCfg)
    """Options of the operator's device; its defaults by default."""

    def __post_init__(self) -> None:
        # A device of which only the name is given has its default options.
        if type(self.robot_cfg) is DriverCfg:
            demand_name("robot", self.robot, ROBOTS)
            object.__setattr__(self, "robot_cfg", ROBOTS[self.robot]())
        camera = self.robot_cfg.camera if self.camera == "auto" else self.camera
        if type(self.camera_cfg) is CameraCfg:
            demand_name("camera", camera, CAMERAS)
            object.__setattr__(self, "camera_cfg", CAMERAS[camera]())
        if type(self.teleop_cfg) is TeleopCfg:
            demand_name("teleop", self.teleop, TELEOPS)
            object.__setattr__(self, "teleop_cfg", TELEOPS[self.teleop]())

    @staticmethod
    def defaults(arguments: list[str]) -> "DeployCfg":
        """Return the defaults of the robot, camera and operator that a command line names.

        They decide which options the rest of the command line may hold.
        """
        load_plug_ins(plug_ins.ROBOTS)
        parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
        for name in ("robot", "camera", "teleop"):
            parser.add_argument(f"--{name}", nargs="?", default=argparse.SUPPRESS)
        devices = vars(parser.parse_known_args(arguments)[0])
        return DeployCfg(**{name: value for name, value in devices.items() if value})

    @property
    def faults(self) -> list[Injection]:
        """Faults of the camera; raises RenetError for one that cannot be read."""
        return [parse_fault(text) for text in self.fault]

    @property
    def live(self) -> bool:
        """True if the robot's clock is the wall's."""
        return self.robot_cfg.live or self.teleop != "auto"

    @property
    def length(self) -> float:
        """Seconds after which the run ends by itself."""
        steered = math.inf if self.teleop != "auto" else UNSTEERED_SECONDS
        return steered if self.seconds is None else self.seconds

    @property
    def operator_timeout(self) -> float:
        """Seconds without a sign of the operator after which the robot stands."""
        if self.deadman is not None:
            return self.deadman
        if self.teleop_cfg.silence is not None:
            return self.teleop_cfg.silence
        # A simulated robot can hurt nobody.
        return math.inf if self.robot_cfg.simulated else DEADMAN

    @property
    def limits(self) -> SafetyCfg:
        """Limits of the controller; in a dry run no joint moves, and so none is checked."""
        if not self.dry_run:
            return self.safety
        return replace(self.safety, max_stand_up_error=LIMP, least_torque=0.0)

    def load_bundle(self) -> Bundle:
        """Load the bundle that is asked for, by default the robot's own.

        Raises:
            RenetError: A setting or the bundle cannot work. One error names them all, before
                anything moves or is written.
        """
        problems = [*self.problems()]
        bundle = None
        with collected(problems):
            bundle = Bundle.load(self.bundle or self.robot_cfg.bundle)
            drives = self.robot_cfg.drives
            name = bundle.manifest.robot.name
            if drives is not None and name != drives.name:
                raise RenetError(
                    f"the bundle drives a {name}, --robot {self.robot} is a {drives.name}"
                )
            if self.unseen != "walk" and not remembers(bundle.sessions["estimator"]):
                raise RenetError(
                    f"--unseen {self.unseen}: {bundle.name} has no memory of the ground"
                )
        demand_none(problems)
        assert bundle is not None
        return bundle

    def problems(self) -> list[str]:
        """List the settings that cannot work, a line for each."""
        found = [*self._mistakes()]
        with collected(found):
            if self.faults and type(self.camera_cfg) is CameraCfg:
                raise RenetError("--fault needs a camera to spoil")
        for part in (self.robot_cfg, self.camera_cfg, self.teleop_cfg):
            with collected(found):
                part.check()
        return found

    def _mistakes(self) -> Iterator[str]:
        """Yield a line for each setting out of range or that does not go with another."""
        if not self.length > 0:
            yield f"--seconds must be positive, got {self.seconds}"
        if not self.operator_timeout > 0:
            yield f"--deadman must be positive, got {self.deadman}"
        if not 0.0 <= self.speed <= MAX_SPEED:
            yield f"--speed must be from 0 to {MAX_SPEED:g} m/s, got {self.speed}"
        if self.seed < 0:
            yield f"--seed must not be negative, got {self.seed}"
        # Otherwise an operator would count on a robot that does not stop.
        if self.unseen != "walk" and self.mode != "memory":
            yield f"--unseen {self.unseen} needs --mode memory, got {self.mode}"
        if not self.robot_cfg.simulated:
            if self.camera_cfg.simulated:
                yield f"--camera {self.camera} looks at a simulation: use realsense, replay or none"
            if self.teleop == "auto" and not self.dry_run:
                yield "a real robot needs --teleop keyboard, joystick or ros2, or --dry-run"

    def header(self, bundle: Bundle) -> dict[str, Any]:
        """Describe a run of a bundle for its recording, as JSON values."""
        devices = vars(self.robot_cfg) | vars(self.camera_cfg) | vars(self.teleop_cfg)
        options = {}
        for name, value in devices.items():
            options[name] = value if isinstance(value, int | float | None) else str(value)
        if options.get("scene"):
            # It replaces the terrain, and has no levels.
            options |= {"terrain": OWN_GROUND, "level": None}
        selector = bundle.manifest.selector
        thresholds = selector.used_thresholds
        # The paper's switch knows one threshold.
        if self.mode == "switch":
            thresholds = {"reconstruction": selector.beta}
        return {
            **options,
            "safety": asdict(self.limits),
            "mode": self.mode,
            "unseen": self.unseen,
            "robot": self.robot,
            "camera": self.camera,
            "teleop": self.teleop,
            "dry_run": self.dry_run,
            "fault": list(self.fault),
            "onsets": [fault.onset * CONTROL_DT for fault in self.faults],
            "seed": self.seed,
            "renet": __version__,
            "bundle": bundle.name,
            "bundle_sha256": bundle.sha256,
            "models": bundle.manifest.sha256,
            "told": bundle.manifest.told,
            "thresholds": thresholds,
        }
