"""Tiles: their stated sizes, a free start, and symmetry that makes any yaw work."""

import mujoco
import numpy as np
import pytest
import torch
from mjlab.terrains import TerrainGenerator
from mjlab.terrains.terrain_generator import TerrainOutput

from renet.errors import RenetError
from renet.evaluation.env import terrain_env_cfg
from renet.sim.depth.rasterizer import scanner
from renet.tasks import VISUAL_GO1, RenetEnvCfg, env_cfg, make_env
from renet.tasks.mdp.curriculums import (
    FIRST_LEVELS,
    curriculum_state,
    load_curriculum_state,
    tile_shares,
)
from renet.tasks.parkour_env_cfg import tile_env_cfg
from renet.tasks.terrains import add_own_ground, tile_row
from renet.terrain.own_ground import GroundFile
from renet.terrain.tiles import LEVELS, TILE, Tile, dense_tiles, tiles

KINDS = list(tiles())
TASK = "Renet-Go1-Parkour"


@pytest.fixture(scope="module")
def world(shared_parkour):
    return shared_parkour, scanner(shared_parkour.sim.mj_model, "cpu")


def profile(world, kind: str, level: int, angle: float = 0.0) -> np.ndarray:
    """Heights along a line through the tile's middle, every 2 cm, middle of the array at 0."""
    env, terrain = world
    origin = env.scene.terrain.terrain_origins[level - 1, KINDS.index(kind)]
    r = torch.arange(-195, 196) * 0.02
    line = torch.stack((r * np.cos(angle), r * np.sin(angle)), dim=-1) + origin[:2] + 0.003
    return terrain.height(line.float()).numpy()


@pytest.mark.parametrize("level", [1, 5, 10])
@pytest.mark.parametrize("kind", KINDS)
def test_start_is_flat_and_free(world, kind, level):
    env, terrain = world
    origin = env.scene.terrain.terrain_origins[level - 1, KINDS.index(kind)]
    line = torch.linspace(-0.75, 0.75, 31)
    heights = terrain.height(torch.cartesian_prod(line, line) + origin[:2])
    assert (heights - origin[2]).abs().max() < 1e-3


def built(tile: Tile, difficulty: float, seed: int = 0) -> tuple[mujoco.MjSpec, TerrainOutput]:
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="terrain")
    return spec, tile.function(difficulty, spec, np.random.default_rng(seed))


def test_obstacles_never_reach_into_the_start():
    obstacles = tiles()["obstacles"]
    for seed in range(30):
        _, tile = built(obstacles, 0.5, seed)
        blocks = [block.geom for block in tile.geometries[1:]]
        assert len(blocks) == obstacles.count
        for block in blocks:
            away = np.abs(block.pos[:2] - TILE / 2)
            assert (away - block.size[:2]).max() > 0.8
            assert (away + block.size[:2]).max() < TILE / 2


@pytest.mark.parametrize(("level", "width"), [(1, 0.10), (10, 0.70)])
def test_gap_width_and_depth(world, level, width):
    heights = profile(world, "gap", level)
    gap = heights < -0.99
    assert gap.sum() * 0.02 / 2 == pytest.approx(width, abs=0.025)
    assert np.abs(heights[~gap]).max() < 1e-3


@pytest.mark.parametrize(("level", "height"), [(1, 0.05), (10, 0.50)])
def test_platform_height(world, level, height):
    heights = profile(world, "platform", level)
    # Its top, the tile's middle, its edge.
    assert [heights.max(), heights[195], heights[0]] == pytest.approx([height, 0, 0], abs=1e-3)


@pytest.mark.parametrize("kind", ["stairs_up", "stairs_down"])
@pytest.mark.parametrize(("level", "rise"), [(1, 0.05), (10, 0.23)])
def test_stairs_rise_and_tread(world, kind, level, rise):
    heights = profile(world, kind, level)
    steps = np.diff(heights)
    edges = np.flatnonzero(np.abs(steps) > 1e-3)
    np.testing.assert_allclose(np.abs(steps[edges]), rise, atol=1e-3)
    np.testing.assert_allclose(np.diff(edges[edges < 130]) * 0.02, 0.30, atol=0.021)
    sign = 1 if kind == "stairs_down" else -1
    env, _ = world
    summit = env.scene.terrain.terrain_origins[level - 1, KINDS.index(kind), 2].item()
    assert summit == pytest.approx(sign * 9 * rise, abs=1e-3)


