"""The ONNX models say what the PyTorch networks say, with memory carried along."""

import json
import shutil

import numpy as np
import onnxruntime as ort
import pytest
import torch

from renet.bundle import pretrained
from renet.bundle.graph import check_graph
from renet.cli import parse
from renet.errors import RenetError
from renet.models.adaptation import fuse
from renet.models.config import ModelCfg
from renet.models.expectation import Evidence, Recollection, mean_blocks
from renet.models.memory import EstimatorMemory
from renet.models.renet import RENet
from renet.options import ExportCfg
from renet.training import checkpoint as checkpoints
from renet.training.export import export, export_models
from renet.training.train import TrainCfg

from .test_ablations import ROWS

MODELS = {
    **{name: ROWS[name].fields for name in ("default", "MLP", "One Obs", "One Image")},
    "no heads": ROWS["w/o VEL"].fields | ROWS["w/o FH"].fields | ROWS["w/o HF"].fields,
    "variance detector": {"detector": "variance"},
    "map's error": {"predict_map_error": True},
    "expected images": {"detector": "variance", "expect_image": True},
}
"""Every row whose exported networks differ."""


@pytest.mark.parametrize("fields", MODELS.values(), ids=MODELS)
def test_sequence_matches_pytorch(fields):
    torch.manual_seed(0)
    cfg = ModelCfg(**fields)
    model = RENet(cfg, critic_size=10).eval()
    models = export_models(model)
    assert sum(map(len, models.values())) < 3e6
    for data in models.values():
        check_graph(data)
    onnx = {name: ort.InferenceSession(data) for name, data in models.items()}
    memory = EstimatorMemory(cfg, 3, "cpu")
    latents = {name: np.zeros((3, 64), np.float32) for name in ("latent_op", "latent_vp")}
    evidence = Evidence(torch.zeros(3), torch.zeros(3))
    for tick in range(6):
        has_image = torch.tensor([True, tick != 3, tick % 2 == 0])
        observation, image = torch.randn(3, 45), torch.rand(3, 48, 64)
        mask = torch.tensor([1.0, 0.0, float(tick % 2)])
        memory.push(observation)
        last_image = memory.frames[:, 0].float()
        known = Recollection(
            memory.latent_vp, memory.history, mean_blocks(last_image), memory.image_age
        )
        memory.see(image, has_image)
        memory.tick(model.advance)
        inputs = {
            "proprioception_history": memory.history.numpy(),
            "depth": memory.frames.float().numpy(),
            "has_image": has_image[:, None].float().numpy(),
            **latents,
        }
        assert {i.name for i in onnx["estimator"].get_inputs()} == set(inputs)
        outputs = [o.name for o in onnx["estimator"].get_outputs()]
        result = dict(zip(outputs, onnx["estimator"].run(None, inputs), strict=True))
        latents = {name: result[f"next_{name}"] for name in latents}
        for name, latent in latents.items():
            np.testing.assert_allclose(latent, getattr(memory, name), atol=1e-4)
        with torch.no_grad():
            estimate = model.vp.predict(memory.latent_vp)
            action = model.actor(observation, fuse(memory.latent_op, memory.latent_vp, mask))
            reconstruction = model.autoencoder.predict(memory.frames.float())[0]
        for name in ("feet_height", "height_map"):
            expected = estimate.get(name, torch.zeros(result[name].shape)).numpy()
            np.testing.assert_allclose(result[name], expected, atol=1e-4)
        assert ("map_error" in result) == cfg.predict_map_error
        if cfg.predict_map_error:
            variance = model.vp.map_log_variance(memory.latent_vp).exp().detach().numpy()
            ahead = variance.reshape(3, 12, 11)[:, 4:]  # From 0.15 m on.
            expected = np.sqrt(ahead.mean(axis=(1, 2)))
            np.testing.assert_allclose(result["map_error"], expected, rtol=1e-4)
        inputs = {"proprioception": observation.numpy(), "op_mask": mask[:, None].numpy()}
        (got,) = onnx["actor"].run(None, inputs | latents)
        np.testing.assert_allclose(got, action.numpy(), atol=1e-4)
        depth = memory.frames.float().numpy()
        feed = {"depth": depth}
        if model.expectation is not None:
            feed |= {
                "proprioception_history": known.history.numpy(),
                "latent_vp": known.latent.numpy(),
                "last_image": last_image.numpy(),
                "image_age": known.age[:, None].numpy(),
                "evidence": torch.stack(evidence, dim=-1).numpy(),
            }
            got, still, after = onnx["vision"].run(["surprise", "stillness", "next_evidence"], feed)
            with torch.no_grad():
                blocks = mean_blocks(memory.frames[:, 0].float())
                surprise = model.expectation.surprise(known, blocks)
                evidence = model.expectation.weigh(known, blocks, evidence)
            np.testing.assert_allclose(got, surprise.numpy(), atol=1e-4)
            np.testing.assert_allclose(still, evidence.stillness, atol=1e-4)
            np.testing.assert_allclose(after, torch.stack(evidence, dim=-1), rtol=1e-3, atol=1e-3)
        got, score = onnx["vision"].run(("reconstruction", "anomaly_score"), feed)
        np.testing.assert_allclose(got, reconstruction.numpy(), atol=1e-4)
        expected = np.mean((depth - got) ** 2, axis=(1, 2, 3))
        np.testing.assert_allclose(score, expected, rtol=1e-4)


