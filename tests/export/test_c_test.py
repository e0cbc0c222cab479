"""What comes with the C files: the test program agrees, and would notice a change."""

import re
import subprocess

import numpy as np
import pytest

from sklearn_raacmm import CylindricalResidualTarget, RBFNetRegressor
from sklearn_raacmm.export import _load_c, export_c

from ._chains import COMPILERS, STRICT, needs_compiler, network, of_arm

# Chains are fitted without groups: what they learn is not the question here.
pytestmark = pytest.mark.filterwarnings("ignore:No groups were given")


@pytest.fixture(scope="module")
def models(data, chain):
    guarded = of_arm(data.arm, "kinematics", orders=2, fade=1.0)
    return {
        "chain": chain,
        "guarded": guarded.fit(data.data, data.target),
        "features": network().fit(data.data[:, :2], data.target[:, :2]),
    }


def run(command, folder):
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@needs_compiler
@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("dtype", ["double", "float"])
@pytest.mark.parametrize("which", ["chain", "guarded", "features"])
def test_the_test_program_agrees_with_predict(models, data, tmp_path, compiler, dtype, which):
    model = models[which]
    rows = data.data[:, : model.n_features_in_]
    export_c(model, tmp_path / "arm.c", dtype=dtype, poses=rows)
    text = (tmp_path / "arm_test.c").read_text()
    # The line in its comment, with every warning an error.
    command = re.search(r"cc (-std=c99 .*) && (\./arm_test)", text)
    done = run([compiler, *STRICT, *command[1].split()], tmp_path)
    assert done.returncode == 0, done.stderr
    printed = run([command[2]], tmp_path)
    n = 2 if which == "features" else 3
    assert re.match(
        rf"arm: 0 of {32 * n} numbers differ too much; the largest gap is .*e-", printed.stdout
    )
    assert printed.returncode == 0


@needs_compiler
def test_the_test_program_notices_another_model(chain, data, tmp_path):
    source, _ = export_c(chain, tmp_path / "arm.c", poses=data.data)
    text = source.read_text()
    weight = re.search(r"static const double rows_\d+\[1\]\[20\] = \{\n    \{([-0-9.e]+),", text)[1]
    source.write_text(text.replace(weight, str(1.001 * float(weight))))
    command = [COMPILERS[0], "-std=c99", "-o", "t", "arm_test.c", "arm.c", "-lm"]
    assert run(command, tmp_path).returncode == 0
    printed = run(["./t"], tmp_path)
    assert printed.returncode == 1
    assert re.search(r"row \d+, output 0: got .* expected", printed.stdout)


@needs_compiler
def test_a_source_that_does_not_keep_its_promise_is_refused(chain, tmp_path, monkeypatch):
    write = _load_c.sources

    def wrong(*args):
        source, header = write(*args)
        return re.sub(r"(rows_\d+\[\d\]\[20\] = \{\n    \{)", r"\g<1>1 + ", source), header

    monkeypatch.setattr(_load_c, "sources", wrong)
    with pytest.raises(ValueError, match=r"the C source is up to .* away from predict, .* of the"):
        export_c(chain, tmp_path / "arm.c")
    assert not list(tmp_path.iterdir())


@needs_compiler
def test_the_header_says_what_single_precision_costs(chain, data, tmp_path):
    paths = export_c(chain, tmp_path / "arm.c", dtype="float", poses=data.data)
    for path in paths:
        found = re.search(
            r"single precision, at 28 rows: within (\S+) mm of predict, (\S+) of the\s+"
            r"(?:\*\s+)?largest;\s+(?:\*\s+)?the\s+(?:\*\s+)?point\s+(?:\*\s+)?within (\S+) mm",
            path.read_text(),
        )
        correction, share, point = map(float, found.groups())
        assert 1e-9 < correction < 1e-4
        assert 1e-7 < share < 1e-2
        assert 1e-5 < point < 3e-3  # a metre has 7 digits


def test_one_row_is_its_own_corner(chain, data, tmp_path):
    export_c(chain, tmp_path / "arm.c", poses=data.data[:1])
    assert (tmp_path / "arm_test.c").exists()


def test_rows_that_predict_refuses_prove_nothing(tmp_path):
    rng = np.random.default_rng(0)
    turns = rng.uniform(-3, 3, 50)
    X = np.column_stack([rng.normal(size=(50, 2)), np.cos(turns), np.sin(turns)])
    model = CylindricalResidualTarget(RBFNetRegressor(5)).fit(X, rng.normal(size=(50, 3)))
    with pytest.raises(ValueError, match=r"predict refuses all of 32 rows, .* give poses"):
        export_c(model, tmp_path / "arm.c", poses=2 * X)  # directions that are none
    assert not list(tmp_path.iterdir())
