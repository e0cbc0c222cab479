"""What comes with exported C: a test program, a CMake project and a header for C++17."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.export._c_columns import in_few_digits
from sklearn_raacmm.export._c_text import Numbers
from sklearn_raacmm.export._steps import leaves

# First line of a CMakeLists.txt that may be replaced.
_MARK = "# Written by sklearn_raacmm.export.export_c."
# Test rows: given ones, corners of their ranges, and what is no number.
_N_INSIDE, _N_CORNERS, _N_BAD = 20, 8, 4
# How far C may be from predict: shares of the largest expected number. Poles of the corners apart,
# double keeps 1e-12; single precision has 7 digits, of which the weights of a network cost some.
# Fading by standard deviations in few digits costs 1e-5 of them.
_TOLERANCE, _OF_FEW_DIGITS = {"double": 1e-9, "float": 2e-2}, 1e-5


def rows_to_test(rows):
    """32 rows to test with: given ones, corners of their ranges, NaN and infinity.

    Parameters
    ----------
    rows : ndarray of shape (n, n_inputs)

    Returns
    -------
    ndarray of shape (32, n_inputs)
    """
    inside = rows[np.linspace(0, len(rows) - 1, _N_INSIDE).round().astype(int)]
    low, high = rows.min(axis=0), rows.max(axis=0)
    # Corners spread over all: bit i of an odd multiple says whether input i is low or high.
    n = rows.shape[1]
    bits = (np.arange(_N_CORNERS)[:, None] * 2654435761 >> np.arange(8, 8 + n)) & 1
    bad = np.tile(inside[0], (_N_BAD, 1))
    bad[np.arange(_N_BAD), np.arange(_N_BAD) % n] = [np.nan, np.inf, -np.inf, np.nan]
    return np.concatenate([inside, np.where(bits, high, low), bad])


def expected_of(model, rows):
    """What ``predict`` gives for test rows, (n, n_outputs); NaN where it refuses."""
    finite = np.isfinite(rows).all(axis=1)
    first = np.reshape(model.predict(rows[:1]), (1, -1))
    out = np.full((len(rows), first.shape[1]), np.nan)
    for i in np.flatnonzero(finite):
        try:
            out[i] = np.reshape(model.predict(rows[i : i + 1]), -1)
        except ValueError:  # a corner where the model is not defined
            continue
    return out


_TEST = """\
/* {stem}_test.c: compares {stem}.c with what predict gave in Python, at {n} rows.
   {command} */
#include "{stem}.h"

#include <math.h>
#include <stdio.h>

{tables}
int main(void)
{{
    {real} largest = 0;
    int wrong = 0;
    for (int i = 0; i < {n}; ++i) {{
        {real} row[{d}], got[{q}];
        for (int j = 0; j < {d}; ++j)
            row[j] = input_kind[i][j] == 0 ? input[i][j]
                : input_kind[i][j] == 1 ? ({real})NAN
                : input_kind[i][j] == 2 ? ({real})INFINITY : -({real})INFINITY;
        const int status = {name}_{verb}(row, got);
        for (int k = 0; k < {q}; ++k) {{
            const {real} gap = fabs{f}(got[k] - expected[i][k]);
            if (refused[i] ? !isnan(got[k]) || status != {upper}_NOT_FINITE
                           : !(gap <= tolerance) || status == {upper}_NOT_FINITE) {{
                printf("row %d, output %d: got %.17g, expected %.17g, status %d\\n", i, k,
                    (double)got[k], (double)expected[i][k], status);
                ++wrong;
            }}
            if (!refused[i] && gap > largest)
                largest = gap;
        }}
    }}
    printf("{name}: %d of %d numbers differ; the largest gap is %.3g.\\n", wrong, {total},
        (double)largest);
    return wrong != 0;
}}
"""

_CMAKE = """\
{mark}
# cmake -S . -B build && cmake --build build && ctest --test-dir build
cmake_minimum_required(VERSION 3.10)
project({name} C)
set(CMAKE_C_STANDARD 99)
set(CMAKE_C_EXTENSIONS OFF)
if(NOT CMAKE_BUILD_TYPE)
  set(CMAKE_BUILD_TYPE Release)
endif()
add_library({name} STATIC {stem}.c)
target_include_directories({name} PUBLIC ${{CMAKE_CURRENT_SOURCE_DIR}})
if(UNIX)
  target_link_libraries({name} PUBLIC m)
