"""Only operators whose time and memory no value can change are accepted, in ONNX's own format."""

from collections.abc import Callable

import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import AttributeProto, helper, numpy_helper
from onnx import TensorProto as Type

from renet.bundle import DEFAULT, pretrained
from renet.bundle.graph import OPERATORS, check_graph
from renet.bundle.models import MODELS

info, node = helper.make_tensor_value_info, helper.make_node
SHIPPED = {name: (pretrained(DEFAULT) / f"{name}.onnx").read_bytes() for name in MODELS}
OPSETS = [helper.make_opsetid("", 17), helper.make_opsetid("com.microsoft", 1)]


def model(*nodes: onnx.NodeProto, functions=(), **constants: list) -> bytes:
    """A model of input `x` and constants, whose last node gives its output."""
    kinds = {int: np.int64, bool: np.bool_, float: np.float32}
    arrays = {k: np.array(v, kinds[type(np.ravel(v).tolist()[0])]) for k, v in constants.items()}
    tensors = [numpy_helper.from_array(array, name) for name, array in arrays.items()]
    inputs, outputs = [info("x", Type.FLOAT, ["n", 3])], [info("y", Type.FLOAT, None)]
    graph = helper.make_graph(list(nodes), "g", inputs, outputs, tensors)
    made = helper.make_model(graph, opset_imports=OPSETS, ir_version=8, functions=list(functions))
    return made.SerializeToString()


BODY = helper.make_graph([node("Identity", ["x"], ["z"])], "b", [], [info("z", 1, None)])


def changed(change: Callable[[onnx.ModelProto], object]) -> bytes:
    """A shipped model after a change."""
    proto = onnx.load_from_string(SHIPPED["actor"])
    change(proto)
    return proto.SerializeToString()


def elsewhere(proto: onnx.ModelProto) -> None:
    tensor = proto.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = Type.EXTERNAL
    tensor.external_data.add(key="location", value="weights.bin")


sparse = helper.make_sparse_tensor(
    numpy_helper.from_array(np.ones(1, np.float32), "v"),
    numpy_helper.from_array(np.zeros(1, np.int64), "i"),
    [9],
)
FUNCTION = helper.make_function(
    "mine", "Twice", ["x"], ["y"], [node("Add", ["x", "x"], ["y"])], OPSETS[:1]
)
CAST = node("Cast", ["x"], ["k"], to=Type.INT64)
HOSTILE = {
    "a loop": (model(node("Loop", ["m", "c", "x"], ["y"], body=BODY), m=9, c=True), "Loop"),
    "a branch": (model(node("If", ["c"], ["y"], then_branch=BODY, else_branch=BODY), c=True), "If"),
    "a scan": (model(node("Scan", ["x"], ["y"], body=BODY, num_scan_inputs=1)), "Scan"),
    "a branch in a listed operator": (model(node("Relu", ["x"], ["y"], body=BODY)), "field 6"),
    "several graphs": (model(node("Relu", ["x"], ["y"], bodies=[BODY])), "field 11"),
    "chance": (model(node("RandomNormalLike", ["x"], ["y"])), "RandomNormalLike"),
    "a size that is a value": (model(node("ConstantOfShape", ["x"], ["y"])), "ConstantOfShape"),
    "a range": (model(node("Range", ["a", "x", "b"], ["y"]), a=0.0, b=1.0), "Range"),
    "an operator of ONNX Runtime's": (
        model(node("QuickGelu", ["x"], ["y"], domain="com.microsoft")),
        "com.microsoft QuickGelu",
    ),
    "a function": (model(node("Twice", ["x"], ["y"], domain="mine"), functions=[FUNCTION]), "25"),
    "a slice as long as an input says": (
        model(CAST, node("Slice", ["big", "start", "k"], ["y"]), big=[0.0] * 9, start=[0]),
        "size of a Slice",
    ),
    "a shape that an input says": (
        model(CAST, node("Mul", ["k", "k"], ["shape"]), node("Reshape", ["x", "shape"], ["y"])),
        "size of a Reshape",
    ),
    "axes that an input says": (
        model(CAST, node("ReduceSum", ["x", "k"], ["y"])),
        "size of a ReduceSum",
    ),
    "sparse weights": (model(node("Constant", [], ["y"], sparse_value=sparse)), "field 22"),
    "weights in another file": (changed(elsewhere), "field 1[34]"),
    "training": (changed(lambda p: p.training_info.add()), "field 20"),
    "ONNX Runtime's own format": (b"\x08\x00\x00\x00ORTM" + bytes(100), "own format"),
    # Loaded from bytes, ONNX Runtime takes any file with ORTM at byte 4 for its own format.
    "two formats": (b"\x12\x06aaORTM" + SHIPPED["actor"], "own format"),
    "text": (b"hello, world", "its model has a field"),
    "nothing": (b"", "no graph"),
    "a number without an end": (b"\xff" * 20, "not protobuf"),
    "half a model": (SHIPPED["actor"][:-1], "torn"),
}


@pytest.mark.parametrize(("data", "reason"), HOSTILE.values(), ids=HOSTILE)
def test_what_is_no_static_model_is_refused(data, reason):
    with pytest.raises(ValueError, match=reason):
        check_graph(data)


@pytest.mark.parametrize("name", MODELS)
def test_shipped_models_are_accepted(name):
    check_graph(SHIPPED[name])


def test_sizes_may_come_from_constants_and_from_the_number_of_robots():
    data = model(
        node("Shape", ["x"], ["s"]),
        node("Gather", ["s", "zero"], ["n"]),
        node("Concat", ["n", "three"], ["shape"], axis=0),
        node("Reshape", ["x", "shape"], ["r"]),
        node("ReduceSum", ["r", "three"], ["y"], keepdims=1, noop_with_empty_axes=1),
        zero=[0],
        three=[1],
    )
    check_graph(data)


def test_no_listed_operator_can_hold_a_graph_or_draws_numbers():
    schemas = [s for s in onnx.defs.get_all_schemas_with_history() if s.name in OPERATORS.split()]
    assert {schema.name for schema in schemas} == set(OPERATORS.split())
    graphs = (AttributeProto.GRAPH, AttributeProto.GRAPHS)
    for schema in schemas:
        assert not {int(a.type) for a in schema.attributes.values()} & set(graphs), schema.name
        assert "seed" not in schema.attributes, schema.name


@given(st.data())
def test_a_damaged_model_is_accepted_or_refused_and_never_an_error(data):
    """Whatever is accepted and runs holds no operator that is not listed, as ONNX reads it."""
    content = bytearray(SHIPPED["actor"])
    small = len(content) - 4000  # Names and nodes; weights make up most of the file.
    places = st.integers(0, 400) | st.integers(small, len(content) - 1)
    for place in data.draw(st.lists(places, min_size=1, max_size=4)):
        content[place] = data.draw(st.integers(0, 255))
    try:
        check_graph(bytes(content))
    except ValueError:
        return
    try:
        proto = onnx.load_from_string(bytes(content))
    except Exception:
        return
    assert {n.op_type for n in proto.graph.node} <= set(OPERATORS.split())
    assert not any(a.HasField("g") or a.graphs for n in proto.graph.node for a in n.attribute)
