"""The Hugging Face Hub, played by a folder: what is loaded and pushed, and what refuses."""

import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import pytest

import renet
from renet.bundle import Bundle, find_bundle, hub, pretrained
from renet.bundle.push import PushCfg, push
from renet.errors import RenetError

NAME = "somebody/my-robot"


@dataclass
class CommitOperationAdd:
    path_in_repo: str
    path_or_fileobj: str | bytes


class FakeHub(ModuleType):
    """huggingface_hub with repositories in a folder; a revision is a folder of its own."""

    CommitOperationAdd = CommitOperationAdd

    def __init__(self, root: Path) -> None:
        super().__init__("huggingface_hub")
        self.root, self.online, self.private = root, True, None
        self.HfApi = lambda: self

    def snapshot_download(self, repository, *, revision, local_dir, allow_patterns):
        source = self.root / revision / repository
        if not self.online and local_dir.exists():
            return str(local_dir)
        if not source.is_dir():
            raise OSError(f"404 Client Error: {repository} not found.\n\nMore words.")
        local_dir.mkdir(parents=True, exist_ok=True)
        (local_dir / ".cache").mkdir(exist_ok=True)  # As the library leaves it.
        for file in source.iterdir():
            if file.name in allow_patterns:
                shutil.copy(file, local_dir)
        return str(local_dir)

    def create_repo(self, repository, *, private, exist_ok):
        self.private = private
        (self.root / "main" / repository).mkdir(parents=True, exist_ok=exist_ok)

    def create_commit(self, repository, operations, *, commit_message, revision):
        if not self.online:
            raise OSError("403 Forbidden")
        for operation in operations:
            data = operation.path_or_fileobj
            data = data if isinstance(data, bytes) else Path(data).read_bytes()
            (self.root / (revision or "main") / repository / operation.path_in_repo).write_bytes(
                data
            )


@pytest.fixture
def server(tmp_path, monkeypatch) -> FakeHub:
    fake = FakeHub(tmp_path / "server")
    monkeypatch.setitem(sys.modules, "huggingface_hub", fake)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return fake


def test_what_is_pushed_is_what_is_loaded(server):
    said = push(PushCfg(Path("go2-parkour"), NAME, private=True))
    assert said == f"Pushed go2-parkour: renet deploy hf://{NAME} runs it"
    assert server.private is True
    shipped = Bundle.load("go2-parkour")
    # A command line makes a Path of it.
    for name in (f"hf://{NAME}", Path(f"hf://{NAME}")):
        loaded = Bundle.load(name)
        assert (loaded.name, loaded.sha256) == ("my-robot", shipped.sha256)
    assert renet.load(f"hf://{NAME}").num_robots == 1
    card = (server.root / "main" / NAME / "README.md").read_text()
    assert card.startswith("---\n")
    assert "# go2-parkour" in card


def test_files_of_others_are_neither_loaded_nor_pushed(server, tmp_path):
    mine = tmp_path / "mine"
    shutil.copytree(pretrained("go1-parkour"), mine)
    (mine / "manifest.previous.json").write_text("{}")
    (mine / "README.md").write_text("---\n---\nmine")
    push(PushCfg(mine, NAME))
    pushed = server.root / "main" / NAME
    assert (pushed / "README.md").read_text() == "---\n---\nmine"
    assert not (pushed / "manifest.previous.json").exists()
    (pushed / "malware.py").write_text("")
    folder = find_bundle(f"hf://{NAME}")
    assert {path.name for path in folder.iterdir()} <= {
        *("manifest.json", "actor.onnx", "vision.onnx", "estimator.onnx"),
        *("README.md", "LICENSE", ".cache"),
    }


def test_a_revision_has_a_folder_of_its_own_and_outlasts_the_network(server):
    push(PushCfg(Path("go1-parkour"), NAME))
    shutil.move(server.root / "main", server.root / "v1")
    first = find_bundle(f"hf://{NAME}@v1")
    server.online = False
    assert find_bundle(f"hf://{NAME}@v1") == first
    assert first.name == "my-robot"


@pytest.mark.parametrize(
    "name", ["hf://", "hf://robot", "hf://a/b/c", "hf://../x", "hf://a/..", "hf://a/b@../../x"]
)
def test_other_names_are_refused(server, name):
    with pytest.raises(RenetError, match="write hf://owner/name"):
        find_bundle(name)


def test_refusals_name_the_way_out(server, tmp_path, monkeypatch):
    with pytest.raises(RenetError, match=r"404 .* not found; is the name right") as told:
        find_bundle(f"hf://{NAME}")
    assert "\n" not in str(told.value)
    server.online = False
    with pytest.raises(RenetError, match="403 Forbidden; `hf auth login`"):
        push(PushCfg(Path("go1-parkour"), NAME))
    with pytest.raises(RenetError, match="write owner/name"):
        push(PushCfg(Path("go1-parkour"), "robot"))
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(RenetError, match=r"need huggingface_hub: .*\[hub\]"):
        hub.library()
