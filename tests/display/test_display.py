"""What the displays draw is what the measures say, on the axes they were given."""

import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sklearn.linear_model import LinearRegression

from sklearn_raacmm import Arm, ArmResidualRegressor
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.display import HarmonicDisplay, RepeatabilityDisplay
from sklearn_raacmm.metrics import repeatability_interval

matplotlib = pytest.importorskip("matplotlib")
draw_repeatability = RepeatabilityDisplay.from_predictions


@pytest.fixture(autouse=True)
def plt():
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    yield plt
    plt.close("all")


@pytest.fixture(scope="module")
def cone():
    return make_single_point(3, 8)


@pytest.fixture(scope="module")
def model(cone):
    return LinearRegression().fit(cone.data, cone.target)


def two_s(points):
    """2S by its definition, for one position."""
    delta = np.linalg.norm(points - points.mean(axis=0), axis=1)
    return 2 * np.sqrt(np.sum(delta**2) / (len(points) - 1))


def drawn(ax, unit="mm"):
    """Ordinates of the lines of an axes by the name in the legend, mm."""
    factor = {"mm": 1.0, "µm": 1e-3}[unit]
    return {
        line.get_label().split(":")[0]: factor * np.asarray(line.get_ydata())
        for line in ax.get_lines()
    }


def test_repeatability_draws_2s_of_every_position(cone, model):
    display = RepeatabilityDisplay.from_estimator(
        model, cone.data, cone.points, groups=cone.groups, name="linear",
        perfect=cone.simulation.perfect_correction,
    )  # fmt: skip
    lines = drawn(display.ax_, display.unit_)
    size = np.mean([display.before, display.after])
    assert display.unit_ == ("µm" if size < 0.1 else "mm")
    after = cone.points - model.predict(cone.data)
    for name, points in {
        "before": cone.points,
        "linear": after,
        "noise floor": cone.points - cone.simulation.perfect_correction,
    }.items():
        expected = [two_s(points[cone.groups == g]) for g in range(3)]
        assert_allclose(lines[name], expected, rtol=1e-9)
    assert display.figure_ is display.ax_.figure
    assert display.ax_.get_ylim()[0] == 0
    # Residuals lie about zero as points about their mean.
    again = draw_repeatability(cone.target, model.predict(cone.data), groups=cone.groups)
    assert_allclose(again.after, display.after, rtol=1e-6)
    assert again.floor is None
    assert list(drawn(again.ax_)) == ["before", "after"]
    # Places have no order: no line joins them.
    assert all(line.get_linestyle() == "None" for line in again.ax_.get_lines())


def test_repeatability_has_intervals(cone):
    settings = {"groups": cone.groups, "statistic": "mean"}
    display = draw_repeatability(cone.points, cone.target, **settings)
    expected = repeatability_interval(cone.points, cone.groups, statistic="mean", aggregate=None)
    assert_allclose(display.before_interval, expected)
    factor = {"mm": 1, "µm": 1000}[display.unit_]
    for lines, shown in zip(
        display.ax_.collections, (display.before_interval, display.after_interval), strict=True
    ):
        drawn = [line[:, 1] for line in lines.get_segments()]
        assert_allclose(drawn, factor * shown)
    without = draw_repeatability(cone.points, cone.target, interval=None, **settings)
    assert without.before_interval is None
    largest = draw_repeatability(cone.points, cone.target, groups=cone.groups, statistic="max")
    assert largest.before_interval is None
    assert len(without.ax_.collections) == 0


def test_given_axes_are_used(plt, cone, model):
    _, axes = plt.subplots(1, 2)
    correction = model.predict(cone.data)
    one = draw_repeatability(cone.points, correction, groups=cone.groups, ax=axes[0])
    assert one.ax_ is axes[0]
    assert len(plt.get_fignums()) == 1
    with pytest.raises(ValueError, match="2 axes were given, but 1 are needed"):
        one.plot(axes)
    assert one.plot().ax_ is not axes[0]  # drawn again


def test_one_unit_in_a_figure():
    """Micrometres where the mean is below a tenth of a millimetre."""
    values = {"before": np.array([0.08, 0.05]), "after": np.array([0.02, 0.01])}
    small = RepeatabilityDisplay(**values).plot()
    assert small.ax_.get_ylabel() == "repeatability, 2S (µm)"
    assert small.ax_.get_legend().get_texts()[0].get_text() == "before: 65.0 µm"
    assert_allclose(small.ax_.get_lines()[1].get_ydata(), [20, 10])
    large = RepeatabilityDisplay(**values | {"before": np.array([0.5, 0.05])}).plot()
    assert large.ax_.get_legend().get_texts()[1].get_text() == "after: 0.015 mm"
    large.figure_.canvas.draw()


