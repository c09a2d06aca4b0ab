"""Extreme Parkour's inputs, of a stand-in network with their shapes."""

import numpy as np
import pytest
import torch

import extreme_parkour_file as example
from renet.bundle import pretrained, read_manifest
from renet.errors import RenetError
from renet.evaluation.adapters import extreme_parkour
from renet.evaluation.adapters.base import Senses
from renet.evaluation.adapters.evaluator import AdaptedEvaluator
from renet.interface import LEGS
from renet.tasks import mdp
from renet.tasks.sensors import FEET_CONTACT

POSE = extreme_parkour.Adapter.pose


class Recorder:
    """A model that keeps its inputs; its states count how often a robot was encoded."""

    name = "recorder"

    def __init__(self):
        self.encoded = []
        self.acted = []
        self.action = 0.1 * np.arange(12, dtype=np.float32)

    def run(self, *inputs, robot=0, method="forward"):
        if method == "encode":
            self.encoded.append([value.copy() for value in inputs])
            state = inputs[2] + 1.0
            return [np.tile(state[:, :1], (1, 34)), state]
        self.acted.append([value.copy() for value in inputs])
        return [np.tile(self.action, (len(inputs[0]), 1))]


def senses(count=2, **changes):
    values = {
        "angular_velocity": np.zeros((count, 3)),
        "gravity": np.tile((0.0, 0.0, -1.0), (count, 1)),
        "command": np.tile((0.6, 0.0, 0.3), (count, 1)),
        "joint_position": np.tile(POSE, (count, 1)),
        "joint_velocity": np.zeros((count, 12)),
        "depth": np.full((count, 48, 64), 2.0),
        "velocity": np.zeros((0, 3)),
        "feet_contact": np.ones((count, 4), bool),
    }
    return Senses(**(values | changes))


def walk(adapter, steps, **changes):
    for _ in range(steps):
        target = adapter.act(senses(adapter.num_robots, **changes))
    return target


def history_of(acted):
    return acted[0][:, 53 + 132 + 9 + 29 :].reshape(-1, 10, 53)


def test_the_observation_has_the_sources_places_and_scales():
    model = Recorder()
    adapter = extreme_parkour.Adapter(model, 1)
    # Rolled by 0.2 and pitched by 0.3 rad, about the axes of the base as yaw, pitch, roll.
    gravity = (np.sin(0.3), -np.cos(0.3) * np.sin(0.2), -np.cos(0.3) * np.cos(0.2))
    speeds = np.arange(12.0)
    adapter.act(
        senses(
            1,
            angular_velocity=np.array(((1.0, 2.0, 3.0),)),
            gravity=np.array((gravity,)),
            joint_position=(POSE + 0.01 * np.arange(12))[None],
            joint_velocity=speeds[None],
            feet_contact=np.array(((True, False, False, True),)),
        )
    )
    seen = model.acted[0][0][0]
    assert seen.shape == (753,)
    np.testing.assert_allclose(seen[:5], (0.25, 0.5, 0.75, 0.2, 0.3), atol=1e-6)
    # The heading is 0.3 rad/s / 1.5 to the left, and so is the next one; a speed; not flat ground.
    np.testing.assert_allclose(seen[5:13], (0.0, 0.2, 0.2, 0.0, 0.0, 0.6, 1.0, 0.0), atol=1e-6)
    np.testing.assert_allclose(seen[13:25], 0.01 * np.arange(12), atol=1e-6)
    np.testing.assert_allclose(seen[25:37], 0.05 * speeds, atol=1e-6)
    np.testing.assert_allclose(seen[37:49], 0.0)
    np.testing.assert_allclose(seen[49:53], (0.5, -0.5, -0.5, 0.5))
    # The encoder sees no heading.
    image, observation, _ = model.encoded[0]
    assert image.shape == (1, 58, 87)
    np.testing.assert_array_equal(observation[0, 6:8], 0.0)
    np.testing.assert_array_equal(np.delete(observation[0], (6, 7)), np.delete(seen[:53], (6, 7)))


def test_actions_are_limited_but_observed_as_they_were():
    model = Recorder()
    model.action = np.array((8.0, -8.0, *[0.0] * 9, 1.0), np.float32)
    adapter = extreme_parkour.Adapter(model, 1)
    target = walk(adapter, 2)
    expected = (1.2, -1.2, *[0.0] * 9, 0.25)
    np.testing.assert_allclose(target[0] - POSE, expected, atol=1e-6)
    np.testing.assert_allclose(model.acted[1][0][0, 37:49], model.action)


