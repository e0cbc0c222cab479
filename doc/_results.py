"""Numbers of `results.json` and `benchmarks.json` as the README and the pages show them.

``benchmarks/make_results.py`` writes the first file; the second says which command measured each
of its entries, and when. Pages take numbers and tables from here when the site is built, as MyST
substitutions such as ``{{ table_regressors }}``. The README is read without a build: it has them in
blocks that :func:`write_readme` writes and a test compares.
"""

import json
import math
from pathlib import Path

FILE = Path(__file__).resolve().parent / "results.json"
BENCHMARKS = FILE.with_name("benchmarks.json")
README = FILE.parent.parent / "README.md"

MIXES = ("gravity", "typical", "eccentricity")
REAL = ("real, panda_3", "real, panda_2", "real, ur10")
SEEDS = 3
SPACE = "\u00a0"  # between a number and its unit, so that no line ends there
UNCORRECTED, PERFECT = "-: uncorrected", "-: perfect model"
NEWRB = "pose angles: RBF network, newrb"
ONE_WIDTH = "pose angles: RBF network, one width"
THREE = "pose angles: RBF network"
CARTESIAN = "pose angles: RBF network, Cartesian"
ALL = "all joints, cos and sin: RBF network"
LINEAR = "all joints: ArmResidualRegressor"
NAMES = {
    UNCORRECTED: "none",
    NEWRB: "paper's network, three inputs",
    THREE: "`RBFNetRegressor`, three inputs",
    "pose angles: kernel ridge": "kernel ridge, three inputs",
    "pose angles: extra trees": "extra trees, three inputs",
    ALL: "`RBFNetRegressor`, all joints",
    LINEAR: "`ArmResidualRegressor`",
    PERFECT: "perfect model",
}
HEADLINE_ROWS = {
    "real, panda_3": "Franka Panda `panda_3`, {folds} placements",
    "real, panda_2": "Franka Panda `panda_2`, {folds} placements",
    "real, ur10": "UR10 against a laser tracker, {rows} poses",
}


class Results:
    """The file, asked by data set and model."""

    def __init__(self, contents):
        self.few_poses = contents["few_poses"]
        self.authors = contents["authors"]
        self.comparisons = contents["comparisons"]
        self.parts = contents.get("parts", {})

    def of(self, data, model):
        """Measures of one model on one data set."""
        return self.comparisons[data]["models"][model]

    def has(self, data, model):
        """Tell whether a model was run on a data set."""
        return model in self.comparisons.get(data, {}).get("models", {})

    def seeds(self, mix, model):
        """Numbers of the individuals of a simulated arm on which a model was run."""
        return [seed for seed in range(SEEDS) if self.has(simulated(mix, seed), model)]

    def days(self, data_sets, models):
        """Days on which some models were measured on some data sets: one, or the first and last."""
        made = [
            self.of(data, model)["made"]["date"]
            for data in data_sets
            for model in models
            if self.has(data, model)
        ]
        return " to ".join(sorted({min(made), max(made)}))

    def less(self, data, model, measure="mean_mm"):
        """Reduction of a measure, in per cent of what was uncorrected."""
        before = self.of(data, UNCORRECTED)[measure]
        return 100 * (1 - self.of(data, model)[measure] / before)


def read():
    """Results of the file."""
    return Results(json.loads(FILE.read_text(encoding="utf-8")))


def simulated(mix, seed=0):
    """Name of a simulated data set."""
    return f"simulated, {mix}, seed {seed}"


def markdown(head, rows):
    """A table in Markdown."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def dated(head, rows, days):
    """A table, and below it the day on which its numbers were measured, or the first and last."""
    return f"{markdown(head, rows)}\n\n*Measured on {days}.*"


def per_cent(value):
    """A share, on one line with its sign."""
    return f"{value:.0f}{SPACE}%"


def listed(values):
    """Numbers as a list in a sentence: 1, 2 and 3."""
    texts = [f"{value:.0f}" for value in values]
    return f"{', '.join(texts[:-1])} and {texts[-1]}"


def span(values):
    """The least and the largest of some numbers: 1 to 3."""
    values = [round(value) for value in values]
    return f"{min(values)} to {max(values)}"


# -- the README -----------------------------------------------------------------------------------


def headline_table(results):
    """Mean deviations of the README's table."""
    # Our own model beside the uncorrected arm: narrow screens show the first columns.
    head = ["data", "uncorrected", "`ArmResidualRegressor`"]
    head += ["RBF network, all joints", "RBF network, three inputs"]
    rows = []
    models = (UNCORRECTED, LINEAR, ALL, THREE)
    for data, title in HEADLINE_ROWS.items():
        values = (results.of(data, model)["mean_mm"] for model in models)
        rows.append([title.format(**results.comparisons[data]), *(f"{v:.3f}" for v in values)])
    return dated(head, rows, results.days(HEADLINE_ROWS, models))


