"""One more study, of walking speeds: `python examples/add_study.py evaluate speeds`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt

from renet.cli import COMMANDS, Command, main
from renet.evaluation import metrics
from renet.evaluation.rollout import Trial
from renet.evaluation.settings import FLAT_GROUND
from renet.evaluation.study import Study
from renet.interface import control_steps


@dataclass(frozen=True)
class SpeedStudy(Study):
    """Mean forward speed of robots on flat ground, for several commanded speeds."""

    name = "speeds"
    out: Path = Path("results/speeds")
    speeds: tuple[float, ...] = (0.3, 0.6, 0.9)
    robots: int = 20
    seconds: float = 6.0

    def parts(self, evaluator):
        return {f"speed_{s:g}": lambda s=s: self.walk(evaluator, s) for s in self.speeds}

    def walk(self, evaluator, speed):
        env = evaluator.make_env(FLAT_GROUND, range(self.robots), speed, self.seed)
        trials = [Trial("memory", robot=robot) for robot in range(self.robots)]
        steps = control_steps(self.seconds)
        trace = evaluator.rollout(env, trials, self.seed).run(steps, f"{speed:g} m/s")
        walked = trace.speed[len(trace.speed) // 2 :].mean(axis=0)
        row = {"commanded": speed, "robots": self.robots, "falls": int(trace.fell.sum())}
        return row | {"speed": walked.mean()} | metrics.with_interval("speed", walked)

    def summarise(self, parts, evaluator):
        return {"runs": [{k: v for k, v in part.items() if k != "key"} for part in parts.values()]}

    def draw(self, summary, parts):
        figure, axis = plt.subplots()
        x, y = zip(*((run["commanded"], run["speed"]) for run in summary["runs"]), strict=True)
        axis.plot(x, y, marker="o")
        axis.set(xlabel="commanded (m/s)", ylabel="walked (m/s)")
        return {"speeds.png": figure}

    def tables(self, summary):
        header = ("commanded", "speed", "falls")
        return [("Speed", header, [tuple(run[n] for n in header) for run in summary["runs"]])]


COMMANDS["evaluate speeds"] = Command("speed", f"{__name__}:SpeedStudy:SpeedStudy.main")

if __name__ == "__main__":
    raise SystemExit(main())
