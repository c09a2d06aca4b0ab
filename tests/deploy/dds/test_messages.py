"""Messages of the Go2 and of ROS 2 against cyclonedds' own serialiser and the XTypes standard."""

from hashlib import md5

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs renet-locomotion[go2]")

from cyclonedds.idl._typesupport.DDS.XTypes import TypeMapping

from renet.deploy.cdr import ENCAPSULATION
from renet.deploy.dds import messages
from renet.deploy.dds.messages import message_type, read_types
from renet.deploy.robots.go2.messages import LOW_CMD, LOW_STATE, MODULE
from renet.deploy.teleop.ros2 import TWIST
from renet.errors import RenetError

TABLES = {"LowCmd_": LOW_CMD, "LowState_": LOW_STATE, "Twist_": TWIST}
MODULES = {"Twist_": "geometry_msgs.msg.dds_"}
"""Those that are not the robot's."""
KINDS = {"u1": 2, "<u2": 6, "<u4": 7, "<i2": 3, "<i4": 4, "<f4": 9, "<f8": 10}
"""XTypes' TypeKind of each number (1.3, 7.3.4.5; version 0.10.2 calls an octet a byte)."""


@pytest.fixture(params=TABLES)
def message(request):
    """A type of messages, made anew."""
    return made(request.param)


def made(name: str):
    return message_type(name, TABLES[name], MODULES.get(name, MODULE))


def filled(message, seed: int):
    """A sample whose every byte is random, and finite where it is a float."""
    sample, random = message(), np.random.default_rng(seed)
    sample.raw[:] = random.integers(0, 256, sample.raw.size)
    sample.raw[3::4] = random.integers(0, 0x40, sample.raw[3::4].size)
    return sample


def stock(cls, values):
    """The same values in a class that the library serialises by itself."""
    parts = {}
    for name, hint in cls.__annotations__.items():
        part = getattr(hint, "__metadata__", (hint,))[0]
        inner, value = getattr(part, "subtype", part), values[name]
        if hasattr(inner, "__idl__"):
            parts[name] = [stock(inner, v) for v in value] if value.shape else stock(inner, value)
        else:
            parts[name] = value.tolist()
    return cls(**parts)


def test_payload_equals_the_librarys_own_byte_for_byte_and_back(message):
    name = message.__name__
    for seed in range(3):
        sample = filled(message, seed)
        library = stock(messages._idl(name, TABLES[name], MODULE), sample.values)
        theirs, ours = library.serialize(use_version_2=False), sample.serialize()
        assert theirs[: len(ours)] == ours
        assert not any(theirs[len(ours) :]), "the library fills its buffer up"
        again = message.deserialize(theirs)
        assert again.serialize() == ours


def test_sizes_are_those_of_the_vendors_c_structs():
    samples = [made(name)() for name in TABLES]
    sizes = [(len(sample.raw), len(sample.serialize()) - 4) for sample in samples]
    assert sizes == [(812, 808), (1180, 1176), (48, 48)]


@pytest.mark.parametrize(("name", "size"), [("LowCmd_", 808), ("Twist_", 48)])
def test_a_payload_of_another_size_or_order_is_none(name, size):
    for data in (b"", ENCAPSULATION, ENCAPSULATION + bytes(size - 1), b"\0\0\0\0" + bytes(size)):
        assert made(name).deserialize(data).values is None


@pytest.mark.parametrize(
    "name", ["LowCmd_", "LowState_", "Request_", "Response_", "Twist_", "TwistStamped_"]
)
def test_type_information_names_types_by_the_md5_of_what_they_are(name):
    information, mapping = read_types()[name]
    types = TypeMapping.deserialize(mapping, has_header=False, use_version_2=True)
    pairs = types.identifier_object_pair_minimal + types.identifier_object_pair_complete
    assert len(pairs) >= 4
    for pair in pairs:
        content = pair.type_object.serialize(use_version_2=True)[4:]
        assert pair.type_identifier.value == md5(content).digest()[:14]
        assert pair.type_identifier.value in information


@pytest.mark.parametrize("name", TABLES)
def test_announced_types_have_the_tables_members(name):
    mapping = TypeMapping.deserialize(read_types()[name][1], has_header=False, use_version_2=True)
    structs = {
        pair.type_identifier.value: pair.type_object.value.value
        for pair in mapping.identifier_object_pair_complete
    }

    def members(struct):
        for member in struct.member_seq:
            kind, count = member.common.member_type_id, 1
            if hasattr(kind.value, "array_bound_seq"):
                (count,), kind = kind.value.array_bound_seq, kind.value.element_identifier
            yield member.detail.name, structs.get(kind.value, kind.discriminator), count

    def check(table, struct):
        for (field, kind, count), member in zip(table, members(struct), strict=True):
            assert (field, count) == (member[0], member[2])
            if isinstance(kind, str):
                assert KINDS[kind] == member[1]
            else:
                assert member[1].header.detail.type_name.endswith(f"::{kind[0]}")
                check(kind[1], member[1])

    whole = f"{MODULES.get(name, MODULE)}.{name}".replace(".", "::")
    check(TABLES[name], next(s for s in structs.values() if s.header.detail.type_name == whole))


def test_a_changed_file_of_type_bytes_is_refused(tmp_path):
    path = tmp_path / "types.json"
    path.write_bytes(messages.TYPES_FILE.read_bytes().replace(b"A", b"B", 1))
    with pytest.raises(RenetError, match=r"types.json is damaged"):
        read_types(path)
