"""The memory study, with stand-ins whose crossings are known."""

import numpy as np
import pytest

from renet.evaluation.studies.memory import MemoryStudy

from ..fakes import FakeEnv, FakeEvaluator, FakePolicy


class Crossing(FakeEnv):
    """Robots leave their tile after 3 s, if they have not fallen before."""

    def step(self, action):
        result = super().step(action)
        result.ended[:] |= self.clock % 150 == 0
        return result


class Trusting(FakePolicy):
    """VP acts on images; where they are black it falls."""

    def step(self, proprioception, depth, op_mask):
        action = super().step(proprioception, depth, op_mask)
        action[:, 0] = np.where(op_mask | (depth.mean(axis=(1, 2)) > 0.1), 0.0, 1.0)
        return action


def test_who_trusts_a_black_camera_falls_and_the_others_cross(tmp_path):
    study = MemoryStudy(
        out=tmp_path, grounds=("gap:3",), without=(0.1, 2.0), robots=3, seconds=3.5,
        modes=("camera", "switch", "blind"),
    )  # fmt: skip
    assert study.onset_on("gap") == 75  # 1.2 m at 0.6 m/s, less half a second.
    runs = {
        (r["mode"], r["without_s"]): r for r in study.run(FakeEvaluator(Crossing, Trusting))["runs"]
    }
    assert set(runs) == {(m, s) for m in ("camera", "switch") for s in (0, 0.1, 2.0)} | {
        ("blind", 0)
    }
    crossed = {key: run["crossed"] for key, run in runs.items()}
    # A tenth of a second is too short to fall in; the paper's switch leaves vision in 35 ms.
    assert crossed == dict.fromkeys(runs, 3) | {("camera", 2.0): 0}
    assert runs["camera", 2.0]["fell"] == 3
    assert (runs["camera", 2.0]["change"], runs["switch", 2.0]["change"]) == (-1.0, 0.0)
    assert runs["camera", 0]["size_m"] == pytest.approx(0.2333, abs=1e-3)
    assert (tmp_path / "memory.png").stat().st_size > 10_000


def test_times_are_found_again_as_files_round_them(tmp_path):
    study = MemoryStudy(tmp_path, grounds=("gap:3",), without=(1 / 3,), robots=2, modes=("camera",))
    summary = study.run(FakeEvaluator(Crossing, Trusting))
    ((_, _, rows),) = study.tables(summary)
    assert rows == [("gap:3", "0", 2), ("gap:3", "0.333333", 0)]


@pytest.mark.parametrize(
    ("kind", "step", "facing"),
    [
        ("gap", 75, True),
        ("stairs_up", 75, True),
        ("platform", 92, True),  # 1.4 m.
        ("stairs_down", 100, True),  # 1.5 m.
        ("obstacles", 75, False),
    ],
)
def test_cameras_die_half_a_second_before_the_edge_of_each_ground(tmp_path, kind, step, facing):
    """Robots start straight before an edge, which is the same distance for all of them."""
    seen = {}

    class Observed(FakeEvaluator):
        def make_env(self, task, robots, speed, seed):
            seen["yaw"] = task.events["spawn"].params["pose_range"]["yaw"]
            return super().make_env(task, robots, speed, seed)

    study = MemoryStudy(
        tmp_path, grounds=(f"{kind}:3",), without=(1.0,), robots=2, modes=("camera",)
    )
    assert study.onset_on(kind) == step
    study.run(Observed(Crossing, Trusting))
    assert (max(np.abs(seen["yaw"])) < 0.2) == facing