@pytest.mark.parametrize("kind", ["stairs_up", "stairs_down", "gap", "platform"])
def test_tiles_have_four_equal_sides(world, kind):
    profiles = [profile(world, kind, 7, k * np.pi / 2) for k in range(4)]
    for other in profiles[1:]:
        assert np.mean(np.abs(other - profiles[0]) > 1e-3) < 0.06  # Samples next to an edge differ.


def test_neighbours_meet_at_ground_level(world):
    env, terrain = world
    origins = env.scene.terrain.terrain_origins.reshape(-1, 3)[:, :2]
    corners = torch.cat([origins + torch.tensor(c) for c in ((3.999, 3.999), (-3.999, 0.5))])
    assert terrain.height(corners).abs().max() < 1e-3


def base(env) -> torch.Tensor:
    """Positions of the bases, which may be written, [N, 3]."""
    return env.sim.data.xpos[:, int(env.scene["robot"].indexing.root_body_id)]


def at_level(env, level: int, steps: int = 500, asked: float = 0.0) -> torch.Tensor:
    """Put everybody at the start of a level, after some steps in which so many metres were asked.

    Returns the levels of the tiles they are on, which change later.
    """
    env.reset()
    terrain = env.scene.terrain
    terrain.terrain_levels[:] = level
    env.curriculum_manager.get_term_cfg("level").func.levels[:] = level
    terrain.env_origins[:] = terrain.terrain_origins[level, terrain.terrain_types]
    base(env)[:] = terrain.env_origins + torch.tensor([0.0, 0.0, 0.3])
    env.episode_length_buf[:] = steps
    env.termination_manager.terminated[:] = False
    goal = env.command_manager.get_term("goal")
    goal.commanded_distance[:], goal.speed[:] = asked, 0.8
    return terrain.terrain_levels


def end(env, robots: int = 12) -> dict[str, float]:
    """End the episodes of the first robots; what the curriculum logs."""
    env.curriculum_manager.compute(env_ids=torch.arange(robots))
    return env.curriculum_manager.reset()


def test_walk_in_minutes_rule(parkour):
    levels, terrain = at_level(parkour, 4), parkour.scene.terrain
    base(parkour)[:6, 0] += torch.tensor([4.1, 3.0, 1.5, 1.5, 0.1, 0.1])
    goal = parkour.command_manager.get_term("goal")
    goal.commanded_distance[:6] = torch.tensor([4.0, 20.0, 20.0, 2.0, 0.0, 4.0])
    logged = end(parkour, 5)
    # Below half of what was asked, at most half of 4 m, means down; robot 5 walks on.
    assert levels[:6].tolist() == [5, 4, 3, 4, 4, 4]
    for robot, level in ((0, 5), (2, 3), (5, 4)):
        start = terrain.terrain_origins[level, terrain.terrain_types[robot]]
        assert torch.equal(terrain.env_origins[robot], start)
    assert logged["Curriculum/level/rough"] == pytest.approx(4.5)


def test_who_falls_owes_the_whole_episode(parkour):
    # 200 steps of 0.02 s at 0.8 m/s remain, 3.2 m; both have covered 1 m of the 0.5 asked so far.
    levels = at_level(parkour, 4, steps=parkour.max_episode_length - 200, asked=0.5)
    base(parkour)[:2, 0] += 1.0
    parkour.termination_manager.terminated[1] = True
    end(parkour, 2)
    assert levels[:2].tolist() == [4, 3]


def begin_flat(env, monkeypatch, flat: bool) -> None:
    """Say whether the first level of each kind of tile is flat, until the end of a test."""
    for kind in env.scene.terrain.cfg.terrain_generator.sub_terrains.values():
        monkeypatch.setattr(kind, "flat_start", flat)