def readme_blocks(results):
    """Text of each block of the README by its name."""
    less = [results.less(data, LINEAR) for data in REAL]
    return {
        "headline": (
            f"**On three real robots `ArmResidualRegressor` took {listed(less)} % off the mean "
            "deviation that\ncalibration had left**."
        ),
        "table": headline_table(results),
    }


def filled(text, results):
    """Text of the README with its blocks made anew."""
    for name, block in readme_blocks(results).items():
        start, end = f"<!-- {name}: from doc/results.json -->\n", "\n<!-- end -->"
        if text.count(start) != 1:
            raise ValueError(f"README.md has {text.count(start)} blocks {name!r}, but needs one.")
        before, rest = text.split(start)
        text = before + start + block + rest[rest.index(end) :]
    return text


def write_readme():
    """Write the README's blocks anew."""
    README.write_text(filled(README.read_text(encoding="utf-8"), read()), encoding="utf-8")


# -- the pages ------------------------------------------------------------------------------------


def paper_table(results):
    """The paper's measures on three simulated arms."""
    head = ["mix", "correction", "2S max / mean", "less", "of possible"]
    head += ["300 mm max / mean", "500 mm max / mean", "500 mm mean, scaled"]
    models = (UNCORRECTED, NEWRB, THREE, "pose angles: kernel ridge", ALL, LINEAR, PERFECT)
    rows = []
    for mix in MIXES:
        for model in models:
            r = results.of(simulated(mix), model)
            share = [per_cent(100 * r[key]) if key in r else "" for key in ("less", "of_possible")]
            rows.append([mix, NAMES[model], _pair(r, "two_s"), *share])
            rows[-1] += [_pair(r, "length_300"), _pair(r, "length_500")]
            rows[-1] += [f"{1000 * r['scaled_mean_mm']:.1f}"]
    return dated(head, rows, results.days(map(simulated, MIXES), models))


def _pair(record, name):
    largest, mean = (1000 * record[f"{name}_{which}_mm"] for which in ("max", "mean"))
    return f"{largest:.1f}{SPACE}/ {mean:.1f}"


def individuals_table(results):
    """Reduction of the mean 2S for several individuals of each simulated arm."""
    models = (LINEAR, NEWRB, ONE_WIDTH, THREE, ALL, PERFECT)
    rows = []
    for mix in MIXES:
        cells = [
            " / ".join(
                f"{results.less(simulated(mix, seed), model, 'two_s_mean_mm'):.0f}"
                for seed in results.seeds(mix, model)
            )
            for model in models
        ]
        rows.append([mix, *(f"{cell}{SPACE}%" for cell in cells)])
    heads = ("arm's model", "paper's network", "one width", "widths by feature", "all joints")
    arms = [simulated(mix, seed) for mix in MIXES for seed in range(SEEDS)]
    return dated(["mix", *heads, "perfect"], rows, results.days(arms, models))


def regressors_table(results):
    """Every regressor on three simulated arms, with its costs."""
    head = ["inputs", "regressor", *MIXES, "fit (s)", "predict (µs)", "size (kB)"]
    sets, rows = [simulated(mix) for mix in MIXES], []
    shown = [
        model
        for model in results.comparisons[simulated("typical")]["models"]
        if all(results.has(data, model) for data in sets)
    ]
    for model in shown:
        inputs, name = model.split(": ")
        cells = []
        for mix in MIXES:
            r = results.of(simulated(mix), model)
            share = f" ({per_cent(100 * r['of_possible'])})" if "of_possible" in r else ""
            cells.append(f"{1000 * r['two_s_mean_mm']:.1f}{share}")
        r = results.of(simulated("typical"), model)
        costs = [""] * 3
        if "fit_seconds" in r:
            costs = [f"{r['fit_seconds']:.2g}", f"{1e6 * r['predict_seconds_per_row']:.0f}"]
            costs += [f"{r['pickle_bytes'] / 1000:.0f}"]
        rows.append([inputs, name, *cells, *costs])
    return dated(head, _in_order(rows), results.days(sets, shown))


