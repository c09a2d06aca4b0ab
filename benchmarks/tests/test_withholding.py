"""Rivals that withhold images, and those that hand over."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from baselines.withholding import Oracle, WithholdingSelector
from judges import Cfg
from renet.errors import RenetError
from renet.evaluation.benchmark.study import BenchmarkStudy
from renet.selector import SelectorInput


def seen(fresh=(True, True), has_image=(True, True)):
    return SelectorInput(np.zeros(2), fresh=np.array(fresh), has_image=np.array(has_image, bool))


@pytest.fixture
def oracle():
    """Knows that the second camera fails from the third tick on."""
    judge = Oracle(2)
    at_work = lambda step: np.array([False, step >= 10])  # noqa: E731
    judge.rollout = SimpleNamespace(injector=SimpleNamespace(at_work=at_work))
    return judge


def test_an_oracle_hands_over_while_a_camera_fails(oracle):
    answers = []
    for _ in range(3):
        oracle.look(seen())
        answers.append(oracle.update(seen(), 0.0).tolist())
    assert answers == [[True, True], [True, True], [True, False]]


def test_withholding_keeps_vision_in_charge(oracle):
    selector = WithholdingSelector(oracle, 2, longest_memory=1.0)
    for _ in range(3):
        gate = selector.look(seen())
    assert gate.acceptable.tolist() == [True, False]
    assert selector.update(seen(has_image=(True, False)), 0.0).all()


def test_memory_ends(oracle):
    selector = WithholdingSelector(oracle, 2, longest_memory=0.02)
    selector.look(seen())
    answers = [selector.update(seen(has_image=(True, False)), 0.0)[1] for _ in range(5)]
    assert answers == [True, True, True, True, False]
    selector.reset(np.array([False, True]))
    assert selector.update(seen(has_image=(True, False)), 0.0).all()


def test_images_that_did_not_come_cannot_be_used(oracle):
    selector = WithholdingSelector(oracle, 2, longest_memory=1.0)
    assert selector.look(seen(fresh=(False, True))).acceptable.tolist() == [False, True]


def test_vb_com_can_only_hand_over():
    with pytest.raises(RenetError, match="can only hand over"):
        Cfg("return", BenchmarkStudy(), withholds=True)


def test_each_judge_has_a_folder_of_its_own():
    assert Cfg("oracle", BenchmarkStudy(), withholds=True).study.out.name == "oracle_withholds"


@pytest.mark.parametrize(
    ("bundle", "method"), [(None, "go1-parkour"), (Path("go2-parkour"), "go2-parkour")]
)
def test_a_judges_result_is_named_after_the_bundle_that_walks(bundle, method):
    assert Cfg("oracle", BenchmarkStudy(bundle=bundle)).study.method == method


@pytest.mark.parametrize(
    ("study", "message"),
    [
        ({"policy": Path("himloco.pt"), "adapter": "himloco"}, "give --study.bundle"),
        ({"verify": Path("result.json")}, "leave out --study.verify"),
        ({"jobs": 2}, "leave out --study.jobs"),
    ],
)
def test_settings_that_no_judge_obeys_are_refused_before_it_is_trained(study, message):
    with pytest.raises(RenetError, match=message):
        Cfg("gate", BenchmarkStudy(**study))
