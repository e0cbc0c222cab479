"""What is written: the old or the new whole, never an input, and refused before the work."""

import io
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sklearn_raacmm import Arm, Correction
from sklearn_raacmm.app import main
from sklearn_raacmm.app._correct import open_beside
from sklearn_raacmm.correction._files import read_folder, write_folder
from sklearn_raacmm.utils import check_places

skops_io = pytest.importorskip("skops.io")


def test_a_folder_put_together_by_hand_is_refused(tmp_path):
    for name in ("one", "two"):
        write_folder(tmp_path / name, {"x": name}, {"arm.json": name, "model.skops": b"m"})
    shutil.copy(tmp_path / "two" / "arm.json", tmp_path / "one" / "arm.json")
    with pytest.raises(ValueError, match=r"arm\.json is not the one that correction\.json was wri"):
        read_folder(tmp_path / "one", ["arm.json"])
    facts, contents = read_folder(tmp_path / "two", ["arm.json", "model.skops"])
    assert (facts["x"], contents) == ("two", [b"two", b"m"])
    (tmp_path / "two" / "model.skops").unlink()
    with pytest.raises(ValueError, match=r"model\.skops is missing"):
        read_folder(tmp_path / "two", ["model.skops"])
    with pytest.raises(FileNotFoundError, match=r"was written without model\.joblib"):
        read_folder(tmp_path / "two", ["model.joblib"])
    facts = json.loads((tmp_path / "one" / "correction.json").read_text())
    for changed in (facts | {"x": "two"}, facts | {"std_factor": -1}, facts | {"format": 1.5}):
        (tmp_path / "two" / "correction.json").write_text(json.dumps(changed))
        with pytest.raises(ValueError, match="was changed after it was written: its fingerprint"):
            read_folder(tmp_path / "two", ["arm.json"])
    (tmp_path / "two" / "correction.json").write_text(json.dumps(facts | {"format": 3}))
    with pytest.raises(ValueError, match=r"has format 3, of a newer version.* reads 2"):
        read_folder(tmp_path / "two", ["arm.json"])
    write_folder(tmp_path / "b", {"written_by": "w 0.0.1"}, {"arm.json": "", "model.skops": b"m"})
    with pytest.raises(
        ValueError, match=r"b was written by w 0\.0\.1, whose model this version, .*l"
    ):
        Correction.load(tmp_path / "b")
    for text in ("{", "[]", "{}", '{"files": 3}'):
        (tmp_path / "two" / "correction.json").write_text(text)
        with pytest.raises(ValueError, match="holds no correction: learn again"):
            read_folder(tmp_path / "two", ["arm.json"])