def real_table(results):
    """Every regressor on three real arms."""
    head = ["inputs", "regressor"]
    head += [f"{data.removeprefix('real, ')}: mean / max, 2S" for data in REAL]
    rows = []
    models = results.comparisons[REAL[0]]["models"]
    shown = [model for model in models if all(results.has(data, model) for data in REAL)]
    for model in shown:
        cells = []
        for data in REAL:
            r = results.of(data, model)
            cell = f"{r['mean_mm']:.3f} / {r['max_mm']:.3f}, {r['two_s_mean_mm']:.3f}"
            cells.append(cell.replace(" ", SPACE))
        rows.append([*model.split(": "), *cells])
    return dated(head, _in_order(rows), results.days(REAL, shown))


def _in_order(rows):
    """Uncorrected first, then by inputs (named shortly) and name, a perfect model last."""
    order = ["pose angles", "theta2 to theta4", "all joints, cos and sin", "all joints"]

    def key(row):
        if row[0] == "-":
            return (-1 if row[1] == "uncorrected" else 9, "")
        return (order.index(row[0]), row[1])

    short = {
        "pose angles": "pose",
        "theta2 to theta4": "theta2 to 4",
        "all joints, cos and sin": "all, cos and sin",
        "all joints": "all",
    }
    return [[short.get(inputs, inputs), *row] for inputs, *row in sorted(rows, key=key)]


def r2_table(results):
    """R2 as it is and with one constant for each position."""
    models = (THREE, "pose angles: extra trees", ALL, LINEAR, PERFECT)
    rows = []
    for model in models:
        found = [results.of(simulated(mix), model) for mix in MIXES]
        rows.append([NAMES[model], *(f"{r['r2']:.2f}, {r['r2_within']:.2f}" for r in found)])
    head = ["model", *(f"{mix}: R2, within" for mix in MIXES)]
    return dated(head, rows, results.days(map(simulated, MIXES), models))


def published_table(results):
    """A published result beside ours on similar data."""
    random, unseen = results.few_poses["random"], results.few_poses["unseen goals"]
    rows = [
        [
            "UR5, transformer with the robot's kinematics (arXiv 2506.22788)",
            "579 of 724, drawn at random",
            "-",
            "0.2515 (0.15)",
        ],
        ["UR10, `ArmResidualRegressor`", "579 of 724, drawn at random", *_few(random)],
        ["UR10, `ArmResidualRegressor`", "500, judged at goals without any pose", *_few(unseen)],
    ]
    head = ["robot and model", "poses to learn from", "before (mm)", "after: mean (sd) (mm)"]
    return dated(head, rows, results.few_poses["made"]["date"])


def authors_table(results):
    """The calibration of the data's authors beside ours."""
    left_out = {name: results.of("real, panda_3", name) for name in (UNCORRECTED, LINEAR)}
    rows = [
        ["the authors' calibrated URDF", "not stated", results.authors["theirs"]],
        ["`calibrate`", "yes", results.authors["ours"]],
        ["`calibrate`", "no", left_out[UNCORRECTED]],
        ["`calibrate`, then `ArmResidualRegressor`", "no", left_out[LINEAR]],
    ]
    days = {results.authors["made"]["date"], *(r["made"]["date"] for r in left_out.values())}
    return dated(
        ["from", "has seen the sockets it is judged at", "mean (mm)", "largest (mm)"],
        [[*row, f"{r['mean_mm']:.3f}", f"{r['max_mm']:.3f}"] for *row, r in rows],
        " to ".join(sorted({min(days), max(days)})),
    )


def choice_table(results):
    """What the choice of an estimator was worth on the real arms."""
    models = {
        UNCORRECTED: "calibrated only",
        THREE: "the published inputs, `RBFNetRegressor`",
        ALL: "all joints, `RBFNetRegressor`",
        LINEAR: "`ArmResidualRegressor`",
    }
    rows = [
        [title, *(f"{results.of(data, model)['mean_mm']:.3f}" for data in REAL)]
        for model, title in models.items()
    ]
    head = ["estimator", *(data.removeprefix("real, ") for data in REAL)]
    return dated(head, rows, results.days(REAL, models))


