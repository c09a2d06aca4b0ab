"""Terms of the RENet tasks' managers, and mjlab's own."""

from mjlab.envs.mdp import *  # noqa: F403

from .actions import *  # noqa: F403
from .barriers import *  # noqa: F403
from .commands import *  # noqa: F403
from .constraints import *  # noqa: F403
from .curriculums import *  # noqa: F403
from .metrics import *  # noqa: F403
from .observations import *  # noqa: F403
from .randomization import *  # noqa: F403
from .rewards import *  # noqa: F403
from .terminations import *  # noqa: F403
