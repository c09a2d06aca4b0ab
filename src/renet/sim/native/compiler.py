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

from renet.sim.threads import THREADS, on_all_threads

TYPES = {"int": ctypes.c_int, "int64": ctypes.c_int64, "float": ctypes.c_float}
TYPES["bool"] = ctypes.c_bool
FIELD = re.compile(r"(?:const )?(\w+)(\*?) (\w+);")


class Struct(ctypes.Structure):
    """A struct of a C++ file. What its pointers point to lives as long as it does."""

    def __init__(self, **fields: Any) -> None:
        """Fill in all fields but `work`, which `Call` does.

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
        self._held: dict[str, Any] = {}
        self.set(**fields)

    def set(self, **fields: Any) -> None:
        """Replace some fields."""
        self._held |= fields
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

    def snippet(self, function: str, argument: str) -> str:
        """Code for `wp.func_native` of one uint64 named `call`.

        Args:
            function: what to call, `static void function(argument&)`.
            argument: the struct that lies at the address `call`.
        """
        # A function's body cannot hold functions, but a struct in it can.
        return f"struct File {{\n{self.text}\n}};\nFile::{function}(*(File::{argument}*)call);"

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


class Call:
    """A kernel around a C++ function whose struct begins with `Work work`; to be called often.

    Warp's own launch looks up and packs each time what takes longer than a small call.
    """

    def __init__(self, kernel: Any, argument: Struct, alone: bool = False) -> None:
        """Prepare a call.

        Args:
            kernel: its one argument is the address of `argument`.
            argument: what the function reads; may be changed between calls.
            alone: leave the work to the calling thread, which releases the GIL in any case.
        """
        self.argument = argument
        address = ctypes.addressof(argument)
        self._launch = wp.launch(kernel, dim=1, inputs=[address], device="cpu", record_cmd=True)
        self._alone = alone or THREADS == 1

    def __call__(self) -> None:
        """Do all the work."""
        self.argument.work.threads = self.argument.work.taken = 0
        if self._alone:
            self._launch.launch()
        else:
            on_all_threads(self._launch.launch)
