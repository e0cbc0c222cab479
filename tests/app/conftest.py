"""A measuring arm of another make, which shares nothing with the package; a reader of pages.

Seven joints (2-2-3). Its encoders are eccentric, its upper arm sags, and its lengths are not those
of the drawing. Poses at a cone are found by Gauss-Newton from random starts.
"""

from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

DRAWING = {"shoulder": 300.0, "upper": 420.0, "fore": 380.0, "probe": 120.0}


class OtherMake:
    """The arm: true points from what its encoders read."""

    def __init__(self, seed, error=1.0):
        rng = np.random.default_rng(seed)
        self.rng = rng
        self.lengths = {k: v + rng.normal(scale=0.3) for k, v in DRAWING.items()}
        arcsec = np.pi / 180 / 3600
        self.amplitude = error * arcsec * rng.uniform(8, 20, 7)
        self.phase = rng.uniform(0, 2 * np.pi, 7)
        self.sag = error * 15 * arcsec

    def points(self, readings):
        """True points (n, 3) for encoder readings (n, 7) in rad."""
        q = readings + self.amplitude * np.cos(readings - self.phase)
        q = np.array(q)
        q[:, 1] += self.sag * np.cos(readings[:, 1])
        place = np.zeros((len(q), 3))
        turn = np.tile(np.eye(3), (len(q), 1, 1))
        for axis, angle, along in (
            ("z", q[:, 0], 0.0), ("y", q[:, 1], self.lengths["upper"]), ("x", q[:, 2], 0.0),
            ("y", q[:, 3], self.lengths["fore"]), ("x", q[:, 4], 0.0),
            ("y", q[:, 5], self.lengths["probe"]), ("x", q[:, 6], 0.0),
        ):  # fmt: skip
            turn = turn @ Rotation.from_euler(axis, angle[:, None]).as_matrix()
            place = place + along * turn[:, :, 0]
        place[:, 2] += self.lengths["shoulder"]
        return place

    def cone(self, place, n):
        """Readings (n, 7) of poses whose probe is in the cone, but for 5 micrometres of seating."""
        found = []
        while len(found) < n:
            q = self.rng.uniform(-1, 1, 7) * [3, 1, 2.5, 1, 2.5, 1.2, 3]
            q[3] = 0.9 + 0.5 * q[3]
            target = place + self.rng.normal(scale=0.005, size=3)
            for _ in range(40):
                steps = q + np.r_[np.zeros((1, 7)), 1e-6 * np.eye(7)]
                p = self.points(steps)
                jac = (p[1:] - p[0]).T / 1e-6
                step = np.linalg.lstsq(jac[:, :6], target - p[0], rcond=None)[0]
                q[:6] += step * 0.5 / max(0.5, np.abs(step).max())
                if np.abs(step).max() < 1e-10:
                    break
            if np.abs(step).max() < 1e-8 and np.all(np.abs(q) < np.pi):
                found.append(q)
        return np.array(found)

    def test(self, n_cones, n_poses):
        """Readings and cone number of a single-point test."""
        readings, cones, self.places = [], [], []
        for i in range(n_cones):
            azimuth, radius = 2.4 * i, 350 + 350 * (i + 0.5) / n_cones
            place = [radius * np.cos(azimuth), radius * np.sin(azimuth), 100 + 60 * (i % 5)]
            self.places.append(np.array(place))
            readings.append(self.cone(self.places[-1], n_poses))
            cones += [i] * n_poses
        return np.concatenate(readings), np.array(cones)


def write_log(path, readings, cones):
    """Degrees, decimal commas, cp1252 and two lines above the header, as its logger writes."""
    lines = ["Meßgerät;Gelenkarm Größe 7", "Datum;21.11.2026;Prüfer;Jürgen"]
    lines.append("Zeit;Kegel;" + ";".join(f"A{i} [°]" for i in range(1, 8)))
    for k, (row, cone) in enumerate(zip(np.rad2deg(readings), cones, strict=True)):
        cells = ";".join(f"{v:.5f}".replace(".", ",") for v in row)
        lines.append(f"13:{k // 60 % 60:02d}:{k % 60:02d};Kegel Süd {cone + 1};{cells}")
    path.write_bytes("\r\n".join([*lines, ""]).encode("cp1252"))


@pytest.fixture(scope="module")
def other_make():
    """What stands here."""
    return SimpleNamespace(OtherMake=OtherMake, DRAWING=DRAWING, write_log=write_log)


class Page(HTMLParser):
    """What is in a page: text outside figures and style, rows of tables, links, names, blanks."""

    def __init__(self, text):
        super().__init__()
        self.open, self.text, self.rows, self.links, self.ids, self.blanks = [], [], [], [], [], 0
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.links += [attrs[k] for k in ("src", "href", "xlink:href") if k in attrs]
        self.ids += [attrs["id"]] if "id" in attrs else []
        self.blanks += attrs.get("class") == "blank"
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
        if tag not in ("meta", "br", "link"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if {"td", "th"} & set(self.open):
            self.rows[-1][-1] += data
        if not {"svg", "style"} & set(self.open):
            self.text.append(data)


@pytest.fixture(scope="session")
def read_page():
    """What parses a page."""
    return Page