def test_a_foot_that_left_the_ground_counts_for_a_step_more():
    model = Recorder()
    adapter = extreme_parkour.Adapter(model, 1)
    walk(adapter, 1)
    walk(adapter, 2, feet_contact=np.zeros((1, 4), bool))
    contacts = [acted[0][0, 49] for acted in model.acted]
    np.testing.assert_allclose(contacts, (0.5, 0.5, -0.5))


def test_the_history_holds_ten_earlier_observations_without_headings():
    model = Recorder()
    adapter = extreme_parkour.Adapter(model, 1)
    for step in range(12):
        adapter.act(senses(1, angular_velocity=np.full((1, 3), float(step))))
    rates = [history_of(acted)[0, :, 0] / 0.25 for acted in model.acted]
    np.testing.assert_allclose(rates[0], 0.0)
    np.testing.assert_allclose(rates[1], 0.0)
    # An episode's second observation fills all of it, as its first one does.
    np.testing.assert_allclose(rates[2], 1.0)
    np.testing.assert_allclose(rates[4], (*[1.0] * 8, 2.0, 3.0))
    np.testing.assert_allclose(rates[11], np.arange(1.0, 11.0))
    assert not history_of(model.acted[11])[0, :, 6:8].any()


def test_images_are_encoded_every_fifth_step_of_each_robots_episode():
    model = Recorder()
    adapter = extreme_parkour.Adapter(model, 2)
    walk(adapter, 3)
    adapter.reset(np.array((False, True)))
    walk(adapter, 6)
    # Both at 0; the second at 3, as it begins anew; the first at 5; the second at 8.
    assert [len(inputs[0]) for inputs in model.encoded] == [2, 1, 1, 1]
    latents = np.array([acted[1][:, 0] for acted in model.acted])
    np.testing.assert_allclose(latents[:, 0], [1.0] * 5 + [2.0] * 4)
    np.testing.assert_allclose(latents[:, 1], [1.0] * 8 + [2.0])


def test_a_reset_forgets_all_of_one_robot_and_nothing_of_another():
    model = Recorder()
    fresh = extreme_parkour.Adapter(model, 2)
    # The feet leave the ground in the last step, which the next one would still feel.
    walk(fresh, 7, angular_velocity=np.ones((2, 3)))
    fresh.reset(np.array((True, False)))
    walk(fresh, 1, angular_velocity=np.ones((2, 3)), feet_contact=np.zeros((2, 4), bool))
    after = model.acted[-1][0]
    other = Recorder()
    walk(
        extreme_parkour.Adapter(other, 2),
        1,
        angular_velocity=np.ones((2, 3)),
        feet_contact=np.zeros((2, 4), bool),
    )
    np.testing.assert_array_equal(after[0], other.acted[0][0][0])
    assert history_of(model.acted[-1])[1].any()
    np.testing.assert_array_equal(after[1, 37:49], model.action)
    np.testing.assert_allclose(after[1, 49:53], 0.5)


def test_the_image_shows_what_the_sources_camera_would():
    """Of a plane whose depth grows linearly with the direction, no pixel is moved.

    Directions beyond the bundle's image have the depth of its border.
    """
    model = Recorder()
    # Slopes of the rays, from the bundle of the adapter's robot.
    lens = read_manifest(pretrained("go2-parkour")).camera
    right = (np.arange(64) + 0.5 - lens.cx) / lens.fx
    down = (np.arange(48) + 0.5 - lens.cy) / lens.fy
    depth = 1.0 + 0.3 * right + 0.5 * down[:, None]
    extreme_parkour.Adapter(model, 1).act(senses(1, depth=depth[None]))
    # The source's square pixels, cut as its crop_depth_image cuts, then resized across.
    pixel = np.tan(np.radians(87.0 / 2)) / 53
    rows = (np.arange(60) + 0.5 - 30)[:-2] * pixel
    columns = (np.arange(106) + 0.5 - 53)[4:-4] * pixel
    centres = torch.from_numpy(columns)[None, None]
    across = torch.nn.functional.interpolate(centres, 87, mode="linear")[0, 0].numpy()
    across = across.clip(right[0], right[-1])
    below = rows.clip(down[0], down[-1])
    expected = 0.5 * (1.0 + 0.3 * across + 0.5 * below[:, None]) - 0.5
    np.testing.assert_allclose(model.encoded[0][0][0], expected, atol=1e-5)


