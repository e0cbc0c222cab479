"""Open data are fetched whole or not at all, and are what an independent reader makes of them."""

import functools
import hashlib
import threading
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_raacmm import calibrate
from sklearn_raacmm.datasets import _fetchers, fetch_panda_ball_socket, fetch_ur10_tracker

MOVED = "moved-position"
CONTENT = b"0.1,0.2\n0.3,0.4\n" * 100


class Handler(SimpleHTTPRequestHandler):
    """Serves a folder; `faults` of the server are what it sends instead at first."""

    def do_GET(self):
        self.server.requests += 1
        if not self.server.faults:
            return super().do_GET()
        content, n_sent = self.server.faults.pop(0)
        self.send_response(200)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content[:n_sent])

    def log_message(self, *args):
        pass


@pytest.fixture
def serve(monkeypatch):
    """Return ``serve(folder, *faults)``: a running server and its address."""
    monkeypatch.setenv("no_proxy", "127.0.0.1")  # a proxy would ask its own machine
    servers = []

    def start(folder, *faults):
        server = ThreadingHTTPServer(
            ("127.0.0.1", 0), functools.partial(Handler, directory=str(folder))
        )
        server.faults, server.requests = list(faults), 0
        threading.Thread(target=server.serve_forever, daemon=True).start()
        servers.append(server)
        return server, f"http://127.0.0.1:{server.server_port}"

    yield start
    for server in servers:
        server.shutdown()
        server.server_close()


@pytest.fixture
def published(tmp_path, monkeypatch):
    monkeypatch.setitem(_fetchers.SHA256, "table.csv", hashlib.sha256(CONTENT).hexdigest())
    folder = tmp_path / "published"
    folder.mkdir()
    (folder / "table.csv").write_bytes(CONTENT)
    return folder


def cached(home, url, download_if_missing=True, n_retries=0):
    options = {"download_if_missing": download_if_missing, "n_retries": n_retries, "delay": 0}
    return _fetchers.cached_file("table.csv", home, url, **options)


def files(folder):
    return sorted(p.name for p in folder.rglob("*") if p.is_file())


def test_a_file_is_downloaded_once(serve, published, tmp_path):
    server, url = serve(published)
    home = tmp_path / "home" / "deep"
    for _ in range(2):
        assert cached(home, url).read_bytes() == CONTENT
    assert server.requests == 1
    assert files(tmp_path / "home") == ["table.csv"]


@pytest.mark.parametrize(
    ("faults", "message"),
    [
        ([(CONTENT[:70], 70)], "SHA256 checksum of table.csv .* differs from expected"),
        ([(CONTENT.replace(b"0.3", b"0.8", 1), 1600)], "checksum of table.csv .* differs"),
        ([(CONTENT, 70)] * 2, "retrieval incomplete: got only 70 out of 1600 bytes"),
    ],
    ids=["cut short", "tampered", "cut in transfer"],
)
@pytest.mark.parametrize("there", [None, b"an older version"])
@pytest.mark.filterwarnings("ignore:Retry downloading", "ignore:.*re-downloading from")
def test_a_bad_download_changes_nothing(serve, published, tmp_path, faults, message, there):
    home = tmp_path / "home"
    server, url = serve(published, *faults)
    if there is not None:
        home.mkdir()
        (home / "table.csv").write_bytes(there)
    with pytest.raises(OSError, match=f"^{url}/table.csv cannot be downloaded: .*{message}"):
        cached(home, url, n_retries=len(faults) - 1)
    assert server.requests == len(faults)
    assert files(home) == ([] if there is None else ["table.csv"])
    assert there is None or (home / "table.csv").read_bytes() == there


def test_a_damaged_file_is_replaced_by_a_whole_one(serve, published, tmp_path):
    _, url = serve(published)
    (tmp_path / "table.csv").write_bytes(CONTENT[:70])
    with pytest.raises(OSError, match="cut short or changed, and download_if_missing=False"):
        cached(tmp_path, url, download_if_missing=False)
    with pytest.warns(UserWarning, match="re-downloading from"):
        assert cached(tmp_path, url).read_bytes() == CONTENT


