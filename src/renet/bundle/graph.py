"""Check of ONNX models: operators whose time and memory no value of an input can change.

A model is a program, which may come from a stranger. Its file is protobuf; the numbers of its
fields are those of https://github.com/onnx/onnx/blob/main/onnx/onnx.proto. Whatever is not listed
here is refused.
"""

from collections.abc import Iterator

FIELDS = {
    "model": {1, 2, 3, 4, 5, 6, 7, 8, 14},
    "graph": {1, 2, 5, 10, 11, 12, 13, 16},
    "node": {1, 2, 3, 4, 5, 6, 7, 9},
    "attribute": {1, 2, 3, 4, 5, 7, 8, 9, 13, 20},
    "tensor": {1, 2, 4, 5, 7, 8, 9, 10, 11, 12},
}
"""Fields that each kind of message may have: no functions, no graphs in attributes, no sparse
tensors, no weights in other files."""
# Numbers of the fields that are looked at: of a model, of a graph, of a node, of an attribute and
# of a tensor.
_GRAPH = 7
_NODE = 1
_INITIALIZER = 5
_INPUT = 1
_OUTPUT = 2
_OPERATOR = 4
_ATTRIBUTE = 5
_DOMAIN = 7
_TENSOR = 5
_NAME = 8
# Kinds of protobuf's contents ("wire types"): a varint, 8 bytes, bytes after their count, 4 bytes.
_VARINT = 0
_FIXED64 = 1
_COUNTED = 2
_FIXED32 = 5
OPERATORS = """
    Abs Acos Acosh Add And ArgMax ArgMin Asin Asinh Atan Atanh AveragePool BatchNormalization
    BitwiseAnd BitwiseNot BitwiseOr BitwiseXor Cast Ceil Celu Clip Concat Constant Conv
    ConvTranspose Cos Cosh DequantizeLinear Div Einsum Elu Equal Erf Exp Expand Flatten Floor GRU
    Gather GatherElements Gelu Gemm GlobalAveragePool GlobalMaxPool Greater GreaterOrEqual
    GroupNormalization HardSigmoid HardSwish Hardmax Identity InstanceNormalization IsInf IsNaN LSTM
    LayerNormalization LeakyRelu Less LessOrEqual Log LogSoftmax LpNormalization MatMul Max MaxPool
    Mean Min Mish Mod Mul Neg Not Or PRelu Pad Pow QuantizeLinear Reciprocal ReduceL1 ReduceL2
    ReduceLogSumExp ReduceMax ReduceMean ReduceMin ReduceProd ReduceSum ReduceSumSquare Relu Reshape
    Round Selu Shape Sigmoid Sign Sin Sinh Slice Softmax Softplus Softsign Split Sqrt Squeeze Sub
    Sum Tan Tanh ThresholdedRelu Transpose Unsqueeze Where Xor
"""
"""Operators whose time and memory follow from their inputs' sizes, but for `SIZED`."""
SIZED = ("Expand", "Pad", "Reshape", "Slice", "Split", "Squeeze", "Unsqueeze")
"""Operators whose inputs after the first say how large their output is, as a `Reduce…`'s do."""


def check_graph(data: bytes) -> None:
    """Refuse a model whose time or memory may depend on the values of its inputs.

    Raises:
        ValueError: The file is no ONNX protobuf, or holds a part that is not accepted, which the
            message names.
    """
    if data[4:8] == b"ORTM":
        raise ValueError("it is in ONNX Runtime's own format, not in ONNX")
    graphs = [value for number, value in _fields(memoryview(data), "model") if number == _GRAPH]
    if not graphs:
        raise ValueError("it has no graph")
    # Names of tensors that no input's value can change. An absent input has an empty name.
    constants = {b""}
    nodes: list[memoryview] = []
    # Protobuf joins the parts of a message that comes in several.
    for graph in graphs:
        for number, value in _fields(graph, "graph"):
            if number == _NODE:
                nodes.append(value)
            elif number == _INITIALIZER:
                constants |= {bytes(v) for n, v in _fields(value, "tensor") if n == _NAME}
    for node in nodes:
        _check_node(node, constants)


def _check_node(node: memoryview, constants: set[bytes]) -> None:
    """Check a node, and add its outputs to `constants` if all its inputs are constant.

    Raises:
        ValueError: The operator or the size of its output is not accepted.
    """
    parts: dict[int, list[bytes]] = {number: [] for number in FIELDS["node"]}
    for number, value in _fields(node, "node"):
        parts[number].append(bytes(value))
    operator = parts[_OPERATOR][-1].decode(errors="replace") if parts[_OPERATOR] else ""
    if any(parts[_DOMAIN]) or operator not in OPERATORS.split():
        domain = b"".join(parts[_DOMAIN]).decode(errors="replace")
        raise ValueError(f"it has the operator {f'{domain} {operator}'.strip()[:60]!r}")
    # Reading the fields of attributes checks them.
    for attribute in parts[_ATTRIBUTE]:
        for number, value in _fields(memoryview(attribute), "attribute"):
            if number == _TENSOR:
                list(_fields(value, "tensor"))
    inputs = parts[_INPUT]
    sizes = inputs[1:] if operator in SIZED or operator.startswith("Reduce") else []
    if not constants.issuperset(sizes):
        raise ValueError(f"the size of a {operator}'s output depends on values")
    # Shapes follow from the sizes of the model's inputs, which are fixed.
    if operator == "Shape" or constants.issuperset(inputs):
        constants.update(parts[_OUTPUT])


def _fields(message: memoryview, kind: str) -> Iterator[tuple[int, memoryview]]:
    """Yield number and content of each of a message's fields; that of a varint is empty.

    Raises:
        ValueError: The message is cut short, or has a field that its kind may not have.
    """
    at = 0
    while at < len(message):
        key, at = _integer(message, at)
        number = key >> 3
        wire = key & 7
        size = {_FIXED64: 8, _FIXED32: 4}.get(wire, 0)
        value = 0
        if wire in (_VARINT, _COUNTED):
            value, at = _integer(message, at)
        if wire == _COUNTED:
            size = value
        # Field 14 tells where a tensor's data is, and 0 that it is inside of the file.
        inside = kind == "tensor" and (number, wire, value) == (14, _VARINT, 0)
        known = wire in (_VARINT, _FIXED64, _COUNTED, _FIXED32)
        if not known or not (number in FIELDS[kind] or inside):
            raise ValueError(f"its {kind} has a field {number}, which is not accepted")
        if at + size > len(message):
            raise ValueError(f"its {kind} is torn")
        yield number, message[at : at + size]
        at += size


def _integer(message: memoryview, at: int) -> tuple[int, int]:
    """Read a varint, a number of up to ten bytes; returns it and the position after it."""
    value = 0
    for place in range(10):
        if at + place == len(message):
            break
        byte = message[at + place]
        # Seven bits of the number a byte; the eighth says that another byte follows.
        value |= (byte & 127) << 7 * place
        if byte < 128:
            return value, at + place + 1
    raise ValueError("it is not protobuf")