@pytest.mark.parametrize("flat_start", [False, True])
def test_easier_tiles_change_no_level(parkour, monkeypatch, flat_start):
    term, terrain = parkour.curriculum_manager.get_term_cfg("level"), parkour.scene.terrain
    begin_flat(parkour, monkeypatch, flat_start)
    monkeypatch.setattr(parkour, "common_step_counter", 1_000)
    monkeypatch.setitem(term.params, "easier_share", "0.25@1k")
    monkeypatch.setitem(term.params, "easier_levels", 10)
    monkeypatch.setitem(term.params, "easier_kinds", tuple(KINDS))

    def drawn_levels(level: int, episodes: int) -> torch.Tensor:
        """Levels of the tiles that robots of a level meet, [episodes, 12]."""
        rows = []
        for _ in range(episodes):
            at_level(parkour, level)
            end(parkour)
            rows.append(terrain.terrain_levels.clone())
            starts = terrain.terrain_origins[rows[-1], terrain.terrain_types]
            assert torch.equal(terrain.env_origins, starts)
            assert (term.func.levels == level).all()
        return torch.stack(rows)

    met = drawn_levels(4, 50).flatten().tolist()
    assert set(met) == set(range(int(flat_start), 5))
    # Three quarters of 600, and those of the rest that are drawn at 4: five deviations around.
    expected = 0.75 + 0.25 / (5 - flat_start)
    assert met.count(4) / 600 == pytest.approx(expected, abs=5 * (0.25 / 600) ** 0.5)
    monkeypatch.setitem(term.params, "easier_share", "0.25@1k,1@1k")
    monkeypatch.setitem(term.params, "easier_levels", "10@1k,2@1k")
    narrow = drawn_levels(4, 5)
    assert set(narrow.flatten().tolist()) == {int(flat_start), 1 + flat_start}
    assert parkour.observation_manager.compute()["easier"].all(), "robots know that it is easier"
    # On easier tiles: who passes, and who fails, keeps its own level, and is told by it.
    at_level(parkour, 4, asked=20.0)
    terrain.terrain_levels[:] = 2
    base(parkour)[:6, 0] += 4.1
    assert end(parkour)["Curriculum/level/rough"] == 4.0
    assert (term.func.levels == 4).all()
    assert (drawn_levels(0, 10) == 0).all(), "who has not passed a flat level meets nothing else"
    monkeypatch.setitem(term.params, "easier_kinds", ("gap",))
    easier = (drawn_levels(4, 5) < 4).any(0)
    assert set(terrain.terrain_types[easier].tolist()) == {KINDS.index("gap")}, "not on others"
    monkeypatch.setitem(term.params, "easier_share", "0@13k,1@14k")
    assert (drawn_levels(4, 10) == 4).all(), "not before its time"


@pytest.mark.parametrize(
    ("flat_start", "level", "steps", "walked", "reached"),
    [
        (False, 0, 500, 0.0, range(FIRST_LEVELS)),
        (True, 0, 500, 0.0, range(1)),  # Who cannot walk stays, and none comes back to flat ground.
        (True, 0, 500, 4.1, range(1, 2)),
        (True, 1, 500, 0.0, range(1, 1 + FIRST_LEVELS)),
        (False, LEVELS - 1, 500, 4.1, range(LEVELS)),
        (False, 4, 0, 0.0, range(4, 5)),  # Who has not taken a step stays.
        (False, 4, 0, 50.0, range(4, 5)),
    ],
)
def test_end_levels_lead_to_several(
    parkour, monkeypatch, flat_start, level, steps, walked, reached
):
    begin_flat(parkour, monkeypatch, flat_start)
    levels = set()
    for _ in range(10):
        tiles = at_level(parkour, level, steps, asked=4.0)
        base(parkour)[:, 1] -= walked
        end(parkour)
        levels |= set(tiles.tolist())
    assert levels == set(reached)


def test_passing_the_last_level_counts(parkour):
    passed = parkour.curriculum_manager.get_term_cfg("level").func.passed
    passed[:] = False
    types = parkour.scene.terrain.terrain_types
    others = int((types == types[0]).sum()) - 1
    at_level(parkour, LEVELS - 1)
    base(parkour)[0, 1] -= 4.1
    for level in (LEVELS - 1, 3):
        expected = (LEVELS + level * others) / (1 + others)
        assert end(parkour)["Curriculum/level/rough"] == pytest.approx(expected)
        at_level(parkour, 3)  # Neither up nor down.
    at_level(parkour, 3, asked=20.0)
    assert end(parkour)["Curriculum/level/rough"] == pytest.approx(2.0)
    assert not passed.any()


def on_kinds(env) -> dict[str, int]:
    """Number of robots on each kind of tile."""
    types = env.scene.terrain.terrain_types
    return dict(zip(KINDS, types.bincount(minlength=len(KINDS)).tolist(), strict=True))


