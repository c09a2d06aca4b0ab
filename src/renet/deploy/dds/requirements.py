"""What DDS needs of this computer: Cyclone DDS, and a network card."""

import socket
from importlib.util import find_spec

from renet.errors import RenetError, install


def demand_dds(user: str) -> None:
    """Raise RenetError, which names the `user` of Cyclone DDS, unless it is installed."""
    if find_spec("cyclonedds") is None:
        raise RenetError(
            f"{user} needs Cyclone DDS: {install('go2')} (docs/deploy.md says what to do on ARM)"
        )


def network_cards() -> list[str]:
    """Names of this computer's network cards, such as lo and eth0."""
    return [name for _, name in socket.if_nameindex()]


def demand_card(name: str) -> None:
    """Raise RenetError, which lists the cards, unless this computer has one of this name."""
    cards = network_cards()
    if name not in cards:
        raise RenetError(f"no network interface {name!r} here, only {', '.join(cards)}")
