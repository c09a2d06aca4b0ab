"""The options `--policy` and `--adapter`, of every command that has them."""

from pathlib import Path

import pytest

from renet.errors import RenetError
from renet.evaluation.adapters.evaluator import ADAPTERS
from renet.evaluation.adapters.options import PolicyOptions
from renet.evaluation.play import PlayCfg

FILE = Path("mine.onnx")


@pytest.mark.parametrize(
    ("options", "bundle", "message"),
    [
        (PolicyOptions(policy=FILE), None, "give --policy FILE and --adapter together"),
        (PolicyOptions(adapter="himloco"), None, "give --policy FILE and --adapter together"),
        (PolicyOptions(policy=FILE, adapter="himloco"), Path("b"), "give --policy or --bundle"),
    ],
)
def test_half_a_policy_and_two_policies_are_refused(options, bundle, message):
    with pytest.raises(RenetError, match=message):
        options.check_policy(bundle)


def test_a_bundle_alone_and_a_whole_policy_are_taken():
    PolicyOptions().check_policy(Path("b"))
    PolicyOptions(policy=FILE, adapter="himloco").check_policy(None)


def test_without_a_policy_none_is_opened():
    assert PolicyOptions().open_policy("auto") is None


def test_help_names_every_adapter(capsys):
    from renet.cli import parse

    with pytest.raises(SystemExit):
        parse(PlayCfg, ["--help"], "renet play")
    words = capsys.readouterr().out
    assert all(name in words for name in ADAPTERS)
