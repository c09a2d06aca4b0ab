"""C++ files, compiled at first use by the clang inside Warp, so that no compiler is needed.

A file has structs and `static` functions, and includes no standard headers. Its structs become
ctypes classes, whose instances are the arguments of its functions.
"""

import ctypes
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from renet.sim.threads import on_all_threads

C_TYPES = {
    "int": ctypes.c_int,
    "int64": ctypes.c_int64,
    "float": ctypes.c_float,
    "bool": ctypes.c_bool,
}
FIELD = re.compile(r"(?:const )?(\w+)(\*?) (\w+);")
"""A field's declaration: type, asterisk of a pointer, and name."""


class Struct(ctypes.Structure):
    """Struct of a C++ file; keeps the objects alive that its pointers point to."""

    def __init__(self, **fields: Any) -> None:
        """Set all fields but `work`, which `Source.call` sets.

        Args:
            fields: Numbers and structs; for pointers NumPy arrays, ctypes objects, addresses or
                None.

        Raises:
            TypeError: A field is missing or unknown.
        """
        super().__init__()
        names = {field[0] for field in self._fields_} - {"work"}
        wrong_names = fields.keys() ^ names
        if wrong_names:
            raise TypeError(f"{type(self).__name__}: missing or unknown {wrong_names}")
        # References that keep the memory behind pointers alive.
        self._references = fields
        for name, value in fields.items():
            if isinstance(value, np.ndarray):
                value = value.ctypes.data
            elif isinstance(value, (ctypes.Array, ctypes._SimpleCData)):
                value = ctypes.addressof(value)
            elif isinstance(value, ctypes._CFuncPtr):
                value = ctypes.cast(value, ctypes.c_void_p)
            setattr(self, name, value)


class Source:
    """C++ file, in which quoted includes are replaced by the included files."""

    def __init__(self, path: Path) -> None:
        text = path.read_text()
        include = re.compile(r'^#include "(.+)"$', re.MULTILINE)
        self.text = include.sub(lambda line: (path.parent / line[1]).read_text(), text)

    @cache  # noqa: B019  Sources are module constants.
    def struct(self, name: str) -> type[Struct]:
        """Build the ctypes class of a struct.

        Raises:
            KeyError: There is no such struct, or it has fields other than numbers, pointers and
                structs.
        """
        match = re.search(rf"^struct {name} {{\n(.*?)^}};", self.text, re.DOTALL | re.MULTILINE)
        if not match:
            raise KeyError(name)
        body = re.sub(r"//.*", "", match[1])
        declarations = FIELD.findall(body)
        if len(declarations) != body.count(";"):
            raise KeyError(f"{name} has fields other than `type name;`")
        fields = []
        for kind, pointer, field in declarations:
            if pointer:
                fields.append((field, ctypes.c_void_p))
            else:
                fields.append((field, C_TYPES.get(kind) or self.struct(kind)))
        return type(name, (Struct,), {"_fields_": fields})

    def call(self, function: str, argument: Struct, alone: bool = False) -> None:
        """Call a function of the file on all threads, and return when all its work is done.

        The GIL is released meanwhile.

        Args:
            function: Name of a `static void function(Argument&)`, whose struct begins with `Work
                work`.
            argument: The struct.
            alone: Use the calling thread alone.
        """
        argument.work.threads = 0
        argument.work.taken = 0
        inputs = [ctypes.addressof(argument)]
        kernel = self._kernel(function, type(argument).__name__)
        launch = wp.launch(kernel, dim=1, inputs=inputs, device="cpu", record_cmd=True).launch
        if alone:
            launch()
        else:
            on_all_threads(launch)

    @cache  # noqa: B019
    def _kernel(self, function: str, argument: str) -> Any:
        """Build a Warp kernel that calls a function with the struct `argument` at an address."""

        # C++ has no functions inside a function's body, but it has structs with functions there.
        @wp.func_native(
            f"struct File {{\n{self.text}\n}};\nFile::{function}(*(File::{argument}*)address);"
        )
        def native(address: wp.uint64): ...

        @wp.kernel(module="unique", enable_backward=False)
        def kernel(address: wp.uint64):
            native(address)

        return kernel
