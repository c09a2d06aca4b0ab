"""Operator that is a script, for runs that nobody steers."""

from dataclasses import dataclass

from renet.deploy.teleop.base import TeleopCommand


@dataclass
class ScriptedTeleop:
    """Script that arms at once and walks straight ahead at `speed`, m/s."""

    speed: float
    controls: str = "walks straight ahead"
    attended: bool = False
    _armed: bool = False

    def command(self, now: float) -> TeleopCommand:
        """Return a wish to arm at the first call, and the speed from then on."""
        if not self._armed:
            self._armed = True
            return TeleopCommand(arm=True)
        return TeleopCommand(forward=self.speed)

    def drain(self, now: float) -> None:
        """Do nothing: nothing was asked for before."""
