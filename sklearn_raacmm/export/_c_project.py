"""What comes with exported C: a test program, a CMake project and a header for C++17."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re

import numpy as np

from sklearn_raacmm._version import __version__
from sklearn_raacmm.export._c_text import Numbers
from sklearn_raacmm.export._proof import TOLERANCE

# First line of a CMakeLists.txt that may be replaced.
_MARK = "# Written by sklearn_raacmm.export.export_c."

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
# cmake --install build --prefix PLACE; then, in your project: find_package({name} {version}) and
# target_link_libraries(yours PRIVATE {name}::{name})
cmake_minimum_required(VERSION 3.12)
project({name} VERSION {version} LANGUAGES C)
set(CMAKE_C_STANDARD 99)
set(CMAKE_C_EXTENSIONS OFF)
if(NOT CMAKE_BUILD_TYPE)
  set(CMAKE_BUILD_TYPE Release)
endif()
include(GNUInstallDirs)
include(CMakePackageConfigHelpers)
add_library({name} STATIC {stem}.c)
add_library({name}::{name} ALIAS {name})
target_include_directories({name} PUBLIC
  $<BUILD_INTERFACE:${{CMAKE_CURRENT_SOURCE_DIR}}>
  $<INSTALL_INTERFACE:${{CMAKE_INSTALL_INCLUDEDIR}}>)
if(UNIX)
  target_link_libraries({name} PUBLIC m)
endif()
set(PACKAGE_PLACE ${{CMAKE_INSTALL_LIBDIR}}/cmake/{name})
install(TARGETS {name} EXPORT {name} ARCHIVE DESTINATION ${{CMAKE_INSTALL_LIBDIR}})
install(FILES {stem}.h {stem}.hpp DESTINATION ${{CMAKE_INSTALL_INCLUDEDIR}})
install(EXPORT {name} NAMESPACE {name}:: FILE {name}-config.cmake DESTINATION ${{PACKAGE_PLACE}})
write_basic_package_version_file({name}-config-version.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${{CMAKE_CURRENT_BINARY_DIR}}/{name}-config-version.cmake
  DESTINATION ${{PACKAGE_PLACE}})
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


def project_files(rows, gap, name, path, dtype, corrects):
    """Texts of the files that come with `path`, that of the C file: a dict of pathlib.Path to str.

    `rows` are test rows and their answers, from which the same operations in Python are `gap` away.
    ``corrects`` says whether the functions are ``correct`` and ``point``, not ``predict``.
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
    version = re.findall(r"^\d+(?:\.\d+)*", __version__)[0]
    return {
        path.with_name(f"{path.stem}_test.c"): _test(rows, gap, names, next(iter(verbs))),
        path.with_suffix(".hpp"): _HPP.format(functions=functions, **names),
        cmake: _CMAKE.format(mark=_MARK, version=version, **names),
    }


def _test(rows, gap, names, verb):
    """Text of the test program."""
    numbers, X, expected = Numbers(names["real"]), rows["X"], rows["y"]
    refused = np.isnan(expected).any(axis=1)
    kind = np.select([np.isnan(X), np.inf == X, -np.inf == X], [1, 2, 3], 0)
    tolerance = TOLERANCE[names["real"]] * np.abs(expected[~refused]).max(initial=1e-3)
    tolerance = max(tolerance, 10 * gap)
    tables = numbers.table("input", np.where(kind == 0, X, 0.0))
    tables += numbers.integers("input_kind", kind, "0 a number, 1 NaN, 2 infinity, 3 -infinity")
    tables += numbers.table("expected", np.where(refused[:, None], 0.0, expected))
    tables += numbers.integers("refused", refused, "1 where all outputs have to be NaN")
    tables += f"static const {numbers.real} tolerance = {numbers.literal(tolerance)};\n"
    stem, (n, q) = names["stem"], expected.shape
    return _TEST.format(
        tables=tables,
        n=n,
        d=X.shape[1],
        q=q,
        f=numbers.suffix,
        verb=verb,
        total=expected.size,
        command=f"cc -std=c99 -O2 -o {stem}_test {stem}_test.c {stem}.c -lm && ./{stem}_test",
        **names,
    )