def test_robots_move_to_other_tiles_as_their_episodes_end(parkour, monkeypatch):
    terrain, everyone = parkour.scene.terrain, torch.arange(12)
    levels = parkour.curriculum_manager.get_term_cfg("level").func
    before, types = on_kinds(parkour), terrain.terrain_types
    monkeypatch.setattr(terrain, "terrain_types", types.clone())
    assert before["rough"] == before["gap"] == 2
    at_level(parkour, 3)
    levels.levels[types == KINDS.index("gap")] = 7
    levels.passed[:] = False

    # The same shares as ever move nobody.
    assert tile_shares(parkour, everyone, {"gap": 1.0})["gap"] == pytest.approx(2 / 12)
    assert torch.equal(terrain.terrain_types, types)

    # No rough ground, and twice as many gaps: both robots go, but only when their episodes end.
    shares = {"rough": "1@0,0@1k", "gap": "1@0,2@1k"}
    monkeypatch.setattr(parkour, "common_step_counter", 1_000)
    rough = (types == KINDS.index("rough")).nonzero()[:, 0]
    tile_shares(parkour, (types != KINDS.index("rough")).nonzero()[:, 0], shares)
    assert torch.equal(terrain.terrain_types, types)
    tile_shares(parkour, rough[1:], shares)
    assert on_kinds(parkour) == before | {"rough": 1, "gap": 3}
    logged = tile_shares(parkour, everyone, shares)
    assert on_kinds(parkour) == before | {"rough": 0, "gap": 4}
    assert {kind: share.item() for kind, share in logged.items()} == {
        "rough": 0.0,
        "gap": pytest.approx(4 / 12),
    }

    # They begin at the level of the robots that are there.
    assert (levels.levels[rough] == 7).all()
    origins = terrain.terrain_origins[terrain.terrain_levels, terrain.terrain_types]
    assert torch.equal(terrain.env_origins[rough], origins[rough])


def test_robots_stay_on_their_tiles_in_a_run_that_goes_on(build):
    env = build(TASK, 24)
    types = env.scene.terrain.terrain_types
    begun = types.clone()
    # The first robot, on rough ground, has gone to the gaps.
    kinds = list(env.scene.terrain.cfg.terrain_generator.sub_terrains)
    types[0] = kinds.index("gap")
    state = {name: value.clone() for name, value in curriculum_state(env).items()}
    types[:] = begun
    load_curriculum_state(env, state, steps=0)
    assert types[0] == kinds.index("gap")
    assert torch.equal(types[1:], begun[1:])


def test_a_run_goes_on_without_levels_and_kinds_that_it_had(build):
    """As with fewer levels, or without the ground of one's own."""
    env = build(TASK, 24)
    terrain = env.scene.terrain
    levels, kinds = terrain.terrain_origins.shape[:2]
    begun = terrain.terrain_types.clone()
    state = {name: value.clone() for name, value in curriculum_state(env).items()}
    state["kinds"][0] = kinds
    state["levels"][1:3] = torch.tensor([levels + 4, levels - 2])
    load_curriculum_state(env, state, steps=0)
    assert torch.equal(terrain.terrain_types, begun)
    assert terrain.terrain_levels.max() == levels - 1
    origins = terrain.terrain_origins[terrain.terrain_levels, begun]
    assert torch.equal(terrain.env_origins, origins)


def test_recipe_ends_with_more_robots_at_gaps_and_fewer_on_rough_ground(build):
    env = build(TASK, 24)
    terrain = env.scene.terrain
    kinds = list(terrain.cfg.terrain_generator.sub_terrains)
    begun = terrain.terrain_types.bincount(minlength=len(kinds))
    state = {name: value.clone() for name, value in curriculum_state(env).items()}
    for steps, change in ((0, 0), (150_000_000, 1)):
        load_curriculum_state(env, state, steps)
        env.curriculum_manager.compute(env_ids=torch.arange(24))
        reached = terrain.terrain_types.bincount(minlength=len(kinds)) - begun
        assert reached[kinds.index("gap")] >= change
        assert reached[kinds.index("rough")] <= -change
        assert reached.any() == bool(change)


@pytest.mark.parametrize("kind", tiles())
def test_every_tile_can_be_single(build, kind):
    env = build(tile_env_cfg(tile_row({kind: LEVELS}), play=True), 1)
    above = env.scene["robot"].data.root_link_pos_w[0, 2] - env.scene.env_origins[0, 2]
    assert 0.25 < above < 0.35


