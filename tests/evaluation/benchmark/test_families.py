"""Families of faults, and the file that is not here."""

import hashlib

import numpy as np
import pytest

from renet.errors import RenetError
from renet.evaluation.benchmark import families
from renet.faults import FAULTS

SEALED = '''
from renet.faults.base import ImageFault

class Dimmed(ImageFault):
    """Half of every depth."""
    unit = "factor"
    levels = (0.9, 0.8, 0.7, 0.6, 0.5)
    def spoil(self, image, robot, elapsed):
        return self.level * image

FAMILIES = {"dim": (Dimmed,)}
'''


@pytest.fixture
def sealed(tmp_path, monkeypatch):
    path = tmp_path / "sealed.py"
    path.write_text(SEALED)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    monkeypatch.setattr(families, "SEALED_SHA256", digest)
    return path


def test_every_fault_of_a_family_exists():
    for family in (*families.LOUD.values(), *families.LIES.values()):
        assert {*family} <= {*FAULTS}


def test_no_fault_is_in_two_families():
    members = [name for of in (families.LOUD, families.LIES) for f in of.values() for name in f]
    assert len({*members}) == len(members)


def test_lasting_is_the_episodes_matter():
    assert families.level_at(FAULTS["unplugged"], 3) == float("inf")
    assert families.level_at(FAULTS["wrong_scale"], 5) == 1.6


def test_families_are_drawn_alike():
    rng = np.random.default_rng(0)
    two = {"large": ("gaussian", "blackout", "frozen"), "small": ("glass",)}
    drawn = [families.draw_fault(rng, two)[0] for _ in range(400)]
    assert 160 < drawn.count("small") < 240


def test_sealed_faults_come_from_their_file(sealed):
    found = families.SealedFaults(sealed)
    assert found.families == {"dim": ("dimmed",)}
    fault = families.fault_of("dimmed", found)
    assert fault(0.5, [np.random.default_rng(0)]).level == 0.5
    assert families.fault_of("frozen", found) is FAULTS["frozen"]


def test_another_file_is_refused(sealed):
    sealed.write_text(SEALED + "# Tuned.\n")
    with pytest.raises(RenetError, match="is not the file of sealed families") as error:
        families.SealedFaults(sealed)
    assert "\n" not in str(error.value)
