"""C++ files that the clang in Warp compiles at first use, so that no compiler need be installed.

A file has structs and `static` functions, and no standard headers. Its structs become ctypes
classes, whose instances are the arguments of its functions.
"""

import ctypes
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from renet.sim.threads import on_all_threads

TYPES = {"int": ctypes.c_int, "int64": ctypes.c_int64, "float": ctypes.c_float}
TYPES["bool"] = ctypes.c_bool
FIELD = re.compile(r"(?:const )?(\w+)(\*?) (\w+);")


class Struct(ctypes.Structure):
    """A struct of a C++ file, which keeps the objects alive that its pointers point to."""

    def __init__(self, **fields: Any) -> None:
        """Set all fields but `work`, which `Source.call` sets; raises TypeError for others.

        Args:
            fields: numbers and structs; for pointers NumPy arrays, ctypes objects, addresses or
                None.
        """
        super().__init__()
        differing = fields.keys() ^ ({field[0] for field in self._fields_} - {"work"})
        if differing:
            raise TypeError(f"{type(self).__name__}: missing or unknown {differing}")
        self._held = fields
        for name, value in fields.items():
            if isinstance(value, np.ndarray):
                value = value.ctypes.data
            elif isinstance(value, (ctypes.Array, ctypes._SimpleCData)):
                value = ctypes.addressof(value)
            elif isinstance(value, ctypes._CFuncPtr):
                value = ctypes.cast(value, ctypes.c_void_p)
            setattr(self, name, value)


class Source:
    """A C++ file, in which quoted includes are replaced by their files."""

    def __init__(self, path: Path) -> None:
        text = path.read_text()
        include = re.compile(r'^#include "(.+)"$', re.MULTILINE)
        self.text = include.sub(lambda line: (path.parent / line[1]).read_text(), text)

    @cache  # noqa: B019  Sources are module constants.
    def struct(self, name: str) -> type[Struct]:
        """A struct of numbers, pointers, structs as a ctypes class; raises KeyError for others."""
        match = re.search(rf"^struct {name} {{\n(.*?)^}};", self.text, re.DOTALL | re.MULTILINE)
        if not match:
            raise KeyError(name)
        body = re.sub(r"//.*", "", match[1])
        declared = FIELD.findall(body)
        if len(declared) != body.count(";"):
            raise KeyError(f"{name} has fields other than `type name;`")
        fields = [
            (field, ctypes.c_void_p if pointer else TYPES.get(kind) or self.struct(kind))
            for kind, pointer, field in declared
        ]
        return type(name, (Struct,), {"_fields_": fields})

    def call(self, function: str, argument: Struct, alone: bool = False) -> None:
        """Call a function of the file on all threads; returns when all its work is done.

        Args:
            function: `static void function(Argument&)`, whose struct begins with `Work work`.
            argument: the struct.
            alone: whether to use the calling thread alone. The GIL is released in both cases.
        """
        argument.work.threads = argument.work.taken = 0
        inputs = [ctypes.addressof(argument)]
        kernel = self._kernel(function, type(argument).__name__)
        launch = wp.launch(kernel, dim=1, inputs=inputs, device="cpu", record_cmd=True).launch
        launch() if alone else on_all_threads(launch)

    @cache  # noqa: B019
    def _kernel(self, function: str, argument: str) -> Any:
        """A Warp kernel that calls a function with the struct `argument` at an address."""

        # C++ has no functions inside a function's body, but it has structs with functions there.
        @wp.func_native(
            f"struct File {{\n{self.text}\n}};\nFile::{function}(*(File::{argument}*)address);"
        )
        def native(address: wp.uint64): ...

        @wp.kernel(module="unique", enable_backward=False)
        def kernel(address: wp.uint64):
            native(address)

        return kernel
