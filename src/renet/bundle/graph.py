"""What an ONNX model may hold: operators whose time and memory no value of an input can change.

A model is a program. Its file is protobuf; the numbers of its fields are those of
https://github.com/onnx/onnx/blob/main/onnx/onnx.proto. Whatever is not listed here is refused.
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
GRAPH, NODE, INITIALIZER = 7, 1, 5
INPUT, OUTPUT, OPERATOR, ATTRIBUTE, DOMAIN = 1, 2, 4, 5, 7
TENSOR, NAME = 5, 8
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
    """Refuse a file that is no ONNX protobuf, or whose time and memory may depend on its inputs.

    Raises ValueError naming what it holds that it may not.
    """
    if data[4:8] == b"ORTM":
        raise ValueError("it is in ONNX Runtime's own format, not in ONNX")
    graphs = [value for number, value in _fields(memoryview(data), "model") if number == GRAPH]
    if not graphs:
        raise ValueError("it has no graph")
    constants = {b""}  # Names of what no input's value can change; an absent input has no name.
    nodes: list[memoryview] = []
    for graph in graphs:  # Protobuf joins the parts of a message that comes in several.
        for number, value in _fields(graph, "graph"):
            if number == NODE:
                nodes.append(value)
            elif number == INITIALIZER:
                constants |= {bytes(v) for n, v in _fields(value, "tensor") if n == NAME}
    for node in nodes:
        _check_node(node, constants)


def _check_node(node: memoryview, constants: set[bytes]) -> None:
    """Refuse a node (ValueError), or add its outputs to `constants` where all its inputs are."""
    parts: dict[int, list[bytes]] = {number: [] for number in FIELDS["node"]}
    for number, value in _fields(node, "node"):
        parts[number].append(bytes(value))
    operator = parts[OPERATOR][-1].decode(errors="replace") if parts[OPERATOR] else ""
    if any(parts[DOMAIN]) or operator not in OPERATORS.split():
        domain = b"".join(parts[DOMAIN]).decode(errors="replace")
        raise ValueError(f"it has the operator {f'{domain} {operator}'.strip()[:60]!r}")
    for attribute in parts[ATTRIBUTE]:
        for number, value in _fields(memoryview(attribute), "attribute"):
            if number == TENSOR:
                list(_fields(value, "tensor"))
    inputs = parts[INPUT]
    sizes = inputs[1:] if operator in SIZED or operator.startswith("Reduce") else []
    if not constants.issuperset(sizes):
        raise ValueError(f"the size of a {operator}'s output depends on values")
    if operator == "Shape" or constants.issuperset(inputs):
        constants.update(parts[OUTPUT])


def _fields(message: memoryview, kind: str) -> Iterator[tuple[int, memoryview]]:
    """Numbers and contents of a message's fields; a number's own content is empty.

    Raises ValueError if it is torn, or has a field that this kind of message may not have.
    """
    at = 0
    while at < len(message):
        key, at = _integer(message, at)
        number, wire = key >> 3, key & 7
        size = {1: 8, 5: 4}.get(wire, 0)
        value, at = _integer(message, at) if wire in (0, 2) else (0, at)
        size = value if wire == 2 else size
        inside = kind == "tensor" and (number, wire, value) == (14, 0, 0)  # Its data's location.
        if wire not in (0, 1, 2, 5) or not (number in FIELDS[kind] or inside):
            raise ValueError(f"its {kind} has a field {number}, which is not accepted")
        if at + size > len(message):
            raise ValueError(f"its {kind} is torn")
        yield number, message[at : at + size]
        at += size


def _integer(message: memoryview, at: int) -> tuple[int, int]:
    """A number of up to ten bytes, and where it ends."""
    value = 0
    for place in range(10):
        if at + place == len(message):
            break
        byte = message[at + place]
        value |= (byte & 127) << 7 * place
        if byte < 128:
            return value, at + place + 1
    raise ValueError("it is not protobuf")