def test_a_perfect_arm_is_drawn_without_warnings():
    points = np.repeat([[500.0, 0, 0], [800.0, 0, 0]], 3, axis=0)
    labels = np.repeat(["$x^{1", "$x^{2"], 3)  # no formulae
    display = draw_repeatability(points, 0 * points, groups=labels)
    display.figure_.canvas.draw()
    assert display.before.tolist() == [0.0, 0.0]


def test_matplotlib_is_imported_when_something_is_drawn():
    program = (
        "import sys, numpy as np\n"
        "from sklearn_raacmm.display import RepeatabilityDisplay\n"
        "assert 'matplotlib' not in sys.modules\n"
        "sys.modules['matplotlib'] = sys.modules['matplotlib.pyplot'] = None\n"
        "display = RepeatabilityDisplay(before=np.ones(2), after=np.ones(2))\n"
        "try:\n"
        "    display.plot()\n"
        "except ImportError as error:\n"
        "    print(error)\n"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert run.stdout.strip() == "Displays need matplotlib: pip install matplotlib.", run.stderr


def test_harmonics_are_drawn_joint_by_joint():
    """Bars against a simulation of the coefficients' own distribution."""
    arm = Arm.from_name("aacmm6")
    rng = np.random.default_rng(0)
    theta = rng.uniform(-2, 2, (300, 6))
    error = np.zeros_like(theta)
    error[:, 1] = 6 * np.cos(theta[:, 1] - 0.5)
    error[:, 3] = 4 * np.sin(17 * theta[:, 3])
    y = np.einsum("nij,nj->ni", arm.jacobian(theta), error * np.pi / 180 / 3600)
    y += rng.normal(scale=0.003, size=y.shape)
    whole = ArmResidualRegressor(arm, causes=[]).fit(theta, y)
    display = HarmonicDisplay.from_estimator(whole)
    table = whole.harmonics_
    size = (len(table), 100_000)
    cos, sin = (
        rng.normal(table[f"{part}_arcsec"][:, None], table[f"{part}_sd_arcsec"][:, None], size)
        for part in ("cos", "sin")
    )
    assert_allclose(display.amplitude_sd, np.hypot(cos, sin).std(axis=1), rtol=0.02)
    phase = np.rad2deg(np.arctan2(sin, cos))
    phase = (phase - table["phase_deg"][:, None] + 180) % 360 - 180
    assert_allclose(display.phase_sd, phase.std(axis=1), rtol=0.02)
    drawn = [len(ax.containers) for ax in display.axes_[:, 0]]
    assert drawn == [0, 1, 0, 1, 0, 0]
    points = display.axes_[3, 1].containers[0].lines[0].get_xydata()
    fourth = table[table["joint"] == 4]
    assert_allclose(points, np.column_stack([fourth["order"], fourth["phase_deg"]]))
    heights = display.axes_[3, 2].containers[0].lines[0].get_xydata()[:, 1]
    assert_allclose(heights, fourth["log_bayes_factor"])
    assert display.n_joints == 6
    with pytest.raises(TypeError, match="got LinearRegression"):
        HarmonicDisplay.from_estimator(LinearRegression().fit(theta, y))


def test_gear_ratios_are_named_where_orders_are_multiples():
    """As a UR10 shows them; a lone high order names nothing."""
    found = [(1, 1, 9), (1, 128, 40), (2, 256, 30), (3, 128, 20), (4, 2, 50), (5, 99, 60)]
    found += [(6, 100, 8), (6, 200, 9), (2, 100, 5)]
    names = ["joint", "order", "amplitude_arcsec", "phase_deg", "log_bayes_factor"]
    names += [f"{part}_arcsec" for part in ("cos", "sin", "cos_sd", "sin_sd")]
    table = np.ones(len(found), dtype=[(name, float) for name in names])
    table["joint"], table["order"], table["log_bayes_factor"] = np.transpose(found)
    display = HarmonicDisplay(harmonics=table, n_joints=6).plot()
    assert display.gear_ratios.tolist() == [128, 128, 128, 0, 0, 100]
    labels = [ax.get_ylabel() for ax in display.axes_[:, 0]]
    assert labels[0] == "joint 1\ngear 128?"
    assert labels[4] == "joint 5"
