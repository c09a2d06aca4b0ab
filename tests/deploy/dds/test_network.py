"""What a Go2's network hears of this program, and that no other network hears anything."""

import subprocess
import sys

import pytest

pytest.importorskip("cyclonedds", reason="needs renet-locomotion[go2]")

from cyclonedds.idl._main import IDL
from cyclonedds.idl._xt_builder import XTBuilder

from renet.deploy.dds import network
from renet.deploy.dds.messages import message_type
from renet.deploy.dds.network import Network
from renet.deploy.robots.go2.messages import LOW_CMD, MODULE
from renet.errors import RenetError

from .domain import free_domain

pytestmark = pytest.mark.wall_clock

ALONE = """
echo 1 > /proc/sys/net/ipv6/conf/default/disable_ipv6
ip link set lo up
ip link add card type veth peer name other
ip addr add 10.9.9.1/24 dev card
ip link set other up
ip link set card up
"$@"
grep card: /proc/net/dev
"""
SPEAK = """
import sys, time
from renet.deploy.dds import network
from renet.deploy.robots.go2.messages import LowCmd
network.INTERFACE_CONFIG = sys.argv[1] or network.INTERFACE_CONFIG
writer = network.Network("lo", int(sys.argv[2])).writer("rt/lowcmd", LowCmd)
for _ in range(20):
    writer.write(LowCmd())
    time.sleep(0.02)
"""
SENT = 10
"""Place of the number of packets sent in a line of /proc/net/dev."""


def test_an_interface_that_is_not_there_is_named():
    with pytest.raises(RenetError, match=r"no network interface 'eth9' here, only .*lo"):
        Network("eth9", free_domain())


def test_another_version_of_cyclone_dds_is_refused(monkeypatch):
    monkeypatch.setattr(network, "version", lambda package: "11.0.2")
    with pytest.raises(RenetError, match=r"need cyclonedds 11.0.1, this is 11.0.2: .* may crash"):
        Network("lo", free_domain())


def test_a_library_that_makes_its_own_type_information_after_all_is_refused(monkeypatch):
    def fill(idl: IDL) -> None:
        idl.populate()
        made = XTBuilder.process_type(idl.datatype)
        idl._xt_bytedata = tuple(part.serialize(use_version_2=True)[4:] for part in made)

    network = Network("lo", free_domain())
    network.writer("rt/lowcmd", message_type("LowCmd_", LOW_CMD, MODULE))
    monkeypatch.setattr(IDL, "fill_type_data", fill)
    with pytest.raises(RenetError, match="announces LowCmd_ in a way that may crash robots"):
        network.writer("rt/other", message_type("LowCmd_", LOW_CMD, MODULE))


@pytest.mark.parametrize(("config", "silent"), [("", True), ("<CycloneDDS/>", False)])
def test_nothing_leaves_the_named_interface(config, silent):
    """In a network of its own, with a card that would carry what is announced by default."""
    alone = ["unshare", "-Urn", "sh", "-c", ALONE, "sh"]
    trial = subprocess.run([*alone, "true"], capture_output=True, text=True, check=False)
    if "card:" not in trial.stdout:
        pytest.skip(f"this system allows no network of one's own: {trial.stderr}")
    speak = [sys.executable, "-c", SPEAK, config, str(free_domain())]
    run = subprocess.run([*alone, *speak], stdout=subprocess.PIPE, text=True, check=True)
    assert (int(run.stdout.split()[SENT]) == 0) == silent