# Two processes write folders of one letter each, without end, and are killed at some moment. What
# is read must be of one alone; prints how often a file was left over, and the letters read.
AT_ANY_MOMENT = """
import os, random, signal, sys, time
from pathlib import Path
from sklearn_raacmm.correction._files import read_folder, write_folder
folder, n_kills = Path(sys.argv[1]), int(sys.argv[2])
random.seed(0)

def write(letter):
    write_folder(folder, {"x": letter}, dict.fromkeys(("arm.json", "model.skops"), letter * 50000))

def read():
    facts, found = read_folder(folder, ["arm.json", "model.skops"])
    assert set(found) == {(facts["x"] * 50000).encode()}
    return facts["x"]

write("a")
(folder / "notes.tmp").write_text("mine")
left, seen = 0, set()
for _ in range(n_kills):
    children = []
    for letter in "ab":
        children.append(os.fork())
        while not children[-1]:
            write(letter)
    until = time.monotonic() + random.uniform(0.01, 0.06)
    # Where the machine has much else to do, both have not begun by then.
    while time.monotonic() < until or (len(seen) < 2 and time.monotonic() < until + 20):
        seen.add(read())
    for child in children:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    left += any(folder.glob("*.*.tmp"))
    seen.add(read())  # which tidies up
    write("a")
    names = {path.name for path in folder.iterdir()}
    assert names == {"correction.json", "arm.json", "model.skops", "notes.tmp"}, names
print(left, *sorted(seen))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork, signals, and locks of folders")
def test_two_writers_killed_at_any_moment_and_a_reader(tmp_path):
    """Nothing that is read is of both, and whoever comes next tidies up."""
    command = [sys.executable, "-c", AT_ANY_MOMENT, str(tmp_path / "out"), "10"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    left, *seen = done.stdout.split()
    assert int(left) > 0
    assert seen == ["a", "b"]


@pytest.fixture
def held(monkeypatch):
    """Names of files that cannot be replaced, as on Windows where a program holds them open."""
    names, replace = set(), os.replace

    def refuses(source, place, **options):
        if Path(place).name in names:
            raise PermissionError("in use")
        return replace(source, place, **options)

    monkeypatch.setattr(os, "replace", refuses)
    return names


@pytest.mark.parametrize(("name", "kept"), [("corrected.csv", "new"), ("correction.json", "old")])
def test_what_cannot_get_its_name_stays_beside_it(tmp_path, held, name, kept):
    write_folder(tmp_path, {"x": "old"}, {"arm.json": "old", "corrected.csv": "old"})
    held.add(name)
    new = {"arm.json": "new", "corrected.csv": "points"}
    with pytest.raises(OSError, match=rf"{name} cannot be replaced \(in use\); its cont") as caught:
        write_folder(tmp_path, {"x": "new"}, new)
    beside = Path(re.search(r"its content is in (.*)\.$", str(caught.value))[1])
    assert beside.name.startswith(name)
    facts, contents = read_folder(tmp_path, ["arm.json"])
    assert (facts["x"], contents) == (kept, [kept.encode()])
    held.clear()
    write_folder(tmp_path, {"x": "old"}, {"arm.json": "old", "corrected.csv": "old"})
    assert not list(tmp_path.glob("*.tmp"))


def test_a_table_that_another_program_holds_open(tmp_path, held):
    """It is refused before the work, and after it the result is kept."""
    table = tmp_path / "corrected.csv"
    table.write_text("old")
    held.add(table.name)
    with pytest.raises(PermissionError, match=r"Close .*corrected\.csv: it cannot be rep.*in use"):
        check_places([tmp_path / "new.csv", table])
    with (
        pytest.raises(OSError, match=r"cannot be replaced \(in use\); its content is in") as caught,
        open_beside(table, "utf-8") as file,
    ):
        file.write("points")
    beside = re.search(r"content is in (.*)\.$", str(caught.value))[1]
    assert (table.read_text(), Path(beside).read_text()) == ("old", "points")


def test_places_are_checked_before_the_work(tmp_path):
    table, folder = tmp_path / "t.csv", tmp_path / "folder"
    table.write_text("")
    folder.mkdir()
    check_places([folder / "new" / "deep" / "out.csv", tmp_path / "out.csv"], [table])
    assert not (folder / "new").exists()
    (tmp_path / "link.csv").symlink_to(table)
    for outputs, error, message in (
        ([table], ValueError, "is read and would be written over"),
        ([tmp_path / "link.csv"], ValueError, "is read and would be written over"),
        ([tmp_path / "a", folder / ".." / "a"], ValueError, "would be written twice"),
        ([folder], IsADirectoryError, "this is a folder"),
        ([table / "out.csv"], NotADirectoryError, r"t\.csv is a file, and no folder"),
    ):
        with pytest.raises(error, match=message):
            check_places(outputs, [table])
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="is no ordinary file"):
        check_places([tmp_path / "pipe"])


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root writes anywhere")
def test_a_folder_that_cannot_be_written_into(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(PermissionError, match="Nothing can be written into the folder"):
        check_places([tmp_path / "out" / "a.csv"])
    tmp_path.chmod(0o700)


@pytest.fixture
def places(tmp_path, monkeypatch):
    """A table, an arm and a correction; none of the refusals may compute anything."""
    rows = np.random.default_rng(0).uniform(-90, 90, (6, 6)).round(3)
    lines = ["cone," + ",".join(f"q{i} [deg]" for i in range(1, 7))]
    lines += [f"{'AB'[i % 2]}," + ",".join(map(str, row)) for i, row in enumerate(rows)]
    (tmp_path / "t.csv").write_text("\n".join(lines) + "\n")
    Arm.from_name("aacmm6").to_json(tmp_path / "arm.json")
    write_folder(tmp_path / "old", {}, {"arm.json": "a", "model.skops": b"m"})
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("learn t.csv --arm arm.json --out .", "arm.json is read and would be written over"),
        ("learn t.csv --arm aacmm6 --out old", "old holds a correction; --force replaces it"),
        ("learn t.csv --arm old/arm.json --out old --force", "is read and would be written over"),
        ("learn t.csv --arm aacmm6 --out t.csv", "t.csv is a file, and no folder"),
        ("correct t.csv --model old --out t.csv", "t.csv is read and would be written over"),
        ("correct t.csv --model old --out old/arm.json", "written as CSV, and old/arm.json says"),
        ("check t.csv --model old --record t.csv", "t.csv is read and would be written over"),
        ("export --model old --onnx old/model.skops", "is read and would be written over"),
        ("arm arm.json --out arm.json", "arm.json is read and would be written over"),
        ("learn t.csv --arm nothing --out o", "there is no file nothing, and as a name must be"),
        ("learn none.csv --arm ur10 --out o", "There is no file none.csv"),
        ("accept none.xlsx --arm ur10", "There is no file none.xlsx"),
        ("learn t.csv --arm ur10 --out o --points x,y", "--points needs three columns"),
        ("learn t.csv --arm ur10 --out -", "--out is a folder here"),
        ("learn t.csv --arm ur10 --out o --counts-per-turn 0", "turn needs a positive number"),
        ("learn t.csv --arm ur10 --out o --counts-per-turn x", "'x' is not a number"),
        ("correct t.csv --model . --out o.csv", "has no correction.json"),
        ("export --model old", "say what to write: --c FOLDER"),
        ("arm", "give an arm: a file, a URDF"),
        ("arm ur10 --dh x.csv", "give one arm: a file or name, --dh"),
        ("arm ur10 --probe 0,0,1", "--modified and --probe belong to --dh"),
        ("arm ur10 --into x.urdf", "--into needs --out"),
        ("arm aacmm6 --sign 1,1", "--sign needs 6 numbers, one for each joint, got '1,1'"),
        ("arm aacmm6 --sign 1,1,1,1,1,2", "--sign needs 1 or -1 for each joint"),
        ("arm aacmm6 --zero 0,0,0,0,0,x", "'x' is not a number"),
        ("arm panda --up 2,0", "--up needs 3 numbers, such as 0,0,1, got '2,0'"),
        ("arm aacmm6 --base link0", "--base and --tip name links of a URDF"),
        ("arm aacmm6 --elbow-offset nan", "belong to --lengths-222 or -223"),
    ],
)
def test_bad_arguments_get_one_sentence_and_change_no_file(places, capsys, arguments, message):
    before = {path: path.read_bytes() for path in places.rglob("*") if path.is_file()}
    assert main(arguments.split()) == 2
    assert message in capsys.readouterr().err.splitlines()[-1]
    assert {path: path.read_bytes() for path in places.rglob("*") if path.is_file()} == before


def test_json_goes_to_the_standard_output_alone(places, capsys):
    assert main(["arm", "ur10", "--out", "-"]) == 0
    printed = capsys.readouterr()
    assert Arm.from_json(printed.out) == Arm.from_name("ur10")
    assert "6 joints" in printed.err
    assert main(["arm", "ur10", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["exit_code"] == 0
    assert main(["arm", "nothing", "--json", "--quiet"]) == 2
    printed = capsys.readouterr()
    assert "there is no file nothing" in json.loads(printed.out)["error"]
    assert main(["arm", "ur10", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_help_is_there_without_the_numerics():
    code = (
        "import sys; from sklearn_raacmm.app._options import make_parser\n"
        "make_parser()\n"
        "assert not {'numpy', 'sklearn', 'scipy'} & set(sys.modules), 'imported'"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_word_nearly_right_is_named(capsys):
    for arguments, sentence in (
        ("lern", "Was learn meant?"),
        ("lern --json", "Was learn meant?"),
        ("learn t --arm=a --out=b --point-sd=1", "Was --points-sd meant?"),
        (
            "correct t --model=a --out=b --points x",
            "--points is an option of learn, check, register, update only",
        ),
    ):
        with pytest.raises(SystemExit):
            main(arguments.split())
        printed = capsys.readouterr()
        in_json = json.loads(printed.out)["error"] if "--json" in arguments else printed.err
        assert sentence in in_json


def test_whoever_closes_the_pipe_has_enough(places, monkeypatch):
    class Closed(io.StringIO):
        def write(self, text):
            raise BrokenPipeError

    with monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", Closed())
        assert main(["arm", "ur10"]) == 0


def test_every_word_has_an_example_in_its_help(capsys):
    from sklearn_raacmm.app._options import WORDS

    for word, (_, _, example, _) in WORDS.items():
        with pytest.raises(SystemExit, match="0"):
            main([word, "--help"])
        printed = capsys.readouterr().out
        assert f"example:\n  {example}" in printed
        assert "Exit codes" in printed