# Tables of parts of the benchmarks: part, title of its table there, head, columns there, how their
# numbers are written, and by the first cells of each row its name there.
_REGISTERED = ("no correction", "updated", "registered through it", "registered without it")
_PROBES = ("uncorrected", "not moved", "moved", "learnt with two, moved", "new fit")
_STARTS = ("calibrated", "new fit", "of 1", "of 4")
PART_TABLES = {
    "series": (
        ["known poses", *_REGISTERED],
        _REGISTERED,
        ".3f",
        {("10",): ("poses of B known; mm", "10"), ("200",): ("poses of B known; mm", "200")},
    ),
    "probes": (
        [
            "probe",
            "uncorrected",
            "registered, model not moved",
            "moved",
            "learned with 100 and 250 mm, moved",
            "new fit on 14 cones",
        ],
        _PROBES,
        ".1f",
        {(f"{mm} mm",): ("probe, mm; 2S in um", f"{mm}") for mm in (150, 250, 400)},
    ),
    "plan": (
        ["first test", "at poses by chance", "at poses of another plan"],
        ("poses by chance", "of another plan"),
        ".0f",
        {(name,): ("first test; 2S in um", name) for name in ("by chance", "planned")},
    ),
    "transfer": (
        ["new arm", "poses", "calibrated only", "new fit", "from one earlier arm", "from four"],
        _STARTS,
        ".3f",
        {
            ("simulated robot, tracker", "20"): ("robots: poses; mm", "20"),
            ("simulated arm, single points", "4 positions"): ("arms: positions; mm", "4"),
        },
    ),
    "lengths": (
        ["known", "rms", "worst arm"],
        ("rms", "worst arm"),
        ".0f",
        {("nothing",): ("error in 1 m, um", "none")}
        | {
            (f"a bar of {mm} mm at {at}",): ("error in 1 m, um", f"{mm} mm at {at}")
            for at in ("one place", "three places")
            for mm in (300, 500, 1000)
        },
    ),
    "scale": (
        ["lengths in the table", "error in mm", "error over `scale_sd`"],
        ("rms", "over scale_sd"),
        ".2f",
        {
            (said,): ("error in 1 m, mm", name)
            for said, name in {
                "good to tenths of a millimetre": "within tenths of a millimetre",
                "of a drawing, off by 0.1 to 0.7 mm at random": "the drawing",
                "750 and 500 for 750.7 and 500.6: both 0.1 % short": (
                    "750 and 500 for 750.7 and 500.6"
                ),
                "by tape, within 3 mm": "lengths by tape, +-3 mm",
            }.items()
        },
    ),
}


def part_table(results, part):
    """A table of a part of the benchmarks."""
    head, columns, form, rows = PART_TABLES[part]
    tables = results.parts[part]["tables"]
    lines = [
        [*cells, *(format(tables[title][name][column], form) for column in columns)]
        for cells, (title, name) in rows.items()
    ]
    return dated(head, lines, results.parts[part]["made"]["date"])


def extra_table(results):
    """What columns of other causes are worth, median and worst, with over without them."""
    (found,) = results.parts["extra"]["tables"].values()
    rows = []
    for case in ("direction", "temperature", "payload"):
        ways = (found[f"{case}, {how}, as cause"] for how in ("single-point", "tracker"))
        cells = (f"{way['median']:.3f}, {way['worst']:.3f}" for way in ways)
        rows.append([case if case != "direction" else "direction, six joints", *cells])
    date = results.parts["extra"]["made"]["date"]
    return dated(["column", "single-point test", "tracker"], rows, date)


# Alarms of checks: names of the pages, and of `benchmarks/bench_check.py`.
CHANGED = {
    "none": "none",
    "knock of 20 arc seconds": "knock of 20 arc seconds",
    "5 K warmer, steel": "5 K warmer",
}
CHECKED = {
    "typical": "typical",
    "gravity": "gravity",
    "soft, nonlinear elbow": "soft elbow",
    "wobble of 12 arc seconds": "wobble",
    "backlash of 6 arc seconds": "hysteresis",
}


def changes_table(results):
    """Share of checks with an alarm, and how many of these named the right cause."""
    tables = results.parts["changes"]["tables"]
    rows = []
    for change, name in CHANGED.items():
        cells = []
        for arm in ("simulated", "UR10"):
            found = tables[f"checks, {arm}"][name]
            alarms = found["alarms"]
            cells.append(f"{100 * alarms / found['checks']:.1f}{SPACE}%")
            right = f"{found['named rightly']:.0f} of {alarms:.0f}"
            cells.append("" if name == "none" else right)
        rows.append([change, *cells])
    head = ["change", "alarm, simulated", "named rightly", "alarm, UR10", "named rightly"]
    return dated(head, rows, results.parts["changes"]["made"]["date"])