def test_oracle_cannot_be_exported():
    with pytest.raises(RenetError, match="Oracle"):
        export_models(RENet(ModelCfg(perception="oracle"), critic_size=10))


@pytest.mark.parametrize(
    ("place", "value", "what"),
    [
        ("actions.joint_pos.scale", 0.5, "scale 0.5; its task has 0.25"),
        ("scene.entities.robot.articulation.actuators.0.stiffness", 20.0, "20.0; its task has 40"),
        ("scene.sensors.CAMERA.mount.pitch", 0.9, "pitch 0.9; its task has 0.52"),
        ("scene.sensors.CAMERA.range", 3.0, "camera.range 3.0; its task has 2.0"),
    ],
)
def test_robot_other_than_the_tasks_is_not_exported(tmp_path, place, value, what):
    """The manifest would describe another robot than that which the policy has learned to walk."""
    folder = tmp_path / "it_00000001"
    shutil.copytree(checkpoints.find(pretrained("checkpoint")), folder)
    file = folder / "state.json"
    state = json.loads(file.read_text())
    setting = state["env"]
    cameras = ["mount" in sensor for sensor in setting["scene"]["sensors"]]
    *parents, last = place.replace("CAMERA", str(cameras.index(True))).split(".")
    for key in parents:
        setting = setting[int(key)] if isinstance(setting, list) else setting[key]
    setting[last] = value
    file.write_text(json.dumps(state))
    with pytest.raises(RenetError, match=what):
        export(ExportCfg(checkpoint=folder, out=tmp_path / "bundle"))
    assert not (tmp_path / "bundle").exists()


def test_a_task_of_another_program_is_told_as_such(tmp_path):
    folder = tmp_path / "it_00000001"
    shutil.copytree(checkpoints.find(pretrained("checkpoint")), folder)
    state = json.loads((folder / "state.json").read_text())
    state["task"] = "Renet-AlienGo-Flat"
    (folder / "state.json").write_text(json.dumps(state))
    message = (
        "Renet-AlienGo-Flat is unknown here: run the program that registers it in place of renet"
    )
    with pytest.raises(RenetError, match=message):
        export(ExportCfg(checkpoint=folder, out=tmp_path / "bundle"))
    with pytest.raises(RenetError, match=message):
        parse(TrainCfg, ["--resume", str(folder)], "renet train")
    assert not (tmp_path / "bundle").exists()
