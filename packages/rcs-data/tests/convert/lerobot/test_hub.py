"""Pushed datasets can be pulled again, whole or in part, from a server that answers as the Hugging Face Hub does."""

from __future__ import annotations

import base64
import hashlib
import json
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature
from rcs_data.convert.lerobot.export import export_lerobot
from rcs_data.convert.lerobot.hub import pull, push
from rcs_data.convert.lerobot.import_ import import_lerobot
from rcs_data.convert.options import ExportOptions, ImportOptions
from rcs_data.errors import DatasetError, InvalidSetup, MissingDependency

COMMIT = "0123456789abcdef0123456789abcdef01234567"


class Hub(ThreadingHTTPServer):
    """A stand-in of the Hub's HTTP interface: repositories with one branch."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Answers)
        self.repos: dict[str, dict[str, bytes]] = {}
        self.tags: dict[str, set[str]] = {}
        self.served: list[str] = []


class Answers(BaseHTTPRequestHandler):
    """The answers of the Hub to `snapshot_download`, `upload_folder` and tags."""

    protocol_version = "HTTP/1.1"
    server: Hub

    def log_message(self, *_: Any) -> None:
        """Print nothing."""

    def do_HEAD(self) -> None:
        self.do_GET()

    def do_GET(self) -> None:
        words = unquote(urlsplit(self.path).path).strip("/").split("/")
        repo = "/".join(words[2:4] if words[0] == "api" else words[1:3])
        if repo not in self.server.repos:
            self._answer(404, b"{}", {"X-Error-Code": "RepoNotFound"})
        elif words[0] == "api" and words[4:5] == ["refs"]:
            tags = [{"name": t, "ref": f"refs/tags/{t}", "targetCommit": COMMIT} for t in self.server.tags[repo]]
            self._json({"branches": [], "converts": [], "tags": tags})
        elif words[0] == "api" and words[4:5] == ["tree"]:
            rows = [
                {"type": "file", "path": path, "size": len(data), "oid": hashlib.sha1(data).hexdigest()}
                for path, data in self.server.repos[repo].items()
            ]
            self._json(rows)
        elif words[0] == "api":
            files = [{"rfilename": path} for path in self.server.repos[repo]]
            self._json({"_id": "1", "id": repo, "sha": COMMIT, "private": False, "tags": [], "siblings": files})
        else:
            path = "/".join(words[5:])
            data = self.server.repos[repo].get(path)
            if data is None:
                self._answer(404, b"", {"X-Error-Code": "EntryNotFound"})
                return
            if self.command == "GET":
                self.server.served.append(path)
            self._answer(200, data, {"ETag": f'"{hashlib.sha1(data).hexdigest()}"', "X-Repo-Commit": COMMIT})

    def do_POST(self) -> None:
        words = unquote(urlsplit(self.path).path).strip("/").split("/")
        sent = self._body()
        if words == ["api", "repos", "create"]:
            about = json.loads(sent)
            repo = "/".join(part for part in (about.get("organization"), about["name"]) if part)
            is_new = repo not in self.server.repos
            self.server.repos.setdefault(repo, {})
            self.server.tags.setdefault(repo, set())
            url = f"http://127.0.0.1:{self.server.server_port}/datasets/{repo}"
            self._json({"url": url, "name": repo, "id": "1"}, 200 if is_new else 409)
            return
        if words[1] != "datasets":
            self._json({})
            return
        repo = "/".join(words[2:4])
        match words[4]:
            case "preupload":
                files = json.loads(sent)["files"]
                known = self.server.repos[repo]
                told = [{"path": f["path"], "uploadMode": "regular", "shouldIgnore": False,
                         "oid": _blob(known[f["path"]]) if f["path"] in known else None} for f in files]  # fmt: skip
                self._json({"files": told})
            case "commit":
                for line in sent.split(b"\n"):
                    entry = json.loads(line) if line else {"key": ""}
                    if entry["key"] == "file":
                        assert entry["value"]["encoding"] == "base64"
                        data = base64.b64decode(entry["value"]["content"])
                        self.server.repos[repo][entry["value"]["path"]] = data
                    elif entry["key"] == "deletedFile":
                        del self.server.repos[repo][entry["value"]["path"]]
                self._json({"success": True, "commitUrl": f"{self._host}/datasets/{repo}/commit/{COMMIT}",
                            "commitOid": COMMIT})  # fmt: skip
            case "tag":
                self.server.tags[repo].add(json.loads(sent)["tag"])
                self._json({})
            case _:
                self._json({})

    def do_DELETE(self) -> None:
        words = unquote(urlsplit(self.path).path).strip("/").split("/")
        self.server.tags["/".join(words[2:4])].remove(words[5])
        self._json({})

    @property
    def _host(self) -> str:
        return f"http://127.0.0.1:{self.server.server_port}"

    def _body(self) -> bytes:
        if "chunked" not in self.headers.get("Transfer-Encoding", ""):
            return self.rfile.read(int(self.headers.get("Content-Length", 0)))
        parts: list[bytes] = []
        while size := int(self.rfile.readline(), 16):
            parts.append(self.rfile.read(size))
            self.rfile.readline()
        self.rfile.readline()
        return b"".join(parts)

    def _json(self, values: Any, code: int = 200) -> None:
        self._answer(code, json.dumps(values).encode(), {"Content-Type": "application/json"})

    def _answer(self, code: int, data: bytes, headers: dict[str, str]) -> None:
        self.send_response(code)
        for name, value in {**headers, "Content-Length": str(len(data))}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data)


def _blob(data: bytes) -> str:
    return hashlib.sha1(b"blob %d\0" % len(data) + data).hexdigest()


@pytest.fixture
def hub(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Hub]:
    constants = pytest.importorskip("huggingface_hub.constants")
    server = Hub()
    thread = threading.Thread(target=server.serve_forever, name="hub", daemon=True)
    thread.start()
    # It reads the environment when it is imported.
    address = f"http://127.0.0.1:{server.server_port}"
    monkeypatch.setenv("HF_ENDPOINT", address)
    monkeypatch.setattr(constants, "ENDPOINT", address)
    monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", address + "/{repo_id}/resolve/{revision}/{filename}")
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False, raising=False)
    monkeypatch.setenv("HF_TOKEN", "hf_of_the_test")
    monkeypatch.setenv("HF_HOME", str(tmp_path / "hf"))
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture
def source(tmp_path: Path) -> Dataset:
    features = (
        Feature(key="observation/joints", shape=(2,), dtype="float64"),
        Feature(key="observation/frames/side/rgb", shape=(32, 48, 3), dtype="uint8", encoding="jpeg"),
        Feature(key="observation/frames/left/wrist/rgb", shape=(32, 48, 3), dtype="uint8", encoding="jpeg"),
        Feature(key="action/joints", shape=(2,), dtype="float64"),
    )
    info = DatasetInfo(frequency=10, features=features, setup={"robot": "so101"}, instruction="wave")
    with DatasetWriter.open(tmp_path / "source", info) as writer:
        for name in ("a", "b", "c"):
            with writer.episode(name, seed=None) as episode:
                for row in range(4):
                    images = {f.key: np.full(f.shape, 40 * row, np.uint8) for f in features if f.is_image}
                    moved = {"action/joints": np.full(2, float(row))} if row else {}
                    episode.add({"observation/joints": np.full(2, float(row)), **images, **moved})
                episode.finish(True)
    return Dataset.open(tmp_path / "source")


@pytest.mark.extras
@pytest.mark.parametrize("version", ["3.0", "2.1"])
def test_a_push_is_pulled_whole(hub: Hub, source: Dataset, tmp_path: Path, version: Any) -> None:
    out = tmp_path / "export"
    export_lerobot(source, out, version=version)
    assert push(out, "me/wave").endswith("/datasets/me/wave")
    assert push(out, "me/wave")  # again: nothing new, and the tag moves
    assert hub.tags["me/wave"] == {f"v{version}"}
    assert b"tags: [LeRobot]" in hub.repos["me/wave"]["README.md"]
    root = pull("me/wave", tmp_path / "pulled")
    files = {str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*") if path.is_file()}
    assert {name: (root / name).read_bytes() for name in files} == files
    back = import_lerobot(root, tmp_path / "back")
    assert [episode.id for episode in back.episodes] == ["a", "b", "c"]


@pytest.mark.extras
def test_a_part_is_pulled_without_the_rest(hub: Hub, source: Dataset, tmp_path: Path) -> None:
    export_lerobot(source, tmp_path / "export", version="2.1")
    push(tmp_path / "export", "me/wave")
    root = pull("me/wave", tmp_path / "pulled", episodes=("1-2",), cameras=("left/wrist",))
    assert not [path for path in hub.served if "episode_000000" in path or "images.side" in path]
    options = ImportOptions(episodes=("1-2",), cameras=("left/wrist",))
    assert [e.id for e in import_lerobot(root, tmp_path / "back", options).episodes] == ["b", "c"]
    with pytest.raises(InvalidSetup, match=r"such as data/chunk-000/episode_000000\.parquet"):
        push(root, "me/wave")  # of the Hub's copy, it would leave this part
    hub.served.clear()
    pull("me/wave", tmp_path / "pulled")  # the rest
    assert {path for path in hub.served if path.endswith(".parquet")} == {"data/chunk-000/episode_000000.parquet"}
    with pytest.raises(InvalidSetup, match="names no episode"):
        pull("me/wave", tmp_path / "pulled", episodes=("9",))


@pytest.mark.extras
def test_a_push_replaces_the_dataset_and_nothing_else(hub: Hub, source: Dataset, tmp_path: Path) -> None:
    export_lerobot(source, tmp_path / "all", version="2.1")
    push(tmp_path / "all", "me/wave")
    hub.repos["me/wave"] |= {"README.md": b"A card of my own.", "notes/data.txt": b"words"}
    export_lerobot(source, tmp_path / "one", ExportOptions(episodes=("a",), cameras=("side",)), version="2.1")
    push(tmp_path / "one", "me/wave")
    files = {str(path.relative_to(tmp_path / "one")) for path in (tmp_path / "one").rglob("*") if path.is_file()}
    assert hub.repos["me/wave"].keys() == files | {"README.md", "notes/data.txt"}
    assert hub.repos["me/wave"]["README.md"] == b"A card of my own."


@pytest.mark.extras
def test_a_folder_takes_one_dataset(hub: Hub, source: Dataset, tmp_path: Path) -> None:
    export_lerobot(source, tmp_path / "export")
    push(tmp_path / "export", "me/wave")
    push(tmp_path / "export", "me/other")
    pull("me/wave", tmp_path / "pulled")
    with pytest.raises(DatasetError, match="of me/wave; choose another folder for me/other"):
        pull("me/other", tmp_path / "pulled")
    with pytest.raises(DatasetError, match="choose another folder"):
        pull("me/wave", tmp_path / "export")


@pytest.mark.extras
def test_what_the_hub_refuses_is_told(hub: Hub, source: Dataset, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="Cannot pull me/nothing"):
        pull("me/nothing", tmp_path / "pulled")
    hub.repos["me/text"] = {"README.md": b"words"}
    with pytest.raises(DatasetError, match=r"me/text has no meta/info\.json"):
        pull("me/text", tmp_path / "pulled")
    with pytest.raises(InvalidSetup, match="not a LeRobot dataset"):
        push(source.path, "me/wave")
    assert "me/wave" not in hub.repos


def test_without_the_package_the_extra_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(MissingDependency, match=r"rcs-data\[hub\]"):
        pull("me/wave", tmp_path / "pulled")
    with pytest.raises(MissingDependency, match=r"rcs-data\[hub\]"):
        push(tmp_path, "me/wave")
