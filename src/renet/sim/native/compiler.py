"""C++ files that Warp's bundled clang compiles at first use, so that none need be installed.

A file holds structs and `static` functions, without standard headers. Python reads the structs from
the file itself, as ctypes classes, and fills in what a function is called with.
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
    """A struct of a C++ file. What its pointers point to lives as long as it does."""

    def __init__(self, **fields: Any) -> None:
        """Fill in all fields but `work`, which `Source.call` does.

        Args:
            fields: numbers and structs; for pointers NumPy arrays, ctypes objects, addresses or
                None.

        Raises:
            TypeError: a field is missing or unknown.
        """
        super().__init__()
        known = {field[0] for field in self._fields_} - {"work"}
        if known != set(fields):
            raise TypeError(f"{type(self).__name__}: missing or unknown {known ^ set(fields)}")
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
    """A C++ file, with the files it includes by name put in."""

    def __init__(self, path: Path) -> None:
        text = path.read_text()
        include = re.compile(r'^#include "(.+)"$', re.MULTILINE)
        self.text = include.sub(lambda found: (path.parent / found[1]).read_text(), text)

    @cache  # noqa: B019  Sources are module constants.
    def struct(self, name: str) -> type[Struct]:
        """The ctypes class of a struct whose fields are numbers, pointers and such structs.

        Raises:
            KeyError: the file has no such struct, or a field of it has a type Python cannot share.
        """
        found = re.search(rf"^struct {name} {{\n(.*?)^}};", self.text, re.DOTALL | re.MULTILINE)
        if not found:
            raise KeyError(name)
        body = re.sub(r"//.*", "", found[1])
        declared = FIELD.findall(body)
        if len(declared) != body.count(";"):
            raise KeyError(f"{name} has fields other than `type name;`")
        fields = [
            (field, ctypes.c_void_p if pointer else TYPES.get(kind) or self.struct(kind))
            for kind, pointer, field in declared
        ]
        return type(name, (Struct,), {"_fields_": fields})

    def call(self, function: str, argument: Struct, alone: bool = False) -> None:
        """Call a function of the file until all its work is done.

        Args:
            function: `static void function(Argument&)`, whose struct begins with `Work work`.
            argument: what it reads.
            alone: leave the work to the calling thread, which releases the GIL in any case.
        """
        argument.work.threads = argument.work.taken = 0
        inputs = [ctypes.addressof(argument)]
        kernel = self._kernel(function, type(argument).__name__)
        launch = wp.launch(kernel, dim=1, inputs=inputs, device="cpu", record_cmd=True).launch
        if alone:
            launch()
        else:
            on_all_threads(launch)

    @cache  # noqa: B019
    def _kernel(self, function: str, argument: str) -> Any:
        """A kernel of one number, the address of a struct `argument`, that calls a function."""

        # A function's body cannot hold functions, but a struct in it can.
        @wp.func_native(
            f"struct File {{\n{self.text}\n}};\nFile::{function}(*(File::{argument}*)address);"
        )
        def native(address: wp.uint64): ...

        @wp.kernel(module="unique", enable_backward=False)
        def kernel(address: wp.uint64):
            native(address)

        return kernel
