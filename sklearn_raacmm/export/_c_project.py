"""What comes with exported C: a test program and a CMake project."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re

import numpy as np

from sklearn_raacmm._version import __version__
from sklearn_raacmm.export._c_text import Tables
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
install(FILES {stem}.h DESTINATION ${{CMAKE_INSTALL_INCLUDEDIR}})
install(EXPORT {name} NAMESPACE {name}:: FILE {name}-config.cmake DESTINATION ${{PACKAGE_PLACE}})
write_basic_package_version_file({name}-config-version.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${{CMAKE_CURRENT_BINARY_DIR}}/{name}-config-version.cmake
  DESTINATION ${{PACKAGE_PLACE}})
enable_testing()
add_executable({name}_test {stem}_test.c)
target_link_libraries({name}_test PRIVATE {name})
add_test(NAME {name} COMMAND {name}_test)
"""


def project_files(rows, gap, name, path, dtype, corrects):
    """Texts of the files that come with `path`, that of the C file: a dict of pathlib.Path to str.

    `rows` are test rows and their answers, from which the same operations in Python are `gap` away.
    ``corrects`` says whether the function is ``correct``, not ``predict``.
    """
    cmake = path.with_name("CMakeLists.txt")
    if cmake.exists() and not cmake.read_text("utf-8", "replace").startswith(_MARK):
        raise ValueError(f"{cmake} is not of sklearn_raacmm, and is left alone: choose a folder.")
    version, stem = re.findall(r"^\d+(?:\.\d+)*", __version__)[0], path.stem
    write, X, expected = Tables(dtype), rows["X"], rows["y"]
    refused = np.isnan(expected).any(axis=1)
    kind = np.select([np.isnan(X), np.inf == X, -np.inf == X], [1, 2, 3], 0)
    tolerance = TOLERANCE[dtype] * np.abs(expected[~refused]).max(initial=1e-3)
    tolerance = max(tolerance, 10 * gap)
    tables = write.table("input", np.where(kind == 0, X, 0.0))
    tables += write.table("input_kind", kind, "0 a number, 1 NaN, 2 infinity, 3 -infinity")
    tables += write.table("expected", np.where(refused[:, None], 0.0, expected))
    tables += write.table("refused", refused, "1 where all outputs have to be NaN")
    tables += f"static const {dtype} tolerance = {write.literal(tolerance)};\n"
    n, q = expected.shape
    test = _TEST.format(
        tables=tables, n=n, d=X.shape[1], q=q, f=write.suffix, total=expected.size, real=dtype,
        verb="correct" if corrects else "predict", name=name, upper=name.upper(), stem=stem,
        command=f"cc -std=c99 -O2 -o {stem}_test {stem}_test.c {stem}.c -lm && ./{stem}_test",
    )  # fmt: skip
    project = _CMAKE.format(mark=_MARK, version=version, name=name, stem=stem)
    return {path.with_name(f"{stem}_test.c"): test, cmake: project}
