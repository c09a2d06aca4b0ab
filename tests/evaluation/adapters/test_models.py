"""Files that strangers export."""

from zipfile import ZipFile

import numpy as np
import onnx
import onnx.parser
import pytest
import torch

from renet.errors import RenetError
from renet.evaluation.adapters.models import open_model

DOUBLE = """
<ir_version: 8, opset_import: ["" : 17]>
double (float[N, 3] observation) => (float[N, 3] action)
{ action = Add (observation, observation) }
"""


class Counter(torch.nn.Module):
    """Remembers what it was given, as policies do that keep their own history."""

    def __init__(self):
        super().__init__()
        self.register_buffer("total", torch.zeros(1, 3))

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, tuple[torch.Tensor]]:
        self.total = self.total + x
        return self.total, (x,)

    @torch.jit.export
    def reset(self):
        self.total = torch.zeros(1, 3)


@pytest.fixture
def onnx_file(tmp_path):
    onnx.save(onnx.parser.parse_model(DOUBLE), tmp_path / "double.onnx")
    return tmp_path / "double.onnx"


@pytest.fixture
def torch_file(tmp_path):
    torch.jit.save(torch.jit.script(Counter()), tmp_path / "counter.pt")
    return tmp_path / "counter.pt"


def test_onnx_runs(onnx_file):
    one = np.ones((2, 3))
    np.testing.assert_array_equal(open_model(onnx_file).run(one)[0], 2 * one)


def test_torchscript_remembers_each_robot(torch_file):
    model = open_model(torch_file)
    one = np.ones((1, 3))
    model.run(one, robot=0)
    total, given = model.run(one, robot=0)
    np.testing.assert_array_equal(total, 2 * one)
    np.testing.assert_array_equal(given, one)
    np.testing.assert_array_equal(model.run(one, robot=1)[0], one)
    model.reset(0)
    np.testing.assert_array_equal(model.run(one, robot=0)[0], one)


def test_too_few_inputs_are_told(onnx_file):
    with pytest.raises(RenetError, match=r"has the inputs observation, the adapter gives 2"):
        open_model(onnx_file).run(np.ones((1, 3)), np.ones((1, 3)))


@pytest.mark.parametrize("kind", ["onnx_file", "torch_file"])
def test_a_method_that_is_not_there_is_told(kind, request):
    model = open_model(request.getfixturevalue(kind))
    with pytest.raises(RenetError, match="has no method encode, which the adapter needs"):
        model.run(np.ones((1, 3)), method="encode")


def test_other_methods_of_torchscript_run(tmp_path):
    class Two(torch.nn.Module):
        def forward(self, x):
            return x

        def encode(self, x):
            return 2 * x

    one = torch.ones(1, 3)
    torch.jit.trace_module(Two(), {"forward": one, "encode": one}).save(tmp_path / "two.pt")
    model = open_model(tmp_path / "two.pt")
    np.testing.assert_array_equal(model.run(one.numpy(), method="encode")[0], 2 * one)
    np.testing.assert_array_equal(model.run(one.numpy())[0], one)


@pytest.mark.parametrize("kind", ["onnx_file", "torch_file"])
def test_wrong_shapes_are_told_in_one_line(kind, request):
    model = open_model(request.getfixturevalue(kind))
    with pytest.raises(RenetError, match=r"does not take inputs of shapes \[1, 4\]") as error:
        model.run(np.ones((1, 4)))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("policy.onnx", "is no ONNX model"),
        ("policy.pt", "is no TorchScript module: torch.jit.save did not write it: "),
        ("policy.zip", "is neither .onnx nor TorchScript"),
    ],
)
def test_other_files_are_refused_in_one_line(tmp_path, name, message):
    (tmp_path / name).write_bytes(b"nothing of the kind\n" * 9)
    with pytest.raises(RenetError, match=message) as error:
        open_model(tmp_path / name)
    assert "\n" not in str(error.value)


def test_a_checkpoint_is_no_module(tmp_path):
    torch.save({"weights": torch.zeros(3)}, tmp_path / "model.pt")
    with pytest.raises(RenetError, match=r"is no TorchScript module: it is a checkpoint, .*trace$"):
        open_model(tmp_path / "model.pt")


def test_a_module_without_its_weights_is_damaged(tmp_path, torch_file):
    with ZipFile(torch_file) as whole, ZipFile(tmp_path / "half.pt", "w") as half:
        for name in whole.namelist():
            if "/data/" not in name:
                half.writestr(name, whole.read(name))
    with pytest.raises(RenetError, match=r"it is damaged, or of a newer PyTorch$"):
        open_model(tmp_path / "half.pt")


def test_shapes_are_those_of_the_newest_run(onnx_file, torch_file):
    for path in (onnx_file, torch_file):
        model = open_model(path)
        assert model.shapes == ""
        model.run(np.ones((1, 3)))
        assert model.shapes.startswith("inputs [1, 3], outputs [1, 3]")


def test_a_missing_file_is_told(tmp_path):
    with pytest.raises(RenetError, match="does not exist"):
        open_model(tmp_path / "policy.onnx")