def test_a_file_in_place_of_the_folder(tmp_path):
    (tmp_path / "home").write_text("a file")
    with pytest.raises(NotADirectoryError, match="home' is a file; a folder is needed"):
        fetch_ur10_tracker(data_home=tmp_path / "home")


@pytest.mark.parametrize("fetch", [fetch_panda_ball_socket, fetch_ur10_tracker])
def test_bad_arguments_are_named(fetch, tmp_path):
    with pytest.raises(OSError, match="is not there, and download_if_missing=False"):
        fetch(data_home=tmp_path, download_if_missing=False)


@pytest.mark.filterwarnings("ignore:The fixed point seems to have moved")  # of panda_2
@pytest.mark.parametrize("arm", ["panda_2", "panda_3"])
def test_panda(serve, tmp_path, data_folder, panda, arm, monkeypatch):
    server, url = serve(data_folder("panda_ball_socket"))
    monkeypatch.setattr(_fetchers, "PANDA_URL", url + "/")
    test = fetch_panda_ball_socket(arm, data_home=tmp_path)
    n_files = server.requests
    expected = panda(arm)
    order = np.lexsort(expected.angles.T), np.lexsort(test.data.T)
    assert_array_equal(test.data[order[1]], expected.angles[order[0]])
    assert (test.groups[order[1]] == expected.groups[order[0]]).all()
    assert (test.placements[order[1]] == expected.placements[order[0]]).all()
    assert n_files == 2 * len(set(test.placements))
    # Within a socket residuals have no mean but for slips, and calibration left little of them.
    means = [np.abs(test.target[test.groups == g].mean(axis=0)).max() for g in set(test.groups)]
    assert np.median(means) < 1e-9
    assert np.linalg.norm(test.target, axis=1).mean() < 0.4
    result = calibrate(test.nominal_arm, test.data, test.groups, lengths=test.lengths, accept=MOVED)
    assert_allclose(result.arm.forward(test.data), test.points)
    assert "MIT" in test.DESCR
    assert "2503.12584" in test.DESCR

    # From the folder alone the second time.
    again = fetch_panda_ball_socket(arm, data_home=tmp_path, download_if_missing=False)
    assert server.requests == n_files
    assert_array_equal(again.target, test.target)


def test_ur10(serve, tmp_path, data_folder, ur10, monkeypatch):
    server, url = serve(data_folder("ur10_tracker"))
    monkeypatch.setattr(_fetchers, "UR10_URL", url)
    test = fetch_ur10_tracker(data_home=tmp_path)
    assert server.requests == 1
    assert_array_equal(test.data, ur10.angles)
    assert_array_equal(test.tracker_points, ur10.points)
    assert_array_equal(test.groups, ur10.groups)
    assert_array_equal(test.temperature, ur10.temperature)
    assert test.directions.shape == test.data.shape
    assert test.time[0] == np.datetime64("2020-07-14T16:39:04")
    assert np.count_nonzero(np.diff(test.time) < np.timedelta64(0, "s")) == 9
    for row in (1, 5000, 11000):  # rows that were measured one after the other
        turned = np.angle(np.exp(1j * (ur10.angles[row] - ur10.angles[row - 1])))
        assert_array_equal(test.directions[row], np.sign(turned))
    # The true points, points - target, are the tracker's moved as a rigid body.
    some = np.arange(0, len(test.data), 500)
    true = (test.points - test.target)[some]
    seen = test.tracker_points[some]
    assert_allclose(
        np.linalg.norm(true[:, None] - true, axis=2),
        np.linalg.norm(seen[:, None] - seen, axis=2),
        atol=1e-8,
    )
    assert np.linalg.norm(test.target, axis=1).mean() < 0.41