def kinds_table(results):
    """Alarms of checks by the kind of arm."""
    tables = results.parts["kinds"]["tables"]

    def of(arm, change, part="alarms", among="checks"):
        found = tables[f"checks, {arm}"][change]
        return f"{found[part]:.0f}/{found[among]:.0f}"

    knocked, twice, rows = "knock of 10 arc s", "corrected twice", []
    for title, arm in CHECKED.items():
        cells = [of(arm, "none"), of(arm, knocked), of(arm, knocked, "named rightly", "alarms")]
        rows.append([title, *cells, of(arm, twice), of(arm, twice, "clear")])
    for title, change in (
        ("settled", "base settled by 40 um"),
        ("drifting", "base drifts by 40 um"),
    ):
        cells = [of("tracker", change), of("tracker", change, "named rightly", "alarms")]
        rows.append([f"tracker: base {title} by 40 µm", of("tracker", "none"), *cells, "", ""])
    head = ["kind of arm", "false alarms", "knock of 10 arc seconds found", "cause named rightly"]
    head += ["corrected twice: found", "p < 1e-4"]
    return dated(head, rows, results.parts["kinds"]["made"]["date"])


# -- benchmarks.json ------------------------------------------------------------------------------


def problems_table(measured):
    """Error of the network over that of a Gaussian process, and what its intervals hold."""
    error, inside = (measured[key]["of"] for key in ("over_gaussian_process", "inside_95_percent"))
    sizes = [str(n) for n in measured["over_gaussian_process"]["rows"]]
    rows = [
        [f"`{name}`", *(f"{e:.3f}" for e in error[name]), *(f"{i:.1f}" for i in inside[name])]
        for name in error
    ]
    means = [
        math.exp(sum(map(math.log, values)) / len(error))
        for values in zip(*error.values(), strict=True)
    ]
    rows.append(["geometric mean", *(f"{mean:.3f}" for mean in means), *[""] * len(sizes)])
    head = ["problem", f"error: {sizes[0]} rows", *sizes[1:]]
    head += [f"in 95 %: {sizes[0]} rows", *sizes[1:]]
    return dated(head, rows, measured["date"])


def large_table(measured, kinds):
    """What fits of many rows take: those of some `kinds`, by their names in the file."""
    names = {"given": "given", "found_by_itself": "found by itself"}
    rows = [
        [
            f"{one['rows']:,}".replace(",", SPACE),
            names[kind],
            f"{one['cpu_seconds']:.3g}",
            f"{one['memory_mib']}",
            f"{one['centers']}",
            f"{one['mean_squared_residual']:.5f}",
        ]
        for kind in kinds
        for one in measured[kind]
    ]
    head = ["rows", "widths and ridge", "CPU (s)", "memory above imports (MiB)", "centres"]
    head += ["mean squared residual"]
    return dated(head, rows, measured["date"])


def ideas_table(measured):
    """Mean and largest deviation as causes join the arm's model."""
    rows = []
    for name, means in measured["mean_mm"].items():
        pairs = list(zip(means, measured["max_mm"][name], strict=True))
        pairs += [measured["default_without_offsets_mean_and_max_mm"].get(name, ())]
        cells = [" / ".join(f"{v:.{4 - i}f}" for i, v in enumerate(pair)) for pair in pairs]
        rows.append([name, *(cell.replace(" ", SPACE) for cell in cells)])
    head = [step.replace("\n", " ") for step in measured["steps"]]
    return dated(["", *head, "default, no offsets"], rows, measured["date"])


def _few(record):
    return [
        f"{record['uncorrected_mean_mm']:.3f}",
        f"{record['mean_mm']:.3f} ({record['sd_mm']:.2f})",
    ]


