"""A small Hugging Face Hub in a folder, for tests: what its client asks to upload and download."""

from __future__ import annotations

import base64
import hashlib
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

TOKEN = "hf_test"


class Repository(dict[str, bytes]):
    """Files by path."""

    private = False

    @property
    def sha(self) -> str:
        """Stands for the commit."""
        content = b"".join(name.encode() + data for name, data in sorted(self.items()))
        return hashlib.sha1(content).hexdigest()


class _Handler(BaseHTTPRequestHandler):
    repositories: dict[str, Repository]
    protocol_version = "HTTP/1.1"

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing."""

    def _answer(self, status: int, content: Any = b"", **headers: str) -> None:
        body = content if isinstance(content, bytes) else json.dumps(content).encode()
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name.replace("_", "-"), value)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def _missing(self, code: str) -> None:
        self._answer(404, {"error": code}, X_Error_Code=code)

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        if self.path == "/api/validate-yaml":
            return self._answer(200, {"errors": [], "warnings": []})
        if self.headers.get("Authorization") != f"Bearer {TOKEN}":
            return self._answer(401, {"error": "no token"})
        parts = self.path.strip("/").split("/")
        if self.path == "/api/repos/create":
            asked = json.loads(body)
            name = "/".join(filter(None, (asked.get("organization") or "me", asked["name"])))
            self.repositories.setdefault(name, Repository())
            return self._answer(200, {"url": f"http://{self.headers['Host']}/{name}"})
        name, job = "/".join(parts[2:4]), parts[4]
        if name not in self.repositories:
            return self._missing("RepoNotFound")
        if job == "preupload":
            files = [
                {"path": f["path"], "uploadMode": "regular", "shouldIgnore": False}
                for f in json.loads(body)["files"]
            ]
            return self._answer(200, {"files": files})
        for line in body.splitlines():
            entry = json.loads(line)
            if entry["key"] == "file":
                value = entry["value"]
                self.repositories[name][value["path"]] = base64.b64decode(value["content"])
            elif entry["key"] == "deletedFile":
                self.repositories[name].pop(entry["value"]["path"], None)
        oid = self.repositories[name].sha
        url = f"http://{self.headers['Host']}/{name}/commit/{oid}"
        return self._answer(200, {"commitUrl": url, "commitOid": oid, "success": True})

    def do_GET(self) -> None:
        path = self.path.partition("?")[0].strip("/").split("/")
        api = path[:2] == ["api", "models"]
        name = "/".join(path[2:4] if api else path[:2])
        repository = self.repositories.get(name)
        if repository is None:
            return self._missing("RepoNotFound")
        if not api:
            data = repository.get("/".join(path[4:]))
            if data is None:
                return self._missing("EntryNotFound")
            tag = hashlib.sha1(data).hexdigest()
            return self._answer(200, data, X_Repo_Commit=repository.sha, ETag=f'"{tag}"')
        if "revision" in path and path[-1] not in ("main", repository.sha):
            return self._missing("RevisionNotFound")
        if "tree" in path:
            tree = [
                {"type": "file", "path": p, "size": len(d), "oid": hashlib.sha1(d).hexdigest()}
                for p, d in repository.items()
            ]
            return self._answer(200, tree)
        siblings = [{"rfilename": file} for file in repository]
        return self._answer(
            200,
            {"id": name, "modelId": name, "sha": repository.sha, "siblings": siblings,
             "private": False, "tags": [], "downloads": 0, "likes": 0},
        )  # fmt: skip

    do_HEAD = do_GET


@contextmanager
def hub_server() -> Iterator[tuple[str, dict[str, Repository]]]:
    """Address of a running server, and its repositories by name."""
    repositories: dict[str, Repository] = {}
    handler = type("Handler", (_Handler,), {"repositories": repositories})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", repositories
    finally:
        server.shutdown()
        server.server_close()


__all__ = ["TOKEN", "hub_server"]