class Actor(torch.nn.Module):
    """A stand-in for base_jit.pt, which writes into its inputs, too."""

    def __init__(self):
        super().__init__()
        self.layer = torch.nn.Linear(753 + 32, 12)
        torch.nn.init.normal_(self.layer.weight, std=1e-3)

    def forward(self, observation, latent):
        observation[:, 185:194] = 0.0
        return self.layer(torch.cat((observation, latent), dim=1))


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The actor, the encoder's weights, and the two joined."""
    folder = tmp_path_factory.mktemp("extreme")
    torch.manual_seed(0)
    example_inputs = torch.zeros(1, 753), torch.zeros(1, 32)
    torch.jit.trace(Actor(), example_inputs).save(folder / "base_jit.pt")
    encoder = example.ImageEncoder()
    weights = {"depth_encoder_state_dict": encoder.state_dict()}
    torch.save(weights, folder / "vision_weight.pt")
    paths = folder / "base_jit.pt", folder / "vision_weight.pt", folder / "joined.pt"
    example.main(*paths)
    return (*paths, encoder)


def test_a_joined_file_walks_in_any_batch(files):
    *_, joined, _ = files
    evaluator = AdaptedEvaluator(joined, "extreme-parkour")
    assert list(evaluator.entries) == ["camera", "healthy"]
    evaluator.make_env("flat", [0, 1], 0.5, 1)
    actions = []
    for count in (1, 2):
        evaluator.feet_contact = lambda count=count: np.ones((count, 4), bool)
        policy = evaluator.make_policy(count)
        policy.reset()
        rng = np.random.default_rng(0)
        for _ in range(6):
            reading = np.tile(rng.normal(size=45).astype(np.float32), (count, 1))
            depth = np.tile(rng.random((48, 64), np.float32), (count, 1, 1))
            action = policy.step(reading, depth, np.zeros(count, bool))
        actions.append(action)
    np.testing.assert_allclose(actions[1], np.tile(actions[0], (2, 1)), atol=1e-4)


def test_the_joined_encoder_keeps_its_state_outside(files):
    *_, joined, encoder = files
    module = torch.jit.load(joined)
    image, observation = torch.rand(3, 58, 87), torch.rand(3, 53)
    with torch.no_grad():
        latent, state = module.encode(image, observation, torch.zeros(3, 512))
        again, _ = module.encode(image, observation, torch.zeros(3, 512))
        later, _ = module.encode(image, observation, state)
        expected, _ = encoder(image, observation, state)
    assert latent.shape == (3, 34)
    torch.testing.assert_close(again, latent)
    torch.testing.assert_close(later, expected)
    assert not torch.allclose(later, latent)


def test_a_wrong_file_is_told_in_one_line(files):
    base, vision, *_ = files
    for given, match in (
        (lambda: AdaptedEvaluator(base, "extreme-parkour"), "has no method encode"),
        (lambda: example.join(vision, vision), "is not Extreme Parkour's actor"),
        (lambda: example.join(base, base), "holds no weights of Extreme Parkour's encoder"),
        (lambda: example.join(base, base.with_name("none.pt")), "cannot read .*none.pt"),
    ):
        with pytest.raises(RenetError, match=match) as error:
            given()
        assert "\n" not in str(error.value)


def test_the_go2s_feet_are_in_the_order_of_legs(files, monkeypatch):
    evaluator = AdaptedEvaluator(files[2], "extreme-parkour")
    env = evaluator.make_env("flat", [0], 0.5, 1)
    # The sensor's order is the model's.
    names = env.env.scene[FEET_CONTACT].primary_names
    for place, leg in enumerate(LEGS):
        touching = torch.zeros(1, 4)
        touching[0, names.index(f"{leg}_foot_collision")] = 1.0
        monkeypatch.setattr(mdp, "feet_contact", lambda env, touching=touching: touching)
        assert env.feet_contact().tolist() == [[place == other for other in range(4)]]