endif()
enable_testing()
add_executable({name}_test {stem}_test.c)
target_link_libraries({name}_test PRIVATE {name})
add_test(NAME {name} COMMAND {name}_test)
"""

_HPP = """\
// {stem}.hpp: {stem}.h for C++17, with arrays that know their length and refusals that have a type.
#pragma once

#include <array>
#include <optional>

#include "{stem}.h"

namespace raacmm::{name} {{

using Input = std::array<{real}, {upper}_N_INPUTS>;
using Output = std::array<{real}, {upper}_N_OUTPUTS>;
{functions}
}} // namespace raacmm::{name}
"""

_HPP_FUNCTION = """
// {about}
inline std::optional<Output> {short}(const Input &input) noexcept
{{
    Output output;
    if ({name}_{short}(input.data(), output.data()) == {upper}_NOT_FINITE)
        return std::nullopt;
    return output;
}}
"""


def project_files(model, name, path, dtype, rows, corrects):
    """Texts of the files that come with ``path``.

    Parameters
    ----------
    model : estimator
    name : str
    path : pathlib.Path
        Of the C file.
    dtype : {"double", "float"}
    rows : ndarray of shape (n, n_inputs)
        Within what the model was fitted on.
    corrects : bool
        Whether the functions are ``correct`` and ``point``, not ``predict``.

    Returns
    -------
    dict of pathlib.Path to str

    Raises
    ------
    ValueError
        If a CMakeLists.txt is there that is not of this package.
    """
    cmake = path.with_name("CMakeLists.txt")
    if cmake.exists() and not cmake.read_text("utf-8", "replace").startswith(_MARK):
        raise ValueError(f"{cmake} is not of sklearn_raacmm, and is left alone: choose a folder.")
    names = {"name": name, "upper": name.upper(), "stem": path.stem, "real": dtype}
    verbs = {"correct": "The correction in mm, or nothing where the model is not defined."}
    verbs["point"] = "The corrected centre of the probe in mm, or nothing."
    if not corrects:
        verbs = {"predict": "The prediction, or nothing where the model is not defined."}
    functions = "".join(
        _HPP_FUNCTION.format(short=verb, about=about, **names) for verb, about in verbs.items()
    )
    return {
        path.with_name(f"{path.stem}_test.c"): _test(model, names, rows, next(iter(verbs))),
        path.with_suffix(".hpp"): _HPP.format(functions=functions, **names),
        cmake: _CMAKE.format(mark=_MARK, **names),
    }


def _test(model, names, rows, verb):
    """Text of the test program."""
    numbers = Numbers(names["real"])
    rows = rows_to_test(rows).astype(numbers.literal_type).astype(float)
    expected = expected_of(model, rows)
    refused = np.isnan(expected).any(axis=1)
    kind = np.select([np.isnan(rows), rows == np.inf, rows == -np.inf], [1, 2, 3], 0)
    linear = [getattr(step.estimator, "linear_model_", None) for step in leaves(model)]
    few = any(in_few_digits(one) for one in linear if one is not None)
    share = max(_TOLERANCE[names["real"]], _OF_FEW_DIGITS * few)
    tolerance = share * np.abs(expected[~refused]).max(initial=1e-3)
    tables = numbers.table("input", np.where(kind == 0, rows, 0.0))
    tables += numbers.integers("input_kind", kind, "0 a number, 1 NaN, 2 infinity, 3 -infinity")
    tables += numbers.table("expected", np.where(refused[:, None], 0.0, expected))
    tables += numbers.integers("refused", refused, "1 where all outputs have to be NaN")
    tables += f"static const {numbers.real} tolerance = {numbers.literal(tolerance)};\n"
    stem, (n, q) = names["stem"], expected.shape
    return _TEST.format(
        tables=tables,
        n=n,
        d=rows.shape[1],
        q=q,
        f=numbers.suffix,
        verb=verb,
        total=expected.size,
        command=f"cc -std=c99 -O2 -o {stem}_test {stem}_test.c {stem}.c -lm && ./{stem}_test",
        **names,
    )


def check_rows(poses, n_inputs):
    """Rows as float64, or one clear sentence."""
    rows = np.asarray(poses, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != n_inputs or not len(rows) or not np.isfinite(rows).all():
        raise ValueError(
            f"poses must be rows of {n_inputs} finite numbers, at least one; got shape {rows.shape}"
            f"{'' if np.isfinite(rows).all() else ' with NaN or infinity'}."
        )
    return rows
