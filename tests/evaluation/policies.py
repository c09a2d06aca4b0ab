"""Somebody else's policies, written as ONNX text."""

from pathlib import Path

import onnx
import onnx.parser

STILL = """
<ir_version: 8, opset_import: ["" : 17]>
still (float[N, 45] observation, float[N, 48, 64] depth) => (float[N, 12] action)
{
    columns = AveragePool <kernel_shape = [53]> (depth)
    mean = ReduceMean <axes = [1], keepdims = 0> (columns)
    little = Constant <value_float = 0.01> ()
    action = Mul (mean, little)
}
"""
"""Actions are 0.01 of mean depths, to see what the policy is shown."""


def save_model(path: Path, text: str) -> Path:
    """Write a model of ONNX's text form."""
    onnx.save(onnx.parser.parse_model(text), path)
    return path


def joint_model(path: Path, body: str, outputs: int = 12) -> Path:
    """Write a model of joint positions x, whose body sets y."""
    head = '<ir_version: 8, opset_import: ["" : 17]>'
    return save_model(path, f"{head}\nt (float[N, 12] x) => (float[N, {outputs}] y) {{ {body} }}")


def write_adapter(path: Path, act: str, bundle: str = "go1-parkour") -> str:
    """Write an adapter whose `act` has this one statement, on line 8."""
    path.write_text(
        "from renet.evaluation.adapters import base\n\n\n"
        f"class Adapter(base.Adapter):\n    bundle = {bundle!r}\n\n"
        f"    def act(self, senses):\n        {act}\n"
    )
    return str(path)