def test_unknown_single_tiles_are_refused():
    for unknown, why in (({"lava": 1}, "rough, obstacles"), ({"gap": 11}, "1 to 10")):
        with pytest.raises(RenetError, match=why):
            tile_row(unknown)


def edges(tile: Tile, difficulty: float) -> np.ndarray:
    """Distances from the middle, m, at which the ground changes by over 2 cm on the way out."""
    spec, output = built(tile, difficulty)
    out = torch.arange(0, 380) * 0.01 + 0.003
    line = torch.stack((out, torch.zeros_like(out)), dim=-1) + torch.tensor(output.origin[:2])
    heights = scanner(spec.compile(), "cpu").height(line.float()).numpy()
    return out[1:].numpy()[np.abs(np.diff(heights)) > 0.02]


@pytest.mark.parametrize("kind", ["gap", "platform"])
def test_dense_tiles_have_more_edges(kind):
    sparse, dense = edges(tiles()[kind], 0.5), edges(dense_tiles()[kind], 5 / 9)
    assert len(sparse) == 2
    assert len(dense) == 4
    assert np.diff(dense).min() > 0.39  # A foot finds room between any two.
    assert len(edges(dense_tiles()[kind], 0.0)) == 0
    # What follows begins and ends as on the tiles that policies are judged on.
    for mine, theirs in ((1 / 9, 0.0), (5 / 9, 0.5), (1.0, 1.0)):
        assert dense_tiles()[kind].measure(mine) == pytest.approx(tiles()[kind].measure(theirs))


def drawn(cfg: RenetEnvCfg) -> set[bytes]:
    """Relief of each rough tile and size of each block that a task's field is built with."""
    spec = mujoco.MjSpec()
    TerrainGenerator(cfg.scene.terrain.terrain_generator, device="cpu").compile(spec)
    return {np.array(field.userdata).tobytes() for field in spec.hfields if any(field.userdata)} | {
        geom.size[:2].tobytes() for geom in spec.geoms if 0 < geom.size[:2].max() < 0.5
    }


@pytest.mark.parametrize("task", [TASK, f"{TASK}-Paper"])
def test_studies_draw_other_tiles_than_training(task):
    trained = drawn(env_cfg(task))
    grounds = {"rough": 5, "obstacles": 5}
    for judged in (terrain_env_cfg("parkour", VISUAL_GO1), terrain_env_cfg(grounds, VISUAL_GO1)):
        assert len(drawn(judged)) > 20
        assert not drawn(judged) & trained


def test_robots_share_a_curriculum_with_own_ground(tmp_path):
    file = tmp_path / "map.npy"
    x = np.linspace(-4.0, 4.0, 81)
    np.save(file, np.tile(0.3 * (x > 2.0), (81, 1)))
    cfg = env_cfg("Renet-Go1-Parkour-Paper")
    add_own_ground(cfg.scene.terrain, GroundFile(file=file).tile(), 0.5)
    env = make_env(cfg, 24)
    own = env.scene.terrain.terrain_types == len(KINDS)
    # mjlab gives one robot to each of seven kinds, then shares out the other 17.
    assert int(own.sum()) in (9, 10)
    origin = env.scene.terrain.terrain_origins[LEVELS - 1, len(KINDS)]
    places = torch.tensor([[3.0, 1.0], [1.0, 1.0]]) + origin[:2]
    heights = scanner(env.sim.mj_model, "cpu").height(places.float())
    assert heights.tolist() == pytest.approx([0.3, 0.0], abs=1e-3)
    env.close()


def test_own_ground_may_be_all_there_is(tmp_path):
    np.save(tmp_path / "map.npy", np.zeros((9, 9)))
    tile = GroundFile(file=tmp_path / "map.npy").tile()
    terrain = env_cfg(TASK).scene.terrain
    add_own_ground(terrain, tile, 1.0)
    assert [*terrain.terrain_generator.sub_terrains] == ["own"]
    with pytest.raises(RenetError, match="no tiles to put a scene among: train a Parkour task"):
        add_own_ground(env_cfg("Renet-Go1-Flat").scene.terrain, tile, 0.5)
    with pytest.raises(RenetError, match="--scene-share must be above 0 and at most 1"):
        add_own_ground(terrain, tile, 0.0)