def sentences(results):
    """Single numbers and ranges of the pages by name."""
    values = {}
    names = {"three": THREE, "all": ALL, "linear": LINEAR, "perfect": PERFECT, "newrb": NEWRB}
    names |= {"cartesian": CARTESIAN, "one_width": ONE_WIDTH}
    two_s, length = "two_s_mean_mm", "length_{}_mean_mm"
    for mix in MIXES:
        for key, model in names.items():
            data = simulated(mix)
            if results.has(data, model):
                values[f"less_{key}_{mix}"] = f"{results.less(data, model, two_s):.0f}"
        pose = [m for m in results.comparisons[simulated(mix)]["models"] if _three_inputs(m)]
        values[f"span_three_{mix}"] = span(
            results.less(simulated(mix), m, two_s) for m in pose if "polynomial" not in m
        )
        values[f"cartesian_{mix}"] = " / ".join(
            f"{-results.less(simulated(mix, seed), CARTESIAN, two_s):+.0f}"
            for seed in results.seeds(mix, CARTESIAN)
        )
    sets = [simulated(mix) for mix in MIXES]
    values["span_perfect"] = span(results.less(data, PERFECT, two_s) for data in sets)
    possible = [100 * results.of(data, LINEAR)["of_possible"] for data in sets]
    values["span_linear_possible"] = span(possible)
    three = (NEWRB, THREE, "pose angles: kernel ridge")
    for size in (300, 500):
        measure = length.format(size)
        values[f"span_linear_{size}"] = span(results.less(data, LINEAR, measure) for data in sets)
    values["span_three_lengths"] = span(
        results.less(d, m, length.format(size)) for d in sets for m in three for size in (300, 500)
    )
    values["span_linear_lengths"] = span(
        results.less(d, LINEAR, length.format(size)) for d in sets for size in (300, 500)
    )
    values["span_linear_scaled"] = span(results.less(d, LINEAR, "scaled_mean_mm") for d in sets)
    for name, key in (("random", "random"), ("unseen", "unseen goals")):
        for end in ("low", "high"):
            found = results.few_poses[key][f"{end}est_mean_mm"]
            values[f"few_{name}_{end}"] = f"{found:.3f}"
    for data in REAL:
        name = data.removeprefix("real, ")
        values[f"before_{name}"] = f"{results.of(data, UNCORRECTED)['mean_mm']:.3f}"
        for key, model in names.items():
            if results.has(data, model):
                values[f"{key}_{name}"] = f"{results.of(data, model)['mean_mm']:.3f}"
                values[f"less_{key}_{name}"] = f"{results.less(data, model):.0f}"
    keys = {"updated": "updated", "few": "new fit, a fifth", "new": "new fit, all"}
    robots = results.parts["months"]["tables"]["poses of a new fit; mm"]
    for key, column in keys.items():
        values[f"months_{key}"] = f"{robots['300'][column]:.3f}"
    values["sentence_months"] = " ".join(
        f"{int(n) // 5} of {n} poses: {', '.join(f'{row[c]:.3f}' for c in keys.values())}."
        for n, row in robots.items()
    )
    return values


def _three_hundred(results):
    """A sentence on as many poses as the paper has, where they have been run."""
    few, many = simulated("typical"), f"{simulated('typical')}, 300 poses"
    if not (results.has(many, NEWRB) and results.has(many, LINEAR)):
        return ""
    values = [
        f"{1000 * results.of(data, model)['two_s_mean_mm']:.0f}"
        for model in (UNCORRECTED, NEWRB, LINEAR)
        for data in (few, many)
    ]
    return (
        "With 300 poses at each position instead of 60, as the paper has them, the mean 2S on the "
        "typical arm is {1} instead of {0} µm before the correction, {3} instead of {2} µm after "
        "the paper's network, and {5} instead of {4} µm after `ArmResidualRegressor`."
    ).format(*values)


def _three_inputs(model):
    return model.startswith("pose angles") and "Cartesian" not in model


def substitutions():
    """Tables and numbers of the pages by name."""
    results = read()
    measured = json.loads(BENCHMARKS.read_text(encoding="utf-8"))
    return {
        "table_headline": headline_table(results),
        "table_choice": choice_table(results),
        "table_paper": paper_table(results),
        "table_individuals": individuals_table(results),
        "table_regressors": regressors_table(results),
        "table_real": real_table(results),
        "table_r2": r2_table(results),
        "table_published": published_table(results),
        "table_authors": authors_table(results),
        "sentence_300": _three_hundred(results),
        **{f"table_{part}": part_table(results, part) for part in PART_TABLES},
        "table_extra": extra_table(results),
        "table_changes": changes_table(results),
        "table_kinds": kinds_table(results),
        "table_problems": problems_table(measured["problems"]),
        "table_large": large_table(measured["rows"], ["found_by_itself"]),
        "table_large_given": large_table(measured["rows"], ["given", "found_by_itself"]),
        "table_ideas": ideas_table(measured["ideas"]),
        **sentences(results),
    }
